"""Panels of `charts`, drawn by Matplotlib."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import EllipseCollection, PolyCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator

from ..charts.panel import Band, Bars, Chart, Dots, Ellipses, Level, Line, Mark, Panel
from . import style

_SHAPES = {"disc": "o", "cross": "x", "tick": "|", "triangle": "^", "square": "s"}
_DASHES = (0, (4, 2))
_POINTS_OF_AN_ELLIPSE = 25
_WIDE_IN = 6.0


def chart_figure(chart: Chart) -> Figure:
    """A chart as a figure, in the house's style."""
    with style.house_style():
        figure = style.new_figure(chart.width_in, chart.height_in)
        count, shares = len(chart.panels), chart.shares
        if chart.stacked:
            axes = figure.subplots(count, 1, sharex=True, height_ratios=shares, squeeze=False)
        else:
            axes = figure.subplots(1, count, width_ratios=shares, squeeze=False)
        for axis, panel in zip(axes.ravel(), chart.panels, strict=True):
            draw_panel(axis, panel)
    return figure


def draw_panel(axis: Axes, panel: Panel) -> Axes:
    """Draws a panel into axes."""
    if panel.x_log:
        axis.set_xscale("log")
    if panel.y_log:
        axis.set_yscale("log")
    handles = [_DRAWN[type(mark)](axis, mark) for mark in panel.marks]
    # Limits that are fixed would be widened by an equal scale all the same, with a complaint in the log.
    axis.set_xlim(panel.x_range, auto=panel.equal)
    axis.set_ylim(panel.y_range, auto=panel.equal)
    if panel.equal:
        axis.set_aspect("equal", adjustable="datalim")
        is_wide = not isinstance(axis.figure, Figure) or axis.figure.get_figwidth() > _WIDE_IN
        for side in (axis.xaxis, axis.yaxis):
            side.set_major_locator(MaxNLocator(nbins=9 if is_wide else 6, steps=[1, 2, 5, 10]))
    for side, is_log in ((axis.xaxis, panel.x_log), (axis.yaxis, panel.y_log)):
        if is_log:
            style.plain_log_ticks(side)
    if panel.rows:
        axis.set_yticks(range(len(panel.rows)), panel.rows)
        axis.grid(visible=False)
    axis.set_title(panel.title)
    axis.set_xlabel(panel.x_label)
    axis.set_ylabel(panel.y_label)
    labelled = [handle for handle, mark in zip(handles, panel.marks, strict=True) if mark.label]
    if not panel.x_numbers:
        axis.tick_params(axis="x", labelbottom=False)
        below: dict[str, Any] = {"loc": "upper center", "bbox_to_anchor": (0.5, -0.04), "borderaxespad": 0.0}
        axis.legend(handles=labelled, ncols=panel.legend_columns, **below)
    elif labelled:
        style.legend_below(axis, columns=panel.legend_columns, handles=labelled)
    return axis


def _line(axis: Axes, mark: Line) -> Any:
    look: dict[str, Any] = {"linestyle": _DASHES if mark.dashed else "solid", "linewidth": mark.width}
    look |= {"drawstyle": "steps-post" if mark.stairs else "default", "zorder": mark.order}
    heavy = style.is_heavy(len(mark.x))
    return axis.plot(mark.x, mark.y, color=mark.color, rasterized=heavy, label=mark.label, **look)[0]


def _dots(axis: Axes, mark: Dots) -> Any:
    look: dict[str, Any] = {"marker": _SHAPES[mark.shape], "linestyle": "none", "markersize": mark.size}
    look |= {"color": mark.color, "alpha": mark.alpha, "zorder": mark.order, "label": mark.label}
    if mark.shape == "disc":
        look["markeredgewidth"] = 0.0
    elif mark.shape == "cross":
        look["markeredgewidth"] = 1.4
    elif mark.shape == "tick":
        look["clip_on"] = False
    else:
        look["markeredgecolor"] = style.INK
    return axis.plot(mark.x, mark.y, rasterized=style.is_heavy(10 * len(mark.x)), **look)[0]


def _band(axis: Axes, mark: Band) -> Any:
    look: dict[str, Any] = {"color": mark.color, "alpha": mark.alpha, "linewidth": 0, "zorder": mark.order}
    return axis.fill_between(mark.x, mark.low, mark.high, label=mark.label, **look)


def _level(axis: Axes, mark: Level) -> Any:
    look: dict[str, Any] = {"color": mark.color, "linewidth": mark.width, "zorder": mark.order}
    look |= {"linestyle": _DASHES if mark.dashed else "solid", "label": mark.label}
    return axis.axvline(mark.at, **look) if mark.upright else axis.axhline(mark.at, **look)


def _bars(axis: Axes, mark: Bars) -> Any:
    corners = [(mark.left, mark.low), (mark.left, mark.high), (mark.right, mark.high), (mark.right, mark.low)]
    boxes = np.stack([np.column_stack(corner) for corner in corners], axis=1)
    look: dict[str, Any] = {"facecolors": mark.color, "linewidths": 0, "alpha": mark.alpha}
    axis.add_collection(PolyCollection(list(boxes), zorder=mark.order, **look))
    return Patch(color=mark.color, alpha=mark.alpha, linewidth=0, label=mark.label)


def _ellipses(axis: Axes, mark: Ellipses) -> Any:
    collection = EllipseCollection(
        mark.major,
        mark.minor,
        mark.angle_deg,
        units="xy",
        offsets=mark.center,
        offset_transform=axis.transData,
        facecolors=f"{mark.color}{round(255 * mark.alpha):02x}",
        edgecolors=mark.color if mark.edge_width else "none",
        linewidths=mark.edge_width,
        zorder=mark.order,
        rasterized=style.is_heavy(_POINTS_OF_AN_ELLIPSE * len(mark.major)),
    )
    axis.add_collection(collection)
    proxy = Line2D([], [], marker="o", markersize=9, linestyle="none", color=mark.color, label=mark.label)
    proxy.set(markerfacecolor=collection.get_facecolor()[0])
    return proxy


_DRAWN: dict[type[Mark], Callable[[Axes, Any], Any]] = {
    Line: _line,
    Dots: _dots,
    Band: _band,
    Level: _level,
    Bars: _bars,
    Ellipses: _ellipses,
}

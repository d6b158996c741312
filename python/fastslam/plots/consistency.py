"""Figures of consistency: NEES over a run against its bounds, and coverage of the reported ellipses."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ..evaluation.consistency import nees_bounds
from ..evaluation.monte_carlo import LEVELS, Consistency
from . import style

_COLORS = (style.LIVE, style.LANDMARK, style.GOOD, style.EVENT, style.SMOOTHED, style.BAND)


def consistency_figure(found: Mapping[str, Consistency], *, title: str) -> Figure:
    """NEES over time on the left, coverage on the right, a line for each variant. Draw in `house_style`."""
    figure = style.new_figure(9.6, 4.6)
    left, right = figure.subplots(1, 2, width_ratios=[3, 2])
    plot_nees(left, found)
    plot_coverage(right, found)
    left.set_title(title)
    return figure


def plot_nees(axis: Axes, found: Mapping[str, Consistency]) -> Axes:
    """Draw the NEES of the pose over the run, its median (line) and mean (dots) over runs, and the bounds."""
    for (color, line), (name, consistency) in zip(_cycle(len(found)), found.items(), strict=True):
        axis.plot(consistency.fraction, consistency.median_over_runs, color=color, linestyle=line, label=name)
        dots: dict[str, Any] = {"marker": ".", "markersize": 3, "linestyle": "none"}
        axis.plot(consistency.fraction, consistency.mean_over_runs, color=color, alpha=0.5, **dots)
    first = next(iter(found.values()))
    degrees = first.pose.degrees_of_freedom
    low, high = nees_bounds(runs=first.runs, degrees_of_freedom=degrees)
    axis.axhspan(low, high, color=style.BAND, alpha=0.3, linewidth=0, label=f"95 % bounds, {first.runs} runs")
    axis.set_yscale("log")
    style.plain_log_ticks(axis.yaxis)
    axis.set_xlabel("part of the run")
    axis.set_ylabel(f"NEES of the pose ({degrees} expected)")
    axis.set_xlim(0.0, 1.0)
    style.legend_below(axis, columns=3)
    return axis


def plot_coverage(axis: Axes, found: Mapping[str, Consistency]) -> Axes:
    """Draw the found coverage of positions (solid) and landmarks (dashed) against the stated probability."""
    stated = np.array(LEVELS)
    axis.plot([0, 1], [0, 1], color=style.MUTED, linewidth=1.0, linestyle=(0, (4, 2)))
    for (color, line), consistency in zip(_cycle(len(found)), found.values(), strict=True):
        coverage = consistency.position.coverage.found
        axis.plot(stated, list(coverage.values()), color=color, linestyle=line, marker="o", markersize=4)
        if consistency.landmarks is not None:
            coverage = consistency.landmarks.coverage.found
            axis.plot(stated, list(coverage.values()), color=color, marker="s", markersize=3, linestyle=":")
    axis.set_title("Coverage")
    axis.set_xlabel("stated probability of the ellipse")
    axis.set_ylabel("fraction of errors inside (dotted: landmarks)")
    axis.set_xlim(0.45, 1.0)
    axis.set_ylim(0.0, 1.02)
    return axis


def _cycle(count: int) -> list[tuple[str, str]]:
    """A colour and a line each; when the colours are used up, dashes."""
    return [(_COLORS[k % len(_COLORS)], "--" if k >= len(_COLORS) else "-") for k in range(count)]

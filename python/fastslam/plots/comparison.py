"""Paths and maps of several results in one picture."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure

from ..evaluation import RigidTransform
from . import style

if TYPE_CHECKING:
    from ..comparison import Group

_MARKS = ("o", "s", "^", "D", "v", "P", "X", "<", ">", "p", "h", "*")
"""One for each group, so that colour is not all that tells them apart."""

_LONGEST_NAME = 40
_PATH = "path of "


def comparison_figure(groups: Sequence[Group], *, width_in: float = 8.0) -> Figure:
    """The first result of each group, all in the frame of the truth where there is one.

    Letters are of one size: a figure of 4 inches can be read on a phone.
    """
    with style.house_style():
        figure = style.new_figure(width_in, 0.9 * width_in + max(0.0, 2.0 - 0.25 * width_in))
        axis = figure.add_subplot()
        aligned = all(group.first.evaluation.T_truth_world is not None for group in groups)
        if aligned:
            _plot_truth(axis, groups)
        for number, group in enumerate(groups):
            _plot_group(axis, group, number, aligned=aligned)
        # Where paths agree the lower one is the wider one, so that all are seen.
        paths = [line for line in axis.lines if str(line.get_label()).startswith(_PATH)]
        for above, line in enumerate(reversed(paths)):
            line.set_linewidth(1.2 + 1.6 * above / len(groups))
        axis.set_aspect("equal", adjustable="datalim")
        axis.set_xlabel("x in the frame of the truth [m]" if aligned else "x in world [m]")
        axis.set_ylabel("y in the frame of the truth [m]" if aligned else "y in world [m]")
        axis.set_title("Paths and maps")
        longest = max(len(group.name) for group in groups)
        style.legend_below(axis, columns=max(1, min(4, round(11.25 * width_in) // (longest + 12))))
    return figure


def _plot_group(axis: Any, group: Group, number: int, *, aligned: bool) -> None:
    result, color = group.first.result, style.CLASSES[number % len(style.CLASSES)]
    transform = (group.first.evaluation.T_truth_world if aligned else None) or RigidTransform.identity()
    path = result.smoothed if len(result.smoothed.stamp_s) else result.trajectory
    points = transform.apply_points(path.T_world_robot[:, :2])
    dashes: Any = "solid" if number < len(style.CLASSES) else (0, (5, 1.5))
    line: dict[str, Any] = {"color": color, "linestyle": dashes, "zorder": 3}
    axis.plot(*points.T, **line, label=f"{_PATH}{_short(group.name)}", rasterized=style.is_heavy(len(points)))
    landmarks = result.landmarks
    kept = np.full(len(landmarks.ids), True) if landmarks.confirmed is None else landmarks.confirmed
    places = transform.apply_points(landmarks.mean_m[kept].reshape(-1, 2))
    dots: dict[str, Any] = {"marker": _MARKS[number], "linestyle": "none", "markersize": 5, "zorder": 5}
    dots |= {"markerfacecolor": "none", "markeredgecolor": color}
    axis.plot(
        *places.T, **dots, label=f"map of {_short(group.name)}", rasterized=style.is_heavy(10 * len(places))
    )


def _short(name: str) -> str:
    """The end of a long name: that is where names of results differ."""
    return name if len(name) <= _LONGEST_NAME else "…" + name[-_LONGEST_NAME:]


def _plot_truth(axis: Any, groups: Sequence[Group]) -> None:
    """The truth of the first log; the others are of the same world, or this picture means nothing."""
    log = groups[0].first.log
    if log.truth_trajectory is not None:
        line: dict[str, Any] = {"color": style.TRUTH, "linestyle": (0, (4, 2)), "linewidth": 1.0, "zorder": 2}
        axis.plot(*log.truth_trajectory.T_world_robot[:, :2].T, **line, label="path, true")
    if log.truth_landmarks is not None and len(log.truth_landmarks.names):
        cross: dict[str, Any] = {"marker": "x", "linestyle": "none", "color": style.INK, "markersize": 6}
        axis.plot(*log.truth_landmarks.position_m.T, **cross, label="landmark, true", zorder=6)

"""The map: landmarks with their uncertainty, the path, and the truth where it is known."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import EllipseCollection
from matplotlib.colors import is_color_like, to_hex
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from ..evaluation import Evaluation, RigidTransform, evaluate_run
from ..log import Floats, Log
from ..result import LandmarkMap, RunResult
from . import style

ELLIPSE_SIGMAS = 2.0
POINTS_OF_AN_ELLIPSE = 25
WIDE_IN = 6.0
"""Figures that are wider have room for a legend of four columns."""
MAX_CLEAR_LANDMARKS = 2000
"""Of more landmarks than this each becomes a dot under the path, or they would cover everything."""


def plot_map(axis: Axes, result: RunResult, log: Log, *, evaluation: Evaluation | None = None) -> Axes:
    """Draw landmarks with covariance ellipses, live and smoothed path, and truth, in the world of the run.

    The truth is brought into the run's world by the rigid alignment of the evaluation; fixes farther from
    the path than the inlier distance are left out. `evaluation` saves evaluating again.
    """
    found = evaluate_run(result, log) if evaluation is None else evaluation
    _plot_truth(axis, log, found)
    live, smoothed = result.trajectory.T_world_robot, result.smoothed.T_world_robot
    # The upper line is the thinner one, so that both are seen where they agree.
    _plot_path(axis, live, color=style.LIVE, linewidth=2.2, label="path, live", zorder=3)
    _plot_path(axis, smoothed, color=style.SMOOTHED, linewidth=1.0, label="path, smoothed", zorder=4)
    path = smoothed if len(smoothed) else live
    if len(path):
        ends: dict[str, Any] = {
            "markersize": 8,
            "linestyle": "none",
            "markeredgecolor": style.INK,
            "zorder": 8,
        }
        axis.plot(*path[0, :2], marker="^", markerfacecolor=style.GOOD, label="start", **ends)
        axis.plot(*path[-1, :2], marker="s", markerfacecolor=style.EVENT, label="end", **ends)
    confirmed = result.landmarks.confirmed
    kept = np.full(len(result.landmarks.ids), True) if confirmed is None else confirmed
    _plot_provisional(axis, result.landmarks.mean_m[~kept])
    groups = landmark_groups(result.landmarks)
    for group in groups:
        _plot_landmarks(axis, group)
    if groups:
        proxy = Line2D([], [], marker="o", markersize=9, linestyle="none", color=groups[0].color)
        proxy.set(markerfacecolor=groups[0].color + "30", label=f"{ELLIPSE_SIGMAS:g}σ ellipse")
        axis.add_line(proxy)
    axis.set_aspect("equal", adjustable="datalim")
    is_wide = _is_wide(axis)
    for side in (axis.xaxis, axis.yaxis):
        side.set_major_locator(MaxNLocator(nbins=9 if is_wide else 6, steps=[1, 2, 5, 10]))
    axis.set_xlabel("x in world [m]")
    axis.set_ylabel("y in world [m]")
    axis.set_title(f"Map and path, {np.count_nonzero(kept):,} landmarks")
    if axis.get_legend_handles_labels()[0]:
        style.legend_below(axis, columns=4 if is_wide else 2)
    return axis


def _is_wide(axis: Axes) -> bool:
    return not isinstance(axis.figure, Figure) or axis.figure.get_figwidth() > WIDE_IN


def _size(axis: Axes, points: float) -> float:
    """The size of a mark, which covers as much of a small map as of a wide one."""
    return points if _is_wide(axis) else 0.65 * points


def ellipse_axes(covariance_m2: Floats) -> tuple[Floats, Floats, Floats]:
    """Full lengths of the major and minor axis [m] and the major axis's angle [deg] of 2-sigma ellipses.

    Shapes: covariances (K, 2, 2); results (K,). Two standard deviations hold 86 % of a planar Gaussian.
    """
    values, vectors = np.linalg.eigh(covariance_m2)
    lengths = 2.0 * ELLIPSE_SIGMAS * np.sqrt(np.maximum(values, 0.0))
    angle = np.degrees(np.arctan2(vectors[:, 1, 1], vectors[:, 0, 1]))
    return lengths[:, 1], lengths[:, 0], angle


def _plot_path(axis: Axes, poses: Floats, **line: Any) -> None:
    if len(poses):
        axis.plot(poses[:, 0], poses[:, 1], **line, rasterized=style.is_heavy(len(poses)))


@dataclass(frozen=True)
class LandmarkGroup:
    """Confirmed landmarks of one class. Shapes: `mean_m` (K, 2), `covariance_m2` (K, 2, 2)."""

    label: str
    color: str
    is_classed: bool
    mean_m: Floats
    covariance_m2: Floats


def landmark_groups(landmarks: LandmarkMap) -> list[LandmarkGroup]:
    """The confirmed landmarks by class, each class in the colour that it names or one of the palette."""
    kept = np.full(len(landmarks.ids), True) if landmarks.confirmed is None else landmarks.confirmed
    names = np.array([landmarks.class_name(row) for row in range(len(landmarks.ids))], dtype=object)
    known = sorted({name for name in names[kept] if name})
    groups = []
    for name in ["", *known]:
        rows = kept & (names == name)
        if rows.any():
            color = style.LANDMARK if not name else class_color(name, known.index(name))
            label = "landmark" if not known else f"landmark, {name or 'class unknown'}"
            groups.append(
                LandmarkGroup(label, color, bool(name), landmarks.mean_m[rows], landmarks.covariance_m2[rows])
            )
    return groups


def class_color(name: str, number: int) -> str:
    """The colour that a class is named after (`blue`, `large orange cone`), else one of the palette.

    Yellow is darkened: on white paper the pure one cannot be seen.
    """
    named = [word for word in name.lower().replace("_", " ").split() if is_color_like(word) and len(word) > 2]
    if not named:
        return style.CLASSES[number % len(style.CLASSES)]
    return style.DARK_YELLOW if named[0] == "yellow" else to_hex(named[0])


def _plot_provisional(axis: Axes, mean_m: Floats) -> None:
    """Landmarks that are not yet believed, faint and without ellipses."""
    if len(mean_m) == 0:
        return
    dots: dict[str, Any] = {"marker": ".", "markersize": 2.5, "linestyle": "none", "color": style.MUTED}
    dots |= {"alpha": 0.5, "zorder": 1.6, "label": "landmark, provisional"}
    axis.plot(*mean_m.T, **dots, rasterized=style.is_heavy(10 * len(mean_m)))


def _plot_landmarks(axis: Axes, landmarks: LandmarkGroup) -> None:
    count = len(landmarks.mean_m)
    dots: dict[str, Any] = {"marker": "o", "linestyle": "none"}
    dots["markersize"] = _size(axis, 3.5 if count <= 500 else 1.5)
    dots |= {"color": landmarks.color, "label": landmarks.label, "zorder": 6}
    if landmarks.is_classed and count <= 500:
        # Large enough to be told by its colour under the cross of its true place.
        dots["markersize"] = _size(axis, 6.0)
    if count > MAX_CLEAR_LANDMARKS:
        dots |= {"marker": ".", "markersize": 0.8, "zorder": 1.5, "alpha": 0.4}
    axis.plot(*landmarks.mean_m.T, **dots, rasterized=style.is_heavy(10 * count))
    major, minor, angle = ellipse_axes(landmarks.covariance_m2)
    ellipses = EllipseCollection(
        major,
        minor,
        angle,
        units="xy",
        offsets=landmarks.mean_m,
        offset_transform=axis.transData,
        facecolors=landmarks.color + "30",
        edgecolors=landmarks.color if count <= MAX_CLEAR_LANDMARKS else "none",
        linewidths=0.9 if count <= 500 else 0.4,
        zorder=5 if count <= MAX_CLEAR_LANDMARKS else 1.4,
        rasterized=style.is_heavy(POINTS_OF_AN_ELLIPSE * count),
    )
    axis.add_collection(ellipses)


def _plot_truth(axis: Axes, log: Log, found: Evaluation) -> None:
    transform = found.T_truth_world
    if transform is None:
        return
    T_world_truth = transform.inverse()
    if log.truth_trajectory is not None and found.live is not None:
        true_path = T_world_truth.apply_points(log.truth_trajectory.T_world_robot[:, :2])
        heavy = style.is_heavy(len(true_path))
        line: dict[str, Any] = {"color": style.TRUTH, "linestyle": (0, (4, 2)), "linewidth": 1.2}
        axis.plot(*true_path.T, **line, label="path, true (aligned)", zorder=2, rasterized=heavy)
    elif found.fixes is not None:
        _plot_fixes(axis, log, found.fixes.transform.inverse())
    if log.truth_landmarks is not None and len(log.truth_landmarks.names):
        points = T_world_truth.apply_points(log.truth_landmarks.position_m)
        cross: dict[str, Any] = {
            "marker": "x",
            "markersize": _size(axis, 7.0),
            "markeredgewidth": 1.4,
            "color": style.INK,
        }
        cross |= {"linestyle": "none", "label": "landmark, true", "zorder": 7}
        if len(points) > MAX_CLEAR_LANDMARKS:
            cross |= {"marker": ".", "markersize": 1.2, "color": style.MUTED, "zorder": 1.3}
        axis.plot(*points.T, **cross, rasterized=style.is_heavy(10 * len(points)))


def _plot_fixes(axis: Axes, log: Log, T_world_fixes: RigidTransform) -> None:
    """Fixes within reach of the picture: one wild fix must not shrink the map to a dot."""
    if log.position_fixes is None:
        return
    points = T_world_fixes.apply_points(log.position_fixes.position_m)
    low, high = np.percentile(points, [2, 98], axis=0)
    margin = 0.15 * (high - low).max()
    near = ((points >= low - margin) & (points <= high + margin)).all(axis=1)
    dots: dict[str, Any] = {
        "marker": ".",
        "markersize": 3,
        "linestyle": "none",
        "color": style.TRUTH,
        "alpha": 0.6,
    }
    axis.plot(*points[near].T, **dots, label="position fixes (aligned)", zorder=2)

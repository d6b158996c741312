"""The map: landmarks with their uncertainty, the path, and the truth where it is known."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..evaluation import Evaluation, RigidTransform
from ..health import HealthStatus
from ..log import Floats, Log
from ..result import LandmarkMap, RunResult, Steps, Trajectory
from . import palette
from .panel import Dots, DotShape, Ellipses, Line, Mark, Panel, range_of

ELLIPSE_SIGMAS = 2.0
MAX_CLEAR_LANDMARKS = 2000
"""Of more landmarks than this each becomes a dot under the path, or they would cover everything."""
_SMALL = 0.65
"""Marks of a small map are smaller by this, to cover as much of it as of a wide one."""


def map_panel(result: RunResult, log: Log, evaluation: Evaluation, *, small: bool = False) -> Panel:
    """Landmarks with covariance ellipses, live and smoothed path, and truth, in the world of the run.

    The truth is brought into the run's world by the rigid alignment of the evaluation; fixes farther from
    the path than the inlier distance are left out.
    """
    size = _SMALL if small else 1.0
    landmarks = result.landmarks
    kept = np.full(len(landmarks.ids), True) if landmarks.confirmed is None else landmarks.confirmed
    marks = [*_truth(log, evaluation, size), *_paths(result), *_provisional(landmarks.mean_m[~kept])]
    for number, group in enumerate(landmark_groups(landmarks)):
        marks += _group(group, size, "" if number else f"{ELLIPSE_SIGMAS:g}σ ellipse")
    drawn = [mark for mark in marks if isinstance(mark, Line | Dots)]
    spread = [mark.center for mark in marks if isinstance(mark, Ellipses)]
    x_range = range_of(*(mark.x for mark in drawn), *(center[:, 0] for center in spread), margin=0.05)
    y_range = range_of(*(mark.y for mark in drawn), *(center[:, 1] for center in spread), margin=0.05)
    return Panel(
        title=f"Map and path, {np.count_nonzero(kept):,} landmarks",
        x_label="x in world [m]",
        y_label="y in world [m]",
        marks=tuple(marks),
        x_range=x_range,
        y_range=y_range,
        equal=True,
        legend_columns=2 if small else 4,
    )


def ellipse_axes(covariance_m2: Floats) -> tuple[Floats, Floats, Floats]:
    """Full lengths of the major and minor axis [m] and the major axis's angle [deg] of 2-sigma ellipses.

    Shapes: covariances (K, 2, 2); results (K,). Two standard deviations hold 86 % of a planar Gaussian.
    """
    values, vectors = np.linalg.eigh(covariance_m2)
    lengths = 2.0 * ELLIPSE_SIGMAS * np.sqrt(np.maximum(values, 0.0))
    angle = np.degrees(np.arctan2(vectors[:, 1, 1], vectors[:, 0, 1]))
    return lengths[:, 1], lengths[:, 0], angle


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
            color = palette.LANDMARK if not name else palette.class_color(name, known.index(name))
            label = "landmark" if not known else f"landmark, {name or 'class unknown'}"
            mean_m, covariance_m2 = landmarks.mean_m[rows], landmarks.covariance_m2[rows]
            groups.append(LandmarkGroup(label, color, bool(name), mean_m, covariance_m2))
    return groups


def _paths(result: RunResult) -> list[Mark]:
    live, smoothed = result.trajectory, result.smoothed
    # The upper line is the thinner one, so that both are seen where they agree.
    looks = ((live, palette.LIVE, 2.2, "live", 3.0), (smoothed, palette.SMOOTHED, 1.0, "smoothed", 4.0))
    marks: list[Mark] = [
        Line(
            x=poses[:, 0],
            y=poses[:, 1],
            color=color,
            width=width,
            label="" if number else f"path, {name}",
            order=order,
        )
        for path, color, width, name, order in looks
        for number, poses in enumerate(_pieces(path, result.steps))
        if len(poses)
    ]
    path = result.path.T_world_robot
    if len(path):
        ends: tuple[tuple[Floats, DotShape, str, str], ...] = (
            (path[:1], "triangle", palette.GOOD, "start"),
            (path[-1:], "square", palette.EVENT, "end"),
        )
        marks += [
            Dots(x=pose[:, 0], y=pose[:, 1], color=color, shape=shape, size=8.0, label=name, order=8.0)
            for pose, shape, color, name in ends
        ]
    return marks


def _pieces(path: Trajectory, steps: Steps) -> list[Floats]:
    """The poses of a path, cut where a search in the map begins: nobody knows the way there."""
    searched = steps.health == HealthStatus.SEARCHING
    begins_s = steps.stamp_s[np.diff(searched.astype(np.int8), prepend=1) > 0]
    return np.split(path.T_world_robot, np.searchsorted(path.stamp_s, begins_s))


def _provisional(mean_m: Floats) -> list[Mark]:
    """Landmarks that are not yet believed, faint and without ellipses."""
    if len(mean_m) == 0:
        return []
    x, y = mean_m.T
    label = "landmark, provisional"
    return [Dots(x=x, y=y, color=palette.MUTED, size=2.2, alpha=0.5, label=label, order=1.6)]


def _group(landmarks: LandmarkGroup, size: float, ellipse_label: str) -> list[Mark]:
    """Dots and ellipses; fewer landmarks are drawn larger, and among very many the path stays on top."""
    count, (x, y) = len(landmarks.mean_m), landmarks.mean_m.T
    major, minor, angle_deg = ellipse_axes(landmarks.covariance_m2)
    crowded = count > MAX_CLEAR_LANDMARKS
    diameter = size * (4.5 if count <= 500 else 2.5)
    if landmarks.is_classed and count <= 500:
        # Large enough to be told by its colour under the cross of its true place.
        diameter = size * 7.0
    edge_width = 0.9 if count <= 500 else 0.4
    color, label = landmarks.color, landmarks.label
    ellipses = Ellipses(
        center=landmarks.mean_m,
        major=major,
        minor=minor,
        angle_deg=angle_deg,
        color=color,
        edge_width=0.0 if crowded else edge_width,
        label=ellipse_label,
        order=1.4 if crowded else 5.0,
    )
    if crowded:
        return [ellipses, Dots(x=x, y=y, color=color, size=1.4, alpha=0.4, label=label, order=1.5)]
    return [ellipses, Dots(x=x, y=y, color=color, size=diameter, label=label, order=6.0)]


def _truth(log: Log, found: Evaluation, size: float) -> list[Mark]:
    transform = found.T_truth_world
    if transform is None:
        return []
    marks: list[Mark] = []
    T_world_truth = transform.inverse()
    if log.truth_trajectory is not None and found.live is not None:
        x, y = T_world_truth.apply_points(log.truth_trajectory.T_world_robot[:, :2]).T
        marks.append(Line(x=x, y=y, color=palette.TRUTH, dashed=True, label="path, true (aligned)"))
    elif found.fixes is not None and log.position_fixes is not None:
        marks.append(_fixes(log.position_fixes.position_m, found.fixes.transform.inverse()))
    if log.truth_landmarks is not None and len(log.truth_landmarks.names):
        x, y = T_world_truth.apply_points(log.truth_landmarks.position_m).T
        label = "landmark, true"
        if len(x) > MAX_CLEAR_LANDMARKS:
            marks.append(Dots(x=x, y=y, color=palette.MUTED, size=1.6, label=label, order=1.3))
        else:
            marks.append(
                Dots(x=x, y=y, color=palette.INK, shape="cross", size=7.0 * size, label=label, order=7.0)
            )
    return marks


def _fixes(position_m: Floats, T_world_fixes: RigidTransform) -> Dots:
    """Fixes within reach of the picture: one wild fix must not shrink the map to a dot."""
    points = T_world_fixes.apply_points(position_m)
    low, high = np.percentile(points, [2, 98], axis=0)
    margin = 0.15 * (high - low).max()
    near = ((points >= low - margin) & (points <= high + margin)).all(axis=1)
    x, y = points[near].T
    return Dots(
        x=x, y=y, color=palette.TRUTH, size=2.5, alpha=0.6, label="position fixes (aligned)", order=2.0
    )

"""Pictures of a run in space."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Ellipse

from ..log import Floats
from ..plots.style import INK, LANDMARK, LIVE, MUTED, SMOOTHED, TRUTH, legend_below, new_figure
from .evaluation import alignment, at_stamps, matrices
from .log import SpaceLog
from .result import SpaceResult

VIEWS = ((0, 1, "from above"), (0, 2, "from the side"))
AXES = "xyz"
STDS = 2.0


def map_figure(result: SpaceResult, log: SpaceLog) -> Figure:
    """Path and map from above and from the side; the truth is moved to where the run's frame lies."""
    figure = new_figure(10.0, 6.2)
    first, second = figure.subplots(1, 2)
    shown = _truth(result, log)
    for axis, (across, up, title) in zip((first, second), VIEWS, strict=True):
        _draw(axis, result, shown, (across, up))
        axis.set_title(title)
    legend_below(first, columns=2)
    return figure


def _draw(axis: Axes, result: SpaceResult, truth: tuple[Floats, Floats] | None, at: tuple[int, int]) -> None:
    across, up = at
    if truth is not None:
        path, places = truth
        axis.plot(path[:, across], path[:, up], color=TRUTH, linewidth=0.9, linestyle="--", label="true path")
        axis.plot(places[:, across], places[:, up], "+", color=INK, markersize=9, label="true landmarks")
    live, smoothed = result.trajectory.T_world_robot, result.smoothed.T_world_robot
    axis.plot(live[:, across], live[:, up], color=LIVE, linewidth=0.6, alpha=0.6, label="live path")
    axis.plot(smoothed[:, across], smoothed[:, up], color=SMOOTHED, linewidth=1.1, label="smoothed path")
    if len(smoothed):
        for pose, mark, name in ((smoothed[0], "o", "start"), (smoothed[-1], "s", "end")):
            axis.plot(pose[across], pose[up], mark, color=INK, markersize=5, label=name)
    for name, mean, covariance in zip(
        result.landmarks.ids, result.landmarks.mean_m, result.landmarks.covariance_m2, strict=True
    ):
        axis.add_patch(_ellipse(mean[[across, up]], covariance[np.ix_([across, up], [across, up])]))
        axis.annotate(
            name, mean[[across, up]], xytext=(4, 4), textcoords="offset points", fontsize=7, color=MUTED
        )
    means = result.landmarks.mean_m
    axis.plot(means[:, across], means[:, up], ".", color=LANDMARK, markersize=4, label="landmarks, 2 σ")
    axis.set_aspect("equal", adjustable="datalim")
    axis.set_xlabel(f"{AXES[across]} [m]")
    axis.set_ylabel(f"{AXES[up]} [m]")


def _ellipse(centre: Floats, covariance: Floats) -> Ellipse:
    values, vectors = np.linalg.eigh(covariance)
    width, height = 2.0 * STDS * np.sqrt(np.maximum(values[::-1], 0.0))
    angle = float(np.degrees(np.arctan2(vectors[1, 1], vectors[0, 1])))
    place = (float(centre[0]), float(centre[1]))
    return Ellipse(place, width, height, angle=angle, facecolor="none", edgecolor=LANDMARK, linewidth=0.9)


def _truth(result: SpaceResult, log: SpaceLog) -> tuple[Floats, Floats] | None:
    """True positions and landmarks in the frame of the run."""
    if log.truth is None or not len(log.truth.stamp_s):
        return None
    stamps, poses = at_stamps(result.smoothed, log.truth.stamp_s)
    if len(stamps) < 3:
        return None
    true = log.truth.T_world_robot[:, :3]
    turn, shift = alignment(true[np.isin(log.truth.stamp_s, stamps)], poses[:, :3])
    rotation = matrices(turn[None])[0]
    return true @ rotation.T + shift, log.truth.position_m @ rotation.T + shift

"""Poses, landmarks and the errors of sensor and odometry as a least-squares problem that the core solves."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from . import _core
from .errors import NumericalError
from .log import Floats, Ints

PARAMETERS = ("range_scale", "range_bias_m", "mounting.x_m", "mounting.y_m", "mounting.yaw_rad")
"""Errors of a range-bearing sensor, in the order of the core."""
GAUGE = 1e8
"""Information that holds the first pose where it is."""
SURVEY_STD_M = 0.005
BLOCKS = 10
"""Stretches of time of a log whose errors are taken for independent of each other."""


@dataclass(frozen=True)
class Batch:
    """What is to be explained, with its present explanation.

    Shapes: `poses` (K, 3), `landmarks_m` (L, 2), `parameters` (5,) in the order of PARAMETERS. Odometry k
    leads from pose k to pose k + 1: `motion` (K - 1, 3). Sighting s is of landmark `landmark[s]` from pose
    `pose[s]`; `range_m` and `bearing_rad` are as reported. `surveyed_m` (L, 2) are known positions of
    landmarks, which then fix frame and scale; NaN for none.
    """

    poses: Floats
    landmarks_m: Floats
    parameters: Floats
    motion: Floats
    pose: Ints
    landmark: Ints
    range_m: Floats
    bearing_rad: Floats
    surveyed_m: Floats


@dataclass(frozen=True)
class Rows:
    """The rows of a batch, not yet weighed.

    `seen` (S, 2) is expected minus reported range and bearing, `moved` (K - 1, 3) motion of the path minus
    that of the odometry.
    """

    core: _core.LeastSquaresRows
    seen: Floats
    moved: Floats


def rows_of(batch: Batch, by_motion: Floats | None = None) -> Rows:
    """The rows of a batch; `by_motion` (K - 1, 3, N): derivatives of its motion by errors of the odometry."""
    if by_motion is None:
        by_motion = np.zeros((*batch.motion.shape, 0))
    seen = np.column_stack([batch.range_m, batch.bearing_rad])
    core = _core.LeastSquaresRows(
        batch.poses,
        batch.landmarks_m,
        batch.parameters.tolist(),
        (batch.motion, by_motion),
        (batch.pose, batch.landmark, seen),
    )
    residuals = core.residuals()
    return Rows(core, residuals[: seen.size].reshape(-1, 2), residuals[seen.size :].reshape(-1, 3))


def solved(
    batch: Batch,
    rows: Rows,
    *,
    whitening: tuple[Floats, Floats],
    missing: Floats,
    prior_std: Floats,
) -> _core.LeastSquares:
    """The factorised equations of the rows.

    `whitening` is one over the standard deviation of each number seen (S, 2), and roots of the precision of
    each motion (K - 1, 3, 3). Parameters (N + 5,), those of the odometry first, lie `missing` from what was
    known of them, with standard deviations `prior_std`; 0 holds one where it is. Errors: NumericalError where
    sightings and odometry do not hold poses and landmarks.
    """
    try:
        return _core.LeastSquares(
            rows.core, whitening, _anchors(batch), np.column_stack([prior_std, missing])
        )
    except ValueError as error:
        raise NumericalError(str(error)) from None


def _anchors(batch: Batch) -> Floats:
    """Information on unknowns, and how far they are off (n, 2): by the survey, or the first pose."""
    size = 3 * len(batch.poses)
    missing = np.concatenate([np.zeros(size), (batch.surveyed_m - batch.landmarks_m).ravel()])
    information = np.isfinite(missing) / SURVEY_STD_M**2
    information[:size] = 0.0
    if not information.any():
        information[:3] = GAUGE
    return np.column_stack([information, np.nan_to_num(missing)])


def clustered(batch: Batch, influence: Floats, covariance: Floats) -> Floats:
    """The covariance of the parameters, widened by how much stretches of the log disagree.

    Errors may repeat within a stretch: the sandwich of a robust estimator, its scores summed over BLOCKS
    stretches of time (Huber 1967; Liang and Zeger 1986). Never less than `covariance`, what independent
    errors would give. `influence` (R, N + 5) is what each row does to the parameters.
    """
    ratio = np.sqrt(np.maximum(scattered(batch, influence) / np.diag(covariance), 1.0))
    widened: Floats = covariance * ratio[:, None] * ratio
    return widened


def scattered(batch: Batch, influence: Floats) -> Floats:
    """Variance (N + 5,) of the parameters by how much stretches of the log disagree, as in `clustered`."""
    poses = len(batch.poses)
    pose = np.concatenate([np.repeat(batch.pose, 2), np.repeat(np.arange(poses - 1), 3)])
    sums = np.zeros((BLOCKS, influence.shape[1]))
    np.add.at(sums, pose * BLOCKS // poses, influence)
    variance: Floats = np.sum(sums**2, axis=0) * (BLOCKS / (BLOCKS - 1))
    return variance


def moved_by(batch: Batch, unknowns: Floats, parameters: Floats) -> Batch:
    """The batch with its solution a step further; `parameters` (5,) are those of the sensor."""
    poses = 3 * len(batch.poses)
    return replace(
        batch,
        poses=batch.poses + unknowns[:poses].reshape(-1, 3),
        landmarks_m=batch.landmarks_m + unknowns[poses:].reshape(-1, 2),
        parameters=batch.parameters + parameters,
    )


def carried_by(batch: Batch, unknowns: Floats, parameters: Floats) -> Batch:
    """As `moved_by`, but what is linear in the step is each move from pose to pose, and each landmark seen
    from the first pose that saw it: a path that turns otherwise carries all that comes after along, however
    far. Every landmark must have been seen."""
    poses = batch.poses
    steps = unknowns[: poses.size].reshape(-1, 3)
    step_m = unknowns[poses.size :].reshape(-1, 2)
    first = np.unique(batch.landmark, return_index=True)[1]
    at = batch.pose[first]
    heading, turned = poses[:, 2], steps[:, 2]
    way = _seen_from(heading[:-1], turned[:-1], np.diff(poses[:, :2], axis=0), np.diff(steps[:, :2], axis=0))
    seen = _seen_from(heading[at], turned[at], batch.landmarks_m - poses[at, :2], step_m - steps[at, :2])
    moved = np.empty_like(poses)
    moved[:, 2] = heading + turned
    moved[0, :2] = poses[0, :2] + steps[0, :2]
    moved[1:, :2] = moved[0, :2] + np.cumsum(_turned(way, moved[:-1, 2]), axis=0)
    landmarks_m = moved[at, :2] + _turned(seen, moved[at, 2])
    return replace(batch, poses=moved, landmarks_m=landmarks_m, parameters=batch.parameters + parameters)


def _seen_from(heading: Floats, turned: Floats, away_m: Floats, step_m: Floats) -> Floats:
    """What lies away (n, 2) as seen from poses of headings (n,), after a step by which both move."""
    seen, step = _turned(away_m, -heading), _turned(step_m, -heading)
    return seen + step + turned[:, None] * np.column_stack([seen[:, 1], -seen[:, 0]])


def _turned(points_m: Floats, angle: Floats) -> Floats:
    cos, sin = np.cos(angle), np.sin(angle)
    x, y = points_m.T
    return np.column_stack([cos * x - sin * y, sin * x + cos * y])

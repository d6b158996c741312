"""Batch least squares over poses, landmarks and the parameters of a range-bearing sensor."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from .datasets.planar import wrap_to_pi
from .log import Floats, Ints

PARAMETERS = ("range_scale", "range_bias_m", "mounting.x_m", "mounting.y_m", "mounting.yaw_rad")
TAIL_DEGREES_OF_FREEDOM = 4.0
"""Of the Student-t distribution that weighs the sightings: outliers hardly count."""
SURVEY_STD_M = 0.005
LEAST_REDUNDANCY = 0.5
PROBES = 3
BLOCKS = 10
"""Stretches of time of a log whose errors are taken for independent of each other."""
SETTLED = 0.05
"""A step of the parameters this small, in standard errors, ends the iteration."""
GAUSSIAN_MAD = 1.4826
"""Standard deviations in a median absolute deviation."""


@dataclass(frozen=True)
class Batch:
    """A least-squares problem with its present solution.

    Shapes: `poses` (K, 3), `landmarks_m` (L, 2), `parameters` (5,) in the order of PARAMETERS. Odometry k
    leads from pose k to pose k + 1: `motion` (K - 1, 3) with `motion_covariance` (K - 1, 3, 3). Sighting s is
    of landmark `landmark[s]` from pose `pose[s]`; `range_m` and `bearing_rad` are as reported. `free` (5,)
    says which parameters are estimated; `prior_std` (5,) holds those that the data leaves open.
    `surveyed_m` (L, 2) are known positions of landmarks, which then fix frame and scale; NaN for none.
    """

    poses: Floats
    landmarks_m: Floats
    parameters: Floats
    motion: Floats
    motion_covariance: Floats
    pose: Ints
    landmark: Ints
    range_m: Floats
    bearing_rad: Floats
    free: Any
    prior_std: Floats
    surveyed_m: Floats
    range_std_m: float
    bearing_std_rad: float


@dataclass(frozen=True)
class Solution:
    """The solved problem, the covariance of its parameters (5, 5), and how the iteration ended.

    `noise_known` (2,) says whether residuals tell the noise of ranges and of bearings: where the path follows
    them half the way or more, they do not.
    """

    batch: Batch
    covariance: Floats
    noise_known: Any
    converged: bool


@dataclass(frozen=True)
class _Equations:
    """Normal equations of a step over (poses, landmarks, parameters), and the whitened rows they come from.

    The rows of sightings come first, range and bearing of each in turn, then those of the odometry.
    """

    matrix: Any
    rhs: Floats
    rows: Any
    residuals: Floats


def solve_batch(batch: Batch, *, most_iterations: int = 40) -> Solution:
    """Gauss-Newton with Student-t weights; the noise of the sensor is estimated along the way.

    It ends when the parameters move by less than SETTLED standard errors and the noise by less than 1 %:
    poses of a stretch with little to hold them go on moving without a say in either.
    """
    first, converged = batch, False
    known = np.array([True, True])
    for _ in range(most_iterations):
        residuals, jacobian = sighting_residuals(batch)
        equations = _normal_equations(
            batch, residuals, jacobian, _weights(batch, residuals)[0], first.parameters
        )
        factor = factorised(equations.matrix)
        step = factor.solve(equations.rhs)
        step *= min(1.0, 0.5 / max(float(np.abs(step).max()), 1e-12))
        redundancy = _redundancy(factor, equations.rows[: 2 * len(batch.pose)])
        known &= redundancy > LEAST_REDUNDANCY
        noisier = _with_noise(batch, residuals, np.where(known, redundancy, np.nan))
        noise = np.log(
            [noisier.range_std_m / batch.range_std_m, noisier.bearing_std_rad / batch.bearing_std_rad]
        )
        batch = _moved(noisier, step)
        error = np.sqrt(np.diag(_last_columns(factor, len(step))[-len(PARAMETERS) :]))
        if np.all(np.abs(step[-len(PARAMETERS) :]) < SETTLED * error) and np.all(np.abs(noise) < 0.01):
            converged = True
            break
    return Solution(batch, _covariance(batch, first.parameters), known, converged)


def factorised(matrix: Any) -> Any:
    # In this order, poses along the path first, nothing fills in but the border of landmarks.
    from scipy.sparse.linalg import splu

    return splu(matrix, permc_spec="NATURAL", diag_pivot_thresh=0.0, options={"SymmetricMode": True})


def _last_columns(factor: Any, size: int) -> Floats:
    """The columns of the inverse that belong to the parameters (size, 5)."""
    unit = np.zeros((size, len(PARAMETERS)))
    unit[-len(PARAMETERS) :] = np.eye(len(PARAMETERS))
    columns: Floats = factor.solve(unit)
    return columns


def _covariance(batch: Batch, first_parameters: Floats) -> Floats:
    """Of the parameters, from how much stretches of the log disagree: errors may repeat within a stretch.

    The sandwich of a robust estimator, its scores summed over BLOCKS stretches of time (Huber 1967; Liang and
    Zeger 1986). Residuals are enlarged by the share of the noise that the fit has followed. Never less than
    what independent errors would give.
    """
    residuals, jacobian = sighting_residuals(batch)
    weights, curvature = _weights(batch, residuals)
    scores = _normal_equations(batch, residuals, jacobian, weights, first_parameters)
    factor = factorised(_normal_equations(batch, residuals, jacobian, curvature, first_parameters).matrix)
    columns = _last_columns(factor, scores.matrix.shape[0])
    sightings = 2 * len(batch.pose)
    share = np.ones(len(scores.residuals))
    share[:sightings] = np.tile(
        np.maximum(_redundancy(factor, scores.rows[:sightings]), 0.1), len(batch.pose)
    )
    influence = (scores.rows @ columns) * (scores.residuals / np.sqrt(share))[:, None]
    pose = np.concatenate([np.repeat(batch.pose, 2), np.repeat(np.arange(len(batch.poses) - 1), 3)])
    block = pose * BLOCKS // len(batch.poses)
    sums = np.column_stack([np.bincount(block, column, minlength=BLOCKS) for column in influence.T])
    independent, clustered = columns[-len(PARAMETERS) :], sums.T @ sums * (BLOCKS / (BLOCKS - 1))
    ratio = np.sqrt(np.maximum(np.diag(clustered) / np.diag(independent), 1.0))
    covariance: Floats = independent * ratio[:, None] * ratio
    return covariance


def _weights(batch: Batch, residuals: Floats) -> tuple[Floats, Floats]:
    """Weight of each sighting (S,), and the mean derivative of its weighted residual (S,), which is less."""
    squared = (residuals[:, 0] / batch.range_std_m) ** 2 + (residuals[:, 1] / batch.bearing_std_rad) ** 2
    tail = TAIL_DEGREES_OF_FREEDOM + squared
    weights: Floats = np.minimum((TAIL_DEGREES_OF_FREEDOM + 2) / tail, 1.0)
    return weights, np.where(weights < 1.0, weights * TAIL_DEGREES_OF_FREEDOM / tail, 1.0)


def _redundancy(factor: Any, seen: Any) -> Floats:
    """Share of the noise of ranges and of bearings that stays in the residuals (2,).

    The rest is followed by poses and landmarks: the trace of the hat matrix, estimated with random signs
    (Hutchinson's estimator), the same ones every time so that the estimate can settle. Without it noise that
    a loose odometry follows would be estimated as zero.
    """
    shares, random = np.zeros(2), np.random.default_rng(0)
    for probe in range(2 * PROBES):
        kind = probe % 2
        signs = np.zeros(seen.shape[0])
        signs[kind::2] = random.choice([-1.0, 1.0], size=len(signs[kind::2]))
        pulled = seen.T @ signs
        shares[kind] += float(pulled @ factor.solve(pulled)) / len(signs[kind::2]) / PROBES
    return np.clip(1.0 - shares, 1e-4, 1.0)


def _with_noise(batch: Batch, residuals: Floats, redundancy: Floats) -> Batch:
    """Noise from the middle of the residuals; changes are bounded so that a bad start cannot run away.

    Noise that poses and landmarks have begun to follow (redundancy NaN) stays as it is: nothing would stop
    its fall.
    """
    now = np.array([batch.range_std_m, batch.bearing_std_rad])
    spread = GAUSSIAN_MAD * np.median(np.abs(residuals), axis=0) / np.sqrt(redundancy)
    bounded = np.clip(spread, 0.7 * now, 1.4 * now)
    range_std_m, bearing_std_rad = np.where(np.isnan(redundancy), now, bounded).tolist()
    return replace(batch, range_std_m=range_std_m, bearing_std_rad=bearing_std_rad)


def sighting_residuals(batch: Batch) -> tuple[Floats, tuple[Floats, Floats, Floats]]:
    """Expected minus reported (S, 2); derivatives (S, 2, n) by pose, landmark and parameters."""
    scale, bias_m, x_m, y_m, yaw_rad = batch.parameters
    pose = batch.poses[batch.pose]
    cosine, sine = np.cos(pose[:, 2]), np.sin(pose[:, 2])
    rotation = np.stack([np.stack([cosine, -sine], 1), np.stack([sine, cosine], 1)], 1)
    arm = rotation @ np.array([x_m, y_m])
    offset = batch.landmarks_m[batch.landmark] - pose[:, :2] - arm
    distance = np.maximum(np.hypot(*offset.T), 1e-6)
    along = offset / distance[:, None]
    across = np.column_stack([-along[:, 1], along[:, 0]]) / distance[:, None]
    bearing = np.arctan2(offset[:, 1], offset[:, 0]) - pose[:, 2] - yaw_rad
    residuals = np.column_stack(
        [scale * distance + bias_m - batch.range_m, wrap_to_pi(bearing - batch.bearing_rad)]
    )
    by_landmark = np.stack([scale * along, across], 1)
    turned_arm = np.column_stack([-arm[:, 1], arm[:, 0]])
    by_heading = -np.einsum("sij,sj->si", by_landmark, turned_arm) - np.array([0.0, 1.0])
    by_pose = np.concatenate([-by_landmark, by_heading[:, :, None]], axis=2)
    by_parameters = np.zeros((len(distance), 2, len(PARAMETERS)))
    by_parameters[:, 0, 0], by_parameters[:, 0, 1] = distance, 1.0
    by_parameters[:, :, 2:4] = -by_landmark @ rotation
    by_parameters[:, 1, 4] = -1.0
    return residuals, (by_pose, by_landmark, by_parameters * batch.free)


def odometry_residuals(batch: Batch) -> tuple[Floats, tuple[Floats, Floats]]:
    """Motion of the path minus that of the odometry (K - 1, 3); derivatives by the poses before and after."""
    before, after = batch.poses[:-1], batch.poses[1:]
    cosine, sine = np.cos(before[:, 2]), np.sin(before[:, 2])
    step = after - before
    ahead = cosine * step[:, 0] + sine * step[:, 1]
    left = -sine * step[:, 0] + cosine * step[:, 1]
    residuals = np.column_stack([ahead, left, step[:, 2]]) - batch.motion
    residuals[:, 2] = wrap_to_pi(residuals[:, 2])
    by_after = np.zeros((len(step), 3, 3))
    by_after[:, 0, 0], by_after[:, 0, 1] = cosine, sine
    by_after[:, 1, 0], by_after[:, 1, 1] = -sine, cosine
    by_after[:, 2, 2] = 1.0
    by_before = -by_after
    by_before[:, 0, 2], by_before[:, 1, 2] = left, -ahead
    return residuals, (by_before, by_after)


def _normal_equations(
    batch: Batch,
    residuals: Floats,
    derivatives: tuple[Floats, Floats, Floats],
    weights: Floats,
    first_parameters: Floats,
) -> _Equations:
    from scipy import sparse

    poses, landmarks = len(batch.poses), len(batch.landmarks_m)
    at_landmark, at_parameters = 3 * poses, 3 * poses + 2 * landmarks
    size = at_parameters + len(PARAMETERS)
    std = np.array([batch.range_std_m, batch.bearing_std_rad])
    whiten = np.sqrt(weights)[:, None] / std
    columns = [
        3 * batch.pose[:, None] + np.arange(3),
        at_landmark + 2 * batch.landmark[:, None] + np.arange(2),
        np.broadcast_to(at_parameters + np.arange(len(PARAMETERS)), (len(batch.pose), len(PARAMETERS))),
    ]
    seen = sparse_rows([d * whiten[:, :, None] for d in derivatives], columns, size)
    error, by_motion = odometry_residuals(batch)
    root = np.swapaxes(np.linalg.cholesky(np.linalg.inv(batch.motion_covariance)), 1, 2)
    index = 3 * np.arange(poses - 1)[:, None] + np.arange(3)
    moved = sparse_rows([root @ d for d in by_motion], [index, index + 3], size)
    pull, target = _priors(batch, first_parameters, size)
    stacked = sparse.vstack([seen, moved]).tocsr()
    values = np.concatenate([(residuals * whiten).ravel(), np.einsum("kij,kj->ki", root, error).ravel()])
    matrix = (stacked.T @ stacked + sparse.diags(pull)).tocsc()
    return _Equations(matrix, -stacked.T @ values + pull * target, stacked, values)


def _priors(batch: Batch, first_parameters: Floats, size: int) -> tuple[Floats, Floats]:
    """Weights and steps towards what is known beforehand: the survey or else the first pose; parameters."""
    pull, target = np.zeros(size), np.zeros(size)
    at_landmark, at_parameters = 3 * len(batch.poses), size - len(PARAMETERS)
    known = np.isfinite(batch.surveyed_m).ravel()
    if known.any():
        pull[at_landmark:at_parameters] = known / SURVEY_STD_M**2
        missing = np.nan_to_num((batch.surveyed_m - batch.landmarks_m).ravel())
        target[at_landmark:at_parameters] = missing
    else:
        pull[:3] = 1e8
    pull[at_parameters:] = 1 / np.where(batch.free, batch.prior_std, 1e-6) ** 2
    target[at_parameters:] = first_parameters - batch.parameters
    return pull, target


def sparse_rows(blocks: list[Floats], columns: list[Any], size: int) -> Any:
    """A sparse matrix of rows in which blocks (N, R, C) stand at columns (N, C)."""
    count, height = blocks[0].shape[:2]
    row = (np.arange(count * height).reshape(count, height, 1),)
    rows = [np.broadcast_to(row[0], block.shape).ravel() for block in blocks]
    wide = [
        np.broadcast_to(c[:, None, :], block.shape).ravel() for c, block in zip(columns, blocks, strict=True)
    ]
    values = np.concatenate([block.ravel() for block in blocks])
    places = (np.concatenate(rows), np.concatenate(wide))
    from scipy.sparse import coo_matrix

    return coo_matrix((values, places), shape=(count * height, size)).tocsr()


def _moved(batch: Batch, step: Floats) -> Batch:
    poses, landmarks = len(batch.poses), len(batch.landmarks_m)
    at_parameters = 3 * poses + 2 * landmarks
    return replace(
        batch,
        poses=batch.poses + step[: 3 * poses].reshape(poses, 3),
        landmarks_m=batch.landmarks_m + step[3 * poses : at_parameters].reshape(landmarks, 2),
        parameters=batch.parameters + step[at_parameters:],
    )

"""The errors, the mounting and the noise of a sensor by least squares in which outliers hardly count."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from . import _core
from ._bordered import PARAMETERS, Batch, Rows, clustered, moved_by, rows_of, solved
from .log import Floats

TAIL_DEGREES_OF_FREEDOM = 4.0
"""Of the Student-t distribution that weighs the sightings: outliers hardly count."""
LEAST_REDUNDANCY = 0.5
PROBES = 3
SETTLED = 0.05
"""A step of the parameters this small, in standard errors, ends the iteration."""
LARGEST_STEP = 0.5
GAUSSIAN_MAD = 1.4826
"""Standard deviations in a median absolute deviation."""


@dataclass(frozen=True)
class SensorProblem:
    """A batch with what is known beside it.

    Shapes: `motion_covariance` (K - 1, 3, 3); `prior` (5,) and `prior_std` (5,) of the parameters, 0 for
    those that are held; `noise_std` (2,) of range and bearing, to begin with.
    """

    batch: Batch
    motion_covariance: Floats
    prior: Floats
    prior_std: Floats
    noise_std: Floats


@dataclass(frozen=True)
class Solution:
    """The solved problem, the covariance of its parameters (5, 5), and how the iteration ended.

    `noise_known` (2,) says whether residuals tell the noise of ranges and of bearings: where the path follows
    them half the way or more, they do not.
    """

    problem: SensorProblem
    covariance: Floats
    noise_known: Any
    converged: bool


def solve_sensor(problem: SensorProblem, *, most_iterations: int = 40) -> Solution:
    """Gauss-Newton with Student-t weights; the noise of the sensor is estimated along the way.

    It ends when the parameters move by less than SETTLED standard errors and the noise by less than 1 %:
    poses of a stretch with little to hold them go on moving without a say in either.
    """
    converged = False
    known = np.array([True, True])
    for _ in range(most_iterations):
        rows = rows_of(problem.batch)
        equations = _equations(problem, rows, _weights(problem, rows)[0])
        unknowns, parameters = equations.step()
        size = max(float(np.abs(unknowns).max()), float(np.abs(parameters).max()))
        shorter = min(1.0, LARGEST_STEP / max(size, 1e-12))
        redundancy = _redundancy(problem, equations)
        known &= redundancy > LEAST_REDUNDANCY
        noise_std = _noise_std(problem, rows, np.where(known, redundancy, np.nan))
        change = np.log(noise_std / problem.noise_std)
        moved = moved_by(problem.batch, shorter * unknowns, shorter * parameters)
        problem = replace(problem, batch=moved, noise_std=noise_std)
        error = np.sqrt(np.diag(equations.covariance()))
        if np.all(np.abs(shorter * parameters) < SETTLED * error) and np.all(np.abs(change) < 0.01):
            converged = True
            break
    return Solution(problem, _covariance(problem), known, converged)


def _equations(problem: SensorProblem, rows: Rows, weights: Floats) -> _core.LeastSquares:
    root = np.swapaxes(np.linalg.cholesky(np.linalg.inv(problem.motion_covariance)), 1, 2)
    return solved(
        problem.batch,
        rows,
        whitening=(np.sqrt(weights)[:, None] / problem.noise_std, root),
        missing=problem.prior - problem.batch.parameters,
        prior_std=problem.prior_std,
    )


def _weights(problem: SensorProblem, rows: Rows) -> tuple[Floats, Floats]:
    """Weight of each sighting (S,), and the mean derivative of its weighted residual (S,), which is less."""
    tail = TAIL_DEGREES_OF_FREEDOM + np.sum((rows.seen / problem.noise_std) ** 2, axis=1)
    weights: Floats = np.minimum((TAIL_DEGREES_OF_FREEDOM + 2) / tail, 1.0)
    return weights, np.where(weights < 1.0, weights * TAIL_DEGREES_OF_FREEDOM / tail, 1.0)


def _covariance(problem: SensorProblem) -> Floats:
    """Of the parameters, from how much stretches of the log disagree.

    Residuals are enlarged by the share of the noise that the fit has followed.
    """
    rows, sightings = rows_of(problem.batch), len(problem.batch.pose)
    weights, curvature = _weights(problem, rows)
    equations = _equations(problem, rows, curvature)
    # Rows count by their weight, the precision by its mean derivative.
    ratio = np.repeat(np.sqrt(weights / curvature), 2)
    scores, share = equations.residuals(), np.ones(len(equations.residuals()))
    scores[: 2 * sightings] *= ratio**2
    share[: 2 * sightings] = np.tile(np.maximum(_redundancy(problem, equations, ratio), 0.1), sightings)
    influence = equations.influence() * (scores / np.sqrt(share))[:, None]
    return clustered(problem.batch, influence, equations.covariance())


def _redundancy(problem: SensorProblem, equations: _core.LeastSquares, ratio: Any = 1.0) -> Floats:
    """Share of the noise of ranges and of bearings that stays in the residuals (2,).

    The rest is followed by poses and landmarks: the trace of the hat matrix, estimated with random signs
    (Hutchinson's estimator), the same ones every time so that the estimate can settle. Without it noise that
    a loose odometry follows would be estimated as zero. `ratio` (2 S,) is by how much rows are to count more
    than in the equations.
    """
    batch = problem.batch
    seen = 2 * len(batch.pose)
    rows = seen + 3 * len(batch.motion)
    size = rows + 3 * len(batch.poses) + 2 * len(batch.landmarks_m) + len(PARAMETERS)
    shares, random = np.zeros(2), np.random.default_rng(0)
    for probe in range(2 * PROBES):
        kind = probe % 2
        signs = np.zeros(size)
        signs[kind:seen:2] = random.choice([-1.0, 1.0], size=seen // 2)
        signs[:seen] *= ratio
        shares[kind] -= float(signs[:rows] @ equations.response(signs)) / (seen // 2) / PROBES
    return np.clip(1.0 - shares, 1e-4, 1.0)


def _noise_std(problem: SensorProblem, rows: Rows, redundancy: Floats) -> Floats:
    """Noise from the middle of the residuals; changes are bounded so that a bad start cannot run away.

    Noise that poses and landmarks have begun to follow (redundancy NaN) stays as it is: nothing would stop
    its fall.
    """
    now = problem.noise_std
    spread = GAUSSIAN_MAD * np.median(np.abs(rows.seen), axis=0) / np.sqrt(redundancy)
    bounded = np.clip(spread, 0.7 * now, 1.4 * now)
    found: Floats = np.where(np.isnan(redundancy), now, bounded)
    return found

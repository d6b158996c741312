"""The least-squares problem of `calibrate` with gains, delay and the parts of the noise at its border.

With poses and landmarks x and parameters p a step solves, with A sparse, B thin and C small,

    [ A  B ] [dx]   [a]        S = C - B' A^-1 B;   dp = S^-1 (b - B' A^-1 a);   dx = A^-1 (a - B dp)

and S^-1 is the covariance of the parameters, everything else integrated out. A draw of the posterior is a
step on residuals drawn from their noise: its share of a residual's variance is what the solution follows.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from .._batch import PARAMETERS as SENSOR_PARAMETERS
from .._batch import Batch, factorised, odometry_residuals, sighting_residuals, sparse_rows
from ..log import Floats
from .motion import Links

DRAWS = 4
GAUGE = 1e8
"""Information that holds the first pose where it is."""
APART_M2 = 1e4
"""Variance between poses that no odometry joins."""
LEAST_VARIANCE = np.array([1e-8, 1e-8, 1e-10])


@dataclass(frozen=True)
class Noise:
    """Variances: `squares` (P,) of the parts of motion, `seen` (2,) of range and bearing, and their tail."""

    squares: Floats
    seen: Floats
    tail: float | None = None
    """Degrees of freedom of Student's t; None for a normal tail."""


@dataclass(frozen=True)
class Problem:
    """A log's stretch to be explained, with its present solution.

    `batch` holds poses, landmarks, sightings and the five sensor parameters; `links` the odometry; `axes`
    (P,) the axis of each part of the noise; `joined` (K - 1,) says where odometry leads on; `motion` (N,) are
    the motion parameters less those at which `links` was computed. `prior_std` (N + 5,) and `prior` (N + 5,)
    hold motion parameters first; a `prior_std` of 0 holds a parameter where it is.
    """

    batch: Batch
    links: Links
    axes: Any
    joined: Any
    motion: Floats
    prior: Floats
    prior_std: Floats

    @property
    def parameters(self) -> Floats:
        """Motion parameters (as differences), then those of the sensor."""
        return np.concatenate([self.motion, self.batch.parameters])


@dataclass(frozen=True)
class Rows:
    """Whitened rows: `seen` (S, 2) and `moved` (K - 1, 3) residuals with derivatives and what they weigh."""

    seen: Floats
    moved: Floats
    by_state: Any
    by_parameter: Floats
    weights: Floats
    variance: Floats
    """Of the motion (K - 1, 3)."""


def variance_of_links(problem: Problem, noise: Noise) -> Floats:
    """Variance (K - 1, 3) of each link, ahead, left and turn; a turn half way swings the rest aside."""
    links = problem.links
    variance = np.tile(LEAST_VARIANCE, (len(links.motion), 1))
    for axis in range(3):
        chosen = problem.axes == axis
        variance[:, axis] += links.share[:, chosen] @ noise.squares[chosen]
    swing = variance[:, 2:] / 12 * links.motion[:, [1, 0]] ** 2
    variance[:, :2] += swing
    variance[~problem.joined] = APART_M2
    return variance


def tail_weights(squared: Floats, tail: float | None) -> Floats:
    """Weight (S,) of each sighting by its squared distance: 1 for a normal tail."""
    return np.ones(len(squared)) if tail is None else (tail + 2) / (tail + squared)


def linearised(problem: Problem, noise: Noise) -> Rows:
    """The rows of the problem at its present solution."""
    batch = problem.batch
    residuals, (by_pose, by_landmark, by_sensor) = sighting_residuals(batch)
    std = np.sqrt(noise.seen)
    weights = tail_weights(np.sum((residuals / std) ** 2, axis=1), noise.tail)
    whiten = np.sqrt(weights)[:, None] / std
    error, (by_before, by_after) = odometry_residuals(batch)
    error = error - problem.links.by_parameter @ problem.motion
    by_motion = -problem.links.by_parameter
    variance = variance_of_links(problem, noise)
    root = _middle(problem.links.motion) / np.sqrt(variance)[:, :, None]
    poses, size = len(batch.poses), 3 * len(batch.poses) + 2 * len(batch.landmarks_m)
    pose = 3 * batch.pose[:, None] + np.arange(3)
    landmark = 3 * poses + 2 * batch.landmark[:, None] + np.arange(2)
    link = 3 * np.arange(poses - 1)[:, None] + np.arange(3)
    from scipy.sparse import vstack

    seen = sparse_rows([d * whiten[:, :, None] for d in (by_pose, by_landmark)], [pose, landmark], size)
    moved = sparse_rows([root @ by_before, root @ by_after], [link, link + 3], size)
    count = len(problem.motion)
    by_parameter = np.zeros((seen.shape[0] + moved.shape[0], count + len(SENSOR_PARAMETERS)))
    by_parameter[: seen.shape[0], count:] = (by_sensor * whiten[:, :, None]).reshape(seen.shape[0], -1)
    by_parameter[seen.shape[0] :, :count] = (root @ by_motion).reshape(moved.shape[0], -1)
    return Rows(
        seen=residuals * whiten,
        moved=np.einsum("kij,kj->ki", root, error),
        by_state=vstack([seen, moved]).tocsr(),
        by_parameter=by_parameter * (problem.prior_std > 0),
        weights=weights,
        variance=variance,
    )


def _middle(motion: Floats) -> Floats:
    """Matrices (K - 1, 3, 3) that take errors to where those of place and turn are independent: half way."""
    matrices = np.tile(np.eye(3), (len(motion), 1, 1))
    matrices[:, 0, 2], matrices[:, 1, 2] = 0.5 * motion[:, 1], -0.5 * motion[:, 0]
    return matrices


class Bordered:
    """The factorised normal equations of the rows."""

    def __init__(self, problem: Problem, rows: Rows) -> None:
        from scipy.sparse import diags

        self._order = _in_time(problem.batch)
        self._by_state = rows.by_state[:, self._order]
        self._by_parameter = rows.by_parameter
        held = np.isin(self._order, np.arange(3))
        self._gauge = GAUGE * held
        matrix = (self._by_state.T @ self._by_state + diags(self._gauge + 1e-9)).tocsc()
        self._factor = factorised(matrix)
        self._border = self._by_state.T @ self._by_parameter
        self._solved = self._factor.solve(self._border)
        self._pull = 1 / np.where(problem.prior_std > 0, problem.prior_std, 1e-9) ** 2
        schur = self._by_parameter.T @ self._by_parameter + np.diag(self._pull)
        schur -= self._border.T @ self._solved
        self.covariance = np.linalg.inv(0.5 * (schur + schur.T))
        """Of the parameters, motion first."""
        self._missing = problem.prior - problem.parameters

    def step(self, residuals: Floats) -> tuple[Floats, Floats]:
        """The step (n,), (N + 5,) that explains whitened residuals (R,), in the problem's order of states."""
        return self._solve(-(self._by_state.T @ residuals), self._by_parameter, residuals, self._missing)

    def draw(self, generator: np.random.Generator) -> tuple[Floats, Floats]:
        """A draw (n,), (N + 5,) from the posterior, less its mode."""
        noise = generator.standard_normal(self._by_state.shape[0])
        gauge = np.sqrt(self._gauge) * generator.standard_normal(len(self._gauge))
        missing = generator.standard_normal(len(self._pull)) / np.sqrt(self._pull)
        return self._solve(-(self._by_state.T @ noise) + gauge, self._by_parameter, noise, missing)

    def _solve(
        self, a: Floats, by_parameter: Floats, residuals: Floats, missing: Floats
    ) -> tuple[Floats, Floats]:
        b = self._pull * missing - by_parameter.T @ residuals
        found = self._factor.solve(a)
        parameters = self.covariance @ (b - self._border.T @ found)
        found = found - self._solved @ parameters
        states = np.empty_like(found)
        states[self._order] = found
        return states, parameters

    def influence(self) -> Floats:
        """What each row's residual does to the parameters (R, N + 5)."""
        own: Floats = (self._by_parameter - self._by_state @ self._solved) @ self.covariance
        return own

    def followed(self, generator: np.random.Generator) -> Floats:
        """Share (R,) of each row's variance that the solution has followed, from DRAWS draws."""
        shares = np.zeros(self._by_state.shape[0])
        for _ in range(DRAWS):
            states, parameters = self.draw(generator)
            moved = self._by_state @ states[self._order] + self._by_parameter @ parameters
            shares += moved**2 / DRAWS
        return shares


def _in_time(batch: Batch) -> Any:
    """Order of the states in which little fills in: each landmark after the last pose that saw it."""
    last = np.zeros(len(batch.landmarks_m))
    np.maximum.at(last, batch.landmark, batch.pose)
    poses = np.repeat(np.arange(len(batch.poses)), 3)
    return np.argsort(np.concatenate([poses, np.repeat(last + 0.5, 2)]), kind="stable")


def moved_by(problem: Problem, states: Floats, parameters: Floats) -> Problem:
    """The problem with its solution a step further."""
    batch, count = problem.batch, len(problem.motion)
    poses = 3 * len(batch.poses)
    moved = replace(
        batch,
        poses=batch.poses + states[:poses].reshape(-1, 3),
        landmarks_m=batch.landmarks_m + states[poses:].reshape(-1, 2),
        parameters=batch.parameters + parameters[count:],
    )
    return replace(problem, batch=moved, motion=problem.motion + parameters[:count])

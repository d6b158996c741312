"""The least-squares problem of a stretch of a log, with gains, delay and the parts of the noise.

The core solves it (`smoothing::Bordered`). A draw of the posterior is a step on residuals drawn from their
noise: its share of a residual's variance is what the solution follows.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from .. import _bordered as bordered
from .._bordered import Batch
from ..log import Floats
from .motion import Links

DRAWS = 4
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
    hold motion parameters first; a `prior_std` of 0 holds a parameter where it is. `repeats` (N + 5,) is how
    many times as uncertain rows whose errors repeat leave each parameter as rows that err independently.
    """

    batch: Batch
    links: Links
    axes: Any
    joined: Any
    motion: Floats
    prior: Floats
    prior_std: Floats
    repeats: Floats

    @property
    def parameters(self) -> Floats:
        """Motion parameters (as differences), then those of the sensor."""
        return np.concatenate([self.motion, self.batch.parameters])

    @property
    def weighed_std(self) -> Floats:
        """Deviations of the prior (N + 5,), narrower where the rows tell less than they seem to."""
        return self.prior_std / self.repeats


@dataclass(frozen=True)
class Rows:
    """Whitened rows: `seen` (S, 2) and `moved` (K - 1, 3) residuals with what they weigh."""

    seen: Floats
    moved: Floats
    weights: Floats
    variance: Floats
    """Of the motion (K - 1, 3)."""
    solver: Solver
    cost: float
    """As `cost_of`."""


class Solver:
    """The factorised equations of the rows."""

    def __init__(self, problem: Problem, rows: bordered.Rows, whitening: tuple[Floats, Floats]) -> None:
        missing = problem.prior - problem.parameters
        self._core = bordered.solved(
            problem.batch, rows, whitening=whitening, missing=missing, prior_std=problem.weighed_std
        )
        self._sightings = len(rows.seen)
        self._unknowns = 3 * len(problem.batch.poses) + 2 * len(problem.batch.landmarks_m)
        self.residuals = self._core.residuals()
        self.covariance = self._core.covariance()
        """Of the parameters, motion first."""

    def step(self) -> tuple[Floats, Floats]:
        """The step (n,), (N + 5,) that explains the residuals."""
        return self._core.step()

    def influence(self) -> Floats:
        """What each row's residual does to the parameters (R, N + 5)."""
        return self._core.influence()

    def followed(self, generator: np.random.Generator) -> Floats:
        """Share (R,) of each row's variance that the solution has followed, from DRAWS draws."""
        size = len(self.residuals)
        moved, left = np.zeros(size), np.zeros(size)
        for _ in range(DRAWS):
            drawn = generator.standard_normal(size + self._unknowns + len(self.covariance))
            response = self._core.response(drawn)
            moved += response**2 / DRAWS
            left += (drawn[:size] + response) ** 2 / DRAWS
        seen = 2 * self._sightings
        return np.concatenate(
            [_surest(moved[:seen], left[:seen], columns=2), _surest(moved[seen:], left[seen:], columns=3)]
        )


def _surest(moved: Floats, left: Floats, *, columns: int) -> Floats:
    """Share (n,) followed of rows of so many kinds in turn, from the squares of what moved and what was left.

    **Why:** each is off in proportion to itself. Odometry that says little is followed for all but a few per
    cent, which the chance of what moved drowns: the noise of motion came out too small by up to ten times.
    """
    moved, left = moved.reshape(-1, columns), left.reshape(-1, columns)
    of_moved, of_left = np.mean(left, axis=0) ** 2, np.mean(moved, axis=0) ** 2
    return np.asarray((of_moved * moved + of_left * (1.0 - left)) / (of_moved + of_left)).ravel()


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
    rows, variance, root = _unweighed(problem, noise)
    std = np.sqrt(noise.seen)
    weights = tail_weights(np.sum((rows.seen / std) ** 2, axis=1), noise.tail)
    whiten = np.sqrt(weights)[:, None] / std
    solver = Solver(problem, rows, (whiten, root))
    return Rows(
        seen=rows.seen * whiten,
        moved=np.einsum("kij,kj->ki", root, rows.moved),
        weights=weights,
        variance=variance,
        solver=solver,
        cost=_cost(problem, noise, rows, root),
    )


def cost_of(problem: Problem, noise: Noise) -> float:
    """What the least-squares problem makes least: minus the log of the posterior, but for a constant."""
    rows, _, root = _unweighed(problem, noise)
    return _cost(problem, noise, rows, root)


def _cost(problem: Problem, noise: Noise, rows: bordered.Rows, root: Floats) -> float:
    squared = np.sum(rows.seen**2 / noise.seen, axis=1)
    tail = noise.tail
    seen = squared if tail is None else (tail + 2) * np.log1p(squared / tail)
    free = problem.prior_std > 0
    missing = (problem.prior - problem.parameters)[free] / problem.weighed_std[free]
    moved = np.einsum("kij,kj->ki", root, rows.moved)
    return 0.5 * float(seen.sum() + np.sum(moved**2) + np.sum(missing**2))


def _unweighed(problem: Problem, noise: Noise) -> tuple[bordered.Rows, Floats, Floats]:
    """The rows, the variance (K - 1, 3) of the motion, and roots (K - 1, 3, 3) of its precision."""
    links = problem.links
    batch = replace(problem.batch, motion=problem.batch.motion + links.by_parameter @ problem.motion)
    variance = variance_of_links(problem, noise)
    root = _middle(links.motion) / np.sqrt(variance)[:, :, None]
    return bordered.rows_of(batch, links.by_parameter), variance, root


def _middle(motion: Floats) -> Floats:
    """Matrices (K - 1, 3, 3) that take errors to where those of place and turn are independent: half way."""
    matrices = np.tile(np.eye(3), (len(motion), 1, 1))
    matrices[:, 0, 2], matrices[:, 1, 2] = 0.5 * motion[:, 1], -0.5 * motion[:, 0]
    return matrices


def moved_by(problem: Problem, unknowns: Floats, parameters: Floats) -> Problem:
    """The problem with its solution a step further."""
    count = len(problem.motion)
    moved = bordered.carried_by(problem.batch, unknowns, parameters[count:])
    return replace(problem, batch=moved, motion=problem.motion + parameters[:count])

"""Motion models of one's own: a class that says where a row of odometry takes the robot, and how surely."""

from __future__ import annotations

from dataclasses import replace
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from .answers import checked, in_one_line, read_only
from .arrays import checked_controls
from .datasets.graph import UPPER_3
from .errors import DataError, ModelError
from .log import Controls, Floats, Log

_SAME = 1e-9
_STANDS_M2 = 1e-12
"""Variance of where a log begins: odometry says nothing of what was before."""


class MotionModel(Protocol):
    """What a class needs to be a motion model; it is called on arrays, once, with a row for each control.

    `controls` (n, C) are the rows of odometry, in whatever columns the robot has, `dt_s` (n,) how long each
    holds.
    """

    def increments(self, controls: Floats, dt_s: Floats) -> ArrayLike:
        """Where each row takes the robot (n, 3), seen from where it began: ahead and left [m], turn [rad]."""

    def covariance(self, controls: Floats, dt_s: Floats) -> ArrayLike:
        """Covariance of each of these (n, 3, 3), or of all (3, 3), in m², m·rad, rad²; positive definite."""


def with_motion(log: Log, model: MotionModel, *, controls: tuple[ArrayLike, ArrayLike] | None = None) -> Log:
    """The log with the displacements that a motion model of one's own makes of its odometry.

    Row i holds from its stamp until the next, the last one to the last sighting. `controls` are `stamp_s`
    (N,) and values (N, C) in place of those of the log, for odometry of more columns than a log holds. Cut
    at sightings, the pieces of a row add up to it, as with all models (`docs/equations.md`). For live use,
    `displacement` makes one row.

    >>> class Mecanum:
    ...     def increments(self, wheels, dt_s):
    ...         mixing = np.array([[1, 1, 1, 1], [-1, 1, 1, -1], [-2, 2, -2, 2]]) / 4
    ...         return wheels @ mixing.T * dt_s[:, None]
    ...     def covariance(self, wheels, dt_s):
    ...         return dt_s[:, None, None] * np.diag([1e-4, 4e-4, 1e-3])
    >>> log = Log.from_arrays(([0.0, 1.0], [[0.0, 0.0], [0.0, 0.0]]), ([1.0], [4.2], [0.3]))
    >>> moved = with_motion(log, Mecanum(), controls=([0.0, 1.0], [[0.2, 0.2, 0.2, 0.2], [0, 0, 0, 0]]))
    >>> moved.controls.values.tolist()
    [[0.0, 0.0, 0.0], [0.2, 0.0, 0.0]]

    Errors: `ModelError` for answers of another shape, that are not finite, or depend on other rows, and for
    covariances that are none; `DataError` for controls that are no table with growing stamps.
    """
    given = (log.controls.stamp_s, log.controls.values) if controls is None else controls
    stamp_s, values = checked_controls(given)
    if len(stamp_s) == 0:
        raise DataError("controls: there are none")
    ends = np.append(stamp_s[1:], log.sightings.stamp_s[log.sightings.stamp_s > stamp_s[-1]][-1:])
    if len(ends) == 0:
        raise DataError("controls: nothing comes after the first row, so that it holds for no time")
    values, dt_s = values[: len(ends)], np.diff(ends, prepend=stamp_s[0])
    increments, covariance = _asked(model, values, dt_s)
    _check_rows(model, values, dt_s, increments)
    start = np.diag(np.full(3, _STANDS_M2))[None]
    triangles = np.concatenate([start, covariance])[:, UPPER_3[0], UPPER_3[1]]
    moved = Controls(np.append(stamp_s[0], ends), np.concatenate([np.zeros((1, 3)), increments]), triangles)
    return replace(log, controls=moved, config={**log.config, "motion": {"model": "increments"}})


def displacement(model: MotionModel, control: ArrayLike, dt_s: float) -> tuple[Floats, Floats]:
    """Where one control (C,) takes the robot in so long: (3,) and its covariance (3, 3).

    `Robot.odometry(stamp_s, moved, covariance=covariance)` takes both, with `motion: {model: increments}`.
    Errors: as of `with_motion`.
    """
    _, row = checked_controls(([0.0], np.expand_dims(np.asarray(control), 0)))
    increments, covariance = _asked(model, row, np.array([dt_s], dtype=np.float64))
    return increments[0], covariance[0]


def _asked(model: MotionModel, values: Floats, dt_s: Floats) -> tuple[Floats, Floats]:
    """Displacements and covariances of all rows."""
    name = type(model).__name__
    for part in ("increments", "covariance"):
        if not hasattr(model, part):
            raise ModelError(f"{name}.{part} is missing: a motion model has increments and covariance")
    given = read_only(values, dt_s)
    with in_one_line(f"{name}.increments"):
        increments = model.increments(*given)
    with in_one_line(f"{name}.covariance"):
        covariance = model.covariance(*given)
    rows = len(values)
    shape = (3, 3) if np.shape(covariance) == (3, 3) else (rows, 3, 3)
    noise = np.broadcast_to(checked(f"{name}.covariance", covariance, shape), (rows, 3, 3))
    symmetric = np.abs(noise - noise.swapaxes(1, 2)).max() <= _SAME * np.abs(noise).max()
    proper = np.linalg.eigvalsh(noise).min(axis=1) > 0.0
    if not symmetric or not proper.all():
        row = int(np.argmin(proper))
        raise ModelError(
            f"{name}.covariance: row {row} is {noise[row].tolist()}, expected a positive definite one"
        )
    return checked(f"{name}.increments", increments, (rows, 3)), noise


def _check_rows(model: MotionModel, values: Floats, dt_s: Floats, increments: Floats) -> None:
    """A row depends on no other: in live use it comes alone."""
    for row in {0, len(values) // 2, len(values) - 1}:
        alone, _ = displacement(model, values[row], float(dt_s[row]))
        if not np.abs(alone - increments[row]).max() <= _SAME * (1.0 + np.abs(alone).max()):
            among = f"alone gives {alone.tolist()}, among others {increments[row].tolist()}"
            raise ModelError(f"{type(model).__name__}.increments: row {row} {among}")

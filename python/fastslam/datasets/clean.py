"""What robots do to logs: not-a-number readings, repeated and disordered stamps. Repaired and counted."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..errors import DataError
from ..log import Bools, Controls, Floats, Ints, Problem, Sightings
from .planar import wrap_to_pi


def clean_controls(stamp_s: Floats, values: Floats, *, path: Path) -> tuple[Controls, tuple[Problem, ...]]:
    """Controls with strictly increasing stamps: bad rows dropped, stable sort, the last of equal stamps kept.

    Shapes: `stamp_s` (N,), `values` (N, C). Errors: DataError when no row is left.
    """
    problems: list[Problem] = []
    finite = np.isfinite(stamp_s) & np.isfinite(values).all(axis=1)
    _count(problems, "odometry rows with NaN or infinite values: dropped", int(np.sum(~finite)))
    stamp_s, values = stamp_s[finite], values[finite]
    if len(stamp_s) == 0:
        raise DataError("no usable odometry row is left (all hold NaN or infinite values)", path)
    order, message, late = _time_order(stamp_s)
    _count(problems, f"odometry rows {message}", late)
    stamp_s, values = stamp_s[order], values[order]
    is_last = np.append(np.diff(stamp_s) > 0, True)
    _count(
        problems,
        "odometry rows with a repeated stamp: the last row of each stamp kept",
        int(np.sum(~is_last)),
    )
    return Controls(stamp_s[is_last], values[is_last]), tuple(problems)


def clean_sightings(sightings: Sightings, *, path: Path) -> tuple[Sightings, tuple[Problem, ...]]:
    """Sightings in time order with finite, positive ranges and bearings in [-pi, pi].

    Errors: DataError when there were sightings and none is left.
    """
    problems: list[Problem] = []
    finite = np.isfinite(sightings.stamp_s) & np.isfinite(sightings.range_m)
    finite &= np.isfinite(sightings.bearing_rad)
    _count(problems, "sightings with NaN or infinite stamp, range or bearing: dropped", int(np.sum(~finite)))
    positive = np.greater(sightings.range_m, 0.0, where=finite, out=np.zeros_like(finite))
    _count(problems, "sightings with zero or negative range: dropped", int(np.sum(finite & ~positive)))
    kept = select_sightings(sightings, finite & positive)
    if len(kept.stamp_s) == 0 and len(sightings.stamp_s) > 0:
        raise DataError(f"no usable sighting is left of {len(sightings.stamp_s)}", path)
    order, message, late = _time_order(kept.stamp_s)
    _count(problems, f"sightings {message}", late)
    beyond = np.abs(kept.bearing_rad) > np.pi
    _count(problems, "sightings with a bearing beyond +-pi: wrapped", int(np.sum(beyond)))
    if np.any(np.abs(kept.bearing_rad) > 4 * np.pi):
        raise DataError("bearings beyond +-4 pi: expected radians, are these degrees?", path)
    kept = select_sightings(kept, order)
    signature = np.where(np.isfinite(kept.signature), kept.signature, np.nan)
    return (
        Sightings(
            stamp_s=kept.stamp_s,
            range_m=kept.range_m,
            bearing_rad=wrap_to_pi(kept.bearing_rad),
            identity=kept.identity,
            class_index=kept.class_index,
            signature=signature,
            covariance=kept.covariance,
        ),
        tuple(problems),
    )


def no_sightings() -> Sightings:
    """The sightings of a log that has only scans."""
    numbers: Floats = np.empty(0)
    indices: Ints = np.empty(0, dtype=np.int64)
    return Sightings(numbers, numbers, numbers, indices, indices, numbers)


def select_sightings(sightings: Sightings, chosen: Bools | Ints) -> Sightings:
    """The chosen rows, by mask or by index, in that order."""
    return Sightings(
        stamp_s=sightings.stamp_s[chosen],
        range_m=sightings.range_m[chosen],
        bearing_rad=sightings.bearing_rad[chosen],
        identity=sightings.identity[chosen],
        class_index=sightings.class_index[chosen],
        signature=sightings.signature[chosen],
        covariance=None if sightings.covariance is None else sightings.covariance[chosen],
    )


def _time_order(stamp_s: Floats) -> tuple[Ints, str, int]:
    """Stable sorting order, what to say about it, and how many rows come after a later stamp."""
    behind_s = np.maximum.accumulate(stamp_s) - stamp_s if len(stamp_s) else stamp_s
    late = int(np.sum(behind_s > 0))
    worst_s = float(np.max(behind_s, initial=0.0))
    return np.argsort(stamp_s, kind="stable"), f"out of time order by up to {worst_s:.6g} s: sorted", late


def _count(problems: list[Problem], message: str, count: int) -> None:
    if count > 0:
        problems.append(Problem(message, count))

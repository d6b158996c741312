"""What robots do to logs: not-a-number readings, repeated and disordered stamps. Repaired and counted."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ..errors import DataError
from ..limits import LARGEST_STAMP_S, WIDEST_GAP_S, stamp_fault
from ..log import REPEATED_STAMPS, Bools, Controls, Floats, Ints, Problem, Sightings
from ..measured import BOTH, Measures, as_rows, measured_alone
from .planar import wrap_to_pi

FULL_TURNS_ALLOWED = 0.01
"""Share of bearings that may lie beyond +-2 pi, by an angle that was not wrapped."""
JITTER_S = 1.0
"""Rows that come later in the file than in time by no more than this are sorted."""
LEAST_RUN = 5
"""So many stamps in order, but behind what came before, are no late rows: the clock was set back."""


def clean_controls(
    stamp_s: Floats, values: Floats, *, path: Path, lines: Sequence[int] | None = None
) -> tuple[Controls, tuple[Problem, ...]]:
    """Controls with strictly increasing stamps: bad rows dropped, stable sort, the last of equal stamps kept.

    Shapes: `stamp_s` (N,), `values` (N, C); `lines` says where the rows stand in the file. Errors: DataError
    when no row is left, or for a stamp that cannot be in seconds or lies months from all others.
    """
    refuse_wrong_stamps(stamp_s, path=path, lines=lines)
    problems: list[Problem] = []
    finite = np.isfinite(stamp_s) & np.isfinite(values).all(axis=1)
    _count(problems, "odometry rows with NaN or infinite values: dropped", int(np.sum(~finite)))
    stamp_s, values = stamp_s[finite], values[finite]
    if len(stamp_s) == 0:
        raise DataError("no usable odometry row is left (all hold NaN or infinite values)", path)
    order, message, late = _time_order(stamp_s, "odometry", path)
    _count(problems, f"odometry rows {message}", late)
    stamp_s, values = stamp_s[order], values[order]
    is_last = np.append(np.diff(stamp_s) > 0, True)
    _count(
        problems,
        "odometry rows with a repeated stamp: the last row of each stamp kept",
        int(np.sum(~is_last)),
        code=REPEATED_STAMPS,
    )
    return Controls(stamp_s[is_last], values[is_last]), tuple(problems)


def clean_sightings(
    sightings: Sightings, *, path: Path, lines: Sequence[int] | None = None, measures: Measures = BOTH
) -> tuple[Sightings, tuple[Problem, ...]]:
    """Sightings in time order with finite, positive ranges and bearings in [-pi, pi].

    `measures` are the columns that the sensor measures, or which of the two each row has; the others are NaN.
    `lines` says where the rows stand in the file. Errors: DataError when there were sightings and none is
    left, or for a stamp that cannot be in seconds or lies months from all others.
    """
    refuse_wrong_stamps(sightings.stamp_s, path=path, lines=lines)
    problems: list[Problem] = []
    sightings = measured_alone(sightings, measures)
    measured = np.isfinite(np.column_stack([getattr(sightings, column) for column in BOTH]))
    expected = as_rows(measures, len(sightings.stamp_s))
    finite = np.isfinite(sightings.stamp_s) & (measured | ~expected).all(axis=1)
    _count(problems, "sightings with NaN or infinite stamp, range or bearing: dropped", int(np.sum(~finite)))
    positive = finite & ~(sightings.range_m <= 0.0)
    _count(problems, "sightings with zero or negative range: dropped", int(np.sum(finite & ~positive)))
    kept = select_sightings(sightings, finite & positive)
    if len(kept.stamp_s) == 0 and len(sightings.stamp_s) > 0:
        raise DataError(f"no usable sighting is left of {len(sightings.stamp_s)}", path)
    order, message, late = _time_order(kept.stamp_s, "sighting", path)
    _count(problems, f"sightings {message}", late)
    beyond = np.abs(kept.bearing_rad) > np.pi
    _count(problems, "sightings with a bearing beyond +-pi: wrapped", int(np.sum(beyond)))
    _refuse_degrees(kept.bearing_rad, path)
    kept = select_sightings(kept, order)
    twice = _identical_rows(kept)
    _count(problems, "sightings that repeat another row in every number: dropped", int(np.sum(twice)))
    kept = select_sightings(kept, ~twice)
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
            sensor_index=kept.sensor_index,
        ),
        tuple(problems),
    )


def _refuse_degrees(bearing_rad: Floats, path: Path) -> None:
    """Refuses what no difference of two angles in [-pi, pi] can be: a narrow camera in degrees."""
    size = np.abs(bearing_rad)
    far = float(np.mean(size > 2 * np.pi)) if len(size) else 0.0
    if far > FULL_TURNS_ALLOWED or np.any(size > 4 * np.pi):
        most = np.nanmax(size)
        message = f"bearings up to {most:.4g}, {far:.1%} beyond +-2 pi: expected radians, are these degrees?"
        raise DataError(message, path)


def _identical_rows(sightings: Sightings) -> Bools:
    """Rows, in time order, that repeat an earlier one of the same stamp in every number.

    Noise makes no reading twice: the rows were written twice, or a detector's output was recorded twice.
    """
    bearing = np.nan_to_num(sightings.bearing_rad, nan=-1e300)
    range_m = np.nan_to_num(sightings.range_m, nan=-1e300)
    columns = [sightings.stamp_s, range_m, bearing, sightings.identity]
    columns += [sightings.class_index, np.nan_to_num(sightings.signature, nan=-1e300)]
    if sightings.sensor_index is not None:
        columns.append(sightings.sensor_index)
    if sightings.covariance is not None:
        columns += list(np.nan_to_num(sightings.covariance, nan=-1e300).T)
    table = np.column_stack(columns)
    first = np.unique(table, axis=0, return_index=True)[1]
    repeats = np.ones(len(table), dtype=np.bool_)
    repeats[first] = False
    return repeats


def refuse_wrong_stamps(stamp_s: Floats, *, path: Path, lines: Sequence[int] | None = None) -> None:
    """Refuses stamps that no repair can save, and names the row.

    Errors: DataError for a stamp that cannot be in seconds, and for stamps that lie months from the others:
    the first row of the smaller part.
    """
    finite = np.flatnonzero(np.isfinite(stamp_s))
    beyond = finite[np.abs(stamp_s[finite]) >= LARGEST_STAMP_S]
    if len(beyond):
        fault = stamp_fault(float(stamp_s[beyond[0]]))
        raise _stamp_error(str(fault), int(beyond[0]), path, lines)
    order = finite[np.argsort(stamp_s[finite], kind="stable")]
    gaps_s = np.diff(stamp_s[order])
    if len(gaps_s) == 0 or gaps_s.max() <= WIDEST_GAP_S:
        return
    split = int(np.argmax(gaps_s)) + 1
    wrong = order[:split] if split < len(order) - split else order[split:]
    row, gap_s = int(wrong.min()), float(gaps_s[split - 1])
    others = f"{len(order) - len(wrong):,} other rows"
    fault = f"the stamp {stamp_s[row]:.15g} lies {gap_s:.6g} s from the {others}"
    raise _stamp_error(f"{fault}: a wrong stamp, another clock, or not in seconds?", row, path, lines)


def _stamp_error(fault: str, row: int, path: Path, lines: Sequence[int] | None) -> DataError:
    if lines is None:
        return DataError(f"row {row + 1}: {fault}", path)
    return DataError(fault, path, lines[row])


def no_sightings() -> Sightings:
    """The sightings of a log that has only scans."""
    numbers: Floats = np.empty(0)
    indices: Ints = np.empty(0, dtype=np.int64)
    return Sightings(numbers, numbers, numbers, indices, indices, numbers)


def select_sightings(sightings: Sightings, chosen: Bools | Ints) -> Sightings:
    """The chosen rows, by mask or by index, in that order."""
    return sightings[chosen]


def _time_order(stamp_s: Floats, what: str, path: Path) -> tuple[Ints, str, int]:
    """Stable sorting order, what to say about it, and how many rows come after a later stamp.

    Errors: DataError where the clock was set back, since nobody can tell what then comes when.
    """
    behind_s = np.maximum.accumulate(stamp_s) - stamp_s if len(stamp_s) else stamp_s
    late = behind_s > 0
    row = _set_back(stamp_s, behind_s)
    if row is not None:
        message = (
            f"clock set back: {what} row {row + 1} has stamp {stamp_s[row]:.10g}, {behind_s[row]:.6g} "
            "s before one above it; cut the log there, or sort the file if only its rows are out of order"
        )
        raise DataError(message, path)
    worst_s = float(np.max(behind_s, initial=0.0))
    message = f"out of time order by up to {worst_s:.6g} s: sorted"
    return np.argsort(stamp_s, kind="stable"), message, int(late.sum())


def _set_back(stamp_s: Floats, behind_s: Floats) -> int | None:
    """The row at which the clock was set back; None where rows are in order or only late by a jitter.

    A row is late if it comes at most JITTER_S behind. After a clock was set back by less than that, a run of
    rows goes on in order until it has caught up.
    """
    if np.any(behind_s > JITTER_S):
        return int(np.argmax(behind_s > JITTER_S))
    steps_back = np.flatnonzero(np.diff(stamp_s) < 0) + 1
    ends = np.append(steps_back[1:], len(stamp_s))
    for row, end in zip(steps_back.tolist(), ends.tolist(), strict=False):
        if len(np.unique(stamp_s[row:end][behind_s[row:end] > 0])) >= LEAST_RUN:
            return int(row)
    return None


def _count(problems: list[Problem], message: str, count: int, *, code: str = "") -> None:
    if count > 0:
        problems.append(Problem(message, count, code))

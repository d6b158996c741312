"""Reads the true path, the true landmarks and the position fixes of a native log."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..errors import DataError
from ..log import Floats, PositionFixes, Problem, TruthLandmarks, TruthTrajectory
from .csv_table import CsvTable, check_columns, read_csv
from .text import line_of_row, read_table


def read_trajectory(path: Path) -> tuple[TruthTrajectory | None, tuple[Problem, ...]]:
    """Rows of `stamp x y z qx qy qz qw`; a quaternion of four zeros says that no heading is known."""
    if not path.is_file():
        return None, ()
    rows = read_table(path, 8)
    finite = np.isfinite(rows).all(axis=1)
    problems = (Problem("true poses with NaN or infinite values: dropped", int(np.sum(~finite))),)
    rows = rows[finite]
    if len(rows) == 0:
        raise DataError("holds no pose without NaN or infinite values", path)
    late = np.diff(rows[:, 0]) <= 0
    if late.any():
        row = int(np.flatnonzero(finite)[np.argmax(late) + 1])
        raise DataError("the stamp is not later than the one before", path, line_of_row(path, row))
    qx, qy, qz, qw = rows[:, 4:].T
    unknown = np.all(rows[:, 4:] == 0, axis=1)
    if unknown.any() and not unknown.all():
        raise DataError(f"{unknown.sum()} of {len(rows)} quaternions are zero: expected none or all", path)
    heading = np.arctan2(2 * (qw * qz + qx * qy), qw**2 + qx**2 - qy**2 - qz**2)
    heading = np.where(unknown, np.nan, heading)
    truth = TruthTrajectory(
        rows[:, 0], np.column_stack([rows[:, 1:3], heading]), heading_known=not unknown.any()
    )
    return truth, tuple(problem for problem in problems if problem.count)


def read_landmarks(path: Path, *, complete: bool) -> TruthLandmarks | None:
    """The true landmarks, or None where there is no such file. Errors: DataError with file and line."""
    if not path.is_file():
        return None
    table = read_csv(path)
    check_columns(table, required=("id", "x_m", "y_m"))
    names = tuple(name.strip() for name in table.columns["id"])
    seen: set[str] = set()
    for name, line in zip(names, table.lines, strict=True):
        if not name or name in seen:
            raise DataError(f"id '{name}' is empty or appears twice", path, line)
        seen.add(name)
    return TruthLandmarks(names, _finite_positions(table), complete=complete)


def read_fixes(path: Path) -> PositionFixes | None:
    """The position fixes, or None where there is no such file. Errors: DataError with file and line."""
    if not path.is_file():
        return None
    table = read_csv(path)
    check_columns(table, required=("stamp_s", "x_m", "y_m"))
    return PositionFixes(_finite(table, "stamp_s"), _finite_positions(table))


def _finite_positions(table: CsvTable) -> Floats:
    return np.column_stack([_finite(table, "x_m"), _finite(table, "y_m")])


def _finite(table: CsvTable, name: str) -> Floats:
    values = table.numbers(name)
    bad = ~np.isfinite(values)
    if bad.any():
        row = int(np.argmax(bad))
        raise DataError(f"{name}: got {values[row]}, expected a finite number", table.path, table.lines[row])
    return values

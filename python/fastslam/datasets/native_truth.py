"""Reads the true path, the true landmarks and the position fixes of a native log."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..csv_cells import unguarded
from ..errors import DataError
from ..log import Floats, PositionFixes, Problem, TruthLandmarks, TruthTrajectory
from .columns import Quantity, name_columns
from .csv_table import CsvTable, read_csv
from .native_odometry import STAMP
from .planar import heading_of_quaternion
from .text import line_of_row, read_table

X, Y = Quantity("x_m", (), "m"), Quantity("y_m", (), "m")
LANDMARKS = (Quantity("id", ("name", "landmark_id"), is_text=True), X, Y)
FIXES = (STAMP, X, Y)


def read_trajectory(path: Path | None) -> tuple[TruthTrajectory | None, tuple[Problem, ...]]:
    """Rows of `stamp x y z qx qy qz qw`; a quaternion of four zeros says that no heading is known."""
    if path is None:
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
    unknown = np.all(rows[:, 4:] == 0, axis=1)
    if unknown.any() and not unknown.all():
        raise DataError(f"{unknown.sum()} of {len(rows)} quaternions are zero: expected none or all", path)
    heading = np.where(unknown, np.nan, heading_of_quaternion(rows[:, 4:]))
    truth = TruthTrajectory(
        rows[:, 0], np.column_stack([rows[:, 1:3], heading]), heading_known=not unknown.any()
    )
    return truth, tuple(problem for problem in problems if problem.count)


def read_landmarks(path: Path | None, *, complete: bool) -> TruthLandmarks | None:
    """The true landmarks, or None where there is no such file. Errors: DataError with file and line."""
    if path is None:
        return None
    table = _table(path, LANDMARKS)
    names = tuple(unguarded(name.strip()) for name in table.texts("id"))
    seen: set[str] = set()
    for name, line in zip(names, table.lines, strict=True):
        if not name or name in seen:
            raise DataError(f"id '{name}' is empty or appears twice", path, line)
        seen.add(name)
    return TruthLandmarks(names, _finite_positions(table), complete=complete)


def read_fixes(path: Path | None) -> PositionFixes | None:
    """The position fixes, or None where there is no such file. Errors: DataError with file and line."""
    if path is None:
        return None
    table = _table(path, FIXES)
    stamp_s = table.stamps("stamp_s")
    table.check_finite("stamp_s", stamp_s)
    return PositionFixes(stamp_s, _finite_positions(table))


def _table(path: Path, known: tuple[Quantity, ...]) -> CsvTable:
    """A table that has all the known columns."""
    example = ",".join(quantity.name for quantity in known)
    table = name_columns(read_csv(path, example=example), known, ignored=("z",))
    missing = next((quantity.name for quantity in known if quantity.name not in table.index_of), None)
    if missing is not None:
        message = f"column {missing} is missing: got {','.join(table.index_of)}, expected {example}"
        raise DataError(message, path, table.header_line)
    return table


def _finite_positions(table: CsvTable) -> Floats:
    return np.column_stack([table.finite_numbers("x_m"), table.finite_numbers("y_m")])

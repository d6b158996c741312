"""Reads `odometry.csv` of a native log: how the robot moved, in the columns of the log's motion model."""

from __future__ import annotations

import difflib
from pathlib import Path

import numpy as np

from ..errors import DataError
from ..log import Controls, Problem
from .clean import clean_controls
from .csv_table import CsvTable, check_columns, read_csv
from .planar import increments_between

POSE_COLUMNS = ("stamp_s", "x_m", "y_m", "heading_rad")
INCREMENT_COLUMNS = ("stamp_s", "dx_m", "dy_m", "dheading_rad")
ODOMETRY_COLUMNS: dict[str, tuple[tuple[str, ...], ...]] = {
    "velocity": (("stamp_s", "speed_m_per_s", "yaw_rate_rad_per_s"),),
    "ackermann": (("stamp_s", "speed_m_per_s", "steering_rad"),),
    "odometry": (INCREMENT_COLUMNS, POSE_COLUMNS),
    "increments": (INCREMENT_COLUMNS, POSE_COLUMNS),
}


def read_controls(path: Path, model: str) -> tuple[Controls, tuple[Problem, ...]]:
    """The controls for a motion model. Errors: DataError with file and line."""
    table = read_csv(path)
    columns = _odometry_columns(table, model)
    stamp_s = table.numbers("stamp_s")
    values = np.column_stack([table.numbers(name) for name in columns[1:]])
    controls, problems = clean_controls(stamp_s, values, path=path)
    if columns == POSE_COLUMNS:
        if len(controls.stamp_s) < 2:
            raise DataError("holds one pose, needs at least two to tell a motion", path)
        controls = Controls(controls.stamp_s[1:], increments_between(controls.values))
    return controls, table.problems + problems


def _odometry_columns(table: CsvTable, model: str) -> tuple[str, ...]:
    """The columns of the header, which must be one of those that the motion model can use."""
    allowed = ODOMETRY_COLUMNS[model]
    present = set(table.columns)
    for columns in allowed:
        if present == set(columns):
            return columns
    for other, variants in ODOMETRY_COLUMNS.items():
        if any(present == set(columns) for columns in variants):
            got, expected = ",".join(table.columns), " or ".join(",".join(columns) for columns in allowed)
            message = f"the header fits motion.model {other}, but log.yaml says {model}"
            raise DataError(f"{message}: got {got}, expected {expected}", table.path, 1)
    nearest = max(allowed, key=lambda columns: _likeness(present, columns))
    check_columns(table, required=nearest)
    return nearest


def _likeness(present: set[str], columns: tuple[str, ...]) -> int:
    return sum(bool(difflib.get_close_matches(name, present, n=1, cutoff=0.7)) for name in columns)

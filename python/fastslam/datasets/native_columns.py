"""The columns of a native log's tables, as arrays: what files and data frames of a log hold."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..errors import DataError
from ..log import Floats, Ints, Log
from ..measured import measured_columns
from .native_odometry import MOTION_COVARIANCE_COLUMNS
from .native_sightings import COVARIANCE_COLUMNS

HEADERS = {
    "velocity": ("stamp_s", "speed_m_per_s", "yaw_rate_rad_per_s"),
    "ackermann": ("stamp_s", "speed_m_per_s", "steering_rad"),
    "odometry": ("stamp_s", "dx_m", "dy_m", "dheading_rad"),
    "increments": ("stamp_s", "dx_m", "dy_m", "dheading_rad"),
}
"""Columns of `odometry.csv` by motion model."""

Names = list[str | None]
"""A column of names; None where there is none."""


def odometry_columns(log: Log) -> dict[str, Floats]:
    """Columns of `odometry.csv`; NaN where a row has no covariance. Errors: DataError (no motion model)."""
    model = log.config.get("motion", {}).get("model")
    if model not in HEADERS:
        raise DataError(f"log {log.name} has no motion model: give it config motion: {{model: velocity}}")
    header = HEADERS[model]
    columns = dict(zip(header, (log.controls.stamp_s, *log.controls.values.T), strict=True))
    if log.controls.covariance is not None:
        columns |= dict(zip(MOTION_COVARIANCE_COLUMNS, log.controls.covariance.T, strict=True))
    return columns


def sightings_columns(log: Log) -> dict[str, Floats | Names]:
    """Columns of `sightings.csv`: those that the log has anything in; NaN and None stand for nothing."""
    seen = log.sightings
    columns: dict[str, Floats | Names] = {"stamp_s": seen.stamp_s}
    for column in measured_columns(log.config.get("sensor", {}).get("model")):
        columns[column] = getattr(seen, column)
    if seen.sensor_index is not None and log.sensor_names:
        columns["sensor"] = _names(seen.sensor_index, log.sensor_names)
    if log.identity_names:
        columns["landmark_id"] = _names(seen.identity, log.identity_names)
    if log.class_names:
        columns["class"] = _names(seen.class_index, log.class_names)
    if not np.isnan(seen.signature).all():
        columns["signature"] = seen.signature
    if seen.covariance is not None:
        columns |= dict(zip(COVARIANCE_COLUMNS, seen.covariance.T, strict=True))
    return columns


def _names(indices: Ints, names: Sequence[str]) -> Names:
    return [None if index < 0 else names[index] for index in indices.tolist()]

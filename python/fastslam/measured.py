"""Which columns of sightings a sensor measures, by the name of its model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from .log import Bools, Ints, Sightings

BOTH = ("range_m", "bearing_rad")
_ALONE = {"range": ("range_m",), "bearing": ("bearing_rad",)}

Measures = Sequence[str] | Bools
"""The columns that a sensor measures, or which of the two each sighting has (S, 2)."""


def measured_columns(model: object) -> tuple[str, ...]:
    """The columns of `sensor.model`; both where none or another is named."""
    return _ALONE.get(str(model), BOTH)


def measured_by_sensor(config: Mapping[str, Any]) -> dict[str, tuple[str, ...]]:
    """The columns that each of several sensors (`sensors`) measures, by name; none where there is one."""
    return {
        name: measured_columns(section.get("model") if isinstance(section, Mapping) else None)
        for name, section in sorted((config.get("sensors") or {}).items())
    }


def measured_rows(
    sensor_index: Ints | None, names: Sequence[str], by_sensor: Mapping[str, Sequence[str]]
) -> Bools | None:
    """Which of range and bearing each sighting has (S, 2); None where all have both.

    `names` are those that `sensor_index` indexes.
    """
    if sensor_index is None or all(tuple(columns) == BOTH for columns in by_sensor.values()):
        return None
    of_name = [[column in by_sensor.get(name, BOTH) for column in BOTH] for name in names]
    return np.array([*of_name, [True, True]], dtype=np.bool_)[sensor_index]


def as_rows(measures: Measures, count: int) -> Bools:
    """Which of range and bearing each of so many sightings has (S, 2)."""
    if isinstance(measures, np.ndarray):
        return measures
    return np.tile(np.array([column in measures for column in BOTH], dtype=np.bool_), (count, 1))


def measured_alone(sightings: Sightings, measures: Measures) -> Sightings:
    """The same with NaN for the range or bearing that a sighting's sensor does not measure."""
    has = as_rows(measures, len(sightings.stamp_s))
    if has.all():
        return sightings
    range_m = np.where(has[:, 0], sightings.range_m, np.nan)
    return replace(sightings, range_m=range_m, bearing_rad=np.where(has[:, 1], sightings.bearing_rad, np.nan))

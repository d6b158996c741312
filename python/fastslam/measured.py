"""Which columns of sightings a sensor measures, by the name of its model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from .log import Sightings

BOTH = ("range_m", "bearing_rad")
_ALONE = {"range": ("range_m",), "bearing": ("bearing_rad",)}


def measured_columns(model: object) -> tuple[str, ...]:
    """The columns of `sensor.model`; both where none or another is named."""
    return _ALONE.get(str(model), BOTH)


def measured_alone(sightings: Sightings, measures: Sequence[str]) -> Sightings:
    """The same with NaN in the column of range or bearing that the sensor does not measure."""
    nothing = np.full(len(sightings.stamp_s), np.nan)
    left_out = {column: nothing for column in BOTH if column not in measures}
    return replace(sightings, **left_out) if left_out else sightings

"""A laser scanner on a robot that drives: its turns are rows of the stream, landmarks are detected inside."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ._given import numbers
from .detection import configure_detector
from .errors import DataError
from .log import BeamGeometry, Floats, Log


@dataclass(frozen=True)
class Scanner:
    """Where the beams of a laser point, and how landmarks are found in its scans.

    It sits where `sensor.mounting` of the robot's configuration says. `detector` is laid over the defaults of
    `docs/detectors.md`.
    """

    geometry: BeamGeometry
    detector: Mapping[str, Any] = field(default_factory=dict)

    @classmethod
    def of(cls, log: Log) -> Scanner:
        """The scanner of a log with scans. Errors: `DataError` for one without."""
        if log.scans is None:
            raise DataError("the log holds no laser scans", log.source)
        return cls(log.scans.geometry, log.scans.detector)

    def to_json(self) -> tuple[str, str]:
        """The settings of the detector and the geometry. Errors: `ConfigError`."""
        return configure_detector(self.detector).to_json(), json.dumps(asdict(self.geometry))


def checked_turn(ranges_m: ArrayLike, intensities: ArrayLike | None) -> tuple[Floats, Floats | None]:
    """One turn of a laser as arrays (B,). Errors: `DataError` for another shape, or what is no number."""
    columns = []
    for name, values in (("ranges_m", ranges_m), ("intensities", intensities)):
        column = None if values is None else numbers(name, values)
        if column is not None and column.ndim != 1:
            raise DataError(f"{name}: got shape {column.shape}, expected one number per beam")
        columns.append(column)
    turn, strength = columns
    return np.empty(0) if turn is None else turn, strength

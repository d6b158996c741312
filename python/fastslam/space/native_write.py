"""Writes a log in space as a native one, which `load` reads back to the bit."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np

from .._yaml import write_yaml
from ..errors import DataError
from ..resultfiles import csv_text, write_atomically
from .log import MEASURED, SpaceLog
from .native import COVARIANCES, PLACE, VELOCITIES
from .result import SpacePath

MEASURED_MOTION = {"odometry": [0, 1, 2, 3, 4, 5], "gyro": [3, 4, 5], "wandering": []}
"""Columns of the velocity that a log has, by `motion.kind`."""


def write_native(log: SpaceLog, folder: Path | str) -> Path:
    """Writes `log.yaml`, the tables and the truth into a new or empty folder; returns it.

    Errors: `DataError` for a folder that holds something, or cannot be written.
    """
    target = Path(folder)
    if target.exists() and (not target.is_dir() or any(target.iterdir())):
        raise DataError("is not empty: name a new folder", target)
    sensor = {"model": log.sensor, **log.config.get("sensor", {})}
    settings = {"format_version": 1, "dimensions": 3, "name": log.name, **log.config, "sensor": sensor}
    write_atomically(target / "log.yaml", write_yaml(settings))
    measured = MEASURED_MOTION[log.motion]
    if measured:
        names = ("stamp_s", *(VELOCITIES[axis].name for axis in measured))
        rows = np.column_stack([log.row_stamp_s, log.velocity[:, measured]])
        write_atomically(target / "odometry.csv", csv_text(names, map(_cells, rows)))
    write_atomically(target / "sightings.csv", _sightings(log))
    if log.truth is not None and len(log.truth.stamp_s):
        path = SpacePath(log.truth.stamp_s, log.truth.T_world_robot)
        write_atomically(target / "truth_trajectory.tum", path.to_tum())
    if log.truth is not None and log.truth.names:
        places = zip(log.truth.names, log.truth.position_m, strict=True)
        text = csv_text(
            [quantity.name for quantity in PLACE], ((name, *_cells(place)) for name, place in places)
        )
        write_atomically(target / "truth_landmarks.csv", text)
    return target


def _sightings(log: SpaceLog) -> str:
    names = ["stamp_s", "landmark_id", *MEASURED[log.sensor]]
    numbers = [log.value]
    if log.covariance is not None:
        names += COVARIANCES
        numbers.append(log.covariance)
    rows = zip(log.sighting_stamp_s, log.identity, np.hstack(numbers), strict=True)
    cells = (
        (repr(float(stamp)), log.names[identity] if identity >= 0 else "", *_cells(row))
        for stamp, identity, row in rows
    )
    return csv_text(names, cells)


def _cells(values: Iterable[float]) -> tuple[str, ...]:
    """Numbers that come back to the bit; what is none is empty."""
    return tuple(repr(float(value)) if np.isfinite(value) else "" for value in values)

"""Rows of a stream, kept to be given to another one."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from . import _core
from .log import BeamGeometry, Controls, Floats, Ints, Log, Scans, Sightings
from .several import each_sensor, sensor_names

_UPPER = np.triu_indices(3)


@dataclass(frozen=True)
class Row:
    """A row that a stream has taken, to be given to another one."""

    kind: Literal["odometry", "sightings", "scan"]
    stamp_s: float
    values: tuple[Any, ...]
    by: int = 0
    """Number of the sensor."""

    def put(self, stream: _core.Stream) -> str:
        """Gives it to a stream; what became of it."""
        if self.kind == "odometry":
            return stream.odometry(self.stamp_s, *self.values)
        if self.kind == "scan":
            return stream.scan(self.stamp_s, *self.values)
        columns: _core._ScanColumns = self.values
        return stream.sightings(self.stamp_s, columns, self.by)

    def to_json(self) -> list[Any]:
        """As lists and numbers."""
        values = [value.tolist() if isinstance(value, np.ndarray) else value for value in self.values]
        return [self.kind, self.stamp_s, values, *([self.by] if self.by else [])]

    @classmethod
    def of_json(cls, kept: list[Any]) -> Row:
        """The inverse of `to_json`."""
        kind, stamp_s, values, *by = kept
        if kind == "odometry":
            return cls("odometry", stamp_s, tuple(values))
        if kind == "scan":
            turn = [None if value is None else np.array(value, dtype=np.float64) for value in values]
            return cls("scan", stamp_s, tuple(turn))
        integers = (2, 4)
        columns = [
            None if value is None else np.array(value, dtype=np.int64 if place in integers else np.float64)
            for place, value in enumerate(values)
        ]
        if columns[3] is not None:
            columns[3] = columns[3].reshape(-1, 3)
        return cls("sightings", stamp_s, tuple(columns), *by)


def log_of(
    rows: Sequence[Row],
    columns: int,
    *,
    name: str,
    config: dict[str, Any],
    scanner: tuple[str, str] | None = None,
) -> Log:
    """Rows as a log in time order, without names; `columns` are those of the motion model.

    Streams take `delay_s` of the sensor off the stamps of sightings; a log has them as they were reported.
    """
    driven = sorted((row for row in rows if row.kind == "odometry"), key=lambda row: row.stamp_s)
    scans = sorted((row for row in rows if row.kind == "sightings"), key=lambda row: row.stamp_s)
    turns = sorted((row for row in rows if row.kind == "scan"), key=lambda row: row.stamp_s)
    controls = Controls(
        np.array([row.stamp_s for row in driven]),
        np.array([row.values[0][:columns] for row in driven], dtype=np.float64).reshape(-1, columns),
        _stated([None if row.values[1] is None else np.array(row.values[1])[_UPPER] for row in driven], 6),
    )
    sizes = [len(row.values[0]) for row in scans]

    def column(place: int, missing: float) -> Floats:
        parts = [
            np.full(size, missing) if row.values[place] is None else np.asarray(row.values[place], np.float64)
            for row, size in zip(scans, sizes, strict=True)
        ]
        return np.concatenate(parts) if parts else np.empty(0)

    def whole(place: int) -> Ints:
        return column(place, -1.0).astype(np.int64)

    names, delays_s = sensor_names(config), [sensor["delay_s"] for sensor in each_sensor(config)]
    stamps_s = [row.stamp_s + delays_s[row.by] for row in scans]
    sightings = Sightings(
        stamp_s=np.repeat(stamps_s, sizes) if scans else np.empty(0),
        range_m=column(0, np.nan),
        bearing_rad=column(1, np.nan),
        identity=whole(2),
        class_index=whole(4),
        signature=column(5, np.nan),
        covariance=_stated([row.values[3] for row in scans], 3, sizes),
        sensor_index=np.repeat(np.array([row.by for row in scans], dtype=np.int64), sizes) if names else None,
    )
    if names:
        sightings = sightings[np.argsort(sightings.stamp_s, kind="stable")]
    return Log(
        name=name,
        source="a live stream",
        format="native",
        controls=controls,
        sightings=sightings,
        sensor_names=names,
        scans=_scans(turns, delays_s[0], scanner, config["sensor"]["mounting"])
        if scanner and turns
        else None,
        config=config,
    )


def _scans(
    turns: Sequence[Row], delay_s: float, scanner: tuple[str, str], mounting: Mapping[str, float]
) -> Scans:
    """Turns of a laser as the scans of a log; where some have fewer beams, the rest of them tell nothing."""
    beams = max(len(row.values[0]) for row in turns)

    def column(place: int) -> Floats:
        whole = np.full((len(turns), beams), np.nan)
        for to, row in zip(whole, turns, strict=True):
            if row.values[place] is not None:
                to[: len(row.values[place])] = row.values[place]
        return whole

    return Scans(
        stamp_s=np.array([row.stamp_s + delay_s for row in turns]),
        ranges_m=column(0),
        geometry=BeamGeometry(**json.loads(scanner[1])),
        intensities=None if all(row.values[1] is None for row in turns) else column(1),
        mounting=(mounting["x_m"], mounting["y_m"], mounting["yaw_rad"]),
        detector=json.loads(scanner[0]),
    )


def _stated(parts: Sequence[Floats | None], width: int, sizes: Sequence[int] | None = None) -> Floats | None:
    """Covariances that rows came with, NaN for those without; None where none has one."""
    if all(part is None for part in parts):
        return None
    sizes = [1] * len(parts) if sizes is None else sizes
    given = zip(parts, sizes, strict=True)
    return np.concatenate(
        [
            np.full((size, width), np.nan) if part is None else part.reshape(size, width)
            for part, size in given
        ]
    )

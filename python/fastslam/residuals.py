"""How far the sightings of each landmark lie off map and path, in the noise that was told."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np

from .errors import DataError
from .evaluation.align import wrap_angle
from .laid import believed, laid_on_map, sensor_poses
from .log import Floats, Ints, Log, Sightings
from .measured import BOTH, measured_columns
from .result import Residuals, RunResult
from .sensors import Adapter
from .several import as_of_one, as_the_core_takes, each_sensor

KINDS = ("range", "bearing")
"""What residuals are of: the columns `range_m` and `bearing_rad` of sightings, whatever they hold."""
AROUND, DISTANCES = 36, 12
"""Where only its range is known a landmark is looked for in so many directions, where only its bearing is at
so many distances."""
NEAREST_M = 0.3
"""No landmark is looked for nearer than this by its bearing."""


class Expecting(Protocol):
    """A sensor, asked about landmarks. Errors: `ModelError` for what one of one's own answers."""

    def off(self, poses: Floats, landmarks: Floats, measured: Floats) -> Floats:
        """Measured minus what it should measure of landmarks (n, 2) from poses (n, 3), (n, Z)."""

    def starts(self, pose: Floats, measured: Floats) -> Floats:
        """Where a landmark may be that was sighted once from a pose (1, 3), (n, 2)."""


@dataclass(frozen=True)
class Group:
    """The sightings that one sensor made of landmarks of the map, in order of time.

    Shapes: `landmark` (n,) rows of the map, `stamp_s` (n,), `pose` (n, 3) of the sensor in the world along
    the best path, `measured` and `std` (n, Z) in the units of the columns. `kinds` (Z) are of `KINDS`.
    """

    kinds: tuple[str, ...]
    sensor: Expecting
    landmark: Ints
    stamp_s: Floats
    pose: Floats
    measured: Floats
    std: Floats

    def off(self, rows: Ints, landmarks: Floats) -> Floats:
        """Normalised residuals (n, Z) of some sightings, were their landmarks there (n, 2)."""
        return np.asarray(self.sensor.off(self.pose[rows], landmarks, self.measured[rows]) / self.std[rows])

    def of_map(self, mean_m: Floats) -> Floats:
        """Normalised residuals (n, Z) of all of them, with the landmarks where the map (K, 2) has them."""
        return self.off(np.arange(len(self.landmark)), mean_m[self.landmark])

    def starts(self, row: int) -> Floats:
        """Where the landmark of a sighting may be by that alone (n, 2). Errors: `ModelError`."""
        return self.sensor.starts(self.pose[row : row + 1], self.measured[row : row + 1])


@dataclass(frozen=True)
class _Plane:
    """The built-in sensors; reported is scale times the range plus a bias."""

    kinds: tuple[str, ...]
    scale: float
    bias_m: float
    bias_rad: float
    limits_m: tuple[float, float] = (NEAREST_M, 100.0)

    def off(self, poses: Floats, landmarks: Floats, measured: Floats) -> Floats:
        dx, dy = (landmarks - poses[:, :2]).T
        expected = {
            "range": lambda: self.scale * np.hypot(dx, dy) + self.bias_m,
            "bearing": lambda: np.arctan2(dy, dx) - poses[:, 2] + self.bias_rad,
        }
        off = measured - np.column_stack([expected[kind]() for kind in self.kinds])
        for column in np.flatnonzero(np.array(self.kinds) == "bearing"):
            off[:, column] = wrap_angle(off[:, column])
        return np.asarray(off)

    def starts(self, pose: Floats, measured: Floats) -> Floats:
        direction = 2.0 * np.pi * np.arange(AROUND) / AROUND
        range_m = np.geomspace(*self.limits_m, DISTANCES)
        if "bearing" in self.kinds:
            direction = pose[:, 2] + measured[:, -1] - self.bias_rad
        if "range" in self.kinds:
            range_m = (measured[:, 0] - self.bias_m) / self.scale
        out = np.stack([np.cos(direction), np.sin(direction)], axis=-1)
        return np.asarray(pose[0, :2] + (range_m[:, None, None] * out).reshape(-1, 2))


@dataclass(frozen=True)
class _Own:
    """A sensor of one's own."""

    adapter: Adapter
    scale: float
    bias: float

    def off(self, poses: Floats, landmarks: Floats, measured: Floats) -> Floats:
        expected = self.adapter.expected(poses, landmarks).copy()
        expected[:, 0] = self.scale * expected[:, 0] + self.bias
        return self.adapter.innovation(measured, expected)

    def starts(self, pose: Floats, measured: Floats) -> Floats:
        true = measured.copy()
        true[:, 0] = (true[:, 0] - self.bias) / self.scale
        if self.adapter.has_births:
            return np.asarray(self.adapter.births(pose, true)[1][0])
        return _Plane(("range",), 1.0, 0.0, 0.0).starts(pose, true)


def compared(result: RunResult, log: Log, own: Adapter | None = None) -> tuple[Group, ...]:
    """The sightings of landmarks of the map, by sensor: those that name theirs, as the run took the names.

    Where there are none, or they are not used, sightings of range and bearing are taken for the landmark that
    explains them best, within five deviations; those of one number alone are left out. None of EKF-SLAM,
    which has no path that the map belongs to.
    """
    if len(result.path.stamp_s) < 2 or len(result.landmarks.ids) == 0 or result.config["algorithm"] == "ekf":
        return ()
    if result.config["association"]["mode"] != "known" or not (log.sightings.identity >= 0).any():
        return _by_place(result, log)
    return tuple(_by_name(result, log, own))


def residuals_of(groups: tuple[Group, ...], mean_m: Floats) -> tuple[Residuals, ...]:
    """The residuals of the landmarks of a map (K, 2), for each kind that there is.

    Errors: `ModelError` for what a sensor of one's own answers.
    """
    found = []
    off = [group.of_map(mean_m) for group in groups]
    for kind in KINDS:
        of_kind = [
            (g.landmark, o[:, g.kinds.index(kind)])
            for g, o in zip(groups, off, strict=True)
            if kind in g.kinds
        ]
        if of_kind:
            landmark, residual = (np.concatenate(columns) for columns in zip(*of_kind, strict=True))
            found.append(_summed(kind, landmark, residual, len(mean_m)))
    return tuple(found)


def _summed(kind: str, landmark: Ints, residual: Floats, count: int) -> Residuals:
    number = np.bincount(landmark, minlength=count)
    least = np.where(number > 0, number, np.nan)
    mean = np.bincount(landmark, residual, count) / least
    square = np.bincount(landmark, residual**2, count) / least
    return Residuals(kind, number.astype(np.int64), np.sqrt(square), mean)


def _by_name(result: RunResult, log: Log, own: Adapter | None) -> Iterator[Group]:
    try:
        seen, numbers = as_the_core_takes(log, result.config)
    except DataError:
        return
    row_of = {name: row for row, name in enumerate(result.landmarks.ids)}
    of_identity = np.array([*(row_of.get(name, -1) for name in log.identity_names), -1], dtype=np.int64)
    placed = np.append(np.isfinite(result.landmarks.mean_m).all(axis=1), False)
    landmark = of_identity[seen.identity]
    inside = (seen.stamp_s >= result.path.stamp_s[0]) & (seen.stamp_s <= result.path.stamp_s[-1])
    for number, section in enumerate(each_sensor(result.config)):
        rows = np.flatnonzero(
            inside & placed[landmark] & (numbers == number if numbers is not None else True)
        )
        group = _of_sensor(seen[rows], landmark[rows], result, section, own)
        if group is not None:
            yield group


def _of_sensor(
    seen: Sightings, landmark: Ints, result: RunResult, section: Mapping[str, Any], own: Adapter | None
) -> Group | None:
    """What one sensor saw, less what a run skips; None where that is nothing."""
    columns = measured_columns(section["model"]) if own is None else own.measures
    kinds = tuple(column.partition("_")[0] for column in columns)
    scale, bias = _range_errors(result, section, own)
    measured = np.column_stack([getattr(seen, column) for column in columns])
    used = np.isfinite(measured).all(axis=1)
    if "range" in kinds:
        range_m = (measured[:, 0] - bias) / scale
        used &= (range_m >= section["min_range_m"]) & (range_m <= section["max_range_m"])
    if not used.any():
        return None
    # A sensor of both is told its noise of ranges as they are once they are put right.
    unit = np.where(np.array(kinds) == "range", scale if len(kinds) == 2 and own is None else 1.0, 1.0)
    std = unit * _stds(seen, columns, section, own)
    limits_m = max(section["min_range_m"], NEAREST_M), section["max_range_m"]
    sensor: Expecting = _Plane(kinds, scale, bias, section["bearing_bias_rad"], limits_m)
    if own is not None:
        sensor = _Own(own, scale, bias)
    pose = sensor_poses(result, seen.stamp_s[used], section["mounting"])
    return Group(kinds, sensor, landmark[used], seen.stamp_s[used], pose, measured[used], std[used])


def _range_errors(result: RunResult, section: Mapping[str, Any], own: Adapter | None) -> tuple[float, float]:
    """Scale and bias of what is reported: those learned, else those configured."""
    told = section["range_scale"], section["range_bias_m"]
    if own is not None and not result.calibration and own.size == 2:
        told = 1.0, 0.0
    if own is not None and own.measures[0] != "range_m":
        return 1.0, 0.0
    learned = result.calibration
    return learned.get("range_scale", told[0]), learned.get("range_bias_m", told[1])


def _stds(
    seen: Sightings, columns: tuple[str, ...], section: Mapping[str, Any], own: Adapter | None
) -> Floats:
    """Standard deviations (n, Z) of the sightings: their own, or the sensor's."""
    stds = [section[f"{c.partition('_')[0]}_std_{c.partition('_')[2]}"] for c in columns]
    told = np.array(stds) if own is None else np.sqrt(np.diag(own.noise))
    if seen.covariance is None:
        return np.tile(told, (len(seen.stamp_s), 1))
    variance = seen.covariance[:, [2 * BOTH.index(column) for column in columns]]
    return np.where(np.isfinite(variance) & (variance > 0.0), np.sqrt(np.abs(variance)), told)


def _by_place(result: RunResult, log: Log) -> tuple[Group, ...]:
    log, config = as_of_one(log, result.config)
    if config["sensor"]["model"] != "range_bearing":
        return ()
    laid = laid_on_map(replace(result, config=config), log)
    if laid is None or not laid.explained.any():
        return ()
    rows = np.flatnonzero(laid.explained)
    std = [config["sensor"]["range_std_m"], config["sensor"]["bearing_std_rad"]]
    measured = np.column_stack([laid.range_m, laid.bearing_rad])[rows]
    landmark = np.flatnonzero(believed(result))[laid.landmark[rows]]
    plane = _Plane(KINDS, 1.0, 0.0, 0.0)
    return (
        Group(
            KINDS,
            plane,
            landmark,
            laid.stamp_s[rows],
            laid.origin[rows],
            measured,
            np.tile(std, (len(rows), 1)),
        ),
    )

"""Faults that logs have, put into sound ones, each with the code of the finding that should name it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from fastslam.datasets.planar import chain_increments, increments_between, wrap_to_pi
from fastslam.log import REPEATED_STAMPS, Controls, Floats, Log, Problem


@dataclass(frozen=True)
class Fault:
    """What to do to a log, and which of the codes must be among the findings. `models`: of the motion."""

    put: Callable[[Log], Log]
    codes: tuple[str, ...]
    models: tuple[str, ...] = ("velocity", "ackermann", "increments", "odometry")


def _seen(log: Log, **changes: Floats) -> Log:
    return replace(log, sightings=replace(log.sightings, **changes))


def _bearings(turned: Callable[[Floats], Floats]) -> Callable[[Log], Log]:
    return lambda log: _seen(log, bearing_rad=wrap_to_pi(turned(log.sightings.bearing_rad)))


def _controls(factor: float, column: int) -> Callable[[Log], Log]:
    def put(log: Log) -> Log:
        values = log.controls.values.copy()
        if values.shape[1] == 2:
            values[:, column] *= factor
        else:
            values[:, slice(2, 3) if column else slice(0, 2)] *= factor
        return replace(log, controls=Controls(log.controls.stamp_s, values))

    return put


def _headings(gain: float) -> Callable[[Log], Log]:
    """What increments become when an odometer's heading is written times `gain`."""

    def put(log: Log) -> Log:
        poses = chain_increments(log.controls.values)
        poses[:, 2] *= gain
        return replace(log, controls=Controls(log.controls.stamp_s, increments_between(poses)))

    return put


def _stamps(factor: float) -> Callable[[Log], Log]:
    return lambda log: _seen(log, stamp_s=factor * log.sightings.stamp_s)


def _both_in_ms(log: Log) -> Log:
    return replace(_stamps(1e3)(log), controls=Controls(1e3 * log.controls.stamp_s, log.controls.values))


def _late(share: float) -> Callable[[Log], Log]:
    return lambda log: _seen(log, stamp_s=log.sightings.stamp_s + share * float(np.ptp(log.controls.stamp_s)))


def _delayed(delay_s: float) -> Callable[[Log], Log]:
    return lambda log: _seen(log, stamp_s=log.sightings.stamp_s + delay_s)


def _paused(log: Log) -> Log:
    """Nothing was recorded for a sixth of the log, from two fifths on."""
    first_s, span_s = log.controls.stamp_s[0], float(np.ptp(log.controls.stamp_s))
    start_s, end_s = first_s + 0.4 * span_s, first_s + (0.4 + 1 / 6) * span_s

    def kept(stamp_s: Floats) -> np.ndarray:
        return (stamp_s < start_s) | (stamp_s > end_s)

    rows, seen = kept(log.controls.stamp_s), kept(log.sightings.stamp_s)
    sightings = log.sightings
    columns = ("stamp_s", "range_m", "bearing_rad", "identity", "class_index", "signature")
    chosen = {name: getattr(sightings, name)[seen] for name in columns}
    covariance = None if sightings.covariance is None else sightings.covariance[seen]
    return replace(
        log,
        controls=Controls(log.controls.stamp_s[rows], log.controls.values[rows]),
        sightings=replace(sightings, covariance=covariance, **chosen),
    )


def _rounded(log: Log) -> Log:
    """Both tables to whole seconds; a reader keeps the last row of each stamp and counts the others."""
    stamp_s = np.floor(log.controls.stamp_s)
    last = np.append(np.diff(stamp_s) > 0, True)
    problem = Problem("repeated stamps", int(np.sum(~last)), REPEATED_STAMPS)
    rounded = _seen(log, stamp_s=np.floor(log.sightings.stamp_s))
    controls = Controls(stamp_s[last], log.controls.values[last])
    return replace(rounded, controls=controls, problems=(*log.problems, problem))


def _twice(log: Log) -> Log:
    """A second detector reports everything again, with noise of its own."""
    sightings, rng = log.sightings, np.random.default_rng(7)
    sensor = log.config["sensor"]
    count = len(sightings.stamp_s)
    again = np.repeat(np.arange(count), 2)
    second = np.tile([False, True], count)
    range_m, bearing_rad = sightings.range_m[again], sightings.bearing_rad[again]
    range_m = range_m + second * rng.normal(0.0, 0.7 * sensor["range_std_m"], 2 * count)
    bearing_rad = bearing_rad + second * rng.normal(0.0, 0.7 * sensor["bearing_std_rad"], 2 * count)
    return replace(
        log,
        sightings=replace(
            sightings,
            stamp_s=sightings.stamp_s[again],
            range_m=np.maximum(range_m, 0.01),
            bearing_rad=wrap_to_pi(bearing_rad),
            identity=sightings.identity[again],
            class_index=sightings.class_index[again],
            signature=sightings.signature[again],
            covariance=None if sightings.covariance is None else sightings.covariance[again],
        ),
    )


VELOCITIES = ("velocity", "ackermann")
STEPS = ("increments", "odometry")
FAULTS: dict[str, Fault] = {
    "bearings clockwise": Fault(_bearings(lambda angle: -angle), ("bearing-mirrored",)),
    "bearings from the left": Fault(_bearings(lambda angle: angle - np.pi / 2), ("sensor-turned",)),
    "bearings from the right": Fault(_bearings(lambda angle: angle + np.pi / 2), ("sensor-turned",)),
    "compass bearings": Fault(_bearings(lambda angle: np.pi / 2 - angle), ("sensor-turned",)),
    "sensor looks backwards": Fault(_bearings(lambda angle: angle + np.pi), ("sensor-turned",)),
    "sensor turned by 45 degrees": Fault(_bearings(lambda angle: angle - np.pi / 4), ("sensor-turned",)),
    "turns of the other sign": Fault(_controls(-1.0, 1), ("bearing-mirrored",), VELOCITIES),
    "yaw rate or steering in degrees": Fault(_controls(180 / np.pi, 1), ("turn-unit",), VELOCITIES),
    "odometer heading in degrees": Fault(_headings(180 / np.pi), ("heading-unit",), STEPS),
    "odometer heading clockwise": Fault(_headings(-1.0), ("heading-clockwise",), STEPS),
    "speeds of the other sign": Fault(_controls(-1.0, 0), ("sensor-turned",), ("velocity",)),
    "speeds or displacements in mm": Fault(_controls(1e3, 0), ("speed-unit",)),
    "speeds or displacements in cm": Fault(_controls(1e2, 0), ("speed-unit",)),
    "speeds or displacements in feet": Fault(_controls(1 / 0.3048, 0), ("speed-unit",)),
    "speeds in km/h": Fault(_controls(3.6, 0), ("speed-unit",), VELOCITIES),
    "positions in degrees of latitude": Fault(_controls(1 / 111_000, 0), ("odometry-still",), STEPS),
    "ranges in mm": Fault(lambda log: _seen(log, range_m=1e3 * log.sightings.range_m), ("range-unit",)),
    "ranges in cm": Fault(lambda log: _seen(log, range_m=1e2 * log.sightings.range_m), ("range-unit",)),
    "ranges in feet": Fault(lambda log: _seen(log, range_m=log.sightings.range_m / 0.3048), ("range-unit",)),
    "sightings in ms": Fault(_stamps(1e3), ("clock-coverage",)),
    "sightings in ns": Fault(_stamps(1e9), ("clock-coverage",)),
    "both tables in ms": Fault(_both_in_ms, ("clock-unit",), VELOCITIES),
    "sightings late by half the log": Fault(_late(0.5), ("clock-coverage",)),
    "sightings late by 0.5 s": Fault(_delayed(0.5), ("clock-offset",)),
    "sightings late by 1.5 s": Fault(_delayed(1.5), ("clock-offset",)),
    "recording paused": Fault(_paused, ("clock-gap",)),
    "stamps rounded to seconds": Fault(_rounded, ("clock-rounded",)),
    "two detectors": Fault(_twice, ("seen-twice",)),
}

"""Learns the noise of motion and sensor from a log in space, by its own residuals."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from ..errors import DataError
from ..log import Floats
from ..settings import Layer
from .config import SCHEMA
from .log import SpaceLog
from .result import NoiseRatios
from .runner import Progress, configure, run

ROUNDS = 40
CLOSE_ENOUGH = 0.01
"""Rounds end when no standard deviation changes by more than this part."""
STRIDE = 1.8
"""Steps of EM are lengthened so many times, in the logarithm: below 2 it converges, in half the rounds."""
STDS = {
    "odometry": ("position_std_m_per_sqrt_s", "turn_std_rad_per_sqrt_s"),
    "gyro": ("velocity_std_m_per_s", "turn_std_rad_per_sqrt_s"),
    "wandering": ("velocity_std_m_per_s", "rate_std_rad_per_s"),
}
"""What is learned of the motion, along and about the axes, by `motion.kind`."""
PLAIN = {"filter": {"particles": 20, "draw_every_scans": 0}}
"""The filter only begins the least squares."""


def learn(log: SpaceLog, config: Layer | None = None, *, progress: Progress | None = None) -> dict[str, Any]:
    """The settings of `motion` and `sensor` whose noise explains the residuals: a layer for `run`.

    EM: the least squares over path and map, then each variance times the expected squared residual over it,
    until nothing changes. Errors: those of `run`, and `DataError` where the least squares has no solution.
    """
    layer: dict[str, Any] = SCHEMA.merge(config or {})
    for done in range(ROUNDS):
        if progress is not None:
            progress(done, ROUNDS)
        effective = configure(log, layer)
        result = run(log, SCHEMA.merge(layer, PLAIN))
        if result.ratios is None:
            raise DataError("the noise cannot be learned: no path explains the sightings", log.source)
        scaled = _scaled(effective, result.ratios, is_sensor_known=log.covariance is not None)
        layer = SCHEMA.merge(layer, scaled)
        if result.interrupted or _change(effective, scaled) < CLOSE_ENOUGH:
            break
    if progress is not None:
        progress(ROUNDS, ROUNDS)
    return layer


def _scaled(config: Mapping[str, Any], ratios: NoiseRatios, *, is_sensor_known: bool) -> dict[str, Any]:
    """The settings with every standard deviation times the root of its ratio."""
    motion, sensor = config["motion"], config["sensor"]
    by_axis, by_number = ratios.motion ** (0.5 * STRIDE), np.sqrt(ratios.sensor)
    parts = (by_axis[:3], by_axis[3:])
    scaled = {
        name: _times(motion[name], part) for name, part in zip(STDS[motion["kind"]], parts, strict=True)
    }
    own = {} if is_sensor_known else _sensor(sensor, by_number)
    return {"motion": scaled, "sensor": {"model": sensor["model"], **own}}


def _change(before: Mapping[str, Any], after: Mapping[str, Any]) -> float:
    """The largest part that a standard deviation has changed by."""
    largest = 0.0
    for section in ("motion", "sensor"):
        for key in after[section].keys() - {"model"}:
            new, old = np.atleast_1d(after[section][key]), np.atleast_1d(before[section][key])
            moving = old > 0
            largest = max(largest, float(np.max(np.abs(np.log(new[moving] / old[moving])), initial=0.0)))
    return largest


def _times(values: list[float], factors: Floats) -> list[float]:
    return [float(value * factor) for value, factor in zip(values, factors, strict=True)]


def _sensor(sensor: Mapping[str, Any], factors: Floats) -> dict[str, Any]:
    if sensor["model"] == "point":
        return {"position_std_m": _times(sensor["position_std_m"], factors)}
    if sensor["model"] == "stereo":
        # The disparity is the difference of two columns.
        column = float(np.sqrt(np.mean(factors[[0, 2]] ** 2)))
        return {
            "column_std_px": sensor["column_std_px"] * column,
            "row_std_px": sensor["row_std_px"] * float(factors[1]),
        }
    names = ("range_std_m", "bearing_std_rad", "elevation_std_rad")
    return {name: float(sensor[name] * factor) for name, factor in zip(names, factors, strict=True)}

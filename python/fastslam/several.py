"""Several sensors on one robot: which one made a sighting, and what each is like."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .config import sensor_of
from .errors import ConfigError, DataError
from .log import Floats, Log, Sightings
from .measured import BOTH, measured_columns

Numbers = NDArray[np.uint8]


def sensor_names(config: Mapping[str, Any]) -> tuple[str, ...]:
    """The names of several sensors, in the order of their numbers in the core; none where there is one."""
    return tuple(sorted(config.get("sensors") or {}))


def each_sensor(config: Mapping[str, Any]) -> tuple[dict[str, Any], ...]:
    """The sections of all sensors of a complete configuration, in the order of their numbers."""
    named = [config["sensors"][name] for name in sensor_names(config)]
    return tuple(sensor_of({"sensor": section}) for section in named or [config["sensor"]])


def refuse_several(config: Mapping[str, Any], who: str) -> None:
    """Errors: `ConfigError` where there are several sensors, for what knows one alone."""
    names = sensor_names(config)
    if names:
        raise ConfigError(f"sensors: got {', '.join(names)}, expected one sensor (`sensor`) for {who}")


def left_out(config: Mapping[str, Any], ignored: NDArray[np.integer[Any]]) -> dict[str, int]:
    """How many sightings no landmark explains (of each step), where a sensor measures one number alone."""
    models = [sensor["model"] for sensor in each_sensor(config)]
    if len(models) < 2 or all(measured_columns(model) == BOTH for model in models):
        return {}
    return {"sightings_left_out": int(ignored.sum())}


def sensor_number(config: Mapping[str, Any], name: str | None) -> int:
    """The number of a sensor that a caller names. Errors: `DataError` for one that there is not."""
    names = sensor_names(config)
    if name is None and len(names) < 2:
        return 0
    if name in names:
        return names.index(name)
    got = "none" if name is None else repr(name)
    if not names:
        raise DataError(f"sensor: got {got}, but the configuration has no `sensors`: leave it out")
    raise DataError(f"sensor: got {got}, expected one of {', '.join(names)}")


def numbers_of(log: Log, config: Mapping[str, Any]) -> Numbers | None:
    """The number of the sensor that made each sighting (S,); None where there is one sensor.

    Errors: `DataError` where sightings do not say which made them, or name one that there is not.
    """
    names, index = sensor_names(config), log.sightings.sensor_index
    if len(names) < 2 and index is None:
        return None
    if not names:
        if len(log.sensor_names) < 2:
            return None
        several = ", ".join(log.sensor_names)
        raise DataError(f"sightings are of {several}: the configuration needs `sensors` for them", log.source)
    if index is None or (index < 0).any():
        raise DataError(
            f"sightings do not say which sensor made them: with the sensors {', '.join(names)} they need a "
            "column `sensor` that names one of them",
            log.source,
        )
    number = {name: number for number, name in enumerate(names)}
    used = [log.sensor_names[place] for place in np.unique(index).tolist()]
    unknown = [name for name in used if name not in number]
    if unknown:
        known = ", ".join(names)
        raise DataError(f"sightings are of the sensor {unknown[0]}, which is none of {known}", log.source)
    by_place = np.array([number.get(name, 0) for name in log.sensor_names], dtype=np.uint8)
    return np.asarray(by_place[index])


def as_the_core_takes(log: Log, config: Mapping[str, Any]) -> tuple[Sightings, Numbers | None]:
    """The sightings with the delays of their sensors taken off the stamps, in time order; and their sensors.

    Errors: as `numbers_of`.
    """
    numbers, seen = numbers_of(log, config), log.sightings
    delay_s = np.array([sensor["delay_s"] for sensor in each_sensor(config)])
    if not delay_s.any() and numbers is None:
        return seen, None
    moments = seen.stamp_s - (delay_s[0] if numbers is None else delay_s[numbers])
    if numbers is None:
        return replace(seen, stamp_s=moments), None
    order = np.lexsort((numbers, moments))
    return replace(seen[order], stamp_s=moments[order]), numbers[order]


def as_of_one(log: Log, config: Mapping[str, Any]) -> tuple[Log, dict[str, Any]]:
    """The log as if one sensor in the robot's origin that looks all around had made it, for what judges it.

    That sensor is as bad as the worst of those, and sees as far as the farthest. Without several sensors both
    are what they were; sightings whose sensor is not known are left out, and so are ranges or bearings alone.
    """
    names, sensors = sensor_names(config), each_sensor(config)
    if not names:
        return log, dict(config)
    judged = config_as_of_one(config)
    try:
        seen, numbers = as_the_core_takes(log, config)
    except DataError:
        seen, numbers = log.sightings[:0], None
    of = np.zeros(len(seen.stamp_s), dtype=np.uint8) if numbers is None else numbers
    whole = np.array([measured_columns(sensor["model"]) == BOTH for sensor in sensors])
    seen, of = seen[whole[of]], of[whole[of]]
    x_m, y_m = _in_robot_frame(seen, of, sensors)
    range_m, bearing_rad = np.hypot(x_m, y_m), np.arctan2(y_m, x_m)
    alike = replace(seen, range_m=range_m, bearing_rad=bearing_rad, covariance=None, sensor_index=None)
    return replace(log, sightings=alike, sensor_names=()), judged


def config_as_of_one(config: Mapping[str, Any]) -> dict[str, Any]:
    """The configuration of `as_of_one`."""
    if not sensor_names(config):
        return dict(config)
    whole = [one for one in each_sensor(config) if one["model"] == "range_bearing"]
    rest = {key: value for key, value in config.items() if key != "sensors"}
    return {**rest, "sensor": _worst(whole)}


def _in_robot_frame(
    seen: Sightings, of: Numbers, sensors: tuple[dict[str, Any], ...]
) -> tuple[Floats, Floats]:
    def column(value: Any) -> Floats:
        return np.asarray(np.array([value(sensor) for sensor in sensors])[of])

    range_m = (seen.range_m - column(lambda s: s["range_bias_m"])) / column(lambda s: s["range_scale"])
    yaw_rad = column(lambda s: s["mounting"]["yaw_rad"] - s["bearing_bias_rad"])
    towards = seen.bearing_rad + yaw_rad
    x_m = column(lambda s: s["mounting"]["x_m"]) + range_m * np.cos(towards)
    return x_m, column(lambda s: s["mounting"]["y_m"]) + range_m * np.sin(towards)


def _worst(sensors: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """A sensor at the robot's origin that is no better than any of these, and sees all that they see."""
    lever_m = [float(np.hypot(sensor["mounting"]["x_m"], sensor["mounting"]["y_m"])) for sensor in sensors]
    reach_m = [sensor["max_range_m"] + lever for sensor, lever in zip(sensors, lever_m, strict=True)]
    return {
        **sensors[0],
        **{key: max(sensor[key] for sensor in sensors) for key in ("range_std_m", "bearing_std_rad")},
        **{"range_scale": 1.0, "range_bias_m": 0.0, "bearing_bias_rad": 0.0, "delay_s": 0.0},
        "min_range_m": min(sensor["min_range_m"] for sensor in sensors),
        "max_range_m": max(reach_m),
        "field_of_view_rad": 2.0 * np.pi,
        "mounting": {"x_m": 0.0, "y_m": 0.0, "yaw_rad": 0.0},
    }

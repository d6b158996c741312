"""Reads `log.yaml` of a native log: which models, and the settings that belong to the log."""

from __future__ import annotations

import difflib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from .._yaml import YamlError, parse_yaml
from ..errors import DataError
from ..space.log import MEASURED
from .columns import UNITS
from .native_odometry import MODELS
from .text import read_text
from .wheels import Wheels, parse_wheels

FORMAT_VERSION = 1
CONFIG_KEYS = ("motion", "sensor", "sensors", "association", "filter", "initial_pose")
KEYS = ("format_version", "name", *CONFIG_KEYS, "wheels", "truth_landmarks_complete")
SENSOR_MODELS = ("range_bearing", "range", "bearing")
REAR_AXLE = {"encoder_left_m": 0.0, "sensor_ahead_m": 0.0, "sensor_left_m": 0.0}
"""Where a car's speed is measured and its path goes, unless its log says otherwise: mid rear axle."""
LEAST_SENSOR = "{model: range_bearing, range_std_m: ..., bearing_std_rad: ...}"


@dataclass(frozen=True)
class LogSettings:
    """What `log.yaml` says. `config` holds the sections that belong to the configuration of a run, in SI."""

    config: dict[str, Any]
    wheels: Wheels
    name: str | None
    truth_landmarks_complete: bool
    notes: tuple[str, ...]

    @property
    def motion_model(self) -> str | None:
        """The motion model, or None where the file leaves it to the columns of the odometry."""
        model: str | None = self.config.get("motion", {}).get("model")
        return model


def read_settings(path: Path) -> LogSettings:
    """The settings, checked for unknown keys and for models that there are. Errors: DataError."""
    try:
        settings, line_of_key = parse_yaml(read_text(path))
    except YamlError as error:
        raise DataError(f"is not valid YAML ({error.message})", path, error.line) from None
    if not isinstance(settings, dict):
        raise DataError(f"got no settings, expected the keys {', '.join(KEYS)}", path)
    return checked_settings(settings, path, line_of_key)


def checked_settings(settings: dict[str, Any], path: Path, line_of_key: dict[str, int]) -> LogSettings:
    """The settings that a mapping with the keys of `log.yaml` holds. Errors: DataError."""
    for key in settings:
        if key not in KEYS:
            near = difflib.get_close_matches(str(key), KEYS, n=1)
            hint = f", did you mean {near[0]}?" if near else f"; known: {', '.join(KEYS)}"
            raise DataError(f"unknown key {key}{hint}", path, line_of_key.get(str(key)))
    version = settings.get("format_version")
    if version != FORMAT_VERSION:
        found = "is missing" if version is None else f"got {version}"
        raise DataError(f"format_version: {found}, expected {FORMAT_VERSION}", path)
    if "sensor" not in settings and "sensors" not in settings:
        raise DataError("sensor is missing: add sensor: " + LEAST_SENSOR, path)
    _check_model(settings, "motion", MODELS, path)
    _check_model(settings, "sensor", SENSOR_MODELS, path)
    complete = settings.get("truth_landmarks_complete", True)
    if not isinstance(complete, bool):
        raise DataError("truth_landmarks_complete: expected true or false", path)
    config = {
        key: _in_si(_section(settings, key, path, line_of_key), key, path, line_of_key)
        for key in CONFIG_KEYS
        if key in settings
    }
    notes = (*_without_noise(config), *place_on_axle(config.get("motion", {})))
    wheels = parse_wheels(settings.get("wheels", {}), path, line_of_key)
    name = settings.get("name")
    return LogSettings(config, wheels, None if name is None else str(name), complete, notes)


def _section(settings: dict[str, Any], key: str, path: Path, line_of_key: dict[str, int]) -> dict[str, Any]:
    section = settings[key]
    if not isinstance(section, dict):
        raise DataError(f"{key}: got {section}, expected a section", path, line_of_key.get(key))
    return section


def _check_model(settings: dict[str, Any], key: str, known: tuple[str, ...], path: Path) -> None:
    """A section, where there is one, names a model that there is."""
    if key not in settings:
        return
    section = settings[key]
    if not isinstance(section, dict):
        raise DataError(f"{key}: got {section}, expected a section with the key model", path)
    if key == "sensor" and section.get("model") in MEASURED:
        raise DataError(
            f"sensor.model: {section['model']} needs a map in three dimensions: dimensions: 3", path
        )
    if section.get("model") not in known:
        raise DataError(f"{key}.model: got {section.get('model')}, expected {' or '.join(known)}", path)


def _without_noise(config: dict[str, Any]) -> tuple[str, ...]:
    """Says which noise is that of the defaults, since no log can do without."""
    sections = {
        "motion": [config.get("motion", {})],
        "sensor": list(config.get("sensors", {}).values()) or [config.get("sensor", {})],
    }
    missing = [key for key, each in sections.items() if not all(map(_says_noise, each))]
    return (
        (f"log.yaml says nothing of the noise of {' and '.join(missing)}: defaults hold",) if missing else ()
    )


def _says_noise(section: object) -> bool:
    return isinstance(section, dict) and any("std" in name or "alpha" in name for name in section)


def place_on_axle(motion: dict[str, Any]) -> tuple[str, ...]:
    """Puts speed and path of an `ackermann` section that says nothing of them on the rear axle; notes say so.

    **Why** The configuration's own defaults are the dimensions of one car, that of Victoria Park.
    """
    if motion.get("model") != "ackermann" or not REAR_AXLE.keys().isdisjoint(motion):
        return ()
    motion |= REAR_AXLE
    said = "motion says nothing of where the speed is measured: taken at the centre of the rear axle"
    length = "" if "wheelbase_m" in motion else "; motion.wheelbase_m is the default's: give your car's"
    return (said + length,)


def _in_si(value: Any, name: str, path: Path, line_of_key: dict[str, int]) -> Any:
    """The same settings with `bearing_std_deg` and the like as `bearing_std_rad`."""
    if not isinstance(value, dict):
        return value
    converted: dict[str, Any] = {}
    for key, item in value.items():
        line = line_of_key.get(f"{name}.{key}")
        if not isinstance(key, str):
            raise DataError(f"{name}: got the key {key}, expected a name", path, line)
        si_name, factor = _si_name(key)
        if si_name in converted or (si_name != key and si_name in value):
            raise DataError(f"{name}.{key}: {si_name} is given too, remove one", path, line)
        if factor == 1.0:
            converted[key] = _in_si(item, f"{name}.{key}", path, line_of_key)
            continue
        if isinstance(item, bool) or not isinstance(item, (int, float)):
            raise DataError(f"{name}.{key}: got {item}, expected a number", path, line)
        converted[si_name] = factor * item
    return converted


def _si_name(key: str) -> tuple[str, float]:
    """The name of a key with its unit in SI, and the factor to it; the key where it has no other unit."""
    parts = key.split("_")
    for length in range(min(4, len(parts) - 1), 0, -1):
        unit, factor = UNITS.get("_".join(parts[-length:]), ("", 1.0))
        if unit:
            return ("_".join((*parts[:-length], unit)), factor) if factor != 1.0 else (key, 1.0)
    return key, 1.0

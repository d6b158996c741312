"""Reads `log.yaml` of a native log: which models, and the settings that belong to the log."""

from __future__ import annotations

import difflib
from pathlib import Path
from typing import Any

from .._yaml import YamlError, parse_yaml
from ..errors import DataError
from .native_odometry import ODOMETRY_COLUMNS
from .text import read_text

FORMAT_VERSION = 1
CONFIG_KEYS = ("motion", "sensor", "association", "filter", "initial_pose")
KEYS = ("format_version", "name", *CONFIG_KEYS, "truth_landmarks_complete")


def read_settings(path: Path) -> dict[str, Any]:
    """The settings, checked for unknown keys and for models that there are. Errors: DataError."""
    try:
        settings, line_of_key = parse_yaml(read_text(path))
    except YamlError as error:
        raise DataError(f"is not valid YAML ({error.message})", path, error.line) from None
    if not isinstance(settings, dict):
        raise DataError(f"got no settings, expected the keys {', '.join(KEYS)}", path)
    for key in settings:
        if key not in KEYS:
            near = difflib.get_close_matches(str(key), KEYS, n=1)
            hint = f", did you mean {near[0]}?" if near else f"; known: {', '.join(KEYS)}"
            raise DataError(f"unknown key {key}{hint}", path, line_of_key.get(str(key)))
    version = settings.get("format_version")
    if version != FORMAT_VERSION:
        raise DataError(f"format_version: got {version}, expected {FORMAT_VERSION}", path)
    _check_model(settings, "motion", tuple(ODOMETRY_COLUMNS), path)
    _check_model(settings, "sensor", ("range_bearing",), path)
    if not isinstance(settings.get("truth_landmarks_complete", True), bool):
        raise DataError("truth_landmarks_complete: expected true or false", path)
    return settings


def _check_model(settings: dict[str, Any], key: str, known: tuple[str, ...], path: Path) -> None:
    section = settings.get(key)
    if not isinstance(section, dict):
        raise DataError(f"{key}: got {section}, expected a section with the key model", path)
    if section.get("model") not in known:
        raise DataError(f"{key}.model: got {section.get('model')}, expected {' or '.join(known)}", path)

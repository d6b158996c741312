"""The configuration of a run: defaults < the log's own settings < file < command line."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from functools import cache
from pathlib import Path
from typing import Any

from . import _core
from .errors import ConfigError
from .settings import KeyInfo, Layer, Schema, Settings

DETECTOR = "detector"
"""Section for a log with laser scans in which landmarks are detected: keys of `docs/detectors.md`."""


def _detectors() -> Schema:
    from .detection import SCHEMA

    return SCHEMA


_SCHEMA = Schema(
    _core.config_schema,
    _core.resolve_config,
    explained_by="fastslam config explain",
    beside={DETECTOR: _detectors},
)


class Config(Settings):
    """An effective configuration: every key is present and every value has been checked.

    The section `detector` is there where somebody sets something in it, and has that alone.
    """

    @classmethod
    def resolve(cls, *layers: Layer) -> Config:
        """Lays partial configurations over the defaults, later ones winning, and checks the outcome.

        >>> Config.resolve({"filter": {"particles": 50}}, {"seed": 3})["filter"]["particles"]
        50

        Errors: `ConfigError`, its message starting with the dotted key.
        """
        read = [_SCHEMA.read_layer(layer) for layer in layers]
        detector = detector_of(*read)
        rest = [{key: value for key, value in layer.items() if key != DETECTOR} for layer in read]
        values = dict(_SCHEMA.resolve(*rest))
        return cls({**values, DETECTOR: detector} if detector else values, _SCHEMA)

    def to_json(self) -> str:
        """Returns the form that the core reads."""
        return json.dumps({key: value for key, value in self.items() if key != DETECTOR})


def detector_of(*layers: Layer) -> dict[str, Any]:
    """What layers of a run's settings say of the detector. Errors: `ConfigError` for unknown keys."""
    section = _SCHEMA.merge(*layers).get(DETECTOR)
    if section is None:
        return {}
    if not isinstance(section, Mapping):
        raise ConfigError(f"{DETECTOR}: got {section!r}, expected settings such as {{kind: corners}}")
    try:
        _detectors().resolve(section)
    except ConfigError as error:
        raise ConfigError(f"{DETECTOR}.{error}") from None
    return dict(section)


def without_detector(config: Config) -> Config:
    """The configuration of a run over sightings, however they were made."""
    return Config.resolve({key: value for key, value in config.items() if key != DETECTOR})


def load_config(path: Path | str) -> dict[str, Any]:
    """Reads a partial configuration from a YAML file; see `Schema.load`."""
    return _SCHEMA.load(path)


def parse_assignments(assignments: Iterable[str]) -> dict[str, Any]:
    """Turns `["filter.particles=100", ...]` into a partial configuration; see `Schema.parse_assignments`."""
    return _SCHEMA.parse_assignments(assignments)


def merge(*layers: Layer) -> dict[str, Any]:
    """Lays partial configurations over each other, later ones winning; see `Schema.merge`."""
    return _SCHEMA.merge(*layers)


def explain(key: str | None = None) -> tuple[KeyInfo, ...]:
    """Returns what is known about all keys, or about `key` and the keys below it; see `Schema.explain`."""
    return _SCHEMA.explain(key)


def sensor_of(config: Mapping[str, Any]) -> dict[str, Any]:
    """The sensor of a configuration, with the defaults of what its model does not have."""
    return {**_any_sensor(), **config["sensor"]}


@cache
def _any_sensor() -> dict[str, Any]:
    return dict(Config.resolve()["sensor"])


def schema() -> dict[str, Any]:
    """Returns the JSON Schema (draft 2020-12) of the configuration."""
    return _SCHEMA.json_schema

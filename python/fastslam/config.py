"""The configuration of a run: defaults < the log's own settings < file < command line."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from functools import cache
from pathlib import Path
from typing import Any

from . import _core
from .settings import KeyInfo, Layer, Schema, Settings

_SCHEMA = Schema(_core.config_schema, _core.resolve_config, explained_by="fastslam config explain")


class Config(Settings):
    """An effective configuration: every key is present and every value has been checked."""

    @classmethod
    def resolve(cls, *layers: Layer) -> Config:
        """Lays partial configurations over the defaults, later ones winning, and checks the outcome.

        >>> Config.resolve({"filter": {"particles": 50}}, {"seed": 3})["filter"]["particles"]
        50

        Errors: `ConfigError`, its message starting with the dotted key.
        """
        return cls(dict(_SCHEMA.resolve(*layers)), _SCHEMA)


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

"""The configuration of a run in space: defaults < the log's own settings < file < command line."""

from __future__ import annotations

from .. import _core
from ..settings import Layer, Schema, Settings

SCHEMA = Schema(_core.space_config_schema, _core.resolve_space_config, explained_by="docs/space.md")


class SpaceConfig(Settings):
    """An effective configuration: every key is present and every value has been checked."""

    @classmethod
    def resolve(cls, *layers: Layer) -> SpaceConfig:
        """Lays partial configurations over the defaults, later ones winning, and checks the outcome.

        >>> SpaceConfig.resolve({"filter": {"particles": 50}}, {"seed": 3})["filter"]["particles"]
        50

        Errors: `ConfigError`, its message starting with the dotted key.
        """
        return cls(dict(SCHEMA.resolve(*layers)), SCHEMA)

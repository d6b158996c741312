"""Layered settings: laid over each other, checked against a schema of the Rust core, explained and dumped."""

from __future__ import annotations

import json
import math
import re
import textwrap
from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import cached_property
from pathlib import Path
from typing import Any, TypeAlias

from ._hints import does_not_exist, in_plain_words
from ._json_schema import KeyInfo, discriminators, flatten, suggestion
from .errors import ConfigError

__all__ = ["KeyInfo", "Layer", "Partial", "Schema", "Settings"]

Partial: TypeAlias = Mapping[str, Any]
"""Partial settings: nested mappings as they stand in a file."""
Layer: TypeAlias = Partial | Path | str
"""Partial settings, or the path of a YAML file that has them."""


RENAMED = {
    "health.window_steps": "health.window_scans",
}
"""Keys of earlier versions and what they are called now, with the same values."""
OF_DETECTORS = ("trunks", "reflectors", "corners")
"""Sections of a run's section `detector`, which are easily taken for those of the run."""


class Settings(Mapping[str, Any]):
    """Complete settings: every key of the schema is present and every value has been checked."""

    def __init__(self, values: dict[str, Any], schema: Schema) -> None:
        self._values = values
        self._schema = schema

    def __getitem__(self, key: str) -> Any:
        return self._values[key]

    def __iter__(self) -> Iterator[str]:
        return iter(self._values)

    def __len__(self) -> int:
        return len(self._values)

    def to_json(self) -> str:
        """Returns the form that the core reads."""
        return json.dumps(self._values)

    def dump(self) -> str:
        """Returns YAML with every key, each under its description; `Schema.load` reads it back."""
        return "\n".join(_commented(self._values, (), self._schema.descriptions)) + "\n"


class Schema:
    """One schema of the core: what `read` describes (JSON Schema) and `resolve_json` fills in and checks.

    `explained_by` is the command or page that users are pointed to.
    """

    def __init__(
        self,
        read: Callable[[], str],
        resolve_json: Callable[[str], str],
        *,
        explained_by: str,
        beside: Mapping[str, Callable[[], Schema]] | None = None,
    ) -> None:
        """Of `beside`, sections with schemas of their own, `resolve` knows nothing."""
        self._read = read
        self._resolve_json = resolve_json
        self._explained_by = explained_by
        self._beside = beside or {}

    @cached_property
    def json_schema(self) -> dict[str, Any]:
        """The JSON Schema (draft 2020-12)."""
        parsed: dict[str, Any] = json.loads(self._read())
        return parsed

    @cached_property
    def keys(self) -> tuple[KeyInfo, ...]:
        """Every key that there may be."""
        return flatten(self.json_schema, self._defaults)

    @cached_property
    def descriptions(self) -> dict[str, str]:
        """Descriptions of keys and of the sections above them, by dotted name."""
        texts = {info.name: info.description for info in self.keys}
        for info in self.keys:
            texts.update(info.section_descriptions)
        return texts

    def resolve(self, *layers: Layer) -> Settings:
        """Lays `layers` over the defaults, later ones winning, and checks the outcome.

        Errors: `ConfigError`, its message starting with the dotted key.
        """
        read = [self.read_layer(layer) for layer in layers]
        for layer in read:
            _refuse_unwritable(layer)
            for key in _leaf_keys(layer):
                self._refuse_unknown(key)
        return Settings(self._complete(self.merge(self._defaults, *read)), self)

    def read_layer(self, layer: Layer) -> Partial:
        """The settings of a layer, read where it is the path of a file. Errors: as `load`."""
        is_assignment = isinstance(layer, str) and "=" in layer and not Path(layer).exists()
        if isinstance(layer, Path | str) and not is_assignment:
            return self.load(layer)
        if not isinstance(layer, Mapping):
            example = '{"filter": {"particles": 50}}'
            raise ConfigError(
                f"settings: got {layer!r}, expected keys and values such as {example}, or a YAML file"
            )
        return layer

    def load(self, path: Path | str) -> dict[str, Any]:
        """Reads partial settings from a YAML file.

        Errors: `ConfigError` with file and line for a syntax error, a duplicate or an unknown key; with the
        file for a missing or unreadable one.
        """
        try:
            text = Path(path).read_text(encoding="utf-8")
        except FileNotFoundError:
            raise ConfigError(f"{path}: {does_not_exist(Path(path))}") from None
        except OSError as error:
            raise ConfigError(f"{path}: {error.strerror or error}") from None
        except UnicodeDecodeError as error:
            raise ConfigError(f"{path}: not UTF-8 text ({error.reason} at byte {error.start})") from None
        layer, line_of_key = _parse(text, str(path))
        if layer is None:
            return {}
        if not isinstance(layer, dict):
            raise ConfigError(f"{path}:1: expected `section:` and indented `key: value` lines")
        for key in _leaf_keys(layer):
            self._refuse_unknown(key, f"{path}:{line_of_key.get(key, 1)}: ")
        return layer

    def parse_assignments(self, assignments: Iterable[str]) -> dict[str, Any]:
        """Turns `["filter.particles=100", ...]` into a layer.

        Values are YAML: `1e-3`, `true`, `[0, 0, 1.5]`.

        Errors: `ConfigError` for text that is no assignment, an unknown key, or a value that is no YAML.
        """
        layer: dict[str, Any] = {}
        for assignment in assignments:
            key, equals, text = assignment.partition("=")
            key = key.strip()
            if not equals or not key:
                raise ConfigError(f"{assignment}: expected key=value, for example filter.particles=100")
            self._refuse_unknown(key)
            nested, _ = _parse(text, key)
            for part in reversed(key.split(".")):
                nested = {part: nested}
            layer = self.merge(layer, nested)
        return layer

    def merge(self, *layers: Layer) -> dict[str, Any]:
        """Lays partial settings over each other: later values win, mappings merge key by key.

        A section whose kind changes (`motion.model`, say) is replaced whole, for the parameters of one model
        mean nothing to another. A layer that is the path of a YAML file is read.
        """
        merged: dict[str, Any] = {}
        for layer in layers:
            merged = self._overlay(merged, self.read_layer(layer), ())
        return merged

    def explain(self, key: str | None = None) -> tuple[KeyInfo, ...]:
        """Returns what the schema says about all keys, or about `key` and the keys below it.

        Errors: `ConfigError` when there is no such key, with the nearest one.
        """
        if key is None:
            return self.keys
        section, _, rest = key.partition(".")
        if section in self._beside:
            return self._beside[section]().explain(rest or None)
        chosen = tuple(info for info in self.keys if info.name == key or info.name.startswith(key + "."))
        if not chosen:
            self._refuse_unknown(key)
        return chosen

    def _complete(self, layer: Partial) -> dict[str, Any]:
        try:
            resolved: dict[str, Any] = json.loads(self._resolve_json(json.dumps(layer)))
        except ValueError as error:
            raise ConfigError(self._say_wrong_kind(str(error))) from None
        return resolved

    def _say_wrong_kind(self, message: str) -> str:
        """Rewords the core's complaint about a key that belongs to another kind of its section."""
        found = re.match(r"(?P<section>\S+): unknown field `(?P<name>\w+)`", message)
        if found is None:
            return in_plain_words(message)
        key = "{section}.{name}".format(**found.groupdict())
        kinds = [info.only_for for info in self.keys if info.name == key and info.only_for]
        return f"{key}: only for {' or '.join(kinds)}" if kinds else message

    def _refuse_unknown(self, key: str, where: str = "") -> None:
        parts = key.split(".")
        if key in self.descriptions or any(".".join(parts[:n]) in self._leaves for n in range(1, len(parts))):
            return
        if parts[0] in self._beside:
            # The section alone is no mapping: whoever takes it out says so.
            if len(parts) > 1:
                self._beside[parts[0]]()._refuse_unknown(".".join(parts[1:]), f"{where}{parts[0]}.")
            return
        if RENAMED.get(key) in self.descriptions:
            raise ConfigError(f"{where}{key}: is called {RENAMED[key]} now, for it counts scans")
        if parts[0] in OF_DETECTORS and "detector" in self._beside:
            raise ConfigError(f"{where}{key}: is a setting of the detector: detector.{key} sets it for a run")
        nearest = suggestion(key, self.descriptions)
        hint = f"did you mean {nearest}?" if nearest else f"see `{self._explained_by}`"
        raise ConfigError(f"{where}{key}: unknown key; {hint}")

    def _overlay(self, below: Partial, above: Partial, path: tuple[str, ...]) -> dict[str, Any]:
        kind_key = self._discriminators.get(path, "")
        other_kind = kind_key in above and kind_key in below and above[kind_key] != below[kind_key]
        merged = {} if other_kind else dict(below)
        for key, value in above.items():
            earlier = merged.get(key)
            if isinstance(earlier, Mapping) and isinstance(value, Mapping):
                merged[key] = self._overlay(earlier, value, (*path, str(key)))
            else:
                merged[key] = _deep_copy(value)
        return merged

    @cached_property
    def _defaults(self) -> dict[str, Any]:
        return self._complete({})

    @cached_property
    def _leaves(self) -> frozenset[str]:
        """Keys that are no sections; what a mapping below one may hold is for the core to say."""
        return frozenset(info.name for info in self.keys)

    @cached_property
    def _discriminators(self) -> Mapping[tuple[str, ...], str]:
        return discriminators(self.json_schema)


def _deep_copy(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _deep_copy(child) for key, child in value.items()}
    return list(value) if isinstance(value, list | tuple) else value


def _leaf_keys(layer: Partial, prefix: str = "") -> Iterator[str]:
    """Dotted keys of everything that is not a mapping; an empty mapping counts as its own leaf."""
    for key, value in layer.items():
        dotted = f"{prefix}{key}"
        if isinstance(value, Mapping) and value:
            yield from _leaf_keys(value, dotted + ".")
        else:
            yield dotted


def _refuse_unwritable(value: Any, key: str = "") -> None:
    """Refuses what JSON cannot carry: NaN, infinities, dates, and keys that are not text."""
    if isinstance(value, Mapping):
        for name, child in value.items():
            if not isinstance(name, str):
                raise ConfigError(f"{key or 'settings'}: keys must be text, got {name!r}")
            if "." in name and not key:
                section, _, rest = name.partition(".")
                raise ConfigError(f"{name}: keys are nested: write {section}: {{{rest}: ...}}")
            _refuse_unwritable(child, f"{key}.{name}" if key else name)
    elif isinstance(value, list | tuple):
        for child in value:
            _refuse_unwritable(child, key)
    elif isinstance(value, float) and not math.isfinite(value):
        raise ConfigError(f"{key}: must be a finite number, got {value}")
    elif not isinstance(value, str | int | float | bool | None):
        raise ConfigError(f"{key}: expected a number, text or list, got a {type(value).__name__} ({value})")


def _parse(text: str, where: str) -> tuple[Any, dict[str, int]]:
    from ._yaml import YamlError, parse_yaml

    try:
        return parse_yaml(text)
    except YamlError as error:
        line = "" if error.line is None else f":{error.line}"
        raise ConfigError(f"{where}{line}: {error.message}") from None


def _commented(section: Partial, path: tuple[str, ...], descriptions: Mapping[str, str]) -> Iterator[str]:
    from ._yaml import write_yaml

    indent = "  " * len(path)
    for key, value in section.items():
        description = descriptions.get(".".join((*path, key)), "")
        yield from textwrap.wrap(
            description, 100, initial_indent=indent + "# ", subsequent_indent=indent + "# "
        )
        if isinstance(value, Mapping) and value:
            yield f"{indent}{key}:"
            yield from _commented(value, (*path, key), descriptions)
        else:
            yield f"{indent}{key}: {write_yaml(value, flow=True).rstrip()}"

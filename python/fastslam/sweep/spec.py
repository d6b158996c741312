"""What a sweep consists of, and the YAML file that says it."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeAlias

from .._hints import does_not_exist, of_our_own
from .._yaml import YamlError, parse_yaml
from ..config import explain, merge
from ..errors import ConfigError
from ..settings import Layer
from ..simulation import resolve_simulation
from .cells import Cell


@dataclass(frozen=True)
class StoredLog:
    """A log on disk; `format` and `robot` as for `datasets.load`."""

    name: str
    path: str
    format: str | None = None
    robot: int | None = None

    def describe(self, seed: int) -> dict[str, Any]:
        """What a cell needs to read it; the seed of the run does not matter."""
        return {"path": self.path, "format": self.format, "robot": self.robot}


@dataclass(frozen=True)
class SimulatedLog:
    """A log that each cell simulates for itself.

    With `new_world` every seed of the sweep simulates another world, so that a mean over the seeds is one
    over worlds; otherwise the world is that of its settings, and only the filter's random numbers change.
    """

    name: str
    settings: Layer = field(default_factory=dict)
    preset: str | None = None
    landmarks: int | None = None
    new_world: bool = False

    def describe(self, seed: int) -> dict[str, Any]:
        """What a cell needs to simulate it: complete settings."""
        layers = [self.settings, {"seed": seed}] if self.new_world else [self.settings]
        return {"simulate": dict(resolve_simulation(*layers, preset=self.preset, landmarks=self.landmarks))}


LogSource: TypeAlias = StoredLog | SimulatedLog


@dataclass(frozen=True)
class SweepSpec:
    """Logs × grid × seeds. `grid` maps dotted configuration keys to the values that they take.

    `measure`, "module:function", takes (RunResult, Log) to further numbers of a cell by name.
    """

    logs: Sequence[LogSource]
    seeds: Sequence[int]
    grid: Mapping[str, Sequence[Any]] = field(default_factory=dict)
    config: Layer = field(default_factory=dict)
    measure: str | None = None

    def cells(self) -> list[Cell]:
        """Every cell once, seeds innermost. Errors: `ConfigError` for a key that does not exist.

        Values are checked where a cell runs: what they may be can depend on the log's own settings.
        """
        for key in [*self.grid, *_leaf_keys(merge(self.config))]:
            explain(key)
        return list(self._cells())

    def _cells(self) -> Iterator[Cell]:
        for log in self.logs:
            for values in itertools.product(*self.grid.values()):
                point = dict(zip(self.grid, values, strict=True))
                layer = merge(self.config, *(_nested(key, value) for key, value in point.items()))
                for seed in self.seeds:
                    yield Cell(
                        log_name=log.name,
                        log=log.describe(seed),
                        config=merge(layer, {"seed": seed}),
                        point=point,
                        seed=seed,
                        measure=self.measure,
                    )


def load_spec(path: Path | str) -> SweepSpec:
    """Reads a sweep from YAML; paths of logs are relative to the file.

    Errors: `ConfigError` with file and line for a syntax error or an unknown key, with the file otherwise.
    """
    file = Path(path)
    if file.is_dir():
        raise ConfigError(f"{file}: {of_our_own(file) or 'is a folder'}; expected a YAML file of a sweep")
    try:
        values, lines = parse_yaml(file.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"{file}: {getattr(error, 'strerror', None) or error}") from None
    except YamlError as error:
        line = "" if error.line is None else f":{error.line}"
        raise ConfigError(f"{file}{line}: {error.message}") from None
    if not isinstance(values, dict):
        raise ConfigError(f"{file}:1: expected `logs:`, `grid:`, `seeds:` and `config:`")
    for key in values:
        if key not in ("logs", "grid", "seeds", "config"):
            raise ConfigError(f"{file}:{lines.get(str(key), 1)}: {key}: unknown key")
    try:
        return SweepSpec(
            logs=_logs(values.get("logs"), file.parent),
            seeds=_seeds(values.get("seeds", 1)),
            grid=_grid(values.get("grid") or {}),
            config=_mapping(values.get("config") or {}, "config"),
        )
    except ConfigError as error:
        raise ConfigError(f"{file}: {error}") from None


def _logs(value: Any, folder: Path) -> list[LogSource]:
    if not isinstance(value, list) or not value:
        raise ConfigError("logs: expected a list of `- path: ...` or `- simulate: ...`")
    logs = [_log(entry, folder, f"logs[{index}]") for index, entry in enumerate(value)]
    names = [log.name for log in logs]
    for name in names:
        if names.count(name) > 1:
            raise ConfigError(f"logs: two are called {name}: give them a `name` each")
    return logs


def _log(entry: Any, folder: Path, where: str) -> LogSource:
    given = dict(_mapping(entry, where))
    if "simulate" in given:
        keys = ("name", "simulate", "landmarks", "settings", "new_world")
        _refuse_others(given, keys, where)
        preset, landmarks = given["simulate"], given.get("landmarks")
        name = given.get("name", preset if landmarks is None else f"{preset}-{landmarks}")
        log = SimulatedLog(
            name=str(name),
            settings=_mapping(given.get("settings") or {}, f"{where}.settings"),
            preset=preset,
            landmarks=landmarks,
            new_world=bool(given.get("new_world", False)),
        )
        log.describe(0)
        return log
    _refuse_others(given, ("name", "path", "format", "robot"), where)
    if not isinstance(given.get("path"), str):
        raise ConfigError(f"{where}: expected `path: ...` or `simulate: ...`")
    path = (folder / Path(given["path"]).expanduser()).resolve()
    if not path.exists():
        raise ConfigError(f"{where}.path: {path} {does_not_exist(path)}")
    return StoredLog(str(given.get("name", path.name)), str(path), given.get("format"), given.get("robot"))


def _refuse_others(given: Mapping[str, Any], keys: Sequence[str], where: str) -> None:
    for key in given:
        if key not in keys:
            raise ConfigError(f"{where}.{key}: unknown key; expected {', '.join(keys)}")


def _seeds(value: Any) -> list[int]:
    """A number of seeds from 0 on, or the seeds themselves."""
    if isinstance(value, int) and not isinstance(value, bool) and value > 0:
        return list(range(value))
    if isinstance(value, list) and value and all(type(seed) is int and seed >= 0 for seed in value):
        if len(set(value)) < len(value):
            raise ConfigError("seeds: one occurs twice")
        return value
    raise ConfigError(f"seeds: got {value}, expected a number of seeds or a list of them")


def _grid(value: Any) -> dict[str, list[Any]]:
    grid = _mapping(value, "grid")
    for key, values in grid.items():
        if not isinstance(values, list) or not values:
            raise ConfigError(f"grid.{key}: expected a list of values")
        if key == "seed":
            raise ConfigError("grid.seed: use `seeds`")
    return dict(grid)


def _mapping(value: Any, where: str) -> Mapping[str, Any]:
    if not isinstance(value, dict) or not all(isinstance(key, str) for key in value):
        raise ConfigError(f"{where}: expected `key: value` lines")
    return value


def _leaf_keys(layer: Mapping[str, Any], prefix: str = "") -> Iterator[str]:
    for name, value in layer.items():
        if isinstance(value, Mapping):
            yield from _leaf_keys(value, f"{prefix}{name}.")
        else:
            yield prefix + name


def _nested(key: str, value: Any) -> dict[str, Any]:
    for part in reversed(key.split(".")):
        value = {part: value}
    nested: dict[str, Any] = value
    return nested

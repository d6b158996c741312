"""Reads back what a run in space left in its folder, for scoring it again."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from .._yaml import YamlError, parse_yaml
from ..csv_cells import unguarded
from ..datasets.csv_table import CsvTable, read_csv
from ..datasets.text import read_table, read_text
from ..errors import DataError
from ..log import Floats
from ..resultfiles import (
    CONFIG_FILE,
    COVARIANCE_FILE,
    RUN_FILE,
    SMOOTHED_FILE,
    SPACE_MAP_FILE,
    STEPS_FILE,
    TRAJECTORY_FILE,
)
from .outputs import MAP_COLUMNS
from .result import SpaceMap, SpacePath, SpaceResult

_COUNTS = ("sightings", "new_landmarks", "skipped", "degrees_of_freedom", "resampled", "rejuvenated")


def is_result(folder: Path) -> bool:
    """Whether a folder holds a run in space. Raises nothing."""
    try:
        facts = json.loads((folder / RUN_FILE).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return False
    return isinstance(facts, dict) and facts.get("dimensions") == 3


def read_result(folder: Path | str) -> SpaceResult:
    """Read back what `write_outputs` wrote. Errors: `DataError` with file and line for what is malformed."""
    source = Path(folder)
    if not is_result(source):
        raise DataError("holds no run in three dimensions", source)
    facts: dict[str, Any] = json.loads(read_text(source / RUN_FILE))
    try:
        config, _ = parse_yaml(read_text(source / CONFIG_FILE))
        return SpaceResult(
            log_name=str(facts["log"]),
            config=dict(config),
            version=str(facts["version"]),
            trajectory=_path(source / TRAJECTORY_FILE, source / COVARIANCE_FILE),
            smoothed=_path(source / SMOOTHED_FILE),
            landmarks=_map(source / SPACE_MAP_FILE),
            steps=_steps(source / STEPS_FILE),
            filter_seconds=float(facts["filter_seconds"]),
            interrupted=bool(facts["interrupted"]),
            counts={str(name): int(count) for name, count in facts["counts"].items()},
            warnings=tuple(facts["warnings"]),
        )
    except (KeyError, TypeError, AttributeError) as error:
        raise DataError(f"is malformed ({error})", source / RUN_FILE) from None
    except YamlError as error:
        raise DataError(f"is not valid YAML ({error.message})", source / CONFIG_FILE, error.line) from None


def _path(file: Path, covariances: Path | None = None) -> SpacePath:
    rows = read_table(file, 8)
    poses = rows[:, [1, 2, 3, 7, 4, 5, 6]]
    if covariances is None or not covariances.is_file():
        return SpacePath(rows[:, 0], poses)
    table = read_csv(covariances, example="stamp_s", allow_empty=True)
    upper = _numbers(table, tuple(table.index_of)[1:])
    if upper.shape != (len(rows), 21):
        raise DataError(f"got {upper.shape} covariances, expected {(len(rows), 21)}", covariances)
    full = np.empty((len(rows), 6, 6))
    first, second = np.triu_indices(6)
    full[:, first, second] = full[:, second, first] = upper
    return SpacePath(rows[:, 0], poses, full)


def _map(file: Path) -> SpaceMap:
    table = read_csv(file, example=",".join(MAP_COLUMNS), allow_empty=True)
    if tuple(table.index_of) != MAP_COLUMNS:
        raise DataError(f"got {','.join(table.index_of)}, expected {','.join(MAP_COLUMNS)}", file, 1)
    numbers = _numbers(table, MAP_COLUMNS[1:])
    full = np.empty((len(numbers), 3, 3))
    first, second = np.triu_indices(3)
    full[:, first, second] = full[:, second, first] = numbers[:, 3:9]
    ids = tuple(unguarded(name.strip()) for name in table.texts("id"))
    return SpaceMap(ids, numbers[:, :3], full, numbers[:, 9].astype(np.int64))


def _steps(file: Path) -> dict[str, Any]:
    table = read_csv(file, example="stamp_s", allow_empty=True)
    names = tuple(table.index_of)[1:]
    columns = dict(zip(names, _numbers(table, names).T, strict=True))
    return {name: column.astype(np.uint32) if name in _COUNTS else column for name, column in columns.items()}


def _numbers(table: CsvTable, names: tuple[str, ...]) -> Floats:
    return np.column_stack([table.finite_numbers(name) for name in names])

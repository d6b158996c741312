"""One cell of a sweep: a log, a configuration and a seed, and what running them gives."""

from __future__ import annotations

import hashlib
import importlib
import json
import time
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from functools import lru_cache
from typing import Any

from .. import _core
from ..datasets.registry import load
from ..errors import FastSlamError
from ..evaluation import evaluate, flatten
from ..log import Log
from ..runner import run
from ..simulation import simulate


@dataclass(frozen=True)
class Cell:
    """Everything that determines a cell's numbers, as plain data that travels between machines."""

    log_name: str
    log: Mapping[str, Any]
    """`path`, `format` and `robot` of a log on disk, or the complete settings of a simulation."""
    config: Mapping[str, Any]
    """Laid over the log's own settings; holds the seed."""
    point: Mapping[str, Any]
    """The values of the grid's keys."""
    seed: int
    measure: str | None = None

    @property
    def key(self) -> str:
        """Names the cell among all cells: the same log, configuration, seed and version have the same key."""
        text = json.dumps([asdict(self), _core.__version__], sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()[:20]


def measure_cell(cell: Cell) -> dict[str, Any]:
    """Runs a cell and returns its row: key, log, grid point, seed, metrics; or `error` where it cannot run.

    An interrupted run raises `KeyboardInterrupt`: half a run is no result.
    """
    started_s = time.perf_counter()
    row: dict[str, Any] = {
        "key": cell.key,
        "log": cell.log_name,
        "point": dict(cell.point),
        "seed": cell.seed,
    }
    try:
        log = _log(json.dumps(cell.log, sort_keys=True))
        result = run(log, cell.config)
        if result.interrupted:
            raise KeyboardInterrupt
        row["metrics"] = flatten(evaluate(result, log))
        if cell.measure is not None:
            row["metrics"] |= _function(cell.measure)(result, log)
        row["error"] = None
    except FastSlamError as error:
        row |= {"metrics": {}, "error": f"{type(error).__name__}: {error}"}
    row["wall_seconds"] = time.perf_counter() - started_s
    return row


@lru_cache(maxsize=2)
def _log(description: str) -> Log:
    """The log of neighbouring cells is mostly the same."""
    given = json.loads(description)
    if "simulate" in given:
        return simulate(given["simulate"])
    return load(given["path"], format=given["format"], robot=given["robot"])


def _function(name: str) -> Any:
    module, _, function = name.partition(":")
    return getattr(importlib.import_module(module), function)

"""Runs the filter over a log."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import TypeAlias

from .config import Config
from .datasets.registry import load
from .errors import ConfigError
from .log import Log
from .result import RunResult
from .settings import Layer

Progress: TypeAlias = Callable[[int, int], None]
"""Called a few times a second with (steps done, steps in all)."""


def configure(log: Log, *layers: Layer) -> Config:
    """The effective configuration: `layers` over the log's own settings over the defaults.

    Errors: `ConfigError`; for the log's own settings the message names the log.
    """
    try:
        Config.resolve(log.config)
    except ConfigError as error:
        raise ConfigError(f"{log.source}: {error}") from None
    return Config.resolve(log.config, *layers)


def run(
    source: Log | Path | str,
    config: Layer | None = None,
    *,
    format: str | None = None,
    robot: int | None = None,
    progress: Progress | None = None,
) -> RunResult:
    """Runs the filter over a log, given as such or as a path (`format` and `robot` as for `datasets.load`).

    `config` is laid over the log's own settings and the defaults. A KeyboardInterrupt, Ctrl-C for one, stops
    the run: what was computed until then is returned with `interrupted` set.

    Errors: `DataError` for the log, `ConfigError` for the configuration, `NumericalError` when the filter
    cannot go on.
    """
    log = source if isinstance(source, Log) else load(source, format=format, robot=robot)
    raise SystemExit


def run_many(
    log: Log, config: Layer | None = None, *, seeds: Iterable[int], progress: Progress | None = None
) -> Iterator[RunResult]:
    """Runs the filter with each seed in turn, one result at a time in memory.

    `progress` counts over all runs. After an interrupted run no further one is started.
    """
    seeds = tuple(seeds)
    for number, seed in enumerate(seeds):

        def advance(done: int, total: int, number: int = number) -> None:
            if progress is not None:
                progress(number * total + done, len(seeds) * total)

        result = run(log, {**(config or {}), "seed": seed}, progress=advance)
        yield result
        if result.interrupted:
            return

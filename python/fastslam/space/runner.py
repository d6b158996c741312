"""Runs the filter over a log in space."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from .. import _core
from .._built import built_version
from ..covariances import symmetric
from ..errors import ConfigError, DataError, NumericalError
from ..settings import Layer
from .config import SpaceConfig
from .log import SpaceLog
from .reading import load
from .result import Hold, NoiseRatios, SpaceMap, SpacePath, SpaceResult
from .verdict import warnings_of

Progress = Callable[[int, int], None]


def configure(log: SpaceLog, *layers: Layer) -> SpaceConfig:
    """The effective configuration: `layers` over the log's own settings over the defaults.

    Errors: `ConfigError`, which names the log where its own settings are at fault, and for a sensor model
    other than that of the log.
    """
    try:
        SpaceConfig.resolve(log.config)
    except ConfigError as error:
        raise ConfigError(f"{log.source}: {error}") from None
    config = SpaceConfig.resolve(log.config, *layers)
    model = config["sensor"]["model"]
    if model != log.sensor:
        raise ConfigError(f"sensor.model: got {model}, expected {log.sensor}, which the log's sightings are")
    return config


def run(
    source: SpaceLog | Path | str, config: Layer | None = None, *, progress: Progress | None = None
) -> SpaceResult:
    """Runs the filter over a log in space, given as such or as a path.

    A KeyboardInterrupt stops the run: what was computed until then is returned with `interrupted` set.

    Errors: `DataError` for the log; `ConfigError` for the configuration; `NumericalError` when the filter
    cannot go on.
    """
    log = source if isinstance(source, SpaceLog) else load(source)
    configuration = configure(log, config or {})
    try:
        columns = _core.run_space(
            configuration.to_json(),
            log.row_stamp_s,
            log.velocity,
            log.sighting_stamp_s,
            log.value,
            log.identity,
            covariance=log.covariance,
            progress=progress,
        )
    except ValueError as error:
        raise DataError(str(error), log.source) from None
    except RuntimeError as error:
        raise NumericalError(str(error)) from None
    return _result(columns, log, configuration)


def _result(columns: dict[str, Any], log: SpaceLog, config: SpaceConfig) -> SpaceResult:
    found = columns["map"]
    result = SpaceResult(
        log_name=log.name,
        config=dict(config),
        version=built_version(),
        trajectory=SpacePath(columns["stamp_s"], columns["T_world_robot"], symmetric(columns["covariance"])),
        smoothed=SpacePath(columns["smoothed_stamp_s"], columns["smoothed_T_world_robot"]),
        landmarks=SpaceMap(
            tuple(log.names[identity] for identity in found["identity"]),
            found["mean_m"],
            found["covariance_m2"],
            found["sightings"].astype(np.int64),
        ),
        steps=columns["steps"],
        filter_seconds=columns["filter_seconds"],
        interrupted=columns["interrupted"],
        counts=columns["counts"],
        ratios=NoiseRatios(columns["motion_ratios"], columns["sensor_ratios"])
        if "motion_ratios" in columns
        else None,
        hold=Hold(columns["misfit"], columns["shape_std_m"]) if "misfit" in columns else None,
    )
    return replace(result, warnings=warnings_of(result, log))

"""A run as it comes: where nothing states the noise of robot and sensor, the log is asked for it first."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from .checkpoint import Checkpoints
from .config import merge
from .datasets.registry import load
from .detection import own_settings
from .errors import DataError, FastSlamError
from .log import Log
from .maps import Map, StartLike
from .noise import after_learning
from .result import RunResult
from .runner import Progress, configure, detected
from .runner import run as run_once
from .sensors import Sensor
from .settings import Layer
from .several import sensor_names
from .timing import stage
from .tuning import Tuning
from .tuning.judge import SOUND, judged
from .tuning.passes import Report
from .tuning.session import searched

if TYPE_CHECKING:
    from .watching import Watch


NUMERIC = (ArithmeticError, np.linalg.LinAlgError)
"""What numbers out of all proportion end in."""


@dataclass(frozen=True)
class Learning:
    """What a log said of its noise before the run: the tuning, or why there is none."""

    found: Tuning | None
    refusal: str = ""

    @property
    def settings(self) -> dict[str, Any]:
        """What to lay over the settings; empty where nothing was found."""
        return {} if self.found is None else self.found.settings

    @property
    def verdict(self) -> tuple[str, ...]:
        """What speaks against the run beside its own verdict."""
        doubt = None if self.found is None or self.found.interrupted else self.found.doubt
        return () if doubt is None else (doubt,)

    @property
    def warnings(self) -> tuple[str, ...]:
        """A sentence where the log does not tell the noise or contradicts a fact, or no map is sound."""
        state = "State what you know of it: motion.*_std_*, sensor.*_std_*"
        if self.found is None:
            return (
                f"the log does not tell its noise ({self.refusal}): the run takes what is stated, and "
                f"the defaults for the rest. {state}",
            )
        fault = None if self.found.interrupted else self.found.best.fault
        said = () if fault is None else (f"no noise that was tried makes a sound map ({fault}). {state}",)
        return (*self.found.conflicts, *said)

    def said_of(self, result: RunResult) -> RunResult:
        """The run with these sentences before those of its own."""
        return replace(
            result,
            verdict=(*self.verdict, *result.verdict),
            warnings=(*self.warnings, *self.after(result.warnings)),
        )

    def after(self, warnings: tuple[str, ...]) -> tuple[str, ...]:
        """The warnings of a run without advice that learning has outdone."""
        return warnings if self.found is None else after_learning(warnings)


def unstated_noise(log: Log, config: Layer | None = None) -> tuple[str, ...]:
    """Whose noise neither the log nor `config` states: `motion`, `sensor`, both or none.

    A covariance in each row states it, and so does any standard deviation among the settings.
    """
    said = merge(own_settings(log), config or {})
    rows = {"motion": log.controls.covariance, "sensor": log.sightings.covariance}
    return tuple(
        name
        for name, covariance in rows.items()
        if covariance is None and not _states_noise(said.get(name) or {})
    )


def is_learning_due(log: Log, config: Layer | None = None) -> bool:
    """Whether a run begins with learning: `unstated_noise`, of a kind that `tune` knows."""
    return is_learnable(log, config) and bool(unstated_noise(log, config))


def is_learnable(log: Log, config: Layer | None = None) -> bool:
    """Whether `tune` knows the algorithm and the sensor of a log."""
    complete = configure(log, config or {})
    if complete["algorithm"] == "ekf" or sensor_names(complete):
        return False
    return bool(complete["sensor"]["model"] == "range_bearing")


def learned_first(
    log: Log,
    config: Layer | None = None,
    *,
    progress: Progress | None = None,
    report: Report | None = None,
) -> Learning:
    """What the log says of its noise, or why it does not; `report` hears of every pass.

    Errors: `ConfigError` for the configuration.
    """
    try:
        with stage("tune"):
            return Learning(searched(log, config, progress=progress, report=report))
    except NUMERIC:
        return Learning(None, "its numbers, or those of the settings, are out of all proportion")
    except DataError as error:
        reason = str(error).removeprefix(f"{log.source}: ")
        return Learning(None, reason.removeprefix("nothing can be learned from this log: "))


def sounder_than(
    result: RunResult,
    log: Log,
    config: Layer | None = None,
    *,
    progress: Progress | None = None,
    on_doubt: Callable[[], None] | None = None,
) -> Tuning | None:
    """What the log teaches where the map of its run is doubted, if that makes a sound map; else None.

    For a log whose noise is stated: it stays as it is as long as nothing speaks against the map. `config`
    are the settings of the run, `on_doubt` is called before anything is learned. The run that is there is not
    lost to what comes after it: what ends the learning, an interrupt too, leaves None.
    """
    if not result.verdict or result.interrupted or not is_learnable(log, config):
        return None
    try:
        if judged(result, log, result.config, result.doubts).rank == SOUND:
            return None
        if on_doubt is not None:
            on_doubt()
        with stage("tune"):
            found = searched(log, config, progress=progress, stated=result)
    except (FastSlamError, KeyboardInterrupt, *NUMERIC):
        return None
    if found.interrupted or found.doubt is not None or not found.best.is_sound:
        return None
    return found


def run(
    source: Log | Path | str,
    config: Layer | None = None,
    *,
    format: str | None = None,
    robot: int | None = None,
    map: Map | Path | str | None = None,
    start: StartLike = None,
    progress: Progress | None = None,
    checkpoints: Checkpoints | None = None,
    watch: Watch | None = None,
    sensor: Sensor | None = None,
    auto: bool | None = None,
) -> RunResult:
    """Runs the filter over a log, given as such or as a path (`format` and `robot` as for `datasets.load`).

    >>> from fastslam.simulation import simulate
    >>> log = simulate({"seed": 1, "world": {"count": 20}})
    >>> result = run(log, {"filter": {"particles": 30}})
    >>> result.landmarks.mean_m.shape == (len(result.landmarks.ids), 2)
    True

    Where neither the log nor `config` states the noise of the robot or of the sensor it is learned from the
    log first, with gains, delay and mounting, as by `fastslam.tune`: a few runs more. `result.config` has
    what was found. With `auto` True that is done in any case, with False never; by itself not with `map`,
    `sensor` or `checkpoints`, nor for EKF-SLAM, several sensors, or one without ranges or bearings.

    Where all noise is stated, but the map of the run is doubted by its verdict, the same is tried afterwards,
    and kept where it makes a map against which nothing speaks; a warning says so.

    What is stated of the rest are facts, which give way only where the log clearly contradicts them; a
    warning says so. An interrupt while it learns ends it with the best run until then; with `map` or `start`
    it is raised.

    All else is as in `fastslam.runner.run`, which makes one run with the settings as they are.
    """
    log = source if isinstance(source, Log) else load(source, format=format, robot=robot)
    log = detected(log, config)
    layer = config or {}
    plain = map is None and sensor is None and checkpoints is None
    learning: Learning | None = None
    if auto or (auto is None and plain and is_learning_due(log, layer)):
        learning = learned_first(log, layer, progress=progress)
        layer = merge(layer, learning.settings)
        found, as_asked = learning.found, plain and start is None
        if found is not None and found.interrupted and not as_asked:
            raise KeyboardInterrupt
        if found is not None and as_asked and (watch is None or found.interrupted):
            return learning.said_of(found.result)
    result = run_once(
        log,
        layer,
        map=map,
        start=start,
        progress=progress,
        checkpoints=checkpoints,
        watch=watch,
        sensor=sensor,
    )
    if learning is not None:
        return learning.said_of(result)
    if auto is None and plain and start is None and watch is None:
        sounder = sounder_than(result, log, layer, progress=progress)
        return result if sounder is None else in_place_of(result, sounder)
    return result


def in_place_of(result: RunResult, found: Tuning) -> RunResult:
    """The run that was found, with a warning on the one that gives way to it."""
    errors = (value for value in found.values if value.significant and value.standard_error >= 0)
    told = [f"{value.key} {value.value:.3g}" for value in errors if value.value != value.stated]
    word = (
        f"with the settings as they are the map is doubted ({result.verdict[0].split(':')[0]}): kept is a "
        f"run with what the log itself says, against whose map nothing speaks: {', '.join([*told, 'noise'])}"
    )
    return replace(found.result, warnings=(word, *found.conflicts, *after_learning(found.result.warnings)))


def _states_noise(section: Mapping[str, Any]) -> bool:
    """Whether a partial section of the settings has a standard deviation, or a variance of odometry."""
    for key, value in section.items():
        if key == "mounting" or key == "correction":
            continue
        if "_std_" in key or key.startswith("alpha"):
            return True
        if isinstance(value, Mapping) and _states_noise(value):
            return True
    return False

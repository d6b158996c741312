"""Runs the filter over a log."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from . import _core
from ._built import built_version
from ._yaml import line_of_key
from .checkpoint import Checkpoints
from .config import Config, merge
from .covariances import symmetric
from .datasets.registry import load
from .detection import own_settings, with_detector, with_sightings
from .errors import ConfigError, DataError, ModelError, NumericalError
from .filter import landmark_map, step_info
from .log import Floats, Log
from .maps import Map, StartLike, changes, core_start
from .misplaced import Misplaced, doubts_of, misplaced, without_misplaced
from .noise import Told, after_verdict, noise_sentences
from .residuals import Group, compared, residuals_of
from .result import RunResult, Steps, Trajectory
from .sensor_checks import begun
from .sensors import Adapter, Sensor, own_layer
from .settings import Layer, Partial
from .several import as_the_core_takes, left_out, refuse_several, sensor_names
from .timing import stage
from .verdict import judged, named_twice

if TYPE_CHECKING:
    from .watching import Watch

Progress: TypeAlias = Callable[[int, int], None]
"""Called a few times a second with (steps done, steps in all)."""


EKF_ASSOCIATION = ("mode", "gate_probability", "new_landmark_gate_probability", "new_landmark_density")
"""What EKF-SLAM takes from a log's own settings of association; it refuses most others."""


REACH_MARGIN = 1.1
"""So many times as far as anything was sighted a sensor sees."""
LEAST_SEEN = 50
"""Fewer sightings do not tell how far a sensor sees."""
FAR_SHARE, FAR_TIMES = 0.99, 2.0
"""What is so many times as far as this share of the sightings is counted only if it was sighted again."""
AGAIN_SCANS = 3
"""In one of so many scans before or after, within REACH_MARGIN of its range,"""
MOST_BETWEEN = 8
"""and with fewer other sightings as far away between them."""


def configure(log: Log, *layers: Layer) -> Config:
    """The effective configuration: `layers` over the log's own settings over the defaults.

    A log's own settings of association are for particles: with `algorithm: ekf` only its gates count. How far
    the sensor sees is learned from the log where nothing states it (`reach_seen_m`). Where no sighting has a
    name, `association.mode` is unknown, whatever is stated: that is how they are taken.

    Errors: `ConfigError`; for the log's own settings the message names the log.
    """
    own: Partial = own_settings(log)
    check_own_settings(log)
    if "association" in own and merge(own, *layers).get("algorithm") == "ekf":
        kept = {key: value for key, value in own["association"].items() if key in EKF_ASSOCIATION}
        own = {**own, "association": kept}
    complete = Config.resolve(own, *layers)
    if not sensor_names(complete) and "max_range_m" not in merge(own, *layers).get("sensor", {}):
        complete = Config.resolve(complete, {"sensor": {"max_range_m": reach_seen_m(log, complete)}})
    with_detector(log, complete)
    if complete["association"]["mode"] == "known" and _has_no_names(log, complete):
        return Config.resolve(complete, {"association": {"mode": "unknown"}})
    return complete


def reach_seen_m(log: Log, config: Mapping[str, Any]) -> float:
    """How far a sensor sees that has a limit nobody states: REACH_MARGIN times its farthest sighting.

    **Why:** what stands beyond the true limit would count as in view and missed, time and again; then it says
    nothing any more that a landmark in view is not sighted, and none that vanished is noticed. More than the
    limit of the settings it never is: ranges may be in another unit.
    """
    sensor = config["sensor"]
    seen = np.isfinite(log.sightings.range_m)
    if sensor["model"] != "range_bearing" or np.count_nonzero(seen) < LEAST_SEEN:
        return float(sensor["max_range_m"])
    farthest_m = _farthest_m(log.sightings.stamp_s[seen], log.sightings.range_m[seen])
    seen_m = float(f"{REACH_MARGIN * (farthest_m - sensor['range_bias_m']) / sensor['range_scale']:.3g}")
    return seen_m if sensor["min_range_m"] < seen_m < sensor["max_range_m"] else float(sensor["max_range_m"])


def _farthest_m(stamp_s: Floats, range_m: Floats) -> float:
    """The farthest of sightings (S,), single ones far beyond nearly all others left out: they are wrong."""
    limit_m = FAR_TIMES * float(np.quantile(range_m, FAR_SHARE))
    rows = np.flatnonzero(range_m > limit_m)
    rows = rows[np.argsort(stamp_s[rows], kind="stable")]
    scan, far_m = np.searchsorted(np.unique(stamp_s), stamp_s[rows]), range_m[rows]
    again = np.zeros(len(rows), dtype=bool)
    for other in range(1, min(MOST_BETWEEN, len(rows) - 1) + 1):
        apart = scan[other:] - scan[:-other]
        alike = np.abs(np.log(far_m[other:] / far_m[:-other])) < np.log(REACH_MARGIN)
        both = (apart > 0) & (apart <= AGAIN_SCANS) & alike
        again[other:] |= both
        again[:-other] |= both
    return float(far_m[again].max(initial=range_m[range_m <= limit_m].max()))


def _has_no_names(log: Log, config: Config) -> bool:
    """Whether no sighting says which landmark it is of, and the filter can do without."""
    identity = log.sightings.identity
    return (
        config["sensor"]["model"] in ("range_bearing", "bearing")
        and bool(len(identity))
        and not (identity >= 0).any()
    )


def _names_missed(log: Log, config: Config, *layers: Layer) -> tuple[str, ...]:
    """A sentence where settings state known identities, and the log has none."""
    stated = merge(own_settings(log), *layers).get("association", {}).get("mode")
    if stated != "known" or config["association"]["mode"] == "known":
        return ()
    return (
        "association.mode = known is stated, but no sighting of the log names a landmark: run as unknown",
    )


def refuse_ranges_alone(config: Mapping[str, Any], who: str) -> None:
    """Errors: `ConfigError` for several sensors, and for one without bearings, which every run calibrates."""
    refuse_several(config, who)
    model = config["sensor"]["model"]
    if model != "range_bearing":
        raise ConfigError(
            f"sensor.model: got {model}, expected range_bearing for {who}: it needs bearings "
            "(a run on ranges alone learns their scale and bias by itself)"
        )


def check_own_settings(log: Log) -> None:
    """Holds the settings that a log brings against the schema.

    Errors: `ConfigError` that names the log, and the line of its `log.yaml` where there is one.
    """
    try:
        Config.resolve(log.config)
    except ConfigError as error:
        key = str(error).partition(":")[0]
        line = line_of_key(Path(log.source) / "log.yaml", key)
        where = log.source if line is None else f"{Path(log.source) / 'log.yaml'}:{line}"
        raise ConfigError(f"{where}: {error}") from None


def detected(log: Log, config: Layer | None = None) -> Log:
    """The log with sightings: where it has laser scans instead, landmarks are detected in them.

    Errors: as `detection.with_sightings`.
    """
    log = with_detector(log, config or {})
    if log.scans is None:
        return log
    with stage("detection"):
        return with_sightings(log)


def _check_classes(log: Log, config: Config) -> None:
    """Errors: `DataError` that names the class of a sighting beyond those configured."""
    classes, index = config["association"]["classes"], log.sightings.class_index
    beyond = index[index >= classes["number"]] if classes is not None else index[:0]
    if len(beyond) and beyond[0] < len(log.class_names):
        known = ", ".join(log.class_names[: classes["number"]])
        raise DataError(
            f"class {log.class_names[beyond[0]]!r} of a sighting: expected one of {known} "
            f"(association.classes.number is {classes['number']})",
            log.source,
        )


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
) -> RunResult:
    """Runs the filter over a log, given as such or as a path (`format` and `robot` as for `datasets.load`).

    >>> from fastslam.simulation import simulate
    >>> log = simulate({"seed": 1, "world": {"count": 20}})
    >>> result = run(log, {"filter": {"particles": 30}})
    >>> result.landmarks.mean_m.shape == (len(result.landmarks.ids), 2)
    True

    Where the log has laser scans and no sightings, landmarks are detected in the scans first.

    With `map` the run begins in a map that was kept, and with `start` at a pose that is not known exactly, or
    at one of several; `result.changes` says what it found otherwise.

    `config` is laid over the log's own settings and the defaults. A KeyboardInterrupt, Ctrl-C for one, stops
    the run: what was computed until then is returned with `interrupted` set. With `checkpoints` the state is
    written to a file on the way, from which the run goes on, in another process too, to the same result but
    for computing times. `watch` is called with a `fastslam.watching.View` after the first step, whenever it
    asked for the next one, and at the end. `sensor` is one of your own, which says what it measures of a
    landmark (`fastslam.sensors.Sensor`); sightings have to name theirs.

    Errors: `DataError` for the log, or a checkpoint that is damaged or of another run; `ConfigError` for the
    configuration; `NumericalError` when the filter cannot go on; `ModelError` for what `sensor` answers.
    """
    log = source if isinstance(source, Log) else load(source, format=format, robot=robot)
    log = detected(log, config)
    adapter = begun(sensor)
    configuration = configure(log, config or {}, own_layer(sensor))
    if map is not None:
        refuse_several(configuration, "a kept map")
    _check_classes(log, configuration)
    controls, (sightings, by) = log.controls, as_the_core_takes(log, configuration)
    given = Given.of(map, log)
    try:
        with stage("filter"):
            columns = _core.run(
                configuration.to_json(),
                controls.stamp_s,
                controls.values,
                sightings.stamp_s,
                (
                    sightings.range_m,
                    sightings.bearing_rad,
                    sightings.identity,
                    sightings.covariance,
                    sightings.class_index,
                    sightings.signature,
                ),
                progress=progress,
                control_covariance=controls.covariance,
                checkpoint=checkpoints.keep if checkpoints is not None else None,
                checkpoint_every_s=checkpoints.every_s if checkpoints is not None else 0.0,
                resume=checkpoints.begin() if checkpoints is not None else None,
                map=given.columns,
                start=core_start(start),
                watch=None if watch is None else _watched(watch, configuration, log, given),
                sensor=adapter,
                by=by,
            )
    except ValueError as error:
        raise DataError(str(error), log.source) from None
    except RuntimeError as error:
        raise NumericalError(str(error)) from None
    result = result_of(columns, log, configuration, given, adapter)
    missed = _names_missed(log, configuration, config or {})
    result = replace(result, warnings=(*result.warnings, *missed))
    if checkpoints is not None:
        result = replace(result, warnings=(*result.warnings, *checkpoints.warnings))
        if not result.interrupted:
            checkpoints.end()
    if progress is not None and not result.interrupted:
        # The core counts up to a bound, which gaps and empty scans keep it from reaching.
        try:
            progress(len(result.steps.stamp_s), len(result.steps.stamp_s))
        except KeyboardInterrupt:
            # As anywhere in the run: what was computed, here all of it, is not lost.
            result = replace(result, interrupted=True)
    return result


def run_many(
    log: Log,
    config: Layer | None = None,
    *,
    seeds: Iterable[int],
    progress: Progress | None = None,
    checkpoints: Checkpoints | None = None,
    watch: Watch | None = None,
    sensor: Sensor | None = None,
) -> Iterator[RunResult]:
    """Runs the filter with each seed in turn, one result at a time in memory.

    `progress` counts over all runs, `watch` sees the first one. After an interrupted run no further one is
    started. Errors: as `run`, and `ConfigError` for `checkpoints` with more than one seed.
    """
    seeds = tuple(seeds)
    if checkpoints is not None and len(seeds) > 1:
        raise ConfigError(f"checkpoints: they are of one run, not of {len(seeds)}")
    for number, seed in enumerate(seeds):

        def advance(done: int, total: int, number: int = number) -> None:
            if progress is not None:
                progress(number * total + done, len(seeds) * total)

        result = run(
            log,
            merge(config or {}, {"seed": seed}),
            progress=advance,
            checkpoints=checkpoints,
            watch=watch if number == 0 else None,
            sensor=sensor,
        )
        yield result
        if result.interrupted:
            return


@dataclass(frozen=True)
class Given:
    """The map that a run begins with, as the core takes it, and the names of landmarks of both."""

    chart: Map | None
    columns: _core._MapColumns | None
    names: tuple[str, ...]

    @classmethod
    def of(cls, map: Map | Path | str | None, log: Log) -> Given:
        chart = Map.load(map) if isinstance(map, Path | str) else map
        if chart is None:
            return cls(None, None, log.identity_names)
        identity, names = chart.identities(log.identity_names)
        return cls(chart, chart.core_columns(identity, log.class_names), names)


def _watched(watch: Watch, config: Config, log: Log, given: Given) -> Callable[..., tuple[float, float]]:
    """Shows `watch` the columns of the core as a view."""
    from .watching import view_of

    chart_ids = () if given.chart is None else given.chart.landmarks.ids
    names = (given.names, log.class_names, chart_ids)

    def show(
        columns: dict[str, Any], step: dict[str, Any], stamp_s: float, pose: list[float], covariance: Any
    ) -> tuple[float, float]:
        info = step_info({**step, "warnings": []}, config, Told())
        return watch(view_of(columns, names, (stamp_s, np.array(pose), np.array(covariance), info)))

    return show


def result_of(
    columns: dict[str, Any], log: Log, config: Config, given: Given, own: Adapter | None = None
) -> RunResult:
    """What the core's columns of a run, or of a stream, come to; `own` is a sensor of one's own."""
    chart_ids = () if given.chart is None else given.chart.landmarks.ids
    landmarks = landmark_map(columns["map"], given.names, log.class_names, chart_ids)
    result = RunResult(
        log_name=log.name,
        config=dict(config),
        version=built_version(),
        trajectory=Trajectory(
            columns["steps"]["stamp_s"], columns["T_world_robot"], symmetric(columns["covariance"])
        ),
        smoothed=Trajectory(columns["smoothed_stamp_s"], columns["smoothed_T_world_robot"]),
        landmarks=landmarks,
        chart=given.chart,
        changes=None if given.chart is None else changes(landmarks, given.chart, columns["map"], config),
        steps=Steps(**columns["steps"]),
        filter_seconds=columns["filter_seconds"],
        peak_memory_bytes=peak_memory_bytes(),
        interrupted=columns["interrupted"],
        map_rows=columns["store_rows"],
        map_bytes=columns["store_bytes"],
        counts=columns["skipped"]
        | {"landmark_covariances_repaired": columns["covariances_repaired"]}
        | {"sightings_named_twice_in_a_scan": named_twice(log.sightings)}
        | left_out(config, columns["steps"]["ignored"]),
        warnings=noise_sentences(
            columns["warnings"],
            config,
            log.sightings,
            detected=log.scans is not None,
            kept_map=given.chart is not None,
        ),
        noise=columns["noise"],
        calibration=columns["calibration"],
    )
    result, found = _with_residuals(result, compared(result, log, own))
    result = judged(result, log, columns["two_places"], doubts_of(result, found))
    return replace(result, warnings=after_verdict(result.warnings, result.verdict))


def _with_residuals(result: RunResult, groups: tuple[Group, ...]) -> tuple[RunResult, Misplaced]:
    """The result with residuals, and what these say of its landmarks.

    A sensor of one's own that cannot say what it should measure along the whole path costs them, not the run.
    """
    try:
        residuals = residuals_of(groups, result.landmarks.mean_m)
        found = misplaced(result, groups)
    except ModelError as error:
        unknown = f"how far sightings lie off the map is not known: {error}"
        return replace(result, warnings=(*result.warnings, unknown)), Misplaced()
    result = replace(result, landmarks=replace(result.landmarks, residuals=residuals))
    return without_misplaced(result, found), found


def peak_memory_bytes() -> int:
    """Largest resident memory of this process so far, the Python interpreter included; 0 where unknown."""
    if sys.platform == "win32":
        return 0
    import resource

    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak if sys.platform == "darwin" else 1024 * peak

"""Several runs over one log: a second one beside, whether both make the same map, and the likeliest.

Without identities a run may take a wrong turn that it does not come back from, and chance decides which. One
run cannot tell: all that it sees fits the map that it made. Two runs can.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import replace
from functools import partial
from itertools import combinations
from typing import Any

import numpy as np

from .config import merge
from .errors import ConfigError, FastSlamError
from .evaluation.align import RigidTransform
from .evaluation.constellation import find_transform, refine_transform
from .log import Floats, Log
from .result import LandmarkMap, RunResult, Trajectory, Try
from .runner import Progress, configure, detected, run, run_many
from .sensors import Sensor, own_layer
from .settings import Layer
from .watching import Watch

AGREED = 0.9
"""Two runs that have a larger share of their landmarks in common made the same map."""
DIFFERENT = 0.8
"""Runs that have less in common do not confirm each other."""
GATE = 0.25
"""So much of the distance that is usual to the third neighbour may the same landmark or pose lie apart."""
NEIGHBOURS = 3
"""Landmarks may stand in pairs and threes."""
MOST_TRIES = 4
MOST_WORK = 1e7
"""Sightings times particles up to which a second run is made unasked: some ten seconds of computing."""


def is_second_run_due(log: Log, config: Mapping[str, Any]) -> bool:
    """Whether a run over the log may take a wrong turn, and a second one costs seconds and not minutes."""
    if config["algorithm"] == "ekf" or config["sensor"]["model"] not in ("range_bearing", "bearing"):
        return False
    work = len(log.sightings.stamp_s) * int(config["filter"]["particles"])
    return bool(config["association"]["mode"] == "unknown") and work <= MOST_WORK


def run_by_need(
    log: Log,
    config: Layer | None = None,
    *,
    progress: Progress | None = None,
    watch: Watch | None = None,
) -> RunResult:
    """What the command `fastslam run` does by itself: a second opinion where one is due, else one run."""
    log = detected(log, config)
    ask = second_opinion if is_second_run_due(log, configure(log, config or {})) else run
    return ask(log, config, progress=progress, watch=watch)


def second_opinion(
    log: Log,
    config: Layer | None = None,
    *,
    progress: Progress | None = None,
    watch: Watch | None = None,
    sensor: Sensor | None = None,
) -> RunResult:
    """Runs the filter with the configured seed and beside it, on another core, with the next one.

    Where both make the same map the first is the result. Where they do not, two more seeds are tried, and the
    result is the likeliest of those that another one confirms, or where none is, that with which the others
    agree most; where it is like none of the others, its verdict says so. `RunResult.tries` has all.

    >>> from fastslam.simulation import simulate
    >>> log = simulate({"seed": 1, "world": {"count": 20}})
    >>> result = second_opinion(log, {"filter": {"particles": 10}, "association": {"mode": "unknown"}})
    >>> [one.seed for one in result.tries]
    [0, 1]

    `progress` counts over the runs that take turns, `watch` sees the first. `sensor` is one of your own, as
    for `run`, which two threads ask then. An interrupted run is returned as
    it is. Errors: as `run`, for the first seed; another one that fails is none of the tries.
    """
    log = detected(log, config)
    seed = configure(log, config or {}, own_layer(sensor))["seed"]
    ask = partial(run, log, sensor=sensor)

    def advance(done: int, total: int, *, turn: int, turns: int) -> None:
        if progress is not None:
            progress(turn * total + done, turns * total)

    results = _beside(ask, config, seed, partial(advance, turn=0, turns=1), watch)
    shares = _shares(results)
    if len(results) == 2 and shares[0][1] < AGREED:
        # What fails now has no say; what there is stays.
        with suppress(FastSlamError):
            results += _beside(ask, config, seed + MOST_TRIES // 2, partial(advance, turn=1, turns=2), None)
    complete = [result for result in results if not result.interrupted]
    if len(complete) < 2 or len(complete) < len(results):
        # Stopped: what there is, without an opinion on it.
        return replace(results[0], interrupted=len(complete) < len(results))
    shares = shares if len(results) == 2 else _shares(results)
    chosen = 0 if len(results) == 2 else _chosen(results, shares)
    best = results[chosen]
    tries = tuple(map(_try, results, shares[chosen]))
    kept = replace(best, tries=tries)
    share = agreement_with_next(kept)
    if share is None or share >= DIFFERENT:
        return kept
    return replace(kept, verdict=(*best.verdict, _alone(tries, share)))


def _shares(results: Sequence[RunResult]) -> list[list[float]]:
    """How far each run agrees with each other."""
    shares = np.eye(len(results))
    for i, j in combinations(range(len(results)), 2):
        shares[i, j] = shares[j, i] = agreement(results[i], results[j])
    return [[float(share) for share in row] for row in shares]


def _chosen(results: Sequence[RunResult], shares: Sequence[Sequence[float]]) -> int:
    """The likeliest run that another one confirms; where none is, that with which the others agree most."""
    confirmed = [i for i, row in enumerate(shares) if sum(share >= DIFFERENT for share in row) > 1]
    if confirmed:
        return max(confirmed, key=lambda i: results[i].log_evidence)
    return max(range(len(results)), key=lambda i: sum(shares[i]))


def agreement_with_next(result: RunResult) -> float | None:
    """How far the run that was kept agrees with the likest of the others; None where none was asked."""
    shares = (one.agreement for one in result.tries if one.seed != result.config["seed"])
    return max((share for share in shares if share is not None), default=None)


def best_of(
    log: Log,
    config: Layer | None = None,
    *,
    seeds: Iterable[int],
    progress: Progress | None = None,
    watch: Watch | None = None,
    sensor: Sensor | None = None,
) -> RunResult:
    """Runs the filter with each seed; the run that makes the sightings most probable, with its `tries`.

    >>> from fastslam.simulation import simulate
    >>> log = simulate({"seed": 1, "world": {"count": 20}})
    >>> result = best_of(log, {"filter": {"particles": 10}}, seeds=range(3))
    >>> result.log_evidence == max(one.log_evidence for one in result.tries)
    True

    An interrupted run is kept where it is the only one. Errors: as `run_many`, and
    `ConfigError` without seeds.
    """
    best: RunResult | None = None
    tries: list[Try] = []
    for result in run_many(log, config, seeds=seeds, progress=progress, watch=watch, sensor=sensor):
        if result.interrupted and best is not None:
            break
        tries.append(_try(result))
        if best is None or result.log_evidence > best.log_evidence:
            best = result
    if best is None:
        raise ConfigError("seeds: got none, expected one at least")
    return replace(best, tries=tuple(tries))


def agreement(first: RunResult, second: RunResult) -> float:
    """How far two runs over one log came to the same, from 0 to 1: the smaller one of two shares.

    That of the landmarks which both have, 2 C / (K + L), provisional ones left out; and that of the stamps at
    which both paths have the robot at one place. The maps are laid on each other first. At one place is what
    lies within a quarter of the distance that is usual to the third neighbour, so that neither drift nor the
    place within a group of landmarks counts, and a field that is there twice does.
    """
    first_m, second_m = _believed(first.landmarks), _believed(second.landmarks)
    total = len(first_m) + len(second_m)
    if min(len(first_m), len(second_m)) == 0:
        return float(total == 0)
    gate_m = GATE * float(np.median(np.concatenate([_to_neighbours(first_m), _to_neighbours(second_m)])))
    # Of one log, they begin in one frame; a start that was hardly known turns them.
    lie, pairs, _ = refine_transform(RigidTransform.identity(), first_m, second_m, gate_m=gate_m)
    if 2.0 * len(pairs) < AGREED * total:
        found = find_transform(first_m, second_m, gate_m=gate_m) or lie
        turned, more, _ = refine_transform(found, first_m, second_m, gate_m=gate_m)
        lie, pairs = (turned, more) if len(more) > len(pairs) else (lie, pairs)
    return min(2.0 * len(pairs) / total, _share_of_path(first.path, second.path, lie, gate_m))


def _share_of_path(first: Trajectory, second: Trajectory, lie: RigidTransform, gate_m: float) -> float:
    """Share of the common stamps at which the paths are within the gate, once the first is moved."""
    _, ours, theirs = np.intersect1d(first.stamp_s, second.stamp_s, return_indices=True)
    if len(ours) == 0:
        return 0.0
    moved_m = lie.apply_points(first.T_world_robot[ours, :2])
    return float(np.mean(np.linalg.norm(moved_m - second.T_world_robot[theirs, :2], axis=1) <= gate_m))


def _beside(
    ask: Callable[..., RunResult], config: Layer | None, seed: int, progress: Progress, watch: Watch | None
) -> list[RunResult]:
    """Runs with this seed and, at the same time, with the next one, the result of which may be missing."""
    stop = threading.Event()

    def unless_stopped(_done: int, _total: int) -> None:
        if stop.is_set():
            raise KeyboardInterrupt

    def beside() -> list[RunResult]:
        try:
            return [ask(merge(config or {}, {"seed": seed + 1}), progress=unless_stopped)]
        except FastSlamError:
            return []

    with ThreadPoolExecutor(1) as pool:
        second = pool.submit(beside)
        try:
            first = ask(merge(config or {}, {"seed": seed}), progress=progress, watch=watch)
            return [first] if first.interrupted else [first, *second.result()]
        except KeyboardInterrupt:
            # The first has ended, or it would have returned; the second ends where it is.
            stop.set()
            return [first, *second.result()]
        finally:
            stop.set()


def _try(result: RunResult, agreement: float | None = None) -> Try:
    return Try(int(result.config["seed"]), result.log_evidence, len(result.landmarks.ids), agreement)


def _alone(tries: Sequence[Try], share: float) -> str:
    return (
        f"{len(tries)} runs that differ in their seeds came to different maps or paths: the one kept "
        f"has {share:.0%} in common with the next at most"
    )


def _believed(landmarks: LandmarkMap) -> Floats:
    mean_m = landmarks.mean_m if landmarks.confirmed is None else landmarks.mean_m[landmarks.confirmed]
    return np.asarray(mean_m[np.isfinite(mean_m).all(axis=1)])


def _to_neighbours(points_m: Floats) -> Floats:
    """How far the third nearest other point is from each, or the farthest where there are fewer."""
    from scipy.spatial import cKDTree

    if len(points_m) < 2:
        return np.ones(len(points_m))
    order = min(NEIGHBOURS, len(points_m) - 1)
    return np.asarray(cKDTree(points_m).query(points_m, k=order + 1)[0][:, order])

"""What a run as a whole comes to, in sentences: nothing mapped or seen again, mapped twice, much lost."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from typing import Any, Protocol

import numpy as np

from .contradictions import TwoPlaces, share_misnamed, that_contradict_themselves
from .health import health_summary, health_warning
from .log import Floats, Log, Sightings
from .result import RunResult
from .several import as_of_one
from .trust import NOT_FOUND, WAS_LOST, Doubt, against, doubts

MANY_DROPPED = 0.01
"""From this fraction on, sightings that were not used are worth a line."""
MOSTLY = 0.5
"""A run that used a smaller part of the sightings is judged by why it left out the others."""
MANY_LEFT_OUT = 0.005
"""The same for those whose name cannot be right, most of which are noticed and left out."""
NOT_FOUND_AGAIN = 0.05
"""From this fraction on of the landmarks that were visited again, those not found there are a verdict."""
FEW = 3
"""Fewer than this many landmarks that were not found again say nothing."""
UNITS = {"feet": 0.3048, "centimetres": 1e-2, "millimetres": 1e-3}
"""What ranges may be in by mistake, in metres; the largest that fits is asked about."""


class Outcome(Protocol):
    """What of a run says how it ended, in any number of dimensions."""

    @property
    def interrupted(self) -> bool:
        """Whether it was stopped before its log ended."""

    @property
    def warnings(self) -> tuple[str, ...]:
        """What else there is to look at."""


def warnings_of(result: RunResult) -> tuple[str, ...]:
    """Everything that speaks against a run, a sentence each: verdict, noise, health."""
    return (*result.verdict, *result.warnings)


def is_believable(result: RunResult) -> bool | None:
    """Whether map and path are to be believed: not where there is a verdict; None where nobody can tell."""
    if result.verdict:
        return False
    return None if result.interrupted or health_summary(result.steps).ok is None else True


def in_one_line(result: RunResult) -> str:
    """Whether the run is to be believed, in a few words that are never missing."""
    count = len(result.verdict)
    checks = "1 check speaks" if count == 1 else f"{count:,} checks speak"
    return said_of(is_believable(result), f"{checks} against map or path", result)


def said_of(believable: bool | None, against: str, run: Outcome) -> str:
    """The line for a run that is believable, is not (`against` says why), or that nobody can tell of."""
    if believable is False:
        return f"not believable: {against}"
    if run.interrupted:
        return "undecided: the run was stopped early"
    if believable is None:
        return "undecided: too little was seen again to judge the run"
    warnings = len(run.warnings)
    if warnings:
        return f"believable, with {warnings:,} warning{'s' * (warnings > 1)}"
    return "believable: no check speaks against the run"


def judged(
    result: RunResult, log: Log, two_places: Iterable[TwoPlaces] = (), more: Iterable[Doubt] = ()
) -> RunResult:
    """The result with its verdict, and with what its health says where the verdict does not say it.

    `two_places` is the core's list of names that were seen at two places, as the poses were believed then;
    `more` is held against the map too.
    """
    (found, held), unhealthy = _held_against(result, log, two_places, more), health_warning(result.steps)
    told = unhealthy is None or any(sentence.startswith(WAS_LOST) for sentence in found)
    warnings = (*result.warnings, *(() if told else (unhealthy,)))
    return replace(result, verdict=found, doubts=held, warnings=warnings)


def is_empty(result: RunResult) -> bool:
    """Whether the run made no map at all though it came to the end of its log."""
    return len(result.landmarks.ids) == 0 and not result.interrupted


def named_twice(sightings: Sightings) -> int:
    """How many sightings name a landmark that an earlier one of the same stamp and sensor names too."""
    named = sightings.identity >= 0
    parts = [sightings.stamp_s, sightings.identity]
    if sightings.sensor_index is not None:
        parts.append(sightings.sensor_index)
    pairs = np.column_stack([part[named] for part in parts])
    return len(pairs) - len(np.unique(pairs, axis=0)) if len(pairs) else 0


def verdict(result: RunResult, log: Log, two_places: Iterable[TwoPlaces] = ()) -> tuple[str, ...]:
    """What the run comes to where that is less than a map and a path, and what the names contradict."""
    return _held_against(result, log, two_places)[0]


def _held_against(
    result: RunResult, log: Log, two_places: Iterable[TwoPlaces], more: Iterable[Doubt] = ()
) -> tuple[tuple[str, ...], tuple[Doubt, ...]]:
    """The verdict, and all that was held against the map for it."""
    if result.interrupted:
        return (), ()
    log, config = as_of_one(log, result.config)
    result = replace(result, config=config)
    total = len(log.sightings.stamp_s)
    if total == 0:
        return ("nothing was mapped: the log has no sightings; the path is that of the odometry alone",), ()
    unit = _unit(log.sightings.range_m, config["sensor"])
    dropped = tuple(dropped_sentences(result.counts, total, config["sensor"], unit))
    of_map = _map_verdict(result, total, explained=bool(dropped))
    missing = not_found_again(result)
    again = () if missing is None else (missing,)
    held = tuple(sorted((*doubts(result, log), *more), key=lambda doubt: -doubt.ratio))
    others = (doubt for doubt in held if doubt.rule != NOT_FOUND)
    # Where most sightings were left out the cause is told already, and all else follows from it.
    doubted = () if int(result.steps.sightings.sum()) < MOSTLY * total else against(others)
    return (*dropped, *of_map, *again, *doubted, *_names(result, log, two_places)), held


def not_found_again(result: RunResult) -> str | None:
    """A sentence where landmarks were not there when the robot came back to them; None where they were."""
    return not_found_sentence(result.counts, result.config)


def not_found_sentence(counts: Mapping[str, int], config: Mapping[str, Any]) -> str | None:
    """The same from the counts of a run, or of a drive so far."""
    visited = counts.get("landmarks_visited_again", 0)
    missed = counts.get("landmarks_not_found_again", 0)
    if missed < max(FEW, NOT_FOUND_AGAIN * visited):
        return None
    plain = config["filter"]["rejuvenation"]["every_steps"] == 0
    return (
        f"{missed:,} of the {visited:,} landmarks to which the robot came back were in view and not sighted "
        "any more: part of the map is there twice, or the world has changed"
        + ("; without filter.rejuvenation.every_steps = 0 such loops are closed" if plain else "")
    )


def _map_verdict(result: RunResult, total: int, *, explained: bool) -> Iterator[str]:
    landmarks = result.landmarks
    nowhere = int(np.count_nonzero(~np.isfinite(landmarks.mean_m).all(axis=1))) if len(landmarks.ids) else 0
    if nowhere:
        yield (
            f"{nowhere:,} of {len(landmarks.ids):,} landmarks stand at no place that can be computed "
            "with: is a length in the settings far too large?"
        )
    if is_empty(result):
        if not explained:
            yield nothing_mapped(total)
    elif not result.steps.matched.any():
        used = int(result.steps.sightings.sum())
        yield nothing_matched(used, len(landmarks.ids), result.config["sensor"]["model"])


def nothing_mapped(total: int) -> str:
    """The sentence of a map without a landmark, after so many sightings."""
    return f"nothing was mapped: none of the {total:,} sightings founded a landmark"


def nothing_matched(used: int, landmarks: int, model: str) -> str:
    """The sentence of a map whose landmarks were never sighted a second time."""
    if model != "range_bearing":
        return (
            f"no landmark was placed: the {used:,} sightings do not say yet where any of the "
            f"{landmarks:,} stands, so nothing corrects the odometry"
        )
    return (
        f"no landmark was seen twice: each of the {used:,} sightings was taken for a new one, so nothing "
        "corrects the odometry"
    )


def _names(result: RunResult, log: Log, two_places: Iterable[TwoPlaces]) -> Iterator[str]:
    total = len(log.sightings.stamp_s)
    doubted = tuple(two_places)
    real = that_contradict_themselves(doubted, result, log)
    for identity, x_m, y_m, seen, other_x_m, other_y_m, seen_there in real:
        yield (
            f"landmark {log.identity_names[identity]} stands at two places: ({x_m:.1f}, {y_m:.1f}) m, seen "
            f"{seen:,} times, and ({other_x_m:.1f}, {other_y_m:.1f}) m, seen {seen_there:,} times; the "
            "second was left out: is the name on two landmarks?"
        )
    if result.config["association"]["mode"] != "known":
        return
    left_out = int(result.steps.ignored.sum()) if (log.sightings.identity >= 0).all() else 0
    pose_was_off = len(doubted) - len(real) >= FEW
    misnamed = left_out >= MANY_LEFT_OUT * total and not pose_was_off
    if misnamed and share_misnamed(result, log) * left_out >= MANY_LEFT_OUT * total:
        yield (
            f"{left_out:,} of {total:,} sightings name a landmark that cannot be seen there and were left "
            "out: misread names? With association.mode = unknown none is needed"
        )
    twice = result.counts.get("sightings_named_twice_in_a_scan", 0)
    if twice > MANY_DROPPED * total:
        yield f"{twice:,} of {total:,} sightings name a landmark that another one of their scan names too"


def dropped_sentences(
    counts: Mapping[str, int], total: int, sensor: Mapping[str, Any], unit: str = ""
) -> Iterator[str]:
    """A sentence for each reason for which many sightings were left out; `unit` asks for another one."""
    reasons = {
        "sightings_too_far": f"lie beyond sensor.max_range_m = {sensor['max_range_m']:g}{unit}",
        "sightings_too_near": f"lie nearer than sensor.min_range_m = {sensor['min_range_m']:g}",
        "sightings_not_finite": "are not finite or have a bearing that is no angle",
        "sightings_without_identity": "name no landmark, and with association.mode = known none is guessed",
        "sightings_bad_covariance": "have a covariance that is not positive definite",
    }
    for name, reason in reasons.items():
        count = counts.get(name, 0)
        if count > MANY_DROPPED * total:
            subject = f"all {total:,} sightings" if count >= total else f"{count:,} of {total:,} sightings"
            end = ": nothing was mapped" if count >= total else " and were left out"
            yield f"{subject} {reason}{end}"


def _unit(range_m: Floats, sensor: Mapping[str, Any]) -> str:
    """Asks for another unit where nearly all ranges are in reach in it, and half of them not in metres."""
    nearest_m, farthest_m = sensor["min_range_m"], sensor["max_range_m"]
    if np.mean(range_m > farthest_m) < 0.5:
        return ""
    for unit, metres in UNITS.items():
        if np.mean((range_m * metres >= nearest_m) & (range_m * metres <= farthest_m)) > 0.99:
            return f" ({unit}?)"
    return ""

"""Whether a run is to be believed: what speaks against its map, each by how far it goes beyond its limit."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from .crowded import crowded
from .health import HealthStatus, health_summary
from .laid import Laid, believed, laid_on_map, laid_on_provisional
from .log import Bools, Log
from .placement import common_variance_m2
from .result import LandmarkMap, RunResult
from .standing import Standing, standing
from .twofold import twofold

if TYPE_CHECKING:
    from .maps import Changes, Map

MOST_WRONG = 0.1
"""A map of which more of the landmarks are wrong is not to be believed."""
FEW = 3
"""Fewer than this many landmarks that were not found again say nothing."""
FEW_ODD = 4
"""Fewer than this many that are odd say nothing: what stands in front of a landmark for long makes it so."""
FEW_CROWDED = 2
"""Fewer than this many that stand for two things say nothing: one trunk may fork."""
FOUND_TWICE = 0.8
"""So many of the landmarks that are there twice are found to be so."""
MOST_NEW = 1 / 3
"""Where so many of the landmarks seen in a kept map are none of it, the robot is elsewhere."""
NEIGHBOURS = 6
"""What is as near to a kept landmark as the sixth neighbour of one mostly is stands among them."""
MOST_LOST = 0.02
"""A filter that is lost now and then comes back at times, and mostly to another map."""
PUT_RIGHT = 0.9
"""A time in which the filter was lost does not count where so many sightings show what other times do."""
LARGEST_INNOVATION_STD = 1.25
"""Innovations this many times as large as the noise explains are told (as in `noise`); it is squared here."""
LARGEST_PARTIAL_STD = 1.5
"""The same of ranges or bearings alone: what a landmark may be is not Gaussian until its place is sure."""
MOST_UNEXPLAINED = 0.1
"""Share of the sightings that were used in the run and are far from every landmark of the map."""


# Names of the rules.
LOST = "lost"
NOT_FOUND = "not found again"
LANDMARKS = "landmarks"
TWICE = "twice"
CROWDED = "crowded"
UNEXPLAINED = "unexplained"
WAS_LOST = "the filter was lost"


@dataclass(frozen=True)
class Doubt:
    """One thing that speaks against a run: which rule, how many times its limit, and a sentence."""

    rule: str
    ratio: float
    """From 1 on the run is not to be believed."""
    sentence: str


def doubts(result: RunResult, log: Log) -> tuple[Doubt, ...]:
    """What speaks against the map of a run over a log, strongest first, all of it whatever the limit.

    What sees ranges or bearings alone cannot be laid on the map sighting by sighting: its steps are judged.
    A live path, all that EKF-SLAM has, lies off the map wherever the robot had drifted: what does not lie on
    the map along it says nothing of the map.
    """
    if result.interrupted:
        return ()
    whole = result.config["sensor"]["model"] == "range_bearing" and result.chart is None
    laid = laid_on_map(result, log) if whole else None
    found = [*_of_steps(result, laid), *_of_kept_map(result)]
    is_live = result.config["algorithm"] == "ekf"
    found.extend(() if laid is None or is_live else _of_map(result, laid, log))
    found.extend(() if laid is None else _of_stretches(result, laid, log))
    return tuple(sorted(found, key=lambda doubt: -doubt.ratio))


def against(found: Iterable[Doubt]) -> tuple[str, ...]:
    """The sentences of what goes beyond its limit."""
    return tuple(doubt.sentence for doubt in found if doubt.ratio >= 1.0)


def _of_steps(result: RunResult, laid: Laid | None) -> Iterator[Doubt]:
    if health_summary(result.steps).lost is not None:
        judged = result.steps.health != HealthStatus.INITIALIZING
        lost = float(lost_for_good(result, laid)[judged].mean())
        yield of_lost_steps(lost, in_kept_map=result.chart is not None)
    yield from of_innovations(result.noise, result.config)
    visited = result.counts.get("landmarks_visited_again", 0)
    missed = result.counts.get("landmarks_not_found_again", 0)
    sentence = f"{missed:,} of {visited:,} landmarks were not found when the robot came back to them"
    yield Doubt(NOT_FOUND, missed / max(FEW, MOST_WRONG * visited), sentence)


def of_lost_steps(share: float, *, in_kept_map: bool) -> Doubt:
    """What it says that the filter was lost in this share of the steps that were judged."""
    hint = "; where its start is not sure, a search in the map may find it" if in_kept_map else ""
    return Doubt(LOST, share / MOST_LOST, f"{WAS_LOST} in {share:.0%} of its steps{hint}")


def of_innovations(noise: Mapping[str, Any], config: Mapping[str, Any]) -> Iterator[Doubt]:
    """What the innovations of all that was driven say; `noise` as in `RunResult.noise`."""
    nis, band = noise.get("nis"), noise.get("nis_band")
    if nis is None or band is None or not band[1] > 0:
        return
    whole = config["sensor"]["model"] == "range_bearing"
    most = band[1] * (LARGEST_INNOVATION_STD if whole else LARGEST_PARTIAL_STD) ** 2
    sentence = (
        f"innovations are larger than the noise explains (NIS {nis:.1f}, at most {band[1]:.1f}): "
        "the noise is told too small, or map and path are wrong"
    )
    yield Doubt("innovations", nis / most, sentence)


def lost_for_good(result: RunResult, laid: Laid | None) -> Bools:
    """At which steps (T,) the filter was lost, but for times that the path drawn at the end has put right.

    **Why:** a robot that is lost maps things anew. Where paths drawn later joined both maps, what it saw
    meanwhile shows landmarks that were seen at other times too; in a second map each shows its own.
    """
    steps = result.steps
    lost = steps.health == HealthStatus.LOST
    if laid is None or not lost.any():
        return np.asarray(lost)
    # Times of one status, from 1 on; no sighting lies before the first step.
    begins = np.flatnonzero(np.diff(lost, prepend=~lost[:1]))
    time_of_sighting = np.searchsorted(steps.stamp_s[begins], laid.stamp_s, "right")
    of_lost = np.concatenate([[False], lost[begins]])
    shown = laid.explained
    elsewhere = np.zeros(len(laid.mean_m), dtype=np.bool_)
    elsewhere[laid.landmark[shown & ~of_lost[time_of_sighting]]] = True
    right = shown & elsewhere[laid.landmark]
    count, good = (np.bincount(time_of_sighting, some, len(of_lost)) for some in (np.ones(len(right)), right))
    put_right = good >= PUT_RIGHT * np.maximum(count, 1.0)
    return np.asarray(lost & ~put_right[np.cumsum(np.isin(np.arange(len(lost)), begins))])


def _of_kept_map(result: RunResult) -> Iterator[Doubt]:
    if result.chart is not None and result.changes is not None:
        places = KeptPlaces.of(result.chart, result.config)
        yield from of_kept_map(result.landmarks, places, result.changes)


@dataclass(frozen=True)
class KeptPlaces:
    """Where the landmarks of a kept map stand: what is nearer to one than `near_m` stands among them."""

    tree: Any
    near_m: float

    @classmethod
    def of(cls, chart: Map, config: Mapping[str, Any]) -> KeptPlaces | None:
        """None for a map of few landmarks, and with names, which say themselves what is in the map."""
        kept_m = chart.landmarks.mean_m
        if config["association"]["mode"] == "known" or len(kept_m) <= NEIGHBOURS:
            return None
        from scipy.spatial import cKDTree

        tree = cKDTree(kept_m)
        return cls(tree, float(np.median(tree.query(kept_m, k=NEIGHBOURS + 1)[0][:, -1])))


def of_kept_map(landmarks: LandmarkMap, places: KeptPlaces | None, changes: Changes) -> Iterator[Doubt]:
    """What it says of a robot in a kept map that landmarks among those of the map are none of it."""
    if places is None:
        return
    names = set(changes.new)
    new = [row for row, name in enumerate(landmarks.ids) if name in names]
    among = int((places.tree.query(landmarks.mean_m[new])[0] < places.near_m).sum())
    seen = among + changes.sighted
    sentence = (
        f"{among:,} landmarks that stand among those of the kept map are none of it, and "
        f"{changes.sighted:,} of it were sighted: the robot is not where it thinks, or the world has "
        "changed"
    )
    yield Doubt("kept map", among / max(FEW_ODD, MOST_NEW * seen), sentence)


def _of_map(result: RunResult, laid: Laid, log: Log) -> Iterator[Doubt]:
    stand = standing(laid, named=_is_named(result, log))
    yield Doubt(LANDMARKS, stand.odd / max(FEW_ODD, MOST_WRONG * stand.landmarks), _landmarks(stand))
    steps = result.steps
    unused = int((steps.ignored + steps.new_landmarks).sum()) + _of_provisional(result, laid)
    used = 1.0 - unused / max(int(steps.sightings.sum()), 1)
    lacking = used - float(laid.explained.mean())
    sentence = (
        f"{lacking:.0%} of the sightings were taken for landmarks of the map and, along the path that came "
        "out, are far from all of them"
    )
    yield Doubt(UNEXPLAINED, lacking / MOST_UNEXPLAINED, sentence)


def _of_provisional(result: RunResult, laid: Laid) -> int:
    """So many sightings were taken for landmarks that are still provisional, and lie on them and no other."""
    taken = int((result.landmarks.sightings[~believed(result)] - 1).sum())
    return min(taken, laid_on_provisional(result, laid)) if taken else 0


def _of_stretches(result: RunResult, laid: Laid, log: Log) -> Iterator[Doubt]:
    if _is_named(result, log):
        return
    total = len(laid.mean_m)
    both = len(crowded(result, log, laid))
    sentence = (
        f"scans show two things each where {both:,} of {total:,} landmarks stand: part of the map is "
        "missing, or some things are seen double"
    )
    yield Doubt(CROWDED, both / max(FEW_CROWDED, MOST_WRONG * total), sentence)
    variance_m2 = 0.5 * np.trace(result.landmarks.covariance_m2[believed(result)], axis1=1, axis2=2)
    twice = len(twofold(laid, variance_m2, common_variance_m2(result.config["sensor"])))
    sentence = (
        f"{twice:,} of {total:,} landmarks stand among others as earlier ones do a little further on: part "
        "of the map is there twice"
    )
    yield Doubt(TWICE, twice / max(FEW_ODD, FOUND_TWICE * MOST_WRONG * total), sentence)


def _is_named(result: RunResult, log: Log) -> bool:
    return result.config["association"]["mode"] == "known" and bool((log.sightings.identity >= 0).any())


def _landmarks(stand: Standing) -> str:
    parts = {
        "were in view and not sighted before some time, or from then on": stand.gone,
        "are elsewhere by their later sightings than by the earlier ones": stand.moved,
        "stand beside another and are never sighted together with it": stand.twins,
    }
    said = ", ".join(f"{number:,} {what}" for what, number in parts.items() if number)
    return (
        f"{stand.odd:,} of {stand.landmarks:,} landmarks do not stand as in a right map ({said}): part of it "
        "is there twice, the path is bent, or the world has changed"
    )

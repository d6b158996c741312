"""Maps of several robots or days as one, and a map brought into the frame of another."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any, NamedTuple

import numpy as np

from .errors import DataError
from .log import Floats, Ints
from .maps import Map, Role, first_free_number
from .overlays import IN_OTHER, Overlap, Overlay, levers, overlap
from .placement import apply, composed
from .result import LandmarkMap

BELIEVED = 0.9
"""How likely a landmark is where its map does not say."""


@dataclass(frozen=True)
class Part:
    """Where one of the merged maps lies: `T_map_part` as x, y, heading, with its covariance (3, 3).

    `pairs` is how many of its landmarks were in the map that it joined, `rms_m` how far they were apart.
    """

    name: str
    T_map_part: Floats
    covariance: Floats
    pairs: int
    rms_m: float


@dataclass(frozen=True)
class Merged:
    """One map of several, in the frame of the first, and where each of them lies in it."""

    map: Map
    parts: tuple[Part, ...]


def merge(maps: Sequence[Map]) -> Merged:
    """See `fastslam.maps.merge`."""
    if len(maps) < 2:
        raise DataError(f"merging takes two maps or more, got {len(maps)}")
    own = {
        (index, index): _Lie(np.zeros(3), np.zeros((3, 3)), len(maps[index].role), 0.0)
        for index in range(len(maps))
    }
    groups = {index: _Group(maps[index], {index: own[index, index]}) for index in range(len(maps))}
    tried: dict[tuple[int, int], Overlap] = {}
    while len(groups) > 1:
        for one, other in combinations(groups, 2):
            if (one, other) not in tried:
                tried[one, other] = overlap(groups[one].map, groups[other].map)
        sure = [key for key, found in tried.items() if found.status == "found"]
        if not sure:
            first = min(groups)
            raise DataError(
                "; ".join(_refusal(maps[other], tried[first, other]) for other in groups if other != first)
            )
        one, other = max(sure, key=lambda key: tried[key].overlays[0].log_odds)
        groups[one] = groups[one].with_other(groups.pop(other), tried[one, other].overlays[0])
        tried = {key: found for key, found in tried.items() if not {one, other} & set(key)}
    whole = groups[0]
    parts = (Part(chart.name, *whole.lies[index]) for index, chart in enumerate(maps))
    made_from = {"merged": [{"name": chart.name, **chart.made_from} for chart in maps]}
    return Merged(replace(whole.map, made_from=made_from), tuple(parts))


class _Lie(NamedTuple):
    """Where a map lies in a group, and how well it fits there."""

    T_map_part: Floats
    covariance: Floats
    pairs: int
    rms_m: float


@dataclass(frozen=True)
class _Group:
    """Maps that are one by now, in the frame of the first of them."""

    map: Map
    lies: dict[int, _Lie]

    def with_other(self, other: _Group, found: Overlay) -> _Group:
        """Both groups as one; how well a map fits is said of when it was joined."""
        joined_by, rms_m = len(found.pairs), math.sqrt(2.0) * found.apart_m
        lies = dict(self.lies)
        for index, lie in other.lies.items():
            pose, covariance = _chained(found, lie)
            alone = len(other.lies) == 1
            lies[index] = _Lie(pose, covariance, *((joined_by, rms_m) if alone else lie[2:]))
        return _Group(joined(self.map, other.map, found), lies)


def _chained(found: Overlay, lie: _Lie) -> tuple[Floats, Floats]:
    """The pose of a part of the other map in ours: mean and covariance to first order."""
    outer, inner = found.T_map_other, lie.T_map_part
    cosine, sine = math.cos(outer[2]), math.sin(outer[2])
    pose = composed(outer, inner)
    by_outer, by_inner = np.eye(3), np.eye(3)
    by_outer[0, 2], by_outer[1, 2] = outer[1] - pose[1], pose[0] - outer[0]
    by_inner[:2, :2] = [[cosine, -sine], [sine, cosine]]
    covariance = by_outer @ found.covariance @ by_outer.T + by_inner @ lie.covariance @ by_inner.T
    return pose, covariance


def align(chart: Map, onto: Map) -> tuple[Map, Part]:
    """See `fastslam.maps.align`."""
    found = overlap(onto, chart)
    if found.status != "found":
        raise DataError(_refusal(chart, found))
    best = found.overlays[0]
    aligned = replace(chart, landmarks=_moved(onto, chart, best), frame=onto.frame)
    lie = _Lie(best.T_map_other, best.covariance, len(best.pairs), math.sqrt(2.0) * best.apart_m)
    return aligned, Part(chart.name, *lie)


def _refusal(chart: Map, found: Overlap) -> str:
    if found.status == "none":
        return f"no overlap found: {chart.name}"
    places = len(found.overlays)
    return f"no overlap found for sure: {chart.name} fits at {places} places that are as likely"


def joined(ours: Map, theirs: Map, found: Overlay) -> Map:
    """Two maps as one in the frame of the first; pairs become one landmark, which keeps its id there."""
    moved = _moved(ours, theirs, found)
    kept = _paired(ours, theirs, moved, found)
    rest = np.setdiff1d(np.arange(len(theirs.role)), found.pairs[:, 1])
    # What was surveyed in another frame is known only as well as that frame.
    free: list[Role] = ["prior"] * len(rest)
    names = tuple(dict.fromkeys((*ours.landmarks.class_names, *theirs.landmarks.class_names)))
    landmarks = LandmarkMap(
        ids=(*ours.landmarks.ids, *_fresh_ids(ours, theirs, rest)),
        mean_m=np.concatenate([kept.landmarks.mean_m, moved.mean_m[rest]]),
        covariance_m2=np.concatenate([kept.landmarks.covariance_m2, moved.covariance_m2[rest]]),
        sightings=np.concatenate([kept.landmarks.sightings, moved.sightings[rest]]),
        class_index=_classes(ours, theirs, found.pairs, rest, names) if names else None,
        signature=_signatures(ours, theirs, found.pairs, rest),
        class_names=names,
    )
    return replace(
        kept,
        landmarks=landmarks,
        role=(*kept.role, *free),
        existence=np.concatenate([kept.existence, _doubted(theirs.existence, found.lacking[1])[rest]]),
        note=(*kept.note, *(theirs.note[row] for row in rest)),
    )


def _doubted(existence: Floats, lacking: Ints) -> Floats:
    """Probabilities after another map that knows the place lacks some landmarks."""
    known = np.where(np.isnan(existence), BELIEVED, existence)
    missed = known * (1.0 - IN_OTHER) / (known * (1.0 - IN_OTHER) + 1.0 - known)
    doubted: Floats = existence.copy()
    doubted[lacking] = missed[lacking]
    return doubted


def _moved(ours: Map, theirs: Map, found: Overlay) -> LandmarkMap:
    """The landmarks of the other map in our frame.

    Their covariances count what is not known of the pose, and what our map does not know of where the pairs
    are, which no pair tells. Pairs further apart than both maps say make both less sure.
    """
    landmarks, pose = theirs.landmarks, found.T_map_other
    mean_m = apply(pose, landmarks.mean_m)
    cosine, sine = math.cos(pose[2]), math.sin(pose[2])
    turned = np.array([[cosine, -sine], [sine, cosine]])
    lever = levers(pose, mean_m)
    common = ours.landmarks.covariance_m2[found.pairs[:, 0]].mean(axis=0)
    covariance = turned @ landmarks.covariance_m2 @ turned.T
    covariance = covariance + lever @ found.covariance @ np.swapaxes(lever, 1, 2)
    return replace(landmarks, mean_m=mean_m, covariance_m2=covariance + common)


def _paired(ours: Map, theirs: Map, moved: LandmarkMap, found: Overlay) -> Map:
    """Our map with what the other one says of its landmarks."""
    mine, other = found.pairs.T
    landmarks = ours.landmarks
    mean_m, covariance_m2 = landmarks.mean_m.copy(), landmarks.covariance_m2.copy()
    sightings, note = landmarks.sightings.copy(), list(ours.note)
    existence = _doubted(ours.existence, found.lacking[0])
    for row, column in zip(mine.tolist(), other.tolist(), strict=True):
        sightings[row] += theirs.landmarks.sightings[column]
        note[row] = "; ".join(dict.fromkeys(filter(None, (note[row], theirs.note[column]))))
        existence[row] = np.fmax(ours.existence[row], theirs.existence[column])
        if ours.role[row] == "prior":
            mean_m[row], covariance_m2[row] = _mixed(
                (mean_m[row], covariance_m2[row]),
                (moved.mean_m[column], moved.covariance_m2[column]),
                found.apart_m,
            )
    improved = replace(landmarks, mean_m=mean_m, covariance_m2=covariance_m2, sightings=sightings)
    return replace(ours, landmarks=improved, existence=existence, note=tuple(note))


def _mixed(
    ours: tuple[Floats, Floats], theirs: tuple[Floats, Floats], apart_m: float
) -> tuple[Floats, Floats]:
    """Two places of one landmark as one.

    What both maps have wrong together (where their frames are) makes no distance between pairs, and is
    not averaged away: the variance sinks by as much as the distances of pairs tell, and no further.
    """
    both = ours[1] + theirs[1]
    gain = np.asarray(np.linalg.solve(both, ours[1]).T, dtype=np.float64)
    told = apart_m**2 / (0.5 * float(np.trace(both)))
    covariance = ours[1] - min(1.0, told) * gain @ ours[1]
    if told > 1.0:
        covariance = told * covariance
    mean = np.asarray(ours[0] + gain @ (theirs[0] - ours[0]))
    return mean, np.asarray(0.5 * (covariance + covariance.T))


def _fresh_ids(ours: Map, theirs: Map, rest: Ints) -> list[str]:
    """Ids of landmarks that our map lacks: their own where those are names that we do not have."""
    taken, free = set(ours.landmarks.ids), first_free_number((*ours.landmarks.ids, *theirs.landmarks.ids))
    named, _ = theirs.identities(())
    found = []
    for row in rest:
        name = theirs.landmarks.ids[row]
        if named[row] < 0 or name in taken:
            name, free = f"L{free}", free + 1
        found.append(name)
    return found


def _classes(ours: Map, theirs: Map, pairs: Ints, rest: Ints, names: Sequence[str]) -> Ints:
    index_of: dict[str, int] = {name: index for index, name in enumerate(names)}

    def of(chart: Map) -> Ints:
        rows = range(len(chart.role))
        return np.array([index_of.get(chart.landmarks.class_name(row), -1) for row in rows], dtype=np.int64)

    mine, other = of(ours), of(theirs)
    told = mine[pairs[:, 0]]
    mine[pairs[:, 0]] = np.where(told < 0, other[pairs[:, 1]], told)
    return np.concatenate([mine, other[rest]])


def _signatures(ours: Map, theirs: Map, pairs: Ints, rest: Ints) -> Floats | None:
    def of(chart: Map) -> Floats:
        unknown = np.full(len(chart.role), np.nan)
        return unknown if chart.landmarks.signature is None else chart.landmarks.signature.copy()

    if ours.landmarks.signature is None and theirs.landmarks.signature is None:
        return None
    mine, other = of(ours), of(theirs)
    told = mine[pairs[:, 0]]
    mine[pairs[:, 0]] = np.where(np.isnan(told), other[pairs[:, 1]], told)
    return np.concatenate([mine, other[rest]])


def facts(merged: Merged) -> dict[str, Any]:
    """What a merge found, for JSON."""
    return {
        "landmarks": len(merged.map.role),
        "parts": [part_facts(part) for part in merged.parts],
    }


def part_facts(part: Part) -> dict[str, Any]:
    """Where a map lies, for JSON."""
    return {
        "name": part.name,
        "T_map_part": part.T_map_part.tolist(),
        "covariance": part.covariance.tolist(),
        "pairs": part.pairs,
        "rms_m": part.rms_m,
    }

"""How one kept map lies on another when nobody knows: relative poses with their evidence.

Patches of the other map are laid on this one by constellations (`placement`); from each likely place the
landmarks that are one are gathered outwards, and the whole is judged: pairs against chance, landmarks that
one map has and the other lacks although it knows the place, and the room there is for other poses.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.spatial import cKDTree

from .log import Bools, Floats, Ints
from .maps import Map
from .placement import Constellation, View, apply, charted, inverse, placements

SURE = math.log(1000.0)
"""An overlay is taken that is so much likelier than none, and than any other."""
FEWEST_PAIRS = 5
IN_OTHER = 0.7
"""Probability that a landmark of one map is in the other, where that knows the place."""
_SAME_CLASS = 0.9
_GATE_SIGMAS = 3.0
_PATCHES, _PATCH_SIZE = 8, 14
_PER_PATCH, _REFINED = 10, 30
_LEAST_STD_M = 0.02
_NEIGHBOURS = 3
_MOST_JUDGED = 60
_STEPS, _NEARLY = 60, 0.6
_ROUNDS = 20
_LEAST_FITTED = 3
_FIRST_COVARIANCE = np.diag([0.1, 0.1, 0.02]) ** 2
_SPREAD_COST = 2.0
"""What is lost since the distances of pairs tell how far they should be apart."""


@dataclass(frozen=True)
class Overlay:
    """A pose at which another map may lie: `T_map_other` as x, y, heading, with its covariance (3, 3).

    `pairs` (P, 2) are the rows of landmarks that are one; `lacking` are the rows of this map, and of the
    other, that lie where the other one knows the place and yet has nothing. `log_odds` are those against maps
    that have nothing in common, `apart_m` how far pairs are apart in each direction (RMS).
    """

    T_map_other: Floats
    covariance: Floats
    pairs: Ints
    lacking: tuple[Ints, Ints]
    log_odds: float
    apart_m: float

    @property
    def common(self) -> int:
        """Landmarks of the other map that lie where this one knows the place."""
        return len(self.pairs) + len(self.lacking[1])


@dataclass(frozen=True)
class Overlap:
    """What is known of how two maps lie: `found`, several that are as likely, or `none`."""

    status: Literal["found", "ambiguous", "none"]
    overlays: tuple[Overlay, ...]


def overlap(ours: Map, theirs: Map) -> Overlap:
    """Where another map lies on this one, from the landmarks alone."""
    if min(len(ours.role), len(theirs.role)) < FEWEST_PAIRS:
        return Overlap("none", ())
    found = _Pair(_side(ours), _side(theirs), _looks(ours, theirs)).overlays()
    likely = [one for one in found if one.log_odds >= SURE and len(one.pairs) >= FEWEST_PAIRS]
    if not likely:
        return Overlap("none", ())
    best = likely[0]
    rivals = [one for one in likely[1:] if best.log_odds - _as_far(one, best) < SURE]
    return Overlap("ambiguous" if rivals else "found", (best, *rivals))


def _as_far(rival: Overlay, best: Overlay) -> float:
    """The odds of a rival if it fitted as it does over as much of the maps as the best one overlaps.

    What lies beyond the edge of a map speaks for nobody: rows of trees shifted by one fit but for the last.
    """
    return rival.log_odds * max(1.0, best.common / max(rival.common, 1))


@dataclass(frozen=True)
class _Side:
    """A map as one of a pair: places (K, 2), density around each, from how far it knows a place.

    `variance_m2` (K,) is what each has beyond the surest of its neighbours: what neighbours have in common
    moves them together. `surest_m2` is that of the landmark that is known best.
    """

    mean_m: Floats
    variance_m2: Floats
    surest_m2: float
    density: Floats
    reach_m: float
    tree: cKDTree

    def knows(self, points_m: Floats) -> Bools:
        """Whether the map knows the places."""
        count = min(_NEIGHBOURS, len(self.mean_m))
        distance = self.tree.query(points_m, k=count)[0].reshape(len(points_m), count)
        return np.asarray(distance[:, -1] <= self.reach_m)


def _side(chart: Map) -> _Side:
    mean_m = chart.landmarks.mean_m
    variance = 0.5 * np.trace(chart.landmarks.covariance_m2, axis1=1, axis2=2)
    tree = cKDTree(mean_m)
    count = min(_PATCH_SIZE, len(mean_m))
    distance, near = tree.query(mean_m, k=count)
    distance, near = distance.reshape(-1, count), near.reshape(-1, count)
    beside = variance - variance[near].min(axis=1)
    surest = max(float(variance.min(initial=math.inf)), _LEAST_STD_M**2)
    order = min(_NEIGHBOURS, count - 1)
    around = np.maximum(distance[:, order], 1e-3)
    reach_m = 1.5 * float(np.percentile(around, 90))
    return _Side(mean_m, beside, surest, order / (math.pi * around**2), reach_m, tree)


def _looks(ours: Map, theirs: Map) -> Floats:
    """(K, L): how much likelier names and classes are of one landmark than of two."""
    looks = np.ones((len(ours.role), len(theirs.role)))
    names = [_names(chart) for chart in (ours, theirs)]
    both = set(names[0].values()) & set(names[1].values())
    if both:
        for row, name in names[0].items():
            for column, other in names[1].items():
                looks[row, column] = float(len(ours.role)) if name == other else 0.0
    classes = [
        [chart.landmarks.class_name(row) for row in range(len(chart.role))] for chart in (ours, theirs)
    ]
    count = max(2, len(set(filter(None, classes[0] + classes[1]))))
    first, second = (np.array(column, dtype=object) for column in classes)
    known = (first != "")[:, None] & (second != "")[None]
    told = np.where(first[:, None] == second[None], _SAME_CLASS, (1.0 - _SAME_CLASS) / (count - 1)) * count
    return np.asarray(looks * np.where(known, told, 1.0))


def _names(chart: Map) -> dict[int, str]:
    """Rows that have a name, which is no running number."""
    identity, names = chart.identities(())
    return {row: names[index] for row, index in enumerate(identity.tolist()) if index >= 0}


class _Pair:
    """Two maps that may overlap."""

    def __init__(self, ours: _Side, theirs: _Side, looks: Floats) -> None:
        self.ours, self.theirs, self.looks = ours, theirs, looks
        radius = [np.linalg.norm(np.ptp(side.mean_m, axis=0)) / 2.0 + side.reach_m for side in (ours, theirs)]
        self.room = math.pi * float(sum(radius)) ** 2 * 2.0 * math.pi
        self.farthest_m = 0.5 / math.sqrt(float(np.median(ours.density)))

    def overlays(self) -> list[Overlay]:
        """All that are likely and apart from each other, the best first."""
        found: list[Overlay] = []
        for pose, patch in self._proposals():
            self._add(found, pose, patch)
        if found:
            for pose, patch in self._rivals(max(found, key=lambda one: one.log_odds)):
                self._add(found, pose, patch)
        return sorted(found, key=lambda one: -one.log_odds)

    def _add(self, found: list[Overlay], pose: Floats, patch: Ints) -> None:
        """Judges a pose that is none of those found, unless it comes down to one of these."""
        if any(self._same(pose, one.T_map_other, patch) for one in found):
            return
        judged = self._grown(pose, patch)
        if judged is not None and not any(
            self._same(judged.T_map_other, one.T_map_other, judged.pairs[:, 1]) for one in found
        ):
            found.append(judged)

    def _rivals(self, best: Overlay) -> Iterator[tuple[Floats, Ints]]:
        """Poses that shift the best one by a step to another landmark, turned or not, and fit nearly as well.

        In rows that are regular there are more of them than proposals, and the right one may be among these.
        """
        mine, other = best.pairs.T
        places = self.theirs.mean_m[other]
        middle = int(np.argmin(np.linalg.norm(places - places.mean(axis=0), axis=1)))
        patch = other[np.argsort(np.linalg.norm(places - places[middle], axis=1))[:_PATCH_SIZE]]
        near = self.ours.tree.query(self.ours.mean_m[mine[middle]], k=min(_STEPS, len(self.ours.mean_m)))[1]
        for turn in (0.0, math.pi / 2.0, math.pi, -math.pi / 2.0):
            pose = best.T_map_other + np.array([0.0, 0.0, turn])
            for goal in self.ours.mean_m[near]:
                pose[:2] += goal - apply(pose, places[middle : middle + 1])[0]
                away = self.ours.tree.query(apply(pose, self.theirs.mean_m[patch]))[0]
                if np.count_nonzero(away < self.farthest_m) >= _NEARLY * len(patch):
                    yield pose.copy(), patch

    def _proposals(self) -> list[tuple[Floats, Ints]]:
        """Poses with the rows of the patch that fits there."""
        found = []
        ours, theirs = self.ours, self.theirs
        marks = Constellation(ours.mean_m, ours.variance_m2 + ours.surest_m2, _unlabelled(ours))
        chart = charted(marks)
        variance, labels = theirs.variance_m2 + theirs.surest_m2, _unlabelled(theirs)
        for patch in _patches(theirs):
            centre = theirs.mean_m[patch].mean(axis=0)
            local = Constellation(theirs.mean_m[patch] - centre, variance[patch], labels[patch])
            reach = 0.8 * float(np.linalg.norm(local.mean_m, axis=1).max())
            view = View(np.zeros((1, 3)), reach, math.pi)
            for one in placements(local, chart, view, most=_PER_PATCH, refined=_REFINED):
                x, y, heading = one.T_map_local
                cosine, sine = math.cos(heading), math.sin(heading)
                shift = [cosine * centre[0] - sine * centre[1], sine * centre[0] + cosine * centre[1]]
                found.append((one.log_odds, np.array([x - shift[0], y - shift[1], heading]), patch))
        found.sort(key=lambda one: -one[0])
        return [(pose, patch) for _, pose, patch in found[:_MOST_JUDGED]]

    def _same(self, pose: Floats, other: Floats, rows: Ints) -> bool:
        """Whether two poses lay landmarks of the other map on the same of this one."""
        places = self.theirs.mean_m[rows]
        apart = np.linalg.norm(apply(pose, places) - apply(other, places), axis=1)
        return bool(np.median(apart) < self.farthest_m)

    def _grown(self, pose: Floats, patch: Ints) -> Overlay | None:
        """The overlay near a pose: pairs are gathered from a patch outwards, as far as the pose is known."""
        rows = patch
        covariance, spread = _FIRST_COVARIANCE, self.ours.surest_m2 + self.theirs.surest_m2
        pairs = np.empty((0, 2), dtype=np.int64)
        for _ in range(_ROUNDS):
            before = pairs
            pairs = self._paired(pose, covariance, spread, rows)
            if len(pairs) < _LEAST_FITTED:
                return None
            if np.array_equal(pairs, before):
                break
            pose, covariance, spread = self._fitted(pose, pairs)
            rows = np.arange(len(self.theirs.mean_m))
        return self._judged(pose, covariance, spread, pairs)

    def _paired(self, pose: Floats, covariance: Floats, spread: float, rows: Ints) -> Ints:
        """Rows of landmarks that are each other's nearest, within what is known of the pose and of both."""
        moved = apply(pose, self.theirs.mean_m[rows])
        away, nearest = self.ours.tree.query(moved)
        mutual = cKDTree(moved).query(self.ours.mean_m[nearest])[1] == np.arange(len(rows))
        variance = self.ours.variance_m2[nearest] + self.theirs.variance_m2[rows] + spread
        variance = variance + _of_pose(pose, moved, covariance)
        gate = np.minimum(_GATE_SIGMAS * np.sqrt(variance), self.farthest_m)
        fits = mutual & (away <= gate) & (self.looks[nearest, rows] > 0.0)
        return np.column_stack([nearest[fits], rows[fits]])

    def _fitted(self, pose: Floats, pairs: Ints) -> tuple[Floats, Floats, float]:
        """Least squares over pairs: pose, covariance, and what all distances have beside what is said."""
        goal, places = self.ours.mean_m[pairs[:, 0]], self.theirs.mean_m[pairs[:, 1]]
        own = self.ours.variance_m2[pairs[:, 0]] + self.theirs.variance_m2[pairs[:, 1]]
        spread = self.ours.surest_m2 + self.theirs.surest_m2
        covariance: Floats = np.eye(3)
        for _ in range(_ROUNDS):
            step, information = _step(pose, apply(pose, places), goal, own + spread)
            pose, covariance = pose + step, np.asarray(np.linalg.inv(information), dtype=np.float64)
            off_m2 = np.sum((goal - apply(pose, places)) ** 2, axis=1)
            # Three numbers of the pose were taken from two per pair.
            per_axis = 0.5 * float(off_m2.sum()) / (len(pairs) - 1.5)
            spread = max(2.0 * _LEAST_STD_M**2, per_axis - float(np.mean(own)))
            if np.abs(step).max() < 1e-7:
                break
        return pose, covariance, spread

    def _judged(self, pose: Floats, covariance: Floats, spread: float, pairs: Ints) -> Overlay:
        moved = apply(pose, self.theirs.mean_m)
        mine, other = pairs.T
        variance = self.ours.variance_m2[mine] + self.theirs.variance_m2[other] + spread
        off_m2 = np.sum((moved[other] - self.ours.mean_m[mine]) ** 2, axis=1)
        peak = np.exp(-0.5 * off_m2 / variance) / (2.0 * math.pi * variance)
        gained = float(np.log(peak * self.looks[mine, other] / self.ours.density[mine]).sum())
        lacking = (
            np.setdiff1d(np.flatnonzero(self.theirs.knows(apply(inverse(pose), self.ours.mean_m))), mine),
            np.setdiff1d(np.flatnonzero(self.ours.knows(moved)), other),
        )
        lost = (len(lacking[0]) + len(lacking[1])) * math.log(1.0 - IN_OTHER)
        volume = (2.0 * math.pi) ** 1.5 * math.sqrt(max(float(np.linalg.det(covariance)), 1e-300))
        log_odds = gained + lost + math.log(volume / self.room) - _SPREAD_COST
        wrapped = np.array([pose[0], pose[1], math.remainder(float(pose[2]), 2.0 * math.pi)])
        apart_m = math.sqrt(0.5 * float(off_m2.mean()))
        return Overlay(wrapped, covariance, pairs, lacking, log_odds, apart_m)


def _step(pose: Floats, moved_m: Floats, goal_m: Floats, variance_m2: Floats) -> tuple[Floats, Floats]:
    """A step of Gauss and Newton, and the information of the pose."""
    lever = levers(pose, moved_m)
    weighted = lever / variance_m2[:, None, None]
    information = np.einsum("nij,nik->jk", weighted, lever) + 1e-9 * np.eye(3)
    return np.linalg.solve(information, np.einsum("nij,ni->j", weighted, goal_m - moved_m)), information


def levers(pose: Floats, moved_m: Floats) -> Floats:
    """(N, 2, 3): how places that a pose has moved follow it."""
    lever = np.zeros((len(moved_m), 2, 3))
    lever[:, 0, 0] = lever[:, 1, 1] = 1.0
    lever[:, 0, 2], lever[:, 1, 2] = -(moved_m[:, 1] - pose[1]), moved_m[:, 0] - pose[0]
    return lever


def _of_pose(pose: Floats, moved_m: Floats, covariance: Floats) -> Floats:
    """Variance in a direction of places that a pose has moved, for what is not known of it."""
    lever = levers(pose, moved_m)
    return np.asarray(0.5 * np.einsum("nij,jk,nik->n", lever, covariance, lever))


def _unlabelled(side: _Side) -> Ints:
    """No labels: names and classes are judged with the whole."""
    return np.full(len(side.mean_m), -1, dtype=np.int64)


def _patches(side: _Side) -> Sequence[Ints]:
    """Rows of neighbours, around landmarks that are far from each other."""
    count = len(side.mean_m)
    if count <= _PATCH_SIZE:
        return [np.arange(count)]
    centre = side.mean_m.mean(axis=0)
    seeds = [int(np.argmin(np.linalg.norm(side.mean_m - centre, axis=1)))]
    away = np.linalg.norm(side.mean_m - side.mean_m[seeds[0]], axis=1)
    while len(seeds) < min(_PATCHES, count // _PATCH_SIZE + 1):
        seeds.append(int(np.argmax(away)))
        away = np.minimum(away, np.linalg.norm(side.mean_m - side.mean_m[seeds[-1]], axis=1))
    return [side.tree.query(side.mean_m[seed], k=_PATCH_SIZE)[1] for seed in seeds]

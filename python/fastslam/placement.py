"""Where a small map of one's own lies in a large one: all places that are likely, with their odds.

A local map of a few landmarks is laid on a kept map wherever a pair of its landmarks has the distance of a
pair there. A place is judged by evidence: how much likelier the local landmarks lie as they do if the robot
is there than if they had nothing to do with the map. The integral over the pose is Laplace's.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import ConvexHull, QhullError, cKDTree

from .log import Bools, Floats, Ints

IN_MAP = 0.8
"""Probability that a landmark that is seen is in the map."""
SEEN = 0.6
"""Probability that a landmark of the map that is surely in view was seen."""
SAME_CLASS = 0.9
"""Probability that a class is told right."""
MOST_LOCAL_PAIRS = 60
MOST_PROPOSALS = 60_000
MOST_REFINED = 150
GATE_SIGMAS = 4.0


@dataclass(frozen=True)
class Constellation:
    """Landmarks with what says which they may be.

    Shapes: `mean_m` (N, 2), `variance_m2` (N,) the mean of the two of each, `label` (N,) -1 where nobody
    says. With `exact` labels are names, which never differ, else classes, which may be told wrong.
    """

    mean_m: Floats
    variance_m2: Floats
    label: Ints
    exact: bool = False


@dataclass(frozen=True)
class View:
    """From where a local map was seen: poses (T, 3) of the sensor in its frame, reach, half field of view."""

    T_local_sensor: Floats
    reach_m: float
    half_view_rad: float


@dataclass(frozen=True)
class Placement:
    """A place at which the local map may lie: `T_map_local` as x, y, heading with its covariance (3, 3).

    `log_odds` are those against a local map that has nothing to do with the map; `matched` is how many of its
    landmarks are explained.
    """

    T_map_local: Floats
    covariance: Floats
    log_odds: float
    matched: int


def placements(local: Constellation, chart: Constellation, view: View, *, most: int = 30) -> list[Placement]:
    """The likeliest places, the best first; fewer than two landmarks in common place nothing.

    Places nearer to each other than half a metre and a tenth of a radian count once.
    """
    if min(len(local.mean_m), len(chart.mean_m)) < 2:
        return []
    search = _Search(local, chart, view)
    proposals = search.proposals()
    if len(proposals) == 0:
        return []
    scores = search.scores(proposals)
    found: list[Placement] = []
    for index in _apart(proposals, np.argsort(-scores, kind="stable"), MOST_REFINED):
        placed = search.refined(proposals[index])
        if placed is not None:
            found.append(placed)
    found.sort(key=lambda placement: -placement.log_odds)
    poses = np.array([placement.T_map_local for placement in found]).reshape(-1, 3)
    return [found[index] for index in _apart(poses, np.arange(len(found)), most)]


def odds_of(found: Sequence[Placement]) -> Floats:
    """The probability of each place, and last that of none, which is as likely as all at the outset."""
    logs = np.array([*(placement.log_odds for placement in found), 0.0])
    weights = np.exp(logs - logs.max())
    return np.asarray(weights / weights.sum())


def apply(T: Floats, points_m: Floats) -> Floats:
    """Points moved by poses (..., 3): (..., N, 2)."""
    cosine, sine = np.cos(T[..., 2:3]), np.sin(T[..., 2:3])
    x = T[..., 0:1] + cosine * points_m[:, 0] - sine * points_m[:, 1]
    y = T[..., 1:2] + sine * points_m[:, 0] + cosine * points_m[:, 1]
    return np.stack([x, y], axis=-1)


class _Search:
    """One local map against one map."""

    def __init__(self, local: Constellation, chart: Constellation, view: View) -> None:
        self.local, self.chart, self.view = local, chart, view
        self.tree = cKDTree(chart.mean_m)
        self.area_m2 = _area_m2(chart.mean_m, view.reach_m)
        self.density = len(chart.mean_m) / self.area_m2
        self.tolerance_m = GATE_SIGMAS * math.sqrt(
            float(np.median(local.variance_m2)) + float(np.median(chart.variance_m2))
        )

    def proposals(self) -> Floats:
        """Places (P, 3) at which a pair of local landmarks lies on a pair of the map."""
        first, second = np.triu_indices(len(self.local.mean_m), k=1)
        length = np.linalg.norm(self.local.mean_m[second] - self.local.mean_m[first], axis=1)
        # Long pairs fix the heading; those of landmarks that are known well come first among them.
        spread = self.local.variance_m2[first] + self.local.variance_m2[second]
        order = np.argsort(spread / np.maximum(length, 1e-9) ** 2, kind="stable")[:MOST_LOCAL_PAIRS]
        pairs = self.tree.query_pairs(float(length[order].max()) + self.tolerance_m, output_type="ndarray")
        if len(pairs) == 0:
            return np.empty((0, 3))
        pairs = np.concatenate([pairs, pairs[:, ::-1]])
        lengths = np.linalg.norm(self.chart.mean_m[pairs[:, 1]] - self.chart.mean_m[pairs[:, 0]], axis=1)
        by_length = np.argsort(lengths, kind="stable")
        pairs, lengths = pairs[by_length], lengths[by_length]
        found: list[Floats] = []
        left = MOST_PROPOSALS
        for index in order:
            if left <= 0:
                break
            low, high = np.searchsorted(lengths, length[index] + self.tolerance_m * np.array([-1.0, 1.0]))
            some = pairs[low:high]
            ends = (int(first[index]), int(second[index]))
            some = some[self._may_be(ends[0], some[:, 0]) & self._may_be(ends[1], some[:, 1])][:left]
            found.append(_laid_on(self.local.mean_m[list(ends)], self.chart.mean_m[some]))
            left -= len(some)
        return np.concatenate(found)

    def _may_be(self, local: int, chart: Ints) -> Bools:
        label, others = self.local.label[local], self.chart.label[chart]
        return np.asarray((others == label) | (not self.local.exact) | (label < 0) | (others < 0))

    def scores(self, proposals: Floats) -> Floats:
        """Σ ln of the likelihood ratio of each local landmark, the nearest of the map alone counted."""
        scores = np.empty(len(proposals))
        size = max(1, 400_000 // len(self.local.mean_m))
        for begin in range(0, len(proposals), size):
            part = slice(begin, begin + size)
            distance, nearest = self.tree.query(apply(proposals[part], self.local.mean_m))
            scores[part] = np.log(self._ratios(distance, nearest)).sum(axis=-1)
        return scores

    def _ratios(self, distance_m: Floats, nearest: Ints, *, spread_m2: float = 0.0) -> Floats:
        """How much likelier each local landmark lies where it does than one by chance."""
        variance = self.local.variance_m2 + self.chart.variance_m2[nearest] + spread_m2
        peak = np.exp(-0.5 * distance_m**2 / variance) / (2.0 * math.pi * variance)
        return np.asarray(1.0 - IN_MAP + IN_MAP * peak * self._looks(nearest) / self.density)

    def _looks(self, nearest: Ints) -> Floats:
        """How much likelier the labels are of one landmark than of two."""
        ours, theirs = np.broadcast_arrays(self.local.label, self.chart.label[nearest])
        count = max(2, len(np.unique(self.chart.label[self.chart.label >= 0])))
        same = ours == theirs
        if self.local.exact:
            told = np.where(same, float(len(self.chart.mean_m)), 0.0)
        else:
            told = np.where(same, SAME_CLASS, (1.0 - SAME_CLASS) / (count - 1)) * count
        return np.asarray(np.where((ours < 0) | (theirs < 0), 1.0, told))

    def refined(self, proposal: Floats) -> Placement | None:
        """The best pose near a proposal, and its evidence; None where too little fits."""
        pose = np.array(proposal)
        information = np.zeros((3, 3))
        for _ in range(8):
            moved = apply(pose, self.local.mean_m)
            distance, nearest = self.tree.query(moved)
            variance = self.local.variance_m2 + self.chart.variance_m2[nearest]
            paired = self._unique(distance, nearest, variance)
            if paired.sum() < 2:
                return None
            step, information = _step(
                pose, moved[paired], self.chart.mean_m[nearest[paired]], variance[paired]
            )
            pose = pose + step
            if np.abs(step).max() < 1e-6:
                break
        return self._judged(pose, np.asarray(np.linalg.inv(information), dtype=np.float64))

    def _unique(self, distance_m: Floats, nearest: Ints, variance_m2: Floats) -> Bools:
        """Local landmarks that lie on one of the map, each of which stands for one alone."""
        fits = (distance_m**2 <= GATE_SIGMAS**2 * variance_m2) & (self._looks(nearest) > 0.0)
        for landmark in np.unique(nearest[fits]):
            rivals = np.flatnonzero(fits & (nearest == landmark))
            fits[rivals[np.argsort(distance_m[rivals])[1:]]] = False
        return np.asarray(fits)

    def _judged(self, pose: Floats, covariance: Floats) -> Placement:
        distance, nearest = self.tree.query(apply(pose, self.local.mean_m))
        variance = self.local.variance_m2 + self.chart.variance_m2[nearest]
        paired = self._unique(distance, nearest, variance)
        ratios = np.where(paired, self._ratios(distance, nearest), 1.0 - IN_MAP)
        seen = np.isin(np.arange(len(self.chart.mean_m)), nearest[paired])
        missed = int(np.count_nonzero(self._in_view(pose) & ~seen))
        pose_volume = (2.0 * math.pi) ** 1.5 * math.sqrt(max(np.linalg.det(covariance), 0.0))
        occam = math.log(max(pose_volume, 1e-300) / (self.area_m2 * 2.0 * math.pi))
        log_odds = float(np.log(ratios).sum()) + missed * math.log(1.0 - SEEN) + occam
        wrapped = np.array([pose[0], pose[1], math.remainder(pose[2], 2.0 * math.pi)])
        return Placement(wrapped, covariance, log_odds, int(paired.sum()))

    def _in_view(self, pose: Floats) -> Bools:
        """Landmarks of the map that the sensor surely saw on its way."""
        sensors = self.view.T_local_sensor
        at_m = apply(pose, sensors[:, :2])
        heading = sensors[:, 2] + pose[2]
        offset = self.chart.mean_m[:, None] - at_m[None]
        bearing = np.arctan2(offset[..., 1], offset[..., 0]) - heading
        ahead = np.abs(np.angle(np.exp(1j * bearing))) < self.view.half_view_rad
        near = np.linalg.norm(offset, axis=-1) < self.view.reach_m
        return np.asarray((near & ahead).mean(axis=1) > 0.3)


def _step(pose: Floats, moved_m: Floats, chart_m: Floats, variance_m2: Floats) -> tuple[Floats, Floats]:
    """A step of Gauss and Newton, and the information of the pose."""
    lever = moved_m - pose[:2]
    jacobian = np.zeros((len(moved_m), 2, 3))
    jacobian[:, 0, 0] = jacobian[:, 1, 1] = 1.0
    jacobian[:, 0, 2], jacobian[:, 1, 2] = -lever[:, 1], lever[:, 0]
    weighted = jacobian / variance_m2[:, None, None]
    information = np.einsum("nij,nik->jk", weighted, jacobian) + 1e-9 * np.eye(3)
    return np.linalg.solve(information, np.einsum("nij,ni->j", weighted, chart_m - moved_m)), information


def _laid_on(local_m: Floats, chart_m: Floats) -> Floats:
    """Poses (P, 3) that lay a segment (2, 2) on others (P, 2, 2), middle on middle."""
    segment, others = local_m[1] - local_m[0], chart_m[:, 1] - chart_m[:, 0]
    heading = np.arctan2(others[:, 1], others[:, 0]) - math.atan2(segment[1], segment[0])
    middle, theirs = local_m.mean(axis=0), chart_m.mean(axis=1)
    cosine, sine = np.cos(heading), np.sin(heading)
    x = theirs[:, 0] - (cosine * middle[0] - sine * middle[1])
    y = theirs[:, 1] - (sine * middle[0] + cosine * middle[1])
    return np.column_stack([x, y, heading])


def _apart(poses: Floats, order: Ints, most: int) -> list[int]:
    """The first of these poses that are not near an earlier one."""
    chosen: list[int] = []
    for index in order:
        if len(chosen) == most:
            break
        others = poses[chosen]
        turned = np.abs(np.angle(np.exp(1j * (others[:, 2] - poses[index, 2]))))
        near = (np.linalg.norm(others[:, :2] - poses[index, :2], axis=1) < 0.5) & (turned < 0.1)
        if not near.any():
            chosen.append(int(index))
    return chosen


def _area_m2(mean_m: Floats, reach_m: float) -> float:
    """Of the map, and at least of what the sensor sees at once."""
    least = math.pi * reach_m**2
    try:
        return max(least, float(ConvexHull(mean_m).volume))
    except (QhullError, ValueError):
        return least

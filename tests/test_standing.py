"""The landmarks that stand as in no right map, found fast: the same as by their plain definitions."""

from __future__ import annotations

import numpy as np
import pytest
from fastslam.laid import Laid
from fastslam.log import Bools
from fastslam.standing import (
    APART_STDS,
    HALF_LOOKS,
    LEAST_LOOKS,
    MOVED_ERRORS,
    NEIGHBOURS,
    SELDOM,
    SURE,
    VIEW_SHARE,
    Looks,
    _by_chance,
    _log_missed,
)

LOOKS, FRAMES = 160, 3


def world(seed: int) -> Laid:
    """A drive round a field of landmarks some of which are twins, are gone after a while, or move."""
    rng = np.random.default_rng(seed)
    mean_m = rng.uniform(-12.0, 12.0, (int(rng.integers(9, 40)), 2))
    twins = rng.integers(0, 3, len(mean_m)) == 0
    mean_m = np.vstack([mean_m, mean_m[twins] + rng.choice([0.01, 0.5]) * rng.normal(size=(twins.sum(), 2))])
    kind = rng.integers(0, 6, len(mean_m))
    stamp_s = np.arange(LOOKS * FRAMES) / FRAMES
    turned = 4.0 * np.pi * stamp_s / LOOKS
    pose = np.column_stack([8.0 * np.cos(turned), 8.0 * np.sin(turned), turned + 0.5 * np.pi])
    late = stamp_s > 0.5 * LOOKS
    moved_m = 0.6 * (kind == 1) * late[:, None]
    apart = mean_m + moved_m[..., None] * [1.0, 0.0] - pose[:, None, :2]
    range_m = np.hypot(apart[..., 0], apart[..., 1])
    bearing = np.arctan2(apart[..., 1], apart[..., 0]) - pose[:, None, 2]
    bearing = (bearing + np.pi) % (2.0 * np.pi) - np.pi
    seen = (range_m < 9.0) & (np.abs(bearing) < 1.5) & (rng.uniform(size=range_m.shape) < 0.8)
    seen &= ~((kind == 0) & late[:, None])
    # Of twins a look shows the one or the other.
    turn = rng.integers(0, 2, LOOKS).repeat(FRAMES)[:, None]
    copies = np.flatnonzero(twins)
    seen[:, copies] &= turn == 0
    seen[:, len(twins) :] &= turn == 1
    frame, landmark = np.nonzero(seen)
    count = len(frame)
    return Laid(
        row=np.arange(count),
        stamp_s=stamp_s[frame],
        squared=rng.chisquare(2, count) * rng.choice([1.0, 4.0]),
        landmark=landmark.astype(np.int64),
        frame=np.unique(frame, return_inverse=True)[1].astype(np.int64),
        mean_m=mean_m,
        origin=pose[frame],
        range_m=range_m[frame, landmark] + 0.03 * rng.normal(size=count),
        bearing_rad=bearing[frame, landmark] + 0.01 * rng.normal(size=count),
    )


class Plain:
    """The rules as they are said: every landmark and every look, one after the other."""

    def __init__(self, laid: Laid) -> None:
        self.laid = laid
        self.looks = np.unique(laid.look)
        of_look = [np.flatnonzero(laid.look == look) for look in self.looks]
        self.origin = laid.origin[[rows[len(rows) // 2] for rows in of_look]]
        self.aside_rad = np.quantile(np.abs(laid.bearing_rad), VIEW_SHARE)
        self.reach_m = np.quantile(laid.range_m, VIEW_SHARE)
        good = laid.explained
        off_m = laid.point_m[good] - laid.mean_m[laid.landmark[good]]
        self.noise_m = 1.4826 * np.median(np.abs(off_m)) * np.sqrt(2)

    def rows(self, landmark: int) -> np.ndarray:
        return np.flatnonzero((self.laid.landmark == landmark) & self.laid.explained)

    def in_view(self, landmark: int, reach_m: float) -> Bools:
        dx_m, dy_m = (self.laid.mean_m[landmark] - self.origin[:, :2]).T
        aside = (np.arctan2(dy_m, dx_m) - self.origin[:, 2] + np.pi) % (2.0 * np.pi) - np.pi
        return (np.hypot(dx_m, dy_m) < reach_m) & (np.abs(aside) < self.aside_rad)

    def sighted(self, landmark: int) -> Bools:
        return np.isin(self.looks, self.laid.look[self.rows(landmark)])

    def gone(self, landmark: int) -> bool:
        rows = self.rows(landmark)
        if len(rows) < LEAST_LOOKS:
            return False
        own_m = min(self.reach_m, np.quantile(self.laid.range_m[rows], VIEW_SHARE))
        sighted = self.sighted(landmark)[self.in_view(landmark, own_m)]
        shown = np.flatnonzero(sighted)
        if len(shown) < 3:
            return False
        missed = max(int(shown[0]), len(sighted) - 1 - int(shown[-1]))
        between = int(shown[-1] - shown[0]) - 1
        return _log_missed(missed, between, len(shown) - 2) < np.log(SURE / len(self.laid.mean_m))

    def moved(self, landmark: int) -> bool:
        own = self.laid.landmark == landmark
        off_m = self.laid.point_m[own] - self.laid.mean_m[landmark]
        mean = np.array(
            [off_m[self.laid.look[own] == k].mean(axis=0) for k in np.unique(self.laid.look[own])]
        )
        half = len(mean) // 2
        if half < HALF_LOOKS:
            return False
        parts = mean[:half], mean[half:]
        median = [np.median(part, axis=0) for part in parts]
        spread = [np.median(np.abs(p - m), axis=0) for p, m in zip(parts, median, strict=True)]
        error = [1.25 * 1.4826 * s / np.sqrt(len(p)) for p, s in zip(parts, spread, strict=True)]
        far_m = np.abs(median[1] - median[0])
        return bool(((far_m > MOVED_ERRORS * np.hypot(*error)) & (far_m > self.noise_m)).any())

    def of_pair(self, one: int, other: int) -> tuple[float, int] | None:
        both = self.in_view(one, self.reach_m) & self.in_view(other, self.reach_m)
        if both.sum() < LEAST_LOOKS:
            return None
        first, second = self.sighted(one), self.sighted(other)
        if np.hypot(*(self.laid.mean_m[one] - self.laid.mean_m[other])) > APART_STDS * self.noise_m:
            expected = both.sum() * first[both].mean() * second[both].mean()
            return float(expected), int((first & second & both).sum())
        either = (first | second)[both].mean()
        together = np.zeros(len(self.looks), dtype=bool)
        for frame in np.intersect1d(*(self.laid.frame[self.rows(k)] for k in (one, other))):
            together |= self.looks == self.laid.look[self.laid.frame == frame][0]
        return float(both.sum() * (1 - np.sqrt(1 - either)) ** 2), int((together & both).sum())

    def twins(self) -> list[tuple[int, int]]:
        mean_m = self.laid.mean_m
        pairs = set()
        for one in range(len(mean_m)):
            order = np.argsort(np.hypot(*(mean_m - mean_m[one]).T))
            pairs |= {(min(one, k), max(one, k)) for k in order[1 : NEIGHBOURS + 1].tolist()}
        tested = {pair: found for pair in sorted(pairs) if (found := self.of_pair(*pair)) is not None}
        return [
            pair
            for pair, (expected, together) in tested.items()
            if together < SELDOM * expected and _by_chance(together, expected) < SURE / len(tested)
        ]


@pytest.mark.parametrize("seed", range(6))
def test_gone_moved_and_twins_are_those_of_their_definitions(seed: int) -> None:
    laid = world(seed)
    fast, plain, landmarks = Looks(laid), Plain(laid), range(len(laid.mean_m))
    assert list(fast.gone()) == [k for k in landmarks if plain.gone(k)]
    assert list(fast.moved()) == [k for k in landmarks if plain.moved(k)]
    assert fast.twins() == plain.twins()


def test_the_worlds_hold_some_of_each() -> None:
    found = [
        (len(list(looks.gone())), len(list(looks.moved())), len(looks.twins()))
        for looks in map(Looks, map(world, range(6)))
    ]
    assert (np.array(found).sum(axis=0) >= 5).all(), found

"""Landmarks that do not stand as those of a right map would: gone, moved, or there twice.

All three come from the sightings laid on the map along its path, look by look: a look is a second of the log.
Nothing of it can be told of landmarks that are in view once, nor of things that hide each other.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from math import exp, lgamma, log

import numpy as np

from .evaluation.align import wrap_angle
from .laid import Laid
from .log import Bools, Floats, Ints

LEAST_LOOKS = 5
VIEW_SHARE = 0.75
"""What lies nearer and less aside than this share of the sightings counts as in view."""
SURE = 1e-3
"""So rarely a sound map has one landmark that is taken for gone, or one pair that is taken for twins."""
NEIGHBOURS = 6
SELDOM = 0.2
"""Twins are sighted together in less than this share of the looks in which two things would be."""
APART_STDS = 3.0
"""Landmarks closer than this many deviations of the sightings are told apart by frames that show both."""
HALF_LOOKS = 8
MOVED_ERRORS = 6.0
"""Halves of a landmark's sightings lie so many standard errors apart, and further than one sighting errs."""
MOST_CELLS = 5_000_000
"""Looks, or landmarks, times landmarks; of larger maps every n-th landmark is looked at."""
ROUNDING = 1.0 + 1e-9
"""By so much squares may be off, and more."""


@dataclass(frozen=True)
class Standing:
    """How many of the landmarks looked at are gone, moved or one too many, and how many are any of these."""

    landmarks: int
    gone: int
    moved: int
    twins: int
    odd: int


def standing(laid: Laid, *, named: bool) -> Standing:
    """Looks at every landmark of the map; names keep two apart, however they are sighted."""
    looks = Looks(laid)
    pairs = [] if named else looks.twins()
    gone, moved, twins = (set(found) for found in (looks.gone(), looks.moved(), surplus(pairs)))
    return Standing(len(looks.chosen), len(gone), len(moved), len(twins), len(gone | moved | twins))


class Looks:
    """What is in view and what is sighted, look by look (L), of landmarks (K)."""

    def __init__(self, laid: Laid) -> None:
        self._laid = laid
        self._of: Ints = np.unique(laid.look, return_inverse=True)[1].astype(np.int64)
        """The look of each sighting (S,)."""
        self._count = int(self._of[-1]) + 1
        step = max(1, max(self._count, len(laid.mean_m)) * len(laid.mean_m) // MOST_CELLS)
        self.chosen: Ints = np.arange(0, len(laid.mean_m), step)
        """The landmarks that are looked at."""
        good = laid.explained
        self._nearest = laid.by_landmark()
        """The sightings that each landmark fits best."""
        self._rows = [own[good[own]] for own in self._nearest]
        """Those that it explains."""
        self._noise_m = _noise_m(laid)
        middle = np.searchsorted(self._of, np.arange(self._count)) + np.bincount(self._of) // 2
        self._x_m, self._y_m, self._heading_rad = np.ascontiguousarray(laid.origin[middle].T)
        """Where the sensor was in the middle of each look (L,)."""
        self._aside = float(np.quantile(np.abs(laid.bearing_rad), VIEW_SHARE))
        self._reach_m = float(np.quantile(laid.range_m, VIEW_SHARE))
        self._found: dict[int, tuple[Bools, Bools]] = {}

    def _in_view(self, landmark: int, reach_m: float) -> Bools:
        """In which looks (L,) a landmark is nearer, and less aside, than most sightings are."""
        x_m, y_m = self._laid.mean_m[landmark]
        # Angles cost most, and most of a map is out of reach.
        near = np.flatnonzero((x_m - self._x_m) ** 2 + (y_m - self._y_m) ** 2 < (ROUNDING * reach_m) ** 2)
        dx_m, dy_m = x_m - self._x_m[near], y_m - self._y_m[near]
        aside = np.abs(wrap_angle(np.arctan2(dy_m, dx_m) - self._heading_rad[near]))
        shown = np.zeros(self._count, dtype=np.bool_)
        shown[near] = (aside < self._aside) & (np.hypot(dx_m, dy_m) < reach_m)
        return shown

    def _sighted(self, landmark: int) -> Bools:
        shown = np.zeros(self._count, dtype=np.bool_)
        shown[self._of[self._rows[landmark]]] = True
        return shown

    def _shown(self, landmark: int) -> tuple[Bools, Bools]:
        """In which looks (L,) a landmark is in view, and in which of these it is sighted; computed once."""
        found = self._found.get(landmark)
        if found is None:
            in_view = self._in_view(landmark, self._reach_m)
            found = self._found[landmark] = in_view, in_view & self._sighted(landmark)
        return found

    def gone(self) -> Iterator[int]:
        """Landmarks that were in view too often before the first or after the last sighting.

        By the rate at which each is sighted between the two, from as near as it is sighted mostly.
        """
        for landmark in self.chosen.tolist():
            rows = self._rows[landmark]
            if len(rows) < LEAST_LOOKS:
                continue
            own_m = min(self._reach_m, float(np.quantile(self._laid.range_m[rows], VIEW_SHARE)))
            sighted = self._sighted(landmark)[self._in_view(landmark, own_m)]
            shown = np.flatnonzero(sighted)
            if len(shown) < 3:
                continue
            between = int(shown[-1] - shown[0]) - 1
            missed = int(max(shown[0], len(sighted) - 1 - shown[-1]))
            if _log_missed(missed, between, len(shown) - 2) < np.log(SURE / len(self.chosen)):
                yield landmark

    def moved(self) -> Iterator[int]:
        """Landmarks whose earlier sightings show them elsewhere than the later ones do."""
        laid = self._laid
        apart = laid.point_m - laid.mean_m[laid.landmark]
        for landmark in self.chosen.tolist():
            rows = self._nearest[landmark]
            look, number = np.unique(self._of[rows], return_inverse=True)
            half = len(look) // 2
            if half < HALF_LOOKS:
                continue
            sums = [np.bincount(number, apart[rows, axis]) for axis in (0, 1)]
            mean = np.column_stack(sums) / np.bincount(number)[:, None]
            (before, error), (after, other) = (_middle(part) for part in (mean[:half], mean[half:]))
            far = np.abs(after - before)
            if ((far > MOVED_ERRORS * np.hypot(error, other)) & (far > self._noise_m)).any():
                yield landmark

    def twins(self) -> list[tuple[int, int]]:
        """Pairs of neighbours of which a look shows the one or the other and never both.

        Two things that are sighted by chance, each at its rate, are sighted together in so many looks; that
        none or hardly one is has a probability by Poisson's law.
        """
        from scipy.spatial import cKDTree

        mean_m = self._laid.mean_m
        near = min(NEIGHBOURS, len(mean_m) - 1)
        neighbours = cKDTree(mean_m).query(mean_m[self.chosen], k=np.arange(1, near + 2))[1]
        pairs = {
            (min(one, other), max(one, other))
            for one, others in zip(self.chosen.tolist(), neighbours.tolist(), strict=True)
            for other in others
            if one != other
        }
        tested = [(pair, *found) for pair in sorted(pairs) if (found := self._of_pair(*pair)) is not None]
        return [
            pair
            for pair, expected, together in tested
            if together < SELDOM * expected and _by_chance(together, expected) < SURE / len(tested)
        ]

    def _of_pair(self, one: int, other: int) -> tuple[float, int] | None:
        """In how many looks both would be sighted by chance, and in how many they are."""
        (first_in_view, first), (second_in_view, second) = self._shown(one), self._shown(other)
        both = first_in_view & second_in_view
        looks = np.count_nonzero(both)
        if looks < LEAST_LOOKS:
            return None
        apart_m = np.hypot(*(self._laid.mean_m[one] - self._laid.mean_m[other]))
        if apart_m > APART_STDS * self._noise_m:
            rate, other_rate = (np.count_nonzero(shown & both) / looks for shown in (first, second))
            return looks * rate * other_rate, int(np.count_nonzero(first & second))
        # Which of two so close a sighting is of cannot be said: both have one rate.
        either = np.count_nonzero((first | second) & both) / looks
        rows = np.concatenate([self._rows[one], self._rows[other]])
        frames, shown = np.unique(self._laid.frame[rows], return_counts=True)
        of_frame = self._of[np.searchsorted(self._laid.frame, frames[shown >= 2])]
        return looks * (1 - np.sqrt(1 - either)) ** 2, int(both[np.unique(of_frame)].sum())


def _noise_m(laid: Laid) -> float:
    """Deviation of the sightings from their landmarks, as it came out."""
    good = laid.explained
    if not good.any():
        return 0.0
    apart = laid.point_m[good] - laid.mean_m[laid.landmark[good]]
    return float(1.4826 * np.median(np.abs(apart)) * np.sqrt(2))


def surplus(pairs: Iterable[tuple[int, int]]) -> list[int]:
    """The landmarks that are left over where those of each pair are one: all of a group but the first."""
    before: dict[int, int] = {}

    def first(landmark: int) -> int:
        while landmark in before:
            landmark = before[landmark]
        return landmark

    for pair in pairs:
        one, other = sorted(map(first, pair))
        if one != other:
            before[other] = one
    return sorted(before)


def _log_missed(missed: int, looks: int, sighted: int) -> float:
    """Log probability of so many looks without a sighting, where `sighted` of `looks` had one before."""
    failed = looks - sighted
    before = lgamma(failed + 1) - lgamma(looks + 2)
    return lgamma(failed + missed + 1) - lgamma(looks + missed + 2) - before


def _by_chance(count: int, expected: float) -> float:
    """Probability of so many or fewer where so many are expected (Poisson)."""
    return sum(exp(number * log(expected) - expected - lgamma(number + 1)) for number in range(count + 1))


def more_by_chance(count: int, expected: float) -> float:
    """Probability of so many or more where so many are expected (Poisson)."""
    return 1.0 - _by_chance(count - 1, expected)


def _middle(mean: Floats) -> tuple[Floats, Floats]:
    """Median (2,) and its standard error, from how the values spread."""
    median = _median(mean)
    spread = 1.4826 * _median(np.abs(mean - median))
    return median, np.asarray(1.25 * spread / np.sqrt(len(mean)))


def _median(values: Floats) -> Floats:
    """That of few values (n, 2), in a tenth of the time of `np.median`."""
    values = np.sort(values, axis=0)
    return np.asarray(0.5 * (values[(len(values) - 1) // 2] + values[len(values) // 2]))

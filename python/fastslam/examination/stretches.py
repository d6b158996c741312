"""Short stretches of a log: what a sighting should look like a moment later, and whether anything does.

The score needs no filter. Sightings of one moment, moved by the odometry, are held against those of a moment
later: of the same name where there are names, the nearest one where there are none.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..datasets.clean import select_sightings
from ..dead_reckoning import DeadReckoning
from ..log import Floats, Ints, Sightings
from ..settings import Partial
from .hypotheses import AS_IS, Hypothesis, Places, places

LAGS = (1, 2, 4, 8, 16)
"""How many moments later."""
LONGEST_S = 4.0
"""Odometry is not trusted for longer, unless the moments themselves are further apart."""
ANCHORS = 160
"""So many moments, spread over the log, are looked at for each lag."""
MOST_PER_MOMENT = 12
BLOCKS = 12
"""Parts of the log, by time, that must agree."""
CUT = 12.0
"""Squared distances count up to here, in squared standard deviations."""
NOISE_FLOOR = 0.01
"""Sensors are trusted to 1 % of the range and 0.01 rad at best, whatever is configured."""


@dataclass(frozen=True)
class Stretches:
    """Which sightings are held against which. Shapes: `first`, `second` and `question` (P,), the others (Q,).

    A question is one sighting `asked`, at one later moment whose first sighting is `moment`; its candidates
    are the rows of equal `question`, which come together. `block` is the part of the log, by time.
    """

    first: Ints
    second: Ints
    question: Ints
    asked: Ints
    moment: Ints
    block: Ints
    named: bool


@dataclass(frozen=True)
class Trial:
    """How the questions are answered under a hypothesis.

    Shapes: all (Q,) but `expected_m` (Q, 2), where the sighting asked should be seen a moment later, in the
    sensor's frame. `cost` is the squared distance of the nearest candidate over its noise, from 0 to 1 at
    CUT; `noise_m` the standard deviation of the sighting asked.
    """

    cost: Floats
    expected_m: Floats
    noise_m: Floats

    @property
    def found(self) -> float:
        """Share of the sightings that are found again where they are expected; NaN without any."""
        return float(np.mean(self.cost < 1.0)) if len(self.cost) else float("nan")


def every(asked: Stretches, step: int) -> Stretches:
    """The questions of every `step`-th pair of moments, spread over the log."""
    pair = np.cumsum(np.diff(asked.moment, prepend=-1) != 0)
    kept = pair % step == 0
    rows = kept[asked.question]
    return replace(
        asked,
        first=asked.first[rows],
        second=asked.second[rows],
        question=np.cumsum(kept)[asked.question[rows]] - 1,
        asked=asked.asked[kept],
        moment=asked.moment[kept],
        block=asked.block[kept],
    )


def only_used(sightings: Sightings, asked: Stretches) -> tuple[Sightings, Stretches]:
    """The sightings that any question is about, and the questions about their rows."""
    used = np.unique(np.concatenate([asked.first, asked.second, asked.asked, asked.moment]))
    first, second = np.searchsorted(used, asked.first), np.searchsorted(used, asked.second)
    moment = np.searchsorted(used, asked.moment)
    fewer = replace(
        asked, first=first, second=second, asked=np.searchsorted(used, asked.asked), moment=moment
    )
    return select_sightings(sightings, used), fewer


@dataclass(frozen=True)
class Bench:
    """Where hypotheses are tried out on the questions of a log; `sensor` holds complete settings."""

    sightings: Sightings
    sensor: Partial
    reckoning: DeadReckoning
    asked: Stretches

    def trial(self, hypothesis: Hypothesis = AS_IS) -> Trial:
        """How well a hypothesis answers all questions."""
        asked, (along, across) = self.asked, sighting_noise_m(self.sightings, self.sensor)
        seen = places(self.sightings, self.sensor, self.reckoning, hypothesis)
        first, second = asked.first, asked.second
        apart, sight = seen.point_m[first] - seen.point_m[second], seen.sight[second]
        ahead = apart[:, 0] * sight[:, 0] + apart[:, 1] * sight[:, 1]
        aside = apart[:, 1] * sight[:, 0] - apart[:, 0] * sight[:, 1]
        squared = ahead**2 / (along[first] ** 2 + along[second] ** 2)
        squared += aside**2 / (across[first] ** 2 + across[second] ** 2)
        starts = np.flatnonzero(np.diff(asked.question, prepend=-1))
        nearest = np.minimum.reduceat(squared, starts) if len(starts) else np.empty(0)
        noise_m = np.hypot(along, across)[asked.asked]
        return Trial(np.minimum(nearest, CUT) / CUT, _expected(asked, seen), noise_m)


def sighting_noise_m(sightings: Sightings, sensor: Partial) -> tuple[Floats, Floats]:
    """Standard deviations (S,) of each sighting along and across the line of sight."""
    range_m = sightings.range_m
    along = np.hypot(sensor["range_std_m"], NOISE_FLOOR * range_m)
    return along, range_m * np.hypot(sensor["bearing_std_rad"], NOISE_FLOOR)


def stretches(sightings: Sightings) -> Stretches:
    """The questions that a log gives; none where nothing is seen or no two moments are close enough."""
    moment = moments(sightings)
    starts = np.flatnonzero(np.diff(moment, prepend=-1))
    named = names_are_unique(sightings)
    pairs = _pairs_of_moments(sightings.stamp_s[starts])
    if len(pairs) == 0:
        return Stretches(*(6 * (np.empty(0, dtype=np.int64),)), named=named)
    bounds = np.append(starts, len(moment))
    first, second = (_members(bounds, pairs[:, side]) for side in (0, 1))
    firsts, seconds = np.repeat(first, MOST_PER_MOMENT, axis=1), np.tile(second, MOST_PER_MOMENT)
    allowed = (firsts >= 0) & (seconds >= 0)
    if named:
        identity = sightings.identity
        allowed &= (identity[firsts] == identity[seconds]) & (identity[firsts] >= 0)
    row, column = np.nonzero(allowed)
    numbers = row * MOST_PER_MOMENT + column // MOST_PER_MOMENT
    asked, question = np.unique(numbers, return_inverse=True)
    pair = asked // MOST_PER_MOMENT
    blocks = np.searchsorted(np.quantile(pairs[:, 0], np.linspace(0, 1, BLOCKS + 1)[1:-1]), pairs[:, 0])
    return Stretches(
        first=firsts[row, column],
        second=seconds[row, column],
        question=question.astype(np.int64),
        asked=first[pair, asked % MOST_PER_MOMENT],
        moment=starts[pairs[pair, 1]],
        block=blocks[pair].astype(np.int64),
        named=named,
    )


def moments(sightings: Sightings) -> Ints:
    """Number of the moment of each sighting: its stamp, or a second or less where most stamps hold one."""
    stamps, index, counts = np.unique(sightings.stamp_s, return_inverse=True, return_counts=True)
    if len(stamps) < 2 or np.mean(counts) >= 2.0:
        return index.astype(np.int64)
    width_s = min(1.0, 5.0 * float(np.median(np.diff(stamps))))
    bins = np.floor((sightings.stamp_s - stamps[0]) / max(width_s, 1e-9))
    return np.unique(bins, return_inverse=True)[1].astype(np.int64)


def names_are_unique(sightings: Sightings) -> bool:
    """Whether names are of single things: half of the sightings have one, and rarely twice at a time."""
    identity = sightings.identity
    known = identity >= 0
    if 2 * int(known.sum()) < len(known) or not known.any():
        return False
    stamp = np.unique(sightings.stamp_s, return_inverse=True)[1]
    once = len(np.unique(np.column_stack([stamp, identity])[known], axis=0))
    return once >= 0.9 * int(known.sum()) and len(np.unique(identity[known])) > 1


def _pairs_of_moments(at_s: Floats) -> Ints:
    """Earlier and later moment (N, 2) of the stretches to look at, spread over the log."""
    pairs = [np.empty((0, 2), dtype=np.int64)]
    if len(at_s) > 1:
        period_s = float(np.median(np.diff(at_s)))
        for lag in LAGS:
            if lag >= len(at_s) or (lag > 1 and lag * period_s > LONGEST_S):
                break
            near = np.flatnonzero(at_s[lag:] - at_s[:-lag] <= 1.5 * lag * period_s)
            chosen = (
                near[np.unique(np.linspace(0, len(near) - 1, ANCHORS).astype(np.int64))]
                if len(near)
                else near
            )
            pairs.append(np.column_stack([chosen, chosen + lag]))
    return np.vstack(pairs)


def _members(bounds: Ints, moment: Ints) -> Ints:
    """Rows of the sightings of each moment (N, MOST_PER_MOMENT), -1 where there are fewer; spread if more."""
    start, count = bounds[moment][:, None], np.diff(bounds)[moment][:, None]
    slot = np.arange(MOST_PER_MOMENT)[None, :]
    spread = np.where(count > MOST_PER_MOMENT, slot * count // MOST_PER_MOMENT, slot)
    return np.where(slot < count, start + spread, -1)


def _expected(asked: Stretches, seen: Places) -> Floats:
    """Where the sighting asked should be at the later moment, in the sensor's frame."""
    sensor = seen.T_odometry_sensor[asked.moment]
    offset = seen.point_m[asked.asked] - sensor[:, :2]
    cosine, sine = np.cos(sensor[:, 2]), np.sin(sensor[:, 2])
    return np.column_stack(
        [cosine * offset[:, 0] + sine * offset[:, 1], cosine * offset[:, 1] - sine * offset[:, 0]]
    )

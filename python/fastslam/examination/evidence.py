"""Which reading of the numbers of a log makes its short stretches fit, and how decisive that is."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Literal, TypeAlias

import numpy as np

from ..log import Bools
from .hypotheses import DEGREE, Hypothesis
from .stretches import BLOCKS, Bench, Stretches, Trial, every, only_used

Kind: TypeAlias = Literal[
    "mirrored",
    "turned",
    "mirrored-turned",
    "turn-sign",
    "turn-unit",
    "speed-sign",
    "speed-unit",
    "bearing-unit",
    "delay",
]

SCREENED = 5
"""One in so many questions decides whether a reading is worth trying on all."""
LEAST_QUESTIONS = 60
"""So many sightings must tell two readings apart."""
TELLING = 3.0
"""Readings differ where what they expect is this many standard deviations of a sighting apart."""
BAD_FIT = 0.6
"""Mean cost, from 0 to 1, from which on a log does not fit as it stands. Sound ones come to 0.78 at most,
where no other reading costs less than 0.9 of that."""
BETTER = 0.7
"""Another reading must cost less than this share of what the log costs as it stands."""
LEAST_BLOCKS = 3
AGREEING_BLOCKS = 0.8
"""Share of the parts of the log, at least LEAST_BLOCKS, in which the other reading must be the better one."""
EQUALLY_GOOD = 0.05
"""Readings whose costs differ by less cannot be told apart."""

FEET_M, MILES_PER_HOUR_M_PER_S = 0.3048, 0.44704
SPEED_UNITS = (1e3, 1e2, 1 / FEET_M, 3.6, 1 / 3.6, FEET_M, MILES_PER_HOUR_M_PER_S, 1e-2, 1e-3)
TURN_UNITS = (DEGREE, 1 / DEGREE)
DELAYS_S = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.8, 1.0, 1.3, 1.6, 2.0)
OFFSETS_DEGREES = (180, 90, -90, 30, 60, 120, 150, -30, -60, -120, -150)


@dataclass(frozen=True)
class Reading:
    """A hypothesis and its kind; of equally good ones the earlier is named first."""

    kind: Kind
    hypothesis: Hypothesis


READINGS: tuple[Reading, ...] = (
    Reading("mirrored", Hypothesis(bearing_sign=-1)),
    Reading("turn-sign", Hypothesis(turn_gain=-1.0)),
    *(Reading("turned", Hypothesis(bearing_offset_rad=DEGREE * angle)) for angle in OFFSETS_DEGREES),
    Reading("speed-sign", Hypothesis(speed_gain=-1.0)),
    *(
        Reading("mirrored-turned", Hypothesis(bearing_sign=-1, bearing_offset_rad=DEGREE * angle))
        for angle in (90, -90, 180)
    ),
    Reading("bearing-unit", Hypothesis(bearing_unit=DEGREE)),
    *(Reading("turn-unit", Hypothesis(turn_gain=gain)) for gain in TURN_UNITS),
    *(Reading("speed-unit", Hypothesis(speed_gain=gain)) for gain in SPEED_UNITS),
    *(Reading("delay", Hypothesis(delay_s=sign * delay_s)) for delay_s in DELAYS_S for sign in (1, -1)),
)


@dataclass(frozen=True)
class Explanation:
    """The reading that fits, those that fit as well, and the shares of sightings found again."""

    reading: Reading
    others: tuple[Reading, ...]
    questions: int
    """Sightings that tell the reading from the log as it stands."""
    found_as_is: float
    found: float


def explain(bench: Bench) -> Explanation | None:
    """The reading that fits decisively better than the numbers as they stand; None where there is none."""
    if len(bench.asked.asked) < LEAST_QUESTIONS:
        return None
    as_is = bench.trial()
    cost_of: dict[Reading, float] = {}
    for reading in _worth_trying(bench):
        trial = bench.trial(reading.hypothesis)
        if _decisive(as_is, trial, bench.asked):
            cost_of[reading] = float(np.mean(trial.cost))
    if not cost_of:
        return None
    least = min(cost_of.values())
    equal = [reading for reading, cost in cost_of.items() if cost <= least + EQUALLY_GOOD]
    chosen = min((reading for reading in equal if reading.kind == equal[0].kind), key=cost_of.__getitem__)
    chosen = _refined(bench, chosen, cost_of[chosen])
    trial = bench.trial(chosen.hypothesis)
    telling = _telling(as_is, trial)
    return Explanation(
        reading=chosen,
        others=_one_of_each_kind(equal, cost_of, besides=chosen.kind),
        questions=int(telling.sum()),
        found_as_is=float(np.mean(as_is.cost[telling] < 1.0)),
        found=float(np.mean(trial.cost[telling] < 1.0)),
    )


def _worth_trying(bench: Bench) -> Iterator[Reading]:
    """Readings that are not clearly worse on some of the questions; most are, on a sound log all."""
    sightings, asked = only_used(bench.sightings, every(bench.asked, SCREENED))
    some = replace(bench, sightings=sightings, asked=asked)
    as_is = some.trial()
    for reading in READINGS:
        trial = some.trial(reading.hypothesis)
        telling = _telling(as_is, trial)
        before, after = as_is.cost[telling], trial.cost[telling]
        if len(before) and after.mean() < before.mean():
            yield reading


def can_tell(bench: Bench, hypothesis: Hypothesis) -> bool:
    """Whether the log could show that a hypothesis is wrong, were it wrong."""
    return int(_telling(bench.trial(), bench.trial(hypothesis)).sum()) >= LEAST_QUESTIONS


def _telling(as_is: Trial, other: Trial) -> Bools:
    """The questions that two readings answer differently."""
    apart_m = np.hypot(*(as_is.expected_m - other.expected_m).T)
    return np.asarray(apart_m > TELLING * as_is.noise_m)


def _decisive(as_is: Trial, other: Trial, asked: Stretches) -> bool:
    """Whether the log does not fit as it stands, the other reading does, and all parts of the log say so."""
    telling = _telling(as_is, other)
    if int(telling.sum()) < LEAST_QUESTIONS:
        return False
    before, after = as_is.cost[telling], other.cost[telling]
    if before.mean() < BAD_FIT or after.mean() > BETTER * before.mean():
        return False
    counts = np.bincount(asked.block[telling], minlength=BLOCKS)
    gains = np.bincount(asked.block[telling], before - after, minlength=BLOCKS)
    used = counts >= LEAST_QUESTIONS / BLOCKS
    return int(used.sum()) >= LEAST_BLOCKS and float(np.mean(gains[used] > 0)) >= AGREEING_BLOCKS


def _refined(bench: Bench, reading: Reading, cost: float) -> Reading:
    """The reading with its angle or delay tuned; an angle within 3 degrees of a right one becomes that."""
    steps: tuple[float, ...] = ()
    if reading.kind in ("turned", "mirrored-turned"):
        name, steps = "bearing_offset_rad", (15 * DEGREE, 5 * DEGREE, 2 * DEGREE)
    elif reading.kind == "delay":
        name, steps = "delay_s", (0.1, 0.05, 0.02)
    best = reading.hypothesis
    for step in steps:
        for change in (step, -step):
            tried = replace(best, **{name: getattr(best, name) + change})
            tried_cost = float(np.mean(bench.trial(tried).cost))
            if tried_cost < cost:
                best, cost = tried, tried_cost
                break
    right = np.round(best.bearing_offset_rad / (np.pi / 2)) * (np.pi / 2)
    if steps and abs(best.bearing_offset_rad - right) < 3 * DEGREE:
        best = replace(best, bearing_offset_rad=float(right))
    return replace(reading, hypothesis=best)


def _one_of_each_kind(
    equal: list[Reading], cost_of: dict[Reading, float], *, besides: Kind
) -> tuple[Reading, ...]:
    kinds = [kind for kind in dict.fromkeys(reading.kind for reading in equal) if kind != besides]
    return tuple(
        min((reading for reading in equal if reading.kind == kind), key=cost_of.__getitem__) for kind in kinds
    )

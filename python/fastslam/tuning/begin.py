"""Where to begin: which turn gain, delay and distance gain make short stretches of the log fit best.

With unknown identities a wrong start ruins the identities. The score is that of the examination of a log
(`examination.stretches`): sightings of one moment, moved by the odometry, against those of a moment later.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..dead_reckoning import DeadReckoning, turning_points
from ..examination.hypotheses import AS_IS, Hypothesis
from ..examination.stretches import Bench, every, only_used, stretches
from ..log import Floats, Log

TURN_GAINS = (0.5, 0.57, 0.65, 0.75, 0.87, 1.0, 1.15, 1.33, 1.5, 1.75, 2.0)
SPEED_GAINS = (0.8, 0.87, 0.93, 1.0, 1.07, 1.15, 1.25)
DELAYS_S = (-1.0, -0.7, -0.5, -0.35, -0.2, -0.1, 0.0, 0.1, 0.2, 0.35, 0.5, 0.7, 1.0)
SWEEPS = 2
LEAST_GAIN = 10.0
"""So many nats a hypothesis must gain to be begun with."""
LEAST_QUESTIONS = 60
CUT_SQUARED = 12.0
MOST_CANDIDATES = 40_000
"""So many candidates, or fewer, are held against what is asked."""


@dataclass(frozen=True)
class Tried:
    """A hypothesis and how many nats the stretches gain by it over the numbers as they stand."""

    name: str
    value: float
    gain: float


@dataclass(frozen=True)
class Beginning:
    """The hypothesis to begin with, and everything that was tried."""

    hypothesis: Hypothesis
    tried: tuple[Tried, ...]


def beginning(log: Log, config: Mapping[str, Any], wide: Floats) -> Beginning:
    """The best start, coordinate by coordinate, SWEEPS times over; `wide` (2,) is the noise of sightings."""
    asked = stretches(log.sightings)
    if len(asked.asked) < LEAST_QUESTIONS:
        return Beginning(AS_IS, ())
    sensor = {**config["sensor"], "range_std_m": float(wide[0]), "bearing_std_rad": float(wide[1])}
    asked = every(asked, 1 + len(asked.first) // MOST_CANDIDATES)
    used, asked = only_used(log.sightings, asked)
    controls = turning_points(log.controls, config["motion"])
    bench = Bench(used, sensor, DeadReckoning(controls, config["motion"]), asked)
    best, nats = AS_IS, {AS_IS: nats_of(bench, AS_IS)}
    for _ in range(SWEEPS):
        for name, values in (("turn_gain", TURN_GAINS), ("delay_s", DELAYS_S), ("speed_gain", SPEED_GAINS)):
            here = [_with(best, name, value) for value in values]
            nats |= {tried: nats_of(bench, tried) for tried in here if tried not in nats}
            found = max(here, key=nats.__getitem__)
            best = found if nats[found] > nats[best] + LEAST_GAIN else best
    alone = tuple(
        Tried(name, getattr(one, name), gain - nats[AS_IS])
        for one, gain in nats.items()
        for name in ("turn_gain", "delay_s", "speed_gain")
        if _with(AS_IS, name, getattr(one, name)) == one and one != AS_IS
    )
    return Beginning(best, alone)


def nats_of(bench: Bench, hypothesis: Hypothesis) -> float:
    """Log-likelihood of the answers, as of normal errors that are cut, one for each sighting asked about.

    Questions about one sighting at several later moments are not independent: they count once together.
    """
    return float(nats_by_part(bench, hypothesis).sum())


def nats_by_part(bench: Bench, hypothesis: Hypothesis) -> Floats:
    """The same for each part of the log, by time, that asks anything. Shape: (P,)."""
    cost, part = bench.trial(hypothesis).cost, bench.asked.block
    once = len(np.unique(bench.asked.asked)) / max(len(cost), 1)
    asks = np.bincount(part) > 0
    return np.asarray(-0.5 * CUT_SQUARED * once * np.bincount(part, cost)[asks])


def _with(hypothesis: Hypothesis, name: str, value: float) -> Hypothesis:
    changes: dict[str, Any] = {name: value}
    return replace(hypothesis, **changes)

"""Trees of one moment in a map: a real forest, and an orchard whose rows are regular."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np
from fastslam.evaluation.align import wrap_angle
from fastslam.localisation import FEWEST_MATCHED, SURE
from fastslam.placement import Constellation, View, charted, odds_of, placements

Floats = np.ndarray
TREES, MISSING, FALSE = 10, 3, 2
RIGHT_M, RIGHT_RAD = 0.5, 0.1


@dataclass(frozen=True)
class Trial:
    """What a robot sees, in its own frame, and where it is."""

    seen_m: Floats
    T_map_robot: Floats
    reach_m: float


@dataclass(frozen=True)
class Outcome:
    """How many trials had the likeliest place right, were sure, were sure and wrong."""

    trials: int
    right: int
    sure: int
    wrong: int

    def row(self, name: str) -> str:
        shown = [f"{100.0 * count / self.trials:.1f} %" for count in (self.right, self.sure)]
        return f"| {name} | {self.trials:,} | {shown[0]} | {shown[1]} | {self.wrong} |"


def degraded(local_m: Floats, pose: Floats, rng: np.random.Generator, std_m: float) -> Trial:
    """The nearest trees around a robot, three of ten missing and two false, with errors."""
    near = local_m[np.argsort(np.hypot(*local_m.T))[:TREES]]
    radius = float(np.hypot(*near.T).max())
    kept = near[rng.permutation(len(near))[MISSING:]]
    away, bearing = radius * np.sqrt(rng.random(FALSE)), rng.uniform(-np.pi, np.pi, FALSE)
    seen = np.concatenate([kept, np.column_stack([away * np.cos(bearing), away * np.sin(bearing)])])
    return Trial(seen + rng.normal(0.0, std_m, seen.shape), pose, 0.7 * radius)


def measured(chart_m: Floats, trials: Iterable[Trial], std_m: float, *, map_std_m: float) -> Outcome:
    """All trials in one map."""
    index = charted(constellation(chart_m, map_std_m))
    count = right = sure = wrong = 0
    for trial in trials:
        view = View(np.zeros((1, 3)), trial.reach_m, np.pi)
        found = placements(constellation(trial.seen_m, std_m), index, view)
        count += 1
        if not found:
            continue
        off = found[0].T_map_local - trial.T_map_robot
        turned = abs(float(wrap_angle(off[2])))
        good = bool(np.hypot(*off[:2]) < RIGHT_M and turned < RIGHT_RAD)
        certain = bool(odds_of(found)[0] >= SURE and found[0].matched >= FEWEST_MATCHED)
        right, sure, wrong = right + good, sure + certain, wrong + (certain and not good)
    return Outcome(count, right, sure, wrong)


def constellation(places_m: Floats, std_m: float) -> Constellation:
    count = len(places_m)
    return Constellation(places_m, np.full(count, std_m**2), np.full(count, -1, dtype=np.int64))


def orchard(jitter_m: float, rng: np.random.Generator, *, rows: int = 25, trees: int = 40) -> Floats:
    """Rows four metres apart with a tree every two metres, planted with a standard deviation."""
    grid = np.stack(np.meshgrid(2.0 * np.arange(trees), 4.0 * np.arange(rows)), axis=-1).reshape(-1, 2)
    return grid + rng.normal(0.0, jitter_m, grid.shape)


def anywhere(places_m: Floats, count: int, rng: np.random.Generator, std_m: float) -> Iterator[Trial]:
    """Robots at random in a map."""
    low, high = places_m.min(axis=0), places_m.max(axis=0)
    for _ in range(count):
        x, y, heading = *rng.uniform(low, high), rng.uniform(-np.pi, np.pi)
        turned = np.array([[np.cos(heading), -np.sin(heading)], [np.sin(heading), np.cos(heading)]])
        yield degraded((places_m - [x, y]) @ turned, np.array([x, y, heading]), rng, std_m)

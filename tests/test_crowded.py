"""Landmarks that stand for two things, as scans show."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from fastslam.log import Bools, Log
from fastslam.result import RunResult
from fastslam.runner import run
from fastslam.simulation import resolve_simulation, simulate
from fastslam.trust import CROWDED, against, doubts

PAIRS = 10
APART_M = 0.3


@cache
def drive(seed: int, clutter: float) -> tuple[Log, RunResult]:
    """A drive among ten pairs of things that stand beside each other, and as many that stand alone."""
    rng = np.random.default_rng(seed)
    grid = np.array([(9.0 * x, 9.0 * y) for x in range(5) for y in range(4)]) + rng.uniform(-2, 2, (20, 2))
    angle = rng.uniform(0, 2 * np.pi, PAIRS)
    second = grid[:PAIRS] + APART_M * np.column_stack([np.cos(angle), np.sin(angle)])
    world = {
        "seed": seed,
        "max_duration_s": 60.0,
        "world": {"layout": "explicit", "points_m": np.vstack([grid, second]).tolist()},
        "scan": {"identities": "none", "clutter_per_scan": clutter, "detection_probability": 0.8},
    }
    log = simulate(resolve_simulation(world))
    return log, run(log, {"seed": seed, "filter": {"particles": 30}, "association": {"mode": "unknown"}})


def of_pairs(result: RunResult) -> Bools:
    """Which landmarks (K,) have another one beside them, and come after it."""
    mean_m = result.landmarks.mean_m
    apart = np.hypot(*np.moveaxis(mean_m[:, None] - mean_m[None], -1, 0))
    return np.asarray((np.tril(apart < 2 * APART_M, -1) & (apart > 0)).any(axis=1))


def without(result: RunResult, left_out: Bools) -> RunResult:
    """The run with fewer landmarks in its map."""
    kept, marks = ~left_out, result.landmarks
    return replace(
        result,
        landmarks=replace(
            marks,
            ids=tuple(name for name, stays in zip(marks.ids, kept, strict=True) if stays),
            **{
                name: value[kept]
                for name, value in vars(marks).items()
                if isinstance(value, np.ndarray) and len(value) == len(kept)
            },
        ),
    )


def ratio(result: RunResult, log: Log) -> float:
    return next(doubt.ratio for doubt in doubts(result, log) if doubt.rule == CROWDED)


@pytest.mark.parametrize("clutter", [0.0, 1.0])
@pytest.mark.parametrize("seed", [1, pytest.param(2, marks=pytest.mark.slow), 3])
def test_a_map_with_one_landmark_for_two_things_is_told_and_one_with_both_is_not(
    seed: int, clutter: float
) -> None:
    log, result = drive(seed, clutter)
    second = of_pairs(result)
    assert second.sum() >= 8, "the pairs in view were mapped"
    assert ratio(result, log) < 1.0
    fewer = without(result, second)
    assert ratio(fewer, log) >= 1.0
    assert any("scans show two things" in sentence for sentence in against(doubts(fewer, log)))


def test_what_is_missing_far_from_all_others_is_not_taken_for_crowded() -> None:
    log, result = drive(1, 0.0)
    alone = np.zeros(len(result.landmarks.ids), dtype=np.bool_)
    second = of_pairs(result)
    mean_m = result.landmarks.mean_m
    first = (np.hypot(*np.moveaxis(mean_m[:, None] - mean_m[second], -1, 0)) < 2 * APART_M).any(axis=1)
    alone[np.flatnonzero(~first & ~second)[::2]] = True
    assert alone.sum() >= 3 and ratio(without(result, alone), log) == 0.0

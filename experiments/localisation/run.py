"""Measures starts from anywhere: ten trees of a forest and of an orchard; Victoria Park, UTIAS.

    python experiments/localisation/run.py [--trials 1000] [--starts 10] [--workers N]
        [--out docs/localisation.md]

`FASTSLAM_DATA` names the folder of the data sets. With `--out` the table takes the place of the one that the
page has between its marks.
"""

from __future__ import annotations

import argparse
import math
import os
import sys
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import fastslam
import numpy as np
from constellations import Floats, Outcome, anywhere, degraded, measured, orchard
from fastslam import Log, Map
from fastslam.evaluation.align import align_points
from fastslam.localisation import FIRST_WINDOW_S, WINDOW_GROWTH, Search, between
from fastslam.resultfiles import write_measured
from fastslam.runner import configure
from scipy.spatial import cKDTree

sys.path.insert(0, str(Path(__file__).parent.parent / "maps"))
import forest as woods

DATA = Path(os.environ.get("FASTSLAM_DATA", "FASTSLAM_DATA"))
UNKNOWN: dict[str, Any] = {"association": {"mode": "unknown"}}
MAPPED = 1200
"""Frames of the forest before this one make its map."""
JITTERS_M = (0.0, 0.05, 0.1, 0.2, 0.4)
PARK_MAP_S, PARK_BEGIN_S = 1200.0, 1190.0


def forest_trials(count: int) -> Outcome:
    """Ten trees of later frames that are within five metres of the earlier path."""
    forest = woods.load(DATA / "oxford_forest_trees")
    poses = forest.T_world_robot
    away = cKDTree(poses[:MAPPED, :2]).query(poses[:, :2])[0]
    later = np.flatnonzero((away < 5.0) & (np.arange(len(poses)) >= MAPPED))
    rng = np.random.default_rng(1)
    frames = rng.choice(later, count)
    trials = (degraded(forest.trees_m[frame], poses[frame], rng, 0.0) for frame in frames)
    return measured(woods.reference_m(forest, MAPPED), trials, 0.1, map_std_m=0.05)


def orchard_trials(jitter_m: float, count: int) -> Outcome:
    rng = np.random.default_rng(2)
    places_m = orchard(jitter_m, rng)
    return measured(places_m, anywhere(places_m, count, rng, 0.05), 0.05, map_std_m=0.03)


@dataclass(frozen=True)
class Case:
    """A log, a map, and where the robot was in it: poses (T, 3) at stamps (T,)."""

    log: Log
    chart: Map
    stamp_s: Floats
    T_map_robot: Floats
    right_m: float
    limit_s: float


@cache
def park() -> Case:
    """Victoria Park: the map of the first twenty minutes; the whole run is the reference.

    Both maps are bent against each other by up to two metres at the edge: three count as right.
    """
    log = fastslam.load(DATA / "victoria_park")
    first = float(log.controls.stamp_s[0])
    chart = fastslam.run(between(log, -math.inf, first + PARK_MAP_S), UNKNOWN).map
    smoothed = fastslam.run(log, UNKNOWN).smoothed
    assert smoothed is not None
    return Case(log, chart, smoothed.stamp_s, smoothed.T_world_robot, 3.0, 60.0)


@cache
def robot(number: int, robot: int) -> Case:
    """UTIAS: the map of robot 1; the run of another robot with known names, laid on it by these."""
    folder = DATA / f"utias_mrclam/MRCLAM_Dataset{number}"
    chart = fastslam.run(fastslam.load(folder, robot=1)).map
    log = fastslam.load(folder, robot=robot)
    result = fastslam.run(log)
    assert result.smoothed is not None
    ours = dict(zip(result.landmarks.ids, result.landmarks.mean_m, strict=True))
    theirs = dict(zip(chart.landmarks.ids, chart.landmarks.mean_m, strict=True))
    both = sorted(set(ours) & set(theirs))
    pairs = [np.array([side[name] for name in both]) for side in (ours, theirs)]
    poses = align_points(*pairs).apply_poses(result.smoothed.T_world_robot)
    return Case(log, chart, result.smoothed.stamp_s, poses, 0.5, 120.0)


def start(case: Case, begin_s: float) -> tuple[bool, bool, bool]:
    """Whether the likeliest place is right at the end, whether it was sure by then, and sure and wrong."""
    part = between(case.log, begin_s, begin_s + case.limit_s)
    config = configure(part, UNKNOWN)
    search = Search(case.chart, config)
    window_s, sure = FIRST_WINDOW_S, False
    while not sure and window_s <= case.limit_s:
        seen = between(part, -math.inf, begin_s + window_s)
        window_s *= WINDOW_GROWTH
        if len(seen.sightings.stamp_s) == 0:
            continue
        local = fastslam.run(seen, config)
        sure = search.look(local.landmarks, local.path.T_world_robot, seen.sightings.range_m)
    if not search.modes:
        return False, sure, sure
    began_s = float(part.controls.stamp_s[0])
    at = np.array([np.interp(began_s, case.stamp_s, column) for column in case.T_map_robot[:, :2].T])
    right = bool(np.hypot(*(search.modes[0].T_map_robot[:2] - at)) < case.right_m)
    return right, sure, sure and not right


def park_start(begin_s: float) -> tuple[bool, bool, bool]:
    return start(park(), begin_s)


def robot_start(number: int, other: int, fraction: float) -> tuple[bool, bool, bool]:
    case = robot(number, other)
    stamps = case.log.controls.stamp_s
    return start(case, float(stamps[0] + fraction * (stamps[-1] - stamps[0] - case.limit_s)))


def row(name: str, found: Sequence[tuple[bool, bool, bool]]) -> str:
    right, sure, wrong = np.array(found).sum(axis=0)
    return f"| {name} | {len(found)} | {right / len(found):.0%} | {sure / len(found):.0%} | {wrong} |"


def table(pool: ProcessPoolExecutor, trials: int, starts: int) -> str:
    rng = np.random.default_rng(3)
    forest = pool.submit(forest_trials, trials)
    orchards = [pool.submit(orchard_trials, jitter, trials // 5) for jitter in JITTERS_M]
    begins = PARK_BEGIN_S + rng.uniform(10.0, 290.0, starts)
    parked = [*pool.map(park_start, begins)]
    lines = [
        "| where | starts | likeliest place right | sure | sure and wrong |",
        "|---|---|---|---|---|",
        forest.result().row("forest, ten trees of one moment, 3 missing, 2 false"),
    ]
    for jitter, outcome in zip(JITTERS_M, orchards, strict=True):
        lines.append(outcome.result().row(f"orchard, the same, trees planted to {jitter:g} m"))
    lines.append(row("Victoria Park, map of 20 minutes, 60 s in the last 6", parked))
    for number in (1, 2):
        robots, fractions = rng.integers(2, 6, starts).tolist(), rng.random(starts).tolist()
        found = [*pool.map(robot_start, [number] * starts, robots, fractions)]
        lines.append(row(f"UTIAS {number}, map of robot 1, 120 s of robots 2 to 5", found))
    return "\n".join(lines) + "\n"


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--trials", type=int, default=1000)
    parser.add_argument("--starts", type=int, default=10)
    parser.add_argument("--workers", type=int, default=None)
    parser.add_argument("--out", type=Path, default=None, help="a page with the marks of the table")
    options = parser.parse_args(arguments)
    if not (DATA / "oxford_forest_trees").is_dir():
        print(f"{DATA / 'oxford_forest_trees'} is no folder: set FASTSLAM_DATA", file=sys.stderr)
        return 2
    with ProcessPoolExecutor(options.workers) as pool:
        text = table(pool, options.trials, options.starts)
    print(text)
    if options.out is not None:
        write_measured(options.out, text)
    return 0


if __name__ == "__main__":
    sys.exit(main())

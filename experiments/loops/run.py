"""Measures loops without identities: the default, and beside it the plain filter, in simulated worlds.

    python experiments/loops/run.py [--seeds 10] [--first 201] [--workers N] [--out docs/loops.md]

Every seed is another world, another path noise and another filter; the noise is told as it is.
"""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import fastslam
import numpy as np
from fastslam.evaluation import evaluate
from fastslam.resultfiles import write_atomically
from fastslam.simulation import resolve_simulation, simulate


def _three_laps(view_deg: float, *, yaw_rad: float = 0.0) -> dict[str, Any]:
    sensor = {"field_of_view_rad": math.radians(view_deg), "mounting": {"yaw_rad": yaw_rad}}
    return {"trajectory": {"laps": 3}, "sensor": sensor}


WORLDS: dict[str, dict[str, Any]] = {
    "preset `loop`, five laps": {},
    "three laps, 90 degrees": _three_laps(90.0),
    "three laps, 120 degrees": _three_laps(120.0),
    "three laps, 162 degrees": _three_laps(162.0),
    "three laps, 180 degrees": _three_laps(180.0),
    "three laps, 120 degrees, facing back": _three_laps(120.0, yaw_rad=math.pi),
    "three laps, 180 degrees, facing back": _three_laps(180.0, yaw_rad=math.pi),
    "three laps, 120 degrees, facing aside": _three_laps(120.0, yaw_rad=0.5 * math.pi),
}
FILTERS: dict[str, dict[str, Any]] = {
    "default": {},
    "plain": {"filter": {"rejuvenation": {"every_steps": 0}}},
}


@dataclass(frozen=True)
class Run:
    """What counts of one run."""

    false_landmarks: float
    map_m: float
    live_m: float
    smoothed_m: float
    is_doubted: bool
    """Whether the verdict speaks of a map that is there twice."""
    seconds: float
    """Of the processor, learning included."""

    @property
    def is_right(self) -> bool:
        """Whether no landmark, or a single one, matches no true one."""
        return self.false_landmarks <= 1.0


def measure(world: str, filter: str, seed: int) -> Run:
    """One run without identities."""
    log = simulate(resolve_simulation({"seed": seed}, WORLDS[world], preset="loop"))
    began_s = time.process_time()
    settings = {"seed": seed, "association": {"mode": "unknown"}, **FILTERS[filter]}
    result = fastslam.run(log, settings, auto=None if filter == "default" else False)
    seconds = time.process_time() - began_s
    found = evaluate(result, log)
    return Run(
        false_landmarks=float(found["landmarks"]) - float(found["landmark_matched"]),
        # No landmark that matches a true one is as wrong as can be.
        map_m=math.inf if found["landmark_rmse_m"] is None else float(found["landmark_rmse_m"]),
        live_m=float(found["ate_rmse_m"]),
        smoothed_m=float(found["smoothed_ate_rmse_m"]),
        is_doubted=any("there twice" in said for said in result.verdict),
        seconds=seconds,
    )


def row(world: str, filter: str, runs: Sequence[Run], plain: Sequence[Run]) -> str:
    """Medians with the worst in brackets; how many are right, and of how many the verdict says otherwise."""
    right = [run for run in runs if run.is_right]
    wrong = [run for run in runs if not run.is_right]

    def cell(name: str, places: int) -> str:
        values = [getattr(run, name) for run in runs]
        return f"{np.median(values):.{places}f} ({max(values):.{places}f})"

    def doubted(some: Sequence[Run]) -> str:
        return f"{sum(run.is_doubted for run in some)} of {len(some)}"

    ratio = np.median([run.seconds for run in runs]) / np.median([run.seconds for run in plain])
    cells = [world, filter, f"{len(right)} of {len(runs)}", cell("false_landmarks", 0), cell("map_m", 3)]
    cells += [cell("live_m", 2), cell("smoothed_m", 2), doubted(wrong), doubted(right), f"{ratio:.1f}"]
    return f"| {' | '.join(cells)} |"


PAGE = """# Loops without identities

Made by `python experiments/loops/run.py --out docs/loops.md`: loops of 280 m among 200 landmarks, sensors of
several fields of view, noise told as it is, no identities, 100 particles. "Default" is no setting at all:
paths are drawn [by need](rejuvenation.md#when-paths-are-drawn); "plain" is
`filter.rejuvenation.every_steps: 0`. Seeds {first} to {last}, each another world, path
and filter, none of which was looked at while the rules were made, but for the search for what is there
twice: it was made with seeds 203 to 206 in view. Medians, the worst in brackets; false landmarks;
metres after rigid alignment ("inf": nothing matches).

A run is right when at most one landmark matches no true one. "Noticed" are wrong runs whose verdict says that
part of the map is [there twice](health.md#verdict), "false alarms" right ones of which it says so. Wrong runs
that are not noticed have part of the map twice, or each landmark once but some of them more than half a metre
off.
A doubted run is learned from; time is that of the processor, all runs counted.

| world | filter | right | false | map [m] | live [m] | smoothed [m] | noticed | false alarms | time / plain |
|---|---|---|---|---|---|---|---|---|---|
{rows}
"""


def main() -> None:
    """Measures, then prints or writes."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--first", type=int, default=201)
    parser.add_argument("--workers", type=int)
    parser.add_argument("--out", type=Path, help="page to write; without it the page is printed")
    options = parser.parse_args()
    last = options.first + options.seeds - 1
    with ProcessPoolExecutor(options.workers) as pool:
        waiting = {
            (world, filter): [
                pool.submit(measure, world, filter, seed) for seed in range(options.first, last + 1)
            ]
            for world in WORLDS
            for filter in FILTERS
        }
        runs = {case: [found.result() for found in futures] for case, futures in waiting.items()}
    rows = [row(world, filter, found, runs[world, "plain"]) for (world, filter), found in runs.items()]
    page = PAGE.format(first=options.first, last=last, rows="\n".join(rows))
    if options.out is None:
        print(page)
    else:
        write_atomically(options.out, page)


if __name__ == "__main__":
    main()

"""Measures the lawn-mower test: 1,000 landmarks swept in lanes, then again across.

    python experiments/lawn_mower/run.py [--seeds 10] [--workers N] [--out docs/lawn-mower.md]

The log is `fastslam simulate --preset lawn-mower`: 6,760 steps of about one metre in lanes of 14 m with 10 m
of range, noise 0.1 m and 1 degree, odometry 0.02 m and 0.1 degrees a step.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

import fastslam
import numpy as np
from fastslam.evaluation import evaluate
from fastslam.resultfiles import write_atomically
from fastslam.simulation import resolve_simulation, simulate

ANEW = {"every_steps": 200, "growth": 0.1, "spread": 0.5}
OFTEN = {"every_steps": 100, "growth": 0.03, "spread": 0.5}
"""Without identities a missed loop must be closed before much has been associated on a wrong path."""
CASES: dict[str, dict[str, Any]] = {
    "known, 250 particles": {"filter": {"particles": 250}},
    "known, 30 particles, paths drawn anew": {"filter": {"particles": 30, "rejuvenation": ANEW}},
    "unknown, 250 particles, plain": {
        "filter": {"particles": 250, "rejuvenation": {"every_steps": 0}},
        "association": {"mode": "unknown"},
    },
    "unknown, defaults": {"association": {"mode": "unknown"}},
    "unknown, 30 particles, paths drawn anew, loops left open": {
        "filter": {"particles": 30, "rejuvenation": ANEW | {"closing_odds": 0.0}},
        "association": {"mode": "unknown"},
    },
    "unknown, 30 particles, paths drawn anew often": {
        "filter": {"particles": 30, "rejuvenation": OFTEN},
        "association": {"mode": "unknown"},
    },
}
COLUMNS = {
    "ate_rmse_m": "live path [m]",
    "smoothed_ate_rmse_m": "smoothed path [m]",
    "landmark_rmse_m": "map [m]",
    "landmark_matched": "found",
}


def measure(name: str, seed: int) -> list[float]:
    """The metrics of one run, and the seconds of computing per 1,000 steps."""
    log = simulate(resolve_simulation({"seed": seed}, preset="lawn-mower"))
    auto = None if name.endswith("defaults") else False
    result = fastslam.run(log, {"seed": seed, **CASES[name]}, auto=auto)
    metrics = evaluate(result, log)
    per_thousand_s = 1000.0 * result.filter_seconds / len(result.steps.stamp_s)
    return [*(float(metrics[column]) for column in COLUMNS), per_thousand_s]


def row(name: str, runs: Sequence[Sequence[float]]) -> str:
    """Medians with the worst in brackets; how many runs stay within a metre."""
    table = np.array(runs)
    cells = [f"{np.median(column):.2f} ({column.max():.2f})" for column in table[:, :3].T]
    found, seconds = np.median(table[:, 3]), np.median(table[:, 4])
    within = int(np.count_nonzero(table[:, 0] <= 1.0))
    return (
        f"| {name} | {' | '.join(cells)} | {found:.0f} of 1000 ({table[:, 3].min():.0f}) "
        f"| {within} of {len(runs)} | {seconds:.2f} |"
    )


PAGE = """# The lawn-mower test

Made by `python experiments/lawn_mower/run.py --out docs/lawn-mower.md`: a robot sweeps 1,000 landmarks in
lanes of 14 m with 10 m of range, then again across, in 6,760 steps; every seed is another world, another path
noise and another filter. FastSLAM 2.0, medians over seeds 1 to {seeds} and the worst in brackets, metres
after rigid alignment. "Paths drawn anew" is [`filter.rejuvenation`](rejuvenation.md): every 200 steps,
growth 0.1, spread 0.5; "often" every 100 steps, growth 0.03, and [missed loops are
closed](rejuvenation.md#closing-missed-loops). "Defaults" is no setting at all: 100 particles, paths drawn [by
need](rejuvenation.md#when-paths-are-drawn).

| identities | live path | smoothed path | map | found | live within 1 m | seconds per 1,000 steps |
|---|---|---|---|---|---|---|
{rows}
"""


def main() -> None:
    """Measures, then prints or writes."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--workers", type=int)
    parser.add_argument("--out", type=Path, help="page to write; without it the page is printed")
    options = parser.parse_args()
    with ProcessPoolExecutor(options.workers) as pool:
        waiting = {
            name: [pool.submit(measure, name, seed) for seed in range(1, options.seeds + 1)] for name in CASES
        }
        rows = [row(name, [found.result() for found in runs]) for name, runs in waiting.items()]
    page = PAGE.format(seeds=options.seeds, rows="\n".join(rows))
    if options.out is None:
        print(page)
    else:
        write_atomically(options.out, page)


if __name__ == "__main__":
    main()

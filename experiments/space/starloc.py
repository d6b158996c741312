"""Measures runs in space without odometry: STAR-loc with its gyro and without, and simulated walks.

    python experiments/space/starloc.py [--seeds 3] [--workers N] [--out docs/space-without-odometry.md]

STAR-loc is read from the folder that the environment variable FASTSLAM_DATA names (default:
`../shared/data`). With `--out` the table takes the place of that which the page has between its marks.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import numpy as np
from fastslam.resultfiles import write_measured
from fastslam.space import evaluate, load, run
from fastslam.space.simulation import simulate
from fastslam.space.verdict import is_unsound

RUNS = (
    ("loop-2d_s4", "wandering"),
    ("loop-2d-v2_s5", "wandering"),
    ("loop-2d-fast_s1", "gyro"),
    ("loop-2d-fast_s1", "wandering"),
    ("simulated", "gyro"),
    ("simulated", "wandering"),
)
FIGURES = {
    "path.live.aligned.position_rmse_m": "live path [m]",
    "path.smoothed.aligned.position_rmse_m": "smoothed path [m]",
    "map.aligned.rmse_m": "map [m]",
}


def measure(task: tuple[str, str, int]) -> list[float]:
    """The figures of one run, how surely landmarks are held, and whether it is said to be lost."""
    name, motion, seed = task
    if name == "simulated":
        log = simulate(motion=motion, seed=seed)
    else:
        log = load(Path(os.environ.get("FASTSLAM_DATA", "../shared/data")) / "starloc" / "data" / name)
    result = run(log, {"seed": seed, "motion": {"kind": motion}})
    metrics = evaluate(result, log)
    held = float("nan") if result.hold is None else result.hold.shape_std_m
    return [*(float(metrics[figure] or 0.0) for figure in FIGURES), held, float(is_unsound(result))]


def table(rows: list[np.ndarray]) -> str:
    """Medians over the seeds with the worst in brackets, and how many runs are said to be lost."""
    heads = ["log", "gyro", *FIGURES.values(), "landmarks held to [m]", "said to be lost"]
    lines = [f"| {' | '.join(heads)} |", "|---" * len(heads) + "|"]
    for (name, motion), runs in zip(RUNS, rows, strict=True):
        cells = [f"{np.median(column):.3f} ({column.max():.3f})" for column in runs[:, :-1].T]
        gyro = "yes" if motion == "gyro" else "no"
        lines.append(f"| {name} | {gyro} | {' | '.join(cells)} | {int(runs[:, -1].sum())} of {len(runs)} |")
    return "\n".join(lines) + "\n"


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--workers", type=int)
    parser.add_argument("--out", type=Path, help="a page with the marks of the table")
    options = parser.parse_args(arguments)
    tasks = [(*of, seed) for of in RUNS for seed in range(1, options.seeds + 1)]
    with ProcessPoolExecutor(options.workers) as pool:
        figures = np.array(list(pool.map(measure, tasks))).reshape(len(RUNS), options.seeds, -1)
    found = table(list(figures))
    print(found)
    if options.out is not None:
        write_measured(options.out, found)


if __name__ == "__main__":
    main()

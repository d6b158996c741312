"""Measures bearings alone beside ranges of 3 % with the same bearings: 60 landmarks of known names.

    python experiments/bearing_only/run.py [--first 1] [--seeds 5] [--workers N] [--unnamed] [--out PAGE]

With `--unnamed` the bearings come without names; the ranges beside them keep theirs.
With `--out` the table takes the place of that which the page has between its marks.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any

import fastslam
import numpy as np
from fastslam.evaluation import evaluate
from fastslam.resultfiles import write_measured
from fastslam.simulation import simulate

LANDMARKS = 60
SENSOR: dict[str, Any] = {"range_std_m": 0.3, "bearing_std_rad": 0.02, "max_range_m": 20.0}
"""3 % of 10 m, which is what most sightings of this world are away."""
FIGURES = {"ate_rmse_m": "live path", "smoothed_ate_rmse_m": "smoothed path", "landmark_rmse_m": "map"}


def measure(seed: int, unnamed: bool = False) -> list[list[float]]:
    """Errors of both sensors in the same world, and the share of landmarks found; a row for each sensor."""
    rows = []
    for model in ("bearing", "range_bearing"):
        log = simulate({"seed": seed, "world": {"count": LANDMARKS}, "sensor": {**SENSOR, "model": model}})
        mode = "unknown" if unnamed and model == "bearing" else "known"
        metrics = evaluate(fastslam.run(log, {"seed": seed, "association": {"mode": mode}}), log)
        names = (*FIGURES, "landmark_recall")
        rows.append([float(metrics[name]) for name in names])
    return rows


def table(runs: np.ndarray) -> str:
    """Medians with the worst in brackets."""
    head = f"| {len(runs)} worlds, median (worst) | bearings alone | with ranges | ratio |"
    lines = [head, "|---|---|---|---|"]
    for k, name in enumerate(FIGURES.values()):
        ours, theirs = runs[:, 0, k], runs[:, 1, k]
        cells = [f"{np.median(column):.3f} ({column.max():.3f}) m" for column in (ours, theirs)]
        ratio = ours / theirs
        lines.append(f"| {name} | {' | '.join(cells)} | {np.median(ratio):.2f} ({ratio.max():.2f}) |")
    found = [f"{100 * np.median(runs[:, s, -1]):.0f} ({100 * runs[:, s, -1].min():.0f}) %" for s in (0, 1)]
    lines.append(f"| landmarks found | {' | '.join(found)} | |")
    return "\n".join(lines) + "\n"


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--first", type=int, default=1, help="the first seed")
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--workers", type=int)
    parser.add_argument("--unnamed", action="store_true", help="bearings without names")
    parser.add_argument("--out", type=Path, help="a page with the marks of the table")
    options = parser.parse_args(arguments)
    with ProcessPoolExecutor(options.workers) as pool:
        seeds = range(options.first, options.first + options.seeds)
        found = table(np.array(list(pool.map(partial(measure, unnamed=options.unnamed), seeds))))
    print(found)
    if options.out is not None:
        write_measured(options.out, found)


if __name__ == "__main__":
    main()

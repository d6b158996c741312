"""Measures runs in space: Starry Night with defaults, and simulated rooms with the consistency of their maps.

    python experiments/space/run.py [--seeds 10] [--workers N] [--out docs/space.md]

Starry Night is read from the folder that the environment variable FASTSLAM_DATA names (default:
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
from fastslam.space.simulation import SENSORS, simulate

STARRY_NIGHT = "Starry Night"
FIGURES = {
    "path.live.aligned.position_rmse_m": ("live path [m]", "{:.3f}", 1.0),
    "path.live.aligned.rotation_rmse_rad": ("live turn [°]", "{:.2f}", 180.0 / np.pi),
    "path.smoothed.aligned.position_rmse_m": ("smoothed path [m]", "{:.3f}", 1.0),
    "path.smoothed.aligned.rotation_rmse_rad": ("smoothed turn [°]", "{:.2f}", 180.0 / np.pi),
    "map.aligned.rmse_m": ("map [m]", "{:.4f}", 1.0),
    "map.nees_per_number": ("map: NEES per number", "{:.2f}", 1.0),
}
"""Metrics, how they stand in the table, and the factor to that."""


def measure(task: tuple[str, int]) -> list[float]:
    """The figures of one run: of a log on disk, or of a room that the seed makes."""
    what, seed = task
    if what == STARRY_NIGHT:
        log = load(Path(os.environ.get("FASTSLAM_DATA", "../shared/data")) / "starry_night")
    else:
        log = simulate(sensor=what, seed=seed)
    metrics = evaluate(run(log, {"seed": seed}), log)
    return [float(metrics[name] or 0.0) * factor for name, (_, _, factor) in FIGURES.items()]


def table(rows: dict[str, np.ndarray]) -> str:
    """Medians over the seeds with the worst in brackets."""
    heads = [head for head, _, _ in FIGURES.values()]
    lines = [f"| log | {' | '.join(heads)} |", "|---|" + "---|" * len(heads)]
    for name, runs in rows.items():
        cells = [
            f"{form.format(np.median(column))} ({form.format(column.max())})"
            for column, (_, form, _) in zip(runs.T, FIGURES.values(), strict=True)
        ]
        lines.append(f"| {name} | {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--workers", type=int)
    parser.add_argument("--out", type=Path, help="a page with the marks of the table")
    options = parser.parse_args(arguments)
    logs = [STARRY_NIGHT, *SENSORS]
    tasks = [(log, seed) for log in logs for seed in range(1, options.seeds + 1)]
    with ProcessPoolExecutor(options.workers) as pool:
        figures = np.array(list(pool.map(measure, tasks))).reshape(len(logs), options.seeds, len(FIGURES))
    names = [STARRY_NIGHT, *(f"simulated, `{name}`" for name in SENSORS)]
    found = table(dict(zip(names, figures, strict=True)))
    print(found)
    if options.out is not None:
        write_measured(options.out, found)


if __name__ == "__main__":
    main()

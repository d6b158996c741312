"""Measures ranges alone: Plaza 1, and simulated beacons beside a sensor that sees bearings too.

    python experiments/range_only/run.py [--plaza-seeds 10] [--seeds 20] [--workers N]
        [--out docs/range-only.md]

`FASTSLAM_DATA` names the folder that holds `plaza1`. With `--out` the tables take the place of those that the
page has between its marks.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import cache
from pathlib import Path
from typing import Any

import fastslam
import numpy as np
from fastslam.evaluation import evaluate_run, pose_nees
from fastslam.log import Log
from fastslam.resultfiles import write_measured
from fastslam.simulation import simulate

WORLD: dict[str, Any] = {"world": {"count": 12}, "scan": {"period_s": 1.0}}
SENSOR: dict[str, Any] = {"range_std_m": 0.5, "bearing_std_rad": 0.02, "max_range_m": 100.0}
FOUND_M = 1.0
"""A beacon that is nearer to its place than this is not at the place of its mirror image."""


@cache
def plaza() -> Log:
    return fastslam.load(Path(os.environ["FASTSLAM_DATA"]) / "plaza1")


def measure_plaza(seed: int) -> list[float]:
    """Live error, the same without the first tenth of the log, smoothed error, error of the radios, NEES."""
    log = plaza()
    result = fastslam.run(log, {"seed": seed})
    found = evaluate_run(result, log)
    assert found.live is not None and found.smoothed is not None and found.landmarks is not None
    later = found.live.error_m[len(found.live.error_m) // 10 :]
    live_m, smoothed_m = found.live.aligned_m.rmse, found.smoothed.aligned_m.rmse
    assert log.truth_trajectory is not None
    nees = pose_nees(result.trajectory, log.truth_trajectory, position_only=True).nees
    radios_m = number(found.metrics["landmark_rmse_m"])
    return [live_m, float(np.sqrt(np.mean(later**2))), smoothed_m, radios_m, float(nees.mean()) / 2.0]


def measure_beacons(seed: int) -> list[float]:
    """Beacons at their places, live and smoothed error, and these where bearings are seen too."""
    errors: list[float] = []
    for model in ("range", "range_bearing"):
        log = simulate({"seed": seed, **WORLD, "sensor": {**SENSOR, "model": model}})
        result = fastslam.run(log, {"seed": seed})
        metrics = evaluate_run(result, log).metrics
        if model == "range":
            errors.append(float(beacons_found(result, log)))
        errors += [number(metrics["ate_rmse_m"]), number(metrics["smoothed_ate_rmse_m"])]
    return errors


def number(value: object) -> float:
    assert isinstance(value, float)
    return value


def beacons_found(result: fastslam.RunResult, log: Log) -> int:
    """How many lie near their places, the map turned as the smoothed path is."""
    truth = log.truth_landmarks
    assert truth is not None
    places = dict(zip(truth.names, truth.position_m, strict=True))
    transform = evaluate_run(result, log).T_truth_world
    assert transform is not None
    found_m = transform.apply_points(result.landmarks.mean_m)
    off_m = [np.hypot(*(at - places[name])) for name, at in zip(result.landmarks.ids, found_m, strict=True)]
    return int(np.count_nonzero(np.array(off_m) < FOUND_M))


def plaza_table(rows: np.ndarray) -> str:
    names = ("live, whole log", "live, without its first tenth", "smoothed", "radios")
    lines = [
        f"| {name} | {column.max():.2f} m | {column.min():.2f} m |"
        for name, column in zip(names, rows[:, :4].T, strict=True)
    ]
    lines.append(
        f"| NEES of the live position, per number | {rows[:, 4].max():.2f} | {rows[:, 4].min():.2f} |"
    )
    return f"| Plaza 1, {len(rows)} seeds | worst | best |\n|---|---|---|\n" + "\n".join(lines) + "\n"


def beacon_table(rows: np.ndarray) -> str:
    found, ours, theirs = rows[:, 0], rows[:, 1:3], rows[:, 3:5]
    worlds = f"{len(rows)} simulated worlds of {WORLD['world']['count']} beacons"
    heads = f"| {worlds}, median (worst) | ranges alone | with bearings | ratio |"
    lines = [heads, "|---|---|---|---|"]
    for k, name in enumerate(("live", "smoothed")):
        cells = [f"{np.median(table[:, k]):.2f} ({table[:, k].max():.2f}) m" for table in (ours, theirs)]
        ratio = ours[:, k] / theirs[:, k]
        lines.append(f"| {name} | {' | '.join(cells)} | {np.median(ratio):.2f} ({ratio.max():.2f}) |")
    whole = int(np.count_nonzero(found == WORLD["world"]["count"]))
    lines.append(f"| worlds with all beacons within {FOUND_M:g} m | {whole} of {len(rows)} | | |")
    return "\n".join(lines) + "\n"


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--plaza-seeds", type=int, default=10)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--workers", type=int, default=None)
    parser.add_argument("--out", type=Path, default=None, help="a page with the marks of the tables")
    options = parser.parse_args(arguments)
    data = Path(os.environ.get("FASTSLAM_DATA", "FASTSLAM_DATA"))
    if not (data / "plaza1").is_dir():
        print(f"{data / 'plaza1'} is no folder: set FASTSLAM_DATA", file=sys.stderr)
        return 2
    with ProcessPoolExecutor(options.workers) as pool:

        def measured(measure: Callable[[int], list[float]], seeds: int) -> np.ndarray:
            return np.array(list(pool.map(measure, range(1, seeds + 1))))

        tables = plaza_table(measured(measure_plaza, options.plaza_seeds))
        tables += "\n" + beacon_table(measured(measure_beacons, options.seeds))
    print(tables)
    if options.out is not None:
        write_measured(options.out, tables)
    return 0


if __name__ == "__main__":
    sys.exit(main())

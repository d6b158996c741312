"""Measures the accuracy on the real logs and writes `docs/accuracy.md`, as `fastslam run` goes by itself.

    python experiments/accuracy/run.py [--seeds 10] [--particles 100] [--only NAME] [--workers N]
        [--set KEY=VALUE] [--out docs/accuracy.md]

The logs are read from the folder that the environment variable FASTSLAM_DATA names (default:
`../shared/data`). Every row is a log; the figures are the median over the seeds and, in brackets, the worst.
"""

from __future__ import annotations

import argparse
import os
import platform
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import fastslam
import numpy as np
from fastslam import space
from fastslam.config import merge, parse_assignments
from fastslam.datasets import load
from fastslam.evaluation.metrics import evaluate
from fastslam.opinion import MOST_TRIES, run_by_need

METRICS = {
    "landmark_rmse_m": "map [m]",
    "ate_rmse_m": "live path [m]",
    "smoothed_ate_rmse_m": "smoothed path [m]",
    "landmark_matched": "found",
    "landmark_duplicates": "duplicates",
    "landmark_precision": "precision",
    "gps_median_m": "GPS median [m]",
    "gps_inlier_rmse_m": "GPS inlier RMSE [m]",
}


IN_SPACE = {
    "landmark_rmse_m": "map.aligned.rmse_m",
    "ate_rmse_m": "path.live.aligned.position_rmse_m",
    "smoothed_ate_rmse_m": "path.smoothed.aligned.position_rmse_m",
    "landmark_matched": "map.matched",
}
"""What the metrics are called in three dimensions."""


@dataclass(frozen=True)
class Case:
    """One log under one association mode."""

    title: str
    folder: str
    association: str
    robot: int | None = None
    max_range_m: float | None = None
    landmarks: int | None = None


def cases() -> Iterator[Case]:
    """Every log of the table."""
    for association in ("known", "unknown"):
        yield Case("Lost in the Woods", "lost_in_the_woods", association, landmarks=17)
    for limit in (3.0, 1.0):
        yield Case(f"Lost in the Woods, ranges to {limit:g} m", "lost_in_the_woods", "known", None, limit, 17)
    for association in ("known", "unknown"):
        for number in (1, 2, 6):
            folder = f"utias_mrclam/MRCLAM_Dataset{number}"
            for robot in range(1, 6):
                yield Case(f"UTIAS {number} robot {robot}", folder, association, robot, None, 15)
    for association in ("known", "unknown"):
        yield Case("cityTrees10000", "city_trees10000", association, landmarks=100)
    yield Case("Starry Night, in space", "starry_night", "known", landmarks=20)
    yield Case("Victoria Park", "victoria_park", "unknown")
    yield Case("Victoria Park, raw scans", "victoria_park/ascii_2003", "unknown")


def measure(case: Case, data: Path, overrides: dict[str, Any], seed: int) -> dict[str, float]:
    """The metrics of one run."""
    if space.matches(data / case.folder):
        return _measure_in_space(data / case.folder, overrides, seed)
    options = {"robot": case.robot, "max_range_m": case.max_range_m}
    log = load(data / case.folder, **{key: value for key, value in options.items() if value is not None})
    settings = merge(overrides, {"seed": seed, "association": {"mode": case.association}})
    metrics = evaluate(run_by_need(log, settings), log)
    return {name: float(metrics[name]) for name in METRICS if metrics.get(name) is not None}


def _measure_in_space(path: Path, overrides: dict[str, Any], seed: int) -> dict[str, float]:
    """Those of a run in space, where every landmark has a name, so that none is false."""
    log = space.load(path)
    found = space.evaluate(space.run(log, {"seed": seed, "filter": overrides["filter"]}), log)
    metrics = {name: float(found[key] or 0.0) for name, key in IN_SPACE.items()}
    return {**metrics, "landmark_duplicates": 0.0, "landmark_precision": 1.0}


def table(rows: Sequence[tuple[Case, list[dict[str, float]]]]) -> str:
    """The measurements as Markdown."""
    lines = ["| log | identities | " + " | ".join(METRICS.values()) + " |", "|---" * (2 + len(METRICS)) + "|"]
    for case, runs in rows:
        cells = [_cell(name, case, [run[name] for run in runs if name in run]) for name in METRICS]
        lines.append(f"| {case.title} | {case.association} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def _cell(name: str, case: Case, values: list[float]) -> str:
    if not values:
        return ""
    best_is_high = name in ("landmark_matched", "landmark_precision")
    median, worst = float(np.median(values)), min(values) if best_is_high else max(values)
    if name in ("landmark_matched", "landmark_duplicates"):
        of = f" of {case.landmarks}" if name == "landmark_matched" and case.landmarks else ""
        return f"{median:.0f} ({worst:.0f}){of}"
    if name == "landmark_precision":
        return f"{median:.2f} ({worst:.2f})"
    return f"{median:.3f} ({worst:.3f})"


def summary(rows: Sequence[tuple[Case, list[dict[str, float]]]]) -> str:
    """What the UTIAS logs give together, as a list."""
    lines = []
    for sets, association in (((1, 2, 6), "known"), ((1, 2), "unknown"), ((6,), "unknown")):
        titles = [f"UTIAS {number} robot {robot}" for number in sets for robot in range(1, 6)]
        logs = [runs for case, runs in rows if case.title in titles and case.association == association]
        if len(logs) != len(titles):
            continue
        medians = np.median([[run["landmark_rmse_m"] for run in runs] for runs in logs], axis=0)
        found = np.array([run["landmark_matched"] for runs in logs for run in runs])
        false = found / np.array([run["landmark_precision"] for runs in logs for run in runs]) - found
        lines.append(
            f"- UTIAS {', '.join(map(str, sets))}, identities {association}: map error, median over "
            f"{len(logs)} logs, {np.median(medians):.3f} m (worst seed {medians.max():.3f} m); at least "
            f"{found.min():.0f} of 15 landmarks found in every run; of all confirmed landmarks "
            f"{100.0 * false.sum() / (false.sum() + found.sum()):.1f} % match no true one."
        )
    return "\n".join(lines)


def main() -> None:
    """Runs all cases on all cores and writes the page."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--particles", type=int, default=100)
    parser.add_argument("--algorithm", default="fastslam2")
    parser.add_argument("--workers", type=int)
    parser.add_argument("--only", default="", help="part of a title")
    parser.add_argument("--set", action="append", default=[], help="another setting, as KEY=VALUE")
    parser.add_argument("--out", type=Path)
    arguments = parser.parse_args()
    data = Path(os.environ.get("FASTSLAM_DATA", "../shared/data"))
    chosen = [case for case in cases() if arguments.only in case.title]
    if not chosen or not data.is_dir():
        parser.error(f"nothing to measure: no case matches {arguments.only!r}, or {data} is no folder")
    named = {"algorithm": arguments.algorithm, "filter": {"particles": arguments.particles}}
    overrides = merge(named, parse_assignments(arguments.set))
    with ProcessPoolExecutor(arguments.workers) as pool:
        futures = [
            [
                pool.submit(measure, case, data, overrides, MOST_TRIES * number)
                for number in range(arguments.seeds)
            ]
            for case in chosen
        ]
        rows = [
            (case, [future.result() for future in runs]) for case, runs in zip(chosen, futures, strict=True)
        ]
    page = HEAD.format(
        particles=arguments.particles,
        algorithm=arguments.algorithm,
        seeds=f"0, {MOST_TRIES}, … {MOST_TRIES * (arguments.seeds - 1)}",
        version=fastslam.__version__,
        machine=f"{platform.machine()}, {os.cpu_count()} cores",
    )
    page += table(rows) + "\n"
    if overall := summary(rows):
        page += f"\n{overall}\n"
    if arguments.out is None:
        print(page)
    else:
        arguments.out.write_text(page, encoding="utf-8")


HEAD = """# Accuracy on real logs

Made by `python experiments/accuracy/run.py --out docs/accuracy.md`: {algorithm}, {particles} particles,
seeds {seeds}, fastslam {version}, {machine}. Each log's own settings, the same with and without identities.
Medians over the seeds, worst in brackets; the map and the paths after rigid alignment
([definitions](metrics.md)). Without identities a landmark counts when it is
[confirmed](association.md#provisional-and-confirmed), duplicates lie within 0.5 m of a landmark that was
found, and a run asks for a [second opinion](tuning.md#several-tries) as the command does. What a run costs
is in `benchmarks/`.

"""

if __name__ == "__main__":
    main()

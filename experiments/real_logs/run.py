"""Figures on the real logs, as a Markdown table: `python experiments/real_logs/run.py [--seeds N]`.

The logs lie in the folder that FASTSLAM_DATA names. Each figure is the median over the seeds of a run with
the log's own settings, 100 particles and FastSLAM 2.0. A log that is absent is listed as such.
"""

from __future__ import annotations

import argparse
import os
import statistics
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import fastslam
from fastslam.evaluation import Metrics, evaluate

PARTICLES = 100


@dataclass(frozen=True)
class Case:
    """One log: its name in the table, where it lies below the data folder, and how to read it."""

    name: str
    path: str
    robot: int | None = None
    associations: tuple[str, ...] = ("known", "unknown")


def cases() -> Iterator[Case]:
    """Every row of the table."""
    yield Case("Lost in the Woods", "lost_in_the_woods")
    for number in (1, 2, 6):
        for robot in range(1, 6):
            yield Case(f"UTIAS {number}, robot {robot}", f"utias_mrclam/MRCLAM_Dataset{number}", robot)
    yield Case("cityTrees10000", "city_trees10000")
    yield Case("Victoria Park", "victoria_park", associations=("unknown",))


def measure(case: Case, data: Path, association: str, seeds: int) -> list[Metrics]:
    """The metrics of one run per seed."""
    log = fastslam.load(data / case.path, robot=case.robot)
    config = {"filter": {"particles": PARTICLES}, "association": {"mode": association}}
    results = fastslam.run_many(log, config, seeds=range(1, seeds + 1))
    return [evaluate(result, log) for result in results]


def median(runs: Sequence[Metrics], name: str) -> float | None:
    """Median of a metric over the runs, None where one of them lacks it."""
    values: list[Any] = [metrics.get(name) for metrics in runs]
    return None if None in values else statistics.median(values)


def row(case: Case, association: str, runs: Sequence[Metrics]) -> str:
    """One line of the table."""
    names = ("landmark_rmse_m", "ate_rmse_m", "smoothed_ate_rmse_m", "gps_median_m")
    errors = [median(runs, name) for name in names]
    found = [median(runs, name) for name in ("landmark_matched", "landmarks", "landmark_duplicates")]
    seconds = median(runs, "filter_seconds")
    cells = ["" if value is None else f"{value:.3f}" for value in errors]
    cells += ["" if value is None else f"{value:.0f}" for value in found]
    return " | ".join([f"| {case.name}", association, *cells, "" if seconds is None else f"{seconds:.1f} |"])


COLUMNS = (
    "log",
    "identities",
    "map [m]",
    "live path [m]",
    "smoothed path [m]",
    "GPS median [m]",
    "matched",
    "in map",
    "doubled",
    "time [s]",
)


def main(arguments: Sequence[str] | None = None) -> None:
    """Prints the table, a row as soon as it is known."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--only", default="", help="rows whose name contains this")
    options = parser.parse_args(arguments)
    data = Path(os.environ.get("FASTSLAM_DATA", "../shared/data"))
    print("| " + " | ".join(COLUMNS) + " |")
    print("|" + "---|" * len(COLUMNS))
    for case in cases():
        if options.only.lower() not in case.name.lower():
            continue
        if not (data / case.path).exists():
            print(f"| {case.name} | absent: {data / case.path} |")
            continue
        for association in case.associations:
            print(row(case, association, measure(case, data, association, options.seeds)), flush=True)


if __name__ == "__main__":
    main()

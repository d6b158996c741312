"""Measures what steps with one or two sightings take, and writes a dated report.

    FASTSLAM_DATA=DATA python benchmarks/bench_small_scans.py [--quick] [--out FOLDER]

UTIAS MR.CLAM, data set 1, robot 1, nobody naming a landmark, 100 particles, otherwise the settings of the
log and the defaults: the core's filter is called for each row as a robot calls it on the way, one call for
each moment of sightings, and one without any at every tenth row of odometry. The time of a call is CPU time
of the thread that makes it, from Python and back; what a call that computes next to nothing takes (a motion)
stands beside. Draws of whole paths fall into some steps and lift the mean, not the median.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Callable, Iterator
from datetime import datetime, timezone
from functools import partial
from pathlib import Path
from typing import TypeAlias

import fastslam
import numpy as np
from fastslam import _core
from fastslam.config import Config
from fastslam.datasets import load
from fastslam.log import Log
from scale_report import commit, markdown, processor

PARTICLES = 100
EMPTY_EVERY = 10
QUICK_ROWS = 6000
HEAD = ("call", "calls", "p10 (us)", "median", "p90", "p99", "worst", "mean")

Call: TypeAlias = tuple[str, Callable[[], object]]


def _scan(log: Log, of: np.ndarray) -> _core._ScanColumns:
    """Some sightings as the core takes them, without names."""
    seen = log.sightings
    names = np.full(len(of), -1, dtype=np.int64)
    return seen.range_m[of], seen.bearing_rad[of], names, None, None, None


def _calls(filter: _core.Filter, log: Log, rows: int) -> Iterator[Call]:
    """What a robot calls, in the order of time; a control holds until the next one."""
    controls, seen = log.controls, log.sightings
    stamps, first = np.unique(seen.stamp_s, return_index=True)
    scans = np.split(np.arange(len(seen.stamp_s)), first[1:])
    now_s, k = float(controls.stamp_s[0]), int(np.searchsorted(stamps, controls.stamp_s[0]))
    nothing = _scan(log, np.arange(0))
    for row in range(min(rows, len(controls.stamp_s) - 1)):
        control, end_s = [*map(float, controls.values[row])], float(controls.stamp_s[row + 1])
        control += [0.0] * (3 - len(control))
        while k < len(stamps) and stamps[k] <= end_s:
            at_s, scan = float(stamps[k]), _scan(log, scans[k])
            yield "motion", partial(filter.predict, control, at_s - now_s)
            yield f"{len(scans[k])} sightings", partial(filter.update, at_s, scan)
            now_s, k = at_s, k + 1
        if end_s > now_s:
            yield "motion", partial(filter.predict, control, end_s - now_s)
            now_s = end_s
        if row % EMPTY_EVERY == 0:
            yield "0 sightings", partial(filter.update, now_s, nothing)


def measure(log: Log, rows: int) -> list[tuple[object, ...]]:
    """The table: a row for each kind of call that came often, and one for all steps with sightings."""
    config = Config.resolve(
        log.config, {"association": {"mode": "unknown"}, "filter": {"particles": PARTICLES}}
    )
    filter = _core.Filter(config.to_json(), "none")
    filter.begin()
    took: dict[str, list[float]] = {}
    for kind, call in _calls(filter, log, rows):
        begun = time.thread_time_ns()
        call()
        took.setdefault(kind, []).append(1e-3 * (time.thread_time_ns() - begun))
    seen = [kind for kind in took if kind not in ("motion", "0 sightings")]
    took["all with sightings"] = [micros for kind in seen for micros in took[kind]]
    table = []
    for kind in ["motion", "0 sightings", *sorted(seen), "all with sightings"]:
        micros = np.array(took[kind])
        figures = [*np.percentile(micros, [10.0, 50.0, 90.0, 99.0]), micros.max(), micros.mean()]
        table.append((kind, len(micros), *(f"{value:.1f}" for value in figures)))
    return table


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--quick", action="store_true", help="a short piece: does it still work?")
    parser.add_argument("--out", type=Path, help="folder of the report")
    arguments = parser.parse_args()
    if "FASTSLAM_DATA" not in os.environ:
        print("skipped: FASTSLAM_DATA does not say where the logs are")
        return
    started, load_before = datetime.now(timezone.utc), os.getloadavg()[0]
    log = load(Path(os.environ["FASTSLAM_DATA"]) / "utias_mrclam" / "MRCLAM_Dataset1", robot=1)
    rows = QUICK_ROWS if arguments.quick else len(log.controls.stamp_s)
    table = markdown(HEAD, measure(log, rows))
    folder = arguments.out or Path("results/benchmarks" if arguments.quick else "benchmarks/reports")
    folder.mkdir(parents=True, exist_ok=True)
    report = folder / f"small-scans-{started:%Y-%m-%d}.md"
    head = f"fastslam {fastslam.__version__}, commit {commit()}; {processor()}; load {load_before:.1f}."
    how = "UTIAS MR.CLAM 1, robot 1, 100 particles. Command: `python benchmarks/bench_small_scans.py`."
    report.write_text(f"# Steps with few sightings\n\n{head} {how}\n\n{table}\n", encoding="utf-8")
    print(f"{table}\nreport: {report}")


if __name__ == "__main__":
    main()

"""Measures how long the steps of a robot that drives take, and writes a dated report.

    FASTSLAM_DATA=DATA python benchmarks/bench_latency.py [--quick] [--delay-scans D ...] [--keyframes K]
        [--out FOLDER]

Victoria Park, ten laps between cones and one hour at 20 Hz in a bounded world, nobody naming a landmark, 100
particles, otherwise the defaults: all rows go to a `Robot` as they would on the way, with `--idle-ms` of rest
after each scan. A step is what a call computes. For each value of `filter.rejuvenation.delay_scans` there are
the median, the 99th and 99.9th percentile and the worst step, the last two also in CPU time of the thread
that calls, the last tenth of the drive against the first in the median step and in CPU time of all threads,
the memory of the last tenth and that against the second, and how often a step has waited for a draw of paths.
On a machine that does other things the worst step is theirs; CPU times are not, but they lack what a step
waits for a draw.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from datetime import datetime, timezone
from pathlib import Path
from typing import Any, NamedTuple

import fastslam
import numpy as np
from fastslam import Robot
from fastslam.config import merge
from fastslam.datasets import load
from fastslam.log import Log
from fastslam.robot import Window
from fastslam.simulation import resolve_simulation, simulate
from scale_report import commit, markdown, processor

LAPS = 10
HOUR_S = 3600.0
QUICK_S = 60.0
HEAD = ("log", "delay (scans)", "steps", "p50 (ms)", "p99", "p99.9", "worst", "worst / p50")
HEAD += ("p99.9 in CPU", "worst in CPU")
HEAD += ("last tenth / first", "the same in CPU", "memory (MB)", "last tenth / second", "waited", "draws")
TENTHS = 10
PAGE_MB = os.sysconf("SC_PAGE_SIZE") / 2**20


class Case(NamedTuple):
    """A log, and how it is driven."""

    log: str
    delay_scans: int
    idle_s: float
    quick: bool
    keyframes: int | None
    """Steps that the past keeps; those of a robot without it."""


class Tenth(NamedTuple):
    """What a tenth of a drive takes."""

    took_ms: list[float]
    thread_ms: list[float]
    """CPU time of the thread that calls."""
    cpu_s: float
    """Of all threads."""
    memory_mb: float
    """Of the process, at the end."""


def _cones(*, quick: bool) -> Log:
    laps = {"trajectory": {"laps": 1 if quick else LAPS}}
    return simulate(resolve_simulation({"seed": 1, **laps}, preset="cones"))


def _hour(*, quick: bool) -> Log:
    """Round and round in the field of the preset `loop`, seen 20 times a second."""
    settings: dict[str, Any] = {"seed": 1, "trajectory": {"laps": 1000}, "control_period_s": 0.05}
    settings |= {"scan": {"period_s": 0.05}, "max_duration_s": QUICK_S if quick else HOUR_S}
    return simulate(resolve_simulation(settings, preset="loop"))


def _victoria_park(*, quick: bool) -> Log:
    return load(Path(os.environ["FASTSLAM_DATA"]) / "victoria_park")


LOGS = {"victoria_park": _victoria_park, "cones": _cones, "hour": _hour}


def _calls(robot: Robot, log: Log) -> Iterator[Any]:
    """Every row of a log as a call, in the order of time."""
    controls, seen = log.controls, log.sightings
    stamps, first = np.unique(seen.stamp_s, return_index=True)
    scans = np.split(np.arange(len(seen.stamp_s)), first[1:])
    rows = [(float(t), 0, k) for k, t in enumerate(controls.stamp_s)]
    rows += [(float(t), 1, k) for k, t in enumerate(stamps)]
    for stamp_s, is_scan, k in sorted(rows):
        if is_scan:
            of = scans[k]
            values = {"range_m": seen.range_m[of], "bearing_rad": seen.bearing_rad[of]}
            yield lambda stamp_s=stamp_s, values=values: robot.sightings(stamp_s, **values)
        else:
            yield lambda stamp_s=stamp_s, row=controls.values[k]: robot.odometry(stamp_s, row)


def _memory_mb() -> float:
    return int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1]) * PAGE_MB


def measure(case: Case) -> tuple[object, ...]:
    """The row of a case in the table."""
    log = LOGS[case.log](quick=case.quick)
    draws: dict[str, Any] = {
        "every_steps": None,
        "spread": 1.0,
        "growth": 0.05,
        "delay_scans": case.delay_scans,
    }
    if case.keyframes is not None:
        draws |= {"keyframes": case.keyframes}
    mine = {"association": {"mode": "unknown"}, "filter": {"particles": 100, "rejuvenation": draws}}
    robot = Robot(merge(log.config, mine), identities="none", window=Window(late_s=0.0))
    calls, tenths, drawn = list(_calls(robot, log)), [], 0
    for part in range(TENTHS):
        tenth = Tenth([], [], time.process_time(), 0.0)
        for call in calls[len(calls) * part // TENTHS : len(calls) * (part + 1) // TENTHS]:
            begun, cpu = time.perf_counter(), time.thread_time()
            steps = call()
            if steps:
                tenth.thread_ms.append(1e3 * (time.thread_time() - cpu) / len(steps))
                tenth.took_ms.append(1e3 * (time.perf_counter() - begun) / len(steps))
                drawn += sum(step.info.rejuvenated for step in steps)
                time.sleep(case.idle_s)
        tenths.append(tenth._replace(cpu_s=time.process_time() - tenth.cpu_s, memory_mb=_memory_mb()))
    took, last = np.concatenate([tenth.took_ms for tenth in tenths]), tenths[-1]
    p50, p99, p999 = np.percentile(took, [50.0, 99.0, 99.9])
    figures = [f"{value:.2f}" for value in (p50, p99, p999, took.max())]
    thread = np.concatenate([tenth.thread_ms for tenth in tenths])
    in_cpu = [f"{value:.2f}" for value in (np.percentile(thread, 99.9), thread.max())]
    ratios = [
        f"{took.max() / p50:.0f}",
        *in_cpu,
        f"{np.median(last.took_ms) / np.median(tenths[0].took_ms):.2f}",
    ]
    ratios += [f"{last.cpu_s / tenths[0].cpu_s:.2f}", f"{last.memory_mb:.0f}"]
    ratios.append(f"{last.memory_mb / tenths[1].memory_mb:.2f}")
    return case.log, case.delay_scans, len(took), *figures, *ratios, robot.waits, drawn


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--quick", action="store_true", help="a minute each: does it still work?")
    parser.add_argument("--delay-scans", type=int, nargs="+", default=[0, 10])
    parser.add_argument("--idle-ms", type=float, default=5.0, help="rest after each scan")
    parser.add_argument(
        "--keyframes", type=int, help="steps that the past keeps; those of a robot without it"
    )
    parser.add_argument("--logs", nargs="+", choices=list(LOGS), help="all without it")
    parser.add_argument("--out", type=Path, help="folder of the report")
    arguments = parser.parse_args()
    has_data = "FASTSLAM_DATA" in os.environ
    names: Sequence[str] = arguments.logs or [name for name in LOGS if has_data or name != "victoria_park"]
    started, load_before = datetime.now(timezone.utc), os.getloadavg()[0]
    idle_s = 1e-3 * arguments.idle_ms
    cases = [
        Case(name, delay, idle_s, arguments.quick, arguments.keyframes)
        for name in names
        for delay in arguments.delay_scans
    ]
    rows = []
    for case in cases:
        # A process each: memory is that of one drive.
        with ProcessPoolExecutor(max_workers=1) as pool:
            rows.append(pool.submit(measure, case).result())
        print(*rows[-1], flush=True)
    folder = arguments.out or Path("results/benchmarks" if arguments.quick else "benchmarks/reports")
    folder.mkdir(parents=True, exist_ok=True)
    report = folder / f"latency-{started:%Y-%m-%d}.md"
    command = f"python benchmarks/bench_latency.py --delay-scans {' '.join(map(str, arguments.delay_scans))}"
    command += "" if arguments.keyframes is None else f" --keyframes {arguments.keyframes}"
    head = f"fastslam {fastslam.__version__}, commit {commit()}; {processor()}; load {load_before:.1f}."
    how = f"Command: `{command}`, {arguments.idle_ms:g} ms of rest after each scan."
    text = f"# Latency of steps\n\n{head} {how}\n\n"
    report.write_text(text + markdown(HEAD, rows) + "\n", encoding="utf-8")
    print(f"report: {report}")


if __name__ == "__main__":
    main()

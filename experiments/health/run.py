"""Measures how often sound runs are called ok, and whether the truth bears out where they are not.

    python experiments/health/run.py [--seeds 3] [--particles 100] [--only NAME] [--workers N]
        [--out docs/health.md]

Runs with defaults over simulated worlds, another one for each seed, and over real logs, which are read from
the folder that FASTSLAM_DATA names (default: `../shared/data`). A step that is not ok is borne out where the
robot had seen nothing for long (`no_sightings`) or the particles disagreed about its pose (`pose_uncertain`),
which are facts; where its live pose is off by more than FACTOR times the RMS error of the steps that are ok;
and where the map was there twice, as the draw says that joined TWICE landmarks or more at the end of such a
time, or less than SOON steps later. What is left are false alarms.
"""

from __future__ import annotations

import argparse
import os
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import fastslam
import numpy as np
from fastslam.datasets import load
from fastslam.evaluation import evaluate_run
from fastslam.evaluation.align import wrap_angle
from fastslam.evaluation.trajectory import interpolate_poses
from fastslam.health import HealthStatus, has_reason, reason_names
from fastslam.log import Bools, Floats, Log
from fastslam.result import RunResult, Steps
from fastslam.simulation import resolve_simulation, simulate

MARK = "<!-- measured by experiments/health/run.py -->"
FACTOR = 2.0
"""Of a Gaussian error in the plane, one in fifty is farther off than twice its RMS."""
TWICE = 3
SOON = 50
WORLDS = ("demo", "loop", "cones", "orchard")


@dataclass(frozen=True)
class Case:
    """One log under one association mode."""

    title: str
    association: str
    folder: str | None = None
    robot: int | None = None


def cases() -> Iterator[Case]:
    """Every log of the table."""
    for association in ("known", "unknown"):
        for world in WORLDS[:2] if association == "known" else WORLDS:
            yield Case(f"simulated `{world}`", association, None)
        for number in (1, 2, 6):
            for robot in range(1, 6):
                folder = f"utias_mrclam/MRCLAM_Dataset{number}"
                yield Case(f"UTIAS {number} robot {robot}", association, folder, robot)
        yield Case("Lost in the Woods", association, "lost_in_the_woods")
        yield Case("cityTrees10000", association, "city_trees10000")
    yield Case("Victoria Park", "unknown", "victoria_park")
    yield Case("car park", "unknown", "car_park")


def _log(case: Case, data: Path, seed: int) -> Log:
    if case.folder is None:
        world = case.title.split("`")[1]
        return simulate(resolve_simulation({"seed": 1 + seed}, preset=world))
    return load(data / case.folder, robot=case.robot)


def measure(case: Case, data: Path, particles: int, seed: int) -> dict[str, Any]:
    """Shares of the judged steps, and what was said of those that are not ok."""
    log = _log(case, data, seed)
    settings = {"seed": seed, "filter": {"particles": particles}, "association": {"mode": case.association}}
    result = fastslam.run(log, settings)
    steps = result.steps
    judged = steps.health != HealthStatus.INITIALIZING
    alarmed = judged & (steps.health != HealthStatus.OK)
    borne_out = {
        "blind": has_reason(steps.health_reasons, "no_sightings"),
        "uncertain": has_reason(steps.health_reasons, "pose_uncertain"),
        "worse": _worse_off(result, log, judged & ~alarmed),
        "twice": _there_twice(steps, alarmed),
    }
    shares, left = {"ok": judged & ~alarmed}, alarmed
    for name, rows in borne_out.items():
        shares[name], left = left & rows, left & ~rows
    said = Counter(name for bits in steps.health_reasons[left] for name in reason_names(int(bits)))
    count = max(int(judged.sum()), 1)
    return {
        **{name: int(rows.sum()) / count for name, rows in (shares | {"false": left}).items()},
        "said": said,
    }


def _there_twice(steps: Steps, alarmed: Bools) -> Bools:
    """Which steps belong to an alarm at whose end a draw joined what was there twice."""
    joined = np.flatnonzero(steps.rejuvenated & (steps.merged >= TWICE))
    twice = np.zeros(len(alarmed), dtype=np.bool_)
    edges = np.flatnonzero(np.diff(alarmed, prepend=False, append=False))
    for first, after in zip(edges[::2], edges[1::2], strict=True):
        twice[first:after] = bool(((joined >= first) & (joined < after + SOON)).any())
    return twice


def _worse_off(result: RunResult, log: Log, ok: Bools) -> Bools:
    """Which steps are off by more than FACTOR times the RMS error of those that are ok."""
    errors = _errors(result, log)
    if errors is None or not ok.any():
        return np.zeros(len(ok), dtype=np.bool_)
    usual = np.sqrt(np.nanmean(errors[ok] ** 2, axis=0))
    return np.asarray((errors > FACTOR * usual).any(axis=1))


def _errors(result: RunResult, log: Log) -> Floats | None:
    """Of position and heading at each step, NaN where the truth is silent. Shape: (T, 2)."""
    truth, live = log.truth_trajectory, evaluate_run(result, log).live
    if truth is None or live is None:
        return None
    stamp_s = result.steps.stamp_s
    true, _ = interpolate_poses(truth.stamp_s, truth.T_world_robot, stamp_s, max_gap_s=1.0)
    path = result.trajectory
    poses, _ = interpolate_poses(path.stamp_s, path.T_world_robot, stamp_s, max_gap_s=1.0)
    poses = live.transform.apply_poses(poses)
    position_m = np.linalg.norm(poses[:, :2] - true[:, :2], axis=1)
    heading_rad = np.abs(wrap_angle(poses[:, 2] - true[:, 2]))
    return np.column_stack([position_m, heading_rad if truth.heading_known else np.zeros(len(heading_rad))])


def table(rows: list[tuple[Case, list[dict[str, Any]]]]) -> str:
    """A line for each log: medians and, in brackets, the worst seed, in per cent of the judged steps."""
    heads = ("log", "identities", *COLUMNS.values(), "what these say")
    lines = ["| " + " | ".join(heads) + " |", "|---" * len(heads) + "|"]
    for case, runs in rows:
        cells = [_cell([run[name] for run in runs], name) for name in COLUMNS]
        said: Counter[str] = sum((run["said"] for run in runs), Counter())
        names = ", ".join(f"`{name}`" for name, _ in said.most_common(2))
        lines.append(f"| {case.title} | {case.association} | {' | '.join(cells)} | {names} |")
    return "\n".join(lines)


COLUMNS = {
    "ok": "ok",
    "blind": "blind",
    "uncertain": "pose unsure",
    "worse": "worse off",
    "twice": "map twice",
    "false": "false alarms",
}


def _cell(shares: list[float], name: str) -> str:
    worst = min(shares) if name == "ok" else max(shares)
    median, worst = 100.0 * float(np.median(shares)), 100.0 * worst
    return f"{median:.1f} ({worst:.1f})" if worst or name == "ok" else "0"


def main() -> None:
    """Runs all cases on all cores; prints the table or writes it into the page."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--particles", type=int, default=100)
    parser.add_argument("--workers", type=int)
    parser.add_argument("--only", default="", help="part of a title")
    parser.add_argument("--out", type=Path)
    given = parser.parse_args()
    data = Path(os.environ.get("FASTSLAM_DATA", "../shared/data"))
    chosen = [case for case in cases() if given.only in case.title]
    if not chosen or not data.is_dir():
        parser.error(f"nothing to measure: no case matches {given.only!r}, or {data} is no folder")
    with ProcessPoolExecutor(given.workers) as pool:
        futures = [
            [pool.submit(measure, case, data, given.particles, seed) for seed in range(given.seeds)]
            for case in chosen
        ]
        rows = [
            (case, [future.result() for future in runs]) for case, runs in zip(chosen, futures, strict=True)
        ]
    if given.out is None:
        print(table(rows))
        return
    before, _, after = given.out.read_text(encoding="utf-8").split(MARK)
    given.out.write_text(f"{before}{MARK}\n{table(rows)}\n{MARK}{after}", encoding="utf-8")


if __name__ == "__main__":
    main()

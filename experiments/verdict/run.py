"""Measures the verdict: runs that failed against runs that were sound, and which of them it spoke against.

    python experiments/verdict/run.py measure ROWS.jsonl [--first-seed 1] [--seeds 4] [--only TEXT]
    python experiments/verdict/run.py page ROWS.jsonl --out docs/health.md

`measure` runs the filter over simulated worlds and real logs (read from the folder that FASTSLAM_DATA names,
default `../shared/data`), as they are and with one known fault put in, and appends a line for each to
ROWS.jsonl. `page` writes table and figure.

A run failed where its map is off by more than FAILED times that of the same log without a fault and with its
names (and by more than LEAST_M), or where more than MOST_FALSE of its confirmed landmarks match no true one.
What was put in does not count, only what came out.
"""

from __future__ import annotations

import argparse
import json
import os
from collections import Counter
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass, fields, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import fastslam
import numpy as np
from fastslam.datasets import load
from fastslam.datasets.planar import wrap_to_pi
from fastslam.detection import with_sightings
from fastslam.evaluation import evaluate
from fastslam.examination import examine
from fastslam.log import Controls, Floats, Log
from fastslam.opinion import DIFFERENT, agreement_with_next, run_by_need
from fastslam.simulation import resolve_simulation, simulate
from fastslam.trust import doubts
from fastslam.verdict import is_empty

MARK = "<!-- measured by experiments/verdict/run.py -->"
FAILED = 3.0
LEAST_M = 0.05
MOST_FALSE = 0.1
PARTICLES = 30


def _seen(log: Log, **changes: Floats) -> Log:
    return replace(log, sightings=replace(log.sightings, **changes))


def _turned(log: Log, gain: float, bias: float = 0.0, part: tuple[float, float] = (0.0, 1.0)) -> Log:
    """Turns of the odometry times a gain and with a bias, in a part of the log."""
    return _odometry(log, slice(2, 3) if log.controls.values.shape[1] > 2 else slice(1, 2), gain, bias, part)


def _driven(log: Log, gain: float, part: tuple[float, float] = (0.0, 1.0)) -> Log:
    return _odometry(log, slice(0, 2) if log.controls.values.shape[1] > 2 else slice(0, 1), gain, 0.0, part)


def _odometry(log: Log, columns: slice, gain: float, bias: float, part: tuple[float, float]) -> Log:
    values, stamp_s = log.controls.values.copy(), log.controls.stamp_s
    begin, span = stamp_s[0], stamp_s[-1] - stamp_s[0]
    inside = (stamp_s >= begin + part[0] * span) & (stamp_s <= begin + part[1] * span)
    values[inside, columns] = gain * values[inside, columns] + bias
    return replace(log, controls=Controls(stamp_s, values))


def _carried(log: Log) -> Log:
    """The robot is carried along its path for a twelfth of the log: the odometry stands, nothing is seen."""
    stamp_s = log.controls.stamp_s
    span = stamp_s[-1] - stamp_s[0]
    start_s, end_s = stamp_s[0] + 0.5 * span, stamp_s[0] + (0.5 + 1 / 12) * span
    values = log.controls.values.copy()
    values[(stamp_s >= start_s) & (stamp_s < end_s)] = 0.0
    kept = (log.sightings.stamp_s < start_s) | (log.sightings.stamp_s >= end_s)
    return replace(_chosen(log, kept), controls=Controls(stamp_s, values))


def _paused(log: Log) -> Log:
    """Nothing was recorded for a twelfth of the log."""
    stamp_s = log.controls.stamp_s
    span = stamp_s[-1] - stamp_s[0]
    start_s, end_s = stamp_s[0] + 0.5 * span, stamp_s[0] + (0.5 + 1 / 12) * span
    rows = (stamp_s < start_s) | (stamp_s >= end_s)
    kept = (log.sightings.stamp_s < start_s) | (log.sightings.stamp_s >= end_s)
    return replace(_chosen(log, kept), controls=Controls(stamp_s[rows], log.controls.values[rows]))


def _chosen(log: Log, rows: Any) -> Log:
    columns = (field.name for field in fields(log.sightings))
    values = {name: getattr(log.sightings, name) for name in columns}
    return _seen(log, **{name: value[rows] for name, value in values.items() if value is not None})


def _moved(log: Log) -> Log:
    """From the middle of the log on, a third of the landmarks are sighted further away."""
    rng = np.random.default_rng(11)
    late = log.sightings.stamp_s > np.median(log.sightings.stamp_s)
    identity = log.sightings.identity
    moved = rng.random(int(identity.max()) + 1) < 1 / 3
    shifted = late & (identity >= 0) & moved[np.maximum(identity, 0)]
    far = 0.1 * float(np.median(log.sightings.range_m)) + 1.0
    return _seen(log, range_m=log.sightings.range_m + far * shifted)


def _misread(log: Log) -> Log:
    """One name in twenty is another one."""
    rng = np.random.default_rng(12)
    identity = log.sightings.identity.copy()
    wrong = (rng.random(len(identity)) < 0.05) & (identity >= 0)
    identity[wrong] = rng.integers(0, int(identity.max()) + 1, int(wrong.sum()))
    return replace(log, sightings=replace(log.sightings, identity=identity))


def _told(log: Log, factor: float, section: str) -> Log:
    """The noise of a section of the settings is told larger or smaller than it is."""
    told = {key: value * factor if "_std" in key else value for key, value in log.config[section].items()}
    return replace(log, config={**log.config, section: told})


def _mounted(log: Log, yaw_rad: float) -> Log:
    return _seen(log, bearing_rad=wrap_to_pi(log.sightings.bearing_rad + yaw_rad))


FAULTS: dict[str, Callable[[Log], Log]] = {
    "none": lambda log: log,
    "carried on": _carried,
    "recording paused": _paused,
    "wheels slip": lambda log: _driven(log, 3.0, (0.5, 0.54)),
    "landmarks moved": _moved,
    "names misread": _misread,
    "ranges in feet": lambda log: _seen(log, range_m=log.sightings.range_m / 0.3048),
    "range + 0.3 m": lambda log: _seen(log, range_m=log.sightings.range_m + 0.3),
    "bearings clockwise": lambda log: _seen(log, bearing_rad=-log.sightings.bearing_rad),
    "sensor turned by 10 degrees": lambda log: _mounted(log, float(np.radians(10.0))),
    "turns in degrees": lambda log: _turned(log, 180 / np.pi),
    "turns x 0.65": lambda log: _turned(log, 1 / 0.65),
    "turns biased": lambda log: _turned(log, 1.0, _bias(log)),
    "way x 1.1": lambda log: _driven(log, 1.1),
    "way x 2": lambda log: _driven(log, 2.0),
    "0.5 s late": lambda log: _seen(log, stamp_s=log.sightings.stamp_s + 0.5),
    "sensor's noise told x 1/3": lambda log: _told(log, 1 / 3, "sensor"),
    "odometry's noise told x 1/5": lambda log: _told(log, 1 / 5, "motion"),
}
"""What is put into a log that is sound without it."""


def _bias(log: Log) -> float:
    """A turn too much of half a radian a minute, in what a row holds."""
    rate = 0.5 / 60.0
    period_s = float(np.median(np.diff(log.controls.stamp_s)))
    return rate if log.config["motion"]["model"] in ("velocity", "ackermann") else rate * period_s


WORLDS: dict[str, dict[str, Any]] = {
    "demo": {},
    "loop": {"trajectory": {"laps": 2}, "sensor": {"field_of_view_rad": float(np.radians(150.0))}},
    "cones": {},
    "orchard": {},
    "rover": {},
    "victoria-like": {"max_duration_s": 300.0},
    "lawn-mower": {"max_duration_s": 1500.0},
}
REAL: dict[str, tuple[str, dict[str, Any]]] = {
    **{
        f"UTIAS {number} robot {robot}": (f"utias_mrclam/MRCLAM_Dataset{number}", {"robot": robot})
        for number in (1, 2, 6)
        for robot in range(1, 6)
    },
    "Lost in the Woods": ("lost_in_the_woods", {}),
    "car park": ("car_park", {}),
    "cityTrees10000": ("city_trees10000", {}),
}


UNNAMED = ("cones", "orchard", "rover", "car park")
OF_NAMES = ("landmarks moved", "names misread")
"""Faults that only a log with names can have."""


@dataclass(frozen=True)
class Case:
    """A log, what is put into it, and whether its names are used."""

    log: str
    fault: str
    association: str
    seed: int

    @property
    def name(self) -> str:
        """What tells it from the others."""
        return f"{self.log}, {self.fault}, {self.association}, {self.seed}"


def cases(first_seed: int, seeds: int) -> Iterator[Case]:
    """Half sound, half with a fault: for each log and seed one of both, the faults in turn."""
    broken = [fault for fault in FAULTS if fault != "none"]
    unnamed = [fault for fault in broken if fault not in OF_NAMES]
    number = 0
    for seed in range(first_seed, first_seed + seeds):
        for log in (*WORLDS, *REAL):
            for association in ("unknown", "known"):
                yield Case(log, "none", association, seed)
                faults = unnamed if log in UNNAMED else broken
                yield Case(log, faults[number % len(faults)], association, seed)
                number += 1


@lru_cache(maxsize=4)
def sound_log(log: str, seed: int, data: Path) -> Log:
    """A log without a fault, its scans detected."""
    if log in REAL:
        folder, options = REAL[log]
        return with_sightings(load(data / folder, **options))
    return simulate(resolve_simulation({"seed": 1000 + seed, **WORLDS[log]}, preset=log))


@lru_cache(maxsize=4)
def reference_m(log: str, seed: int, data: Path) -> float:
    """Map error of the sound log with its names, where it has any, and paths drawn often."""
    sound = sound_log(log, seed, data)
    mode = "known" if bool((sound.sightings.identity >= 0).all()) else "unknown"
    drawn = {"every_steps": 50, "growth": 0.1, "spread": 0.5}
    settings = {
        "seed": 1,
        "filter": {"particles": PARTICLES, "rejuvenation": drawn},
        "association": {"mode": mode},
    }
    found = evaluate(fastslam.run(sound, settings), sound)["landmark_rmse_m"]
    return max(float(found), LEAST_M / FAILED) if isinstance(found, float) else LEAST_M / FAILED


def measure(case: Case, data: Path) -> dict[str, Any]:
    """What came out, whether the examination speaks against it, and how far it is beyond each limit."""
    sound = sound_log(case.log, case.seed if case.log in WORLDS else 0, data)
    log = FAULTS[case.fault](sound)
    row: dict[str, Any] = {**asdict(case), "name": case.name}
    settings = {
        "seed": case.seed,
        "filter": {"particles": PARTICLES},
        "association": {"mode": case.association},
    }
    examined = any(finding.severity in ("error", "problem") for finding in examine(log))
    result = run_by_need(log, settings)
    metrics: dict[str, Any] = dict(evaluate(result, sound))
    map_m, right = metrics["landmark_rmse_m"], metrics["landmark_precision"]
    false = 1.0 if right is None else 1.0 - right
    least_m = reference_m(case.log, case.seed if case.log in WORLDS else 0, data)
    failed = map_m is None or map_m > FAILED * least_m or false > MOST_FALSE
    ratios = {doubt.rule: doubt.ratio for doubt in doubts(result, log)}
    share = agreement_with_next(result)
    if share is not None:
        ratios["other seeds"] = (1.0 - share) / (1.0 - DIFFERENT)
    row |= {"map_m": map_m, "reference_m": least_m, "false": false, "failed": failed}
    return {**row, "examined": examined or is_empty(result), "ratios": ratios}


def score(row: dict[str, Any]) -> float:
    """How far a run goes beyond the limit that it exceeds most."""
    return float("inf") if row["examined"] else max(row["ratios"].values(), default=0.0)


def table(rows: list[dict[str, Any]]) -> str:
    """A line for each fault: how many runs failed, and of how many of these and others that was told."""
    heads = ("put in", "runs", "failed", "of these told", "told of the others")
    lines = ["| " + " | ".join(heads) + " |", "|---" * len(heads) + "|"]
    groups = [(fault, [row for row in rows if row["fault"] == fault]) for fault in FAULTS]
    for title, group in (*groups, ("all", rows)):
        failed = [row for row in group if row["failed"]]
        others = [row for row in group if not row["failed"]]
        told, false = (sum(score(row) >= 1.0 for row in some) for some in (failed, others))
        lines.append(f"| {title} | {len(group)} | {len(failed)} | {told} | {false} of {len(others)} |")
    return "\n".join(lines)


def summary(rows: list[dict[str, Any]]) -> str:
    """Detection and false alarms in a sentence, with where the misses are."""
    failed = [row for row in rows if row["failed"]]
    sound = [row for row in rows if not row["failed"] and row["fault"] == "none"]
    told, false = (sum(score(row) >= 1.0 for row in some) for some in (failed, sound))
    missed = Counter(
        f"{row['log']}, {row['association']}" if row["fault"] == "none" else row["fault"]
        for row in failed
        if score(row) < 1.0
    )
    where = ", ".join(f"{name} ({count})" for name, count in missed.most_common())
    return (
        f"Of {len(failed)} failed runs {told} are told ({told / len(failed):.0%}); of {len(sound)} sound "
        f"runs of logs without a fault {false} are accused ({false / len(sound):.1%}). Missed: {where}."
    )


def figure(rows: list[dict[str, Any]], path: Path) -> None:
    """Detection against false alarms as all limits are scaled together."""
    import matplotlib.pyplot as plt

    failed = np.array([score(row) for row in rows if row["failed"]])
    sound = np.array([score(row) for row in rows if not row["failed"] and row["fault"] == "none"])
    limits = np.unique(np.concatenate([failed, sound, [1.0]]))[::-1]
    shares = np.array([[np.mean(some >= limit) for some in (sound, failed)] for limit in limits])
    drawn, axes = plt.subplots(figsize=(6.0, 4.0), layout="constrained")
    axes.step(shares[:, 0], shares[:, 1], where="post", color="tab:blue")
    at = np.array([np.mean(some >= 1.0) for some in (sound, failed)])
    axes.plot(*at, "o", color="tab:red", label=f"the limits as they are: {at[1]:.0%} at {at[0]:.1%}")
    axes.set(xlim=(-0.005, 0.3), ylim=(0.5, 1.005))
    axes.set(xlabel="share of sound runs accused", ylabel="share of failed runs told")
    axes.grid(alpha=0.3)
    axes.legend(loc="lower right")
    drawn.savefig(path, dpi=110)


def main() -> None:
    """Measures, or writes table and figure."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("what", choices=("measure", "page"))
    parser.add_argument("rows", type=Path)
    parser.add_argument("--first-seed", type=int, default=1)
    parser.add_argument("--seeds", type=int, default=4)
    parser.add_argument("--only", default="")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--out", type=Path, default=Path("docs/health.md"))
    given = parser.parse_args()
    lines = given.rows.read_text().splitlines() if given.rows.exists() else []
    rows = [json.loads(line) for line in lines]
    if given.what == "page":
        before, _, after = given.out.read_text().split(MARK)
        given.out.write_text(f"{before}{MARK}\n{table(rows)}\n\n{summary(rows)}\n{MARK}{after}")
        figure(rows, given.out.parent / "images" / "verdict.png")
        return
    done = {row["name"] for row in rows}
    data = Path(os.environ.get("FASTSLAM_DATA", "../shared/data"))
    todo = [
        case
        for case in cases(given.first_seed, given.seeds)
        if case.name not in done and given.only in case.name
    ]
    # A log is read and its reference made once for the cases that stand beside each other.
    with ProcessPoolExecutor(given.workers) as pool, given.rows.open("a") as out:
        for row in pool.map(measure, todo, [data] * len(todo), chunksize=4):
            out.write(json.dumps(row) + "\n")
            out.flush()


if __name__ == "__main__":
    main()

"""Measures `fastslam tune` with nothing told, on real logs and on simulated ones with errors put in.

    python experiments/self_calibration/run.py measure ROWS.jsonl [--worlds 5] [--only TEXT]
    python experiments/self_calibration/run.py table ROWS.jsonl --out docs/self-calibration.md
    python experiments/self_calibration/run.py figure docs/images/self-calibration.png

`measure` appends a line to ROWS.jsonl for each log as it is done, and leaves out those that are there. Real
logs are read from the folder that FASTSLAM_DATA names (default: `../shared/data`); of the settings of their
readers only geometry, limits and the first pose are kept, all else is the default.
`table` writes the rows between the marks of the page.
"""

from __future__ import annotations

import argparse
import json
import os
import time
from collections.abc import Iterator
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import fastslam
import numpy as np
from fastslam.config import merge
from fastslam.datasets import load
from fastslam.errors import FastSlamError
from fastslam.evaluation import evaluate
from fastslam.log import Log
from fastslam.runner import run
from fastslam.simulation import resolve_simulation, simulate
from fastslam.tuning import Tuning

MARK = "<!-- measured by experiments/self_calibration/run.py -->"
GEOMETRY = ("mounting", "min_range_m", "max_range_m", "field_of_view_rad", "model")
ERRORS: dict[str, dict[str, Any]] = {
    "none": {},
    "turn x 0.65": {"turn": 0.65},
    "distance x 1.06": {"distance": 1.06},
    "mounting off 0.2 m, 5 degrees": {"mounting": {"x_m": 0.2, "yaw_rad": 0.0873}},
    "0.3 s late": {"delay_s": 0.3},
    "range x 1.02": {"range": 1.02},
    "noise told x 1/3": {"told": 1 / 3},
    "noise told x 3": {"told": 3.0},
}
WORLDS = ("demo", "loop")
FIGURE = "turn x 0.65, distance x 1.06, 0.3 s late, noise told x 3"
NOISES = ("sensor.range_std_m", "sensor.bearing_std_rad")
SHOWN = {
    "motion.correction.turn_gain": "gain of turns",
    "motion.correction.distance_gain": "gain of the way",
    "sensor.delay_s": "delay of the sensor [s]",
    "sensor.range_std_m": "noise of ranges [m]",
    "sensor.bearing_std_rad": "noise of bearings [rad]",
    "sensor.mounting.yaw_rad": "yaw of the sensor [rad]",
}
"""What the figure shows."""
WELL = 1.2
"""A map that is off by at most this many times as much as with the truth told is as good."""
TRUTH = {"distance": "motion.correction.distance_gain", "turn": "motion.correction.turn_gain"}
TRUTH |= {"delay_s": "sensor.delay_s", "range": "sensor.range_scale"}
NONE_PUT_IN = {
    "motion.correction.distance_gain": 1.0,
    "motion.correction.turn_gain": 1.0,
    "motion.correction.yaw_rate_bias_rad_per_s": 0.0,
    "sensor.delay_s": 0.0,
    "sensor.range_scale": 1.0,
    "sensor.range_bias_m": 0.0,
    "sensor.mounting.x_m": 0.0,
    "sensor.mounting.y_m": 0.0,
    "sensor.mounting.yaw_rad": 0.0,
}
"""The parameters of a log without a systematic error."""


@dataclass(frozen=True)
class Case:
    """A log under one association mode: of a folder of data, or of a world with an error put in."""

    title: str
    association: str
    folder: str = ""
    robot: int | None = None
    world: str = ""
    seed: int = 0

    @property
    def name(self) -> str:
        """What tells it from the others."""
        return f"{self.title}, {self.association}" + (f", {self.world} {self.seed}" if self.world else "")


def cases(worlds: int) -> Iterator[Case]:
    """Everything that is measured."""
    for association in ("unknown", "known"):
        for number in (1, 2, 6):
            for robot in range(1, 6):
                yield Case(f"UTIAS {number}", association, f"utias_mrclam/MRCLAM_Dataset{number}", robot)
    for seed in range(1, worlds + 1):
        for world in WORLDS:
            for error in ERRORS:
                yield Case(error, "unknown", world=world, seed=100 + seed)
    for association in ("unknown", "known"):
        yield Case("Lost in the Woods", association, "lost_in_the_woods")
    yield Case("Victoria Park", "unknown", "victoria_park")


def untold(log: Log) -> Log:
    """The log with nothing in its settings but geometry, limits and the first pose."""
    sensor = {key: value for key, value in log.config["sensor"].items() if key in GEOMETRY}
    motion = {
        key: value
        for key, value in log.config["motion"].items()
        if "_std_" not in key and key != "noise_period_s" and not key.startswith("alpha")
    }
    config = {"sensor": sensor, "motion": motion, "initial_pose": log.config.get("initial_pose", {})}
    return replace(log, config=config)


def sound_world(case: Case) -> Log:
    """The simulated log without the error, but for a sensor that is mounted elsewhere."""
    settings: dict[str, Any] = {"seed": case.seed}
    if "mounting" in ERRORS[case.title]:
        settings["sensor"] = {"mounting": ERRORS[case.title]["mounting"]}
    return simulate(resolve_simulation(settings, preset=case.world))


def world_with(case: Case) -> Log:
    """A simulated log with the error of the case put into its numbers, or into what it states."""
    error, log = ERRORS[case.title], sound_world(case)
    values = log.controls.values / np.array([error.get("distance", 1.0), error.get("turn", 1.0)])
    seen = log.sightings
    late = seen.stamp_s + error.get("delay_s", 0.0)
    sensor, motion = dict(log.config["sensor"]), dict(log.config["motion"])
    sensor.pop("mounting", None)
    for section in (sensor, motion):
        for key in section:
            section[key] = section[key] * error.get("told", 1.0) if "_std_" in key else section[key]
    return replace(
        log,
        controls=replace(log.controls, values=values),
        sightings=replace(seen, stamp_s=late, range_m=error.get("range", 1.0) * seen.range_m),
        config={**log.config, "sensor": sensor, "motion": motion},
    )


def truth_of(case: Case) -> dict[str, float]:
    """The systematic errors of a simulated log, by key."""
    error = ERRORS[case.title]
    put_in = {key: error[name] for name, key in TRUTH.items() if name in error}
    put_in |= {f"sensor.mounting.{key}": value for key, value in error.get("mounting", {}).items()}
    return NONE_PUT_IN | put_in


def told_truth(case: Case) -> Log:
    """The log of the case with its errors and its noise told as they are."""
    config = dict(sound_world(case).config)
    for key, value in truth_of(case).items():
        for part in reversed(key.split(".")):
            value = {part: value}
        config = merge(config, value)
    return replace(world_with(case), config=config)


def covered(found: Tuning, case: Case) -> list[bool]:
    """Whether the interval of each systematic error that the log tells holds what was put in."""
    learned = [attempt.learned for attempt in found.attempts if attempt.learned is not None]
    values = found.values or learned[-1].values
    told = [value for value in values if value.observable and not np.isnan(value.standard_error)]
    truth = truth_of(case)
    if not any(value.key == "sensor.range_scale" for value in told):
        # The log tells the ratio of the two; where it is not blamed on the ranges the gain stands for it.
        truth["motion.correction.distance_gain"] *= truth["sensor.range_scale"]
    return [value.interval95[0] <= truth[value.key] <= value.interval95[1] for value in told]


def measure(case: Case, data: Path) -> dict[str, Any]:
    """The figures before and after tuning."""
    if case.world:
        log = world_with(case)
    else:
        options: dict[str, Any] = {} if case.robot is None else {"robot": case.robot}
        log = untold(load(data / case.folder, **options))
    settings = {"seed": 1, "association": {"mode": case.association}}
    row: dict[str, Any] = {"name": case.name, "title": case.title, "association": case.association}
    row |= {"world": case.world, "robot": case.robot}
    began = time.perf_counter()
    try:
        found = fastslam.tune(log, settings)
    except FastSlamError as error:
        return {**row, "refused": str(error), "before": figures(run(log, settings), log)}
    row["seconds"] = time.perf_counter() - began
    stated = found.attempts[0]
    row["before"] = figures(run(log, settings) if stated.was_ended else stated.result, log)
    row["after"] = figures(found.result, log)
    if case.world:
        row["told"] = figures(fastslam.run(told_truth(case), settings), log)
        row["covered"] = covered(found, case)
    return {**row, "kept": found.best.name, "gain": found.evidence_gain, "values": learned(found)}


def figures(result: fastslam.RunResult, log: Log) -> dict[str, Any]:
    """What a run is judged by."""
    metrics: dict[str, Any] = dict(evaluate(result, log))
    known = log.truth_landmarks is not None
    return {
        "false": metrics["landmarks"] - metrics["landmark_matched"] if known else None,
        "landmarks": metrics["landmarks"],
        **{name: metrics.get(name) for name in ("landmark_rmse_m", "ate_rmse_m", "smoothed_ate_rmse_m")},
        "gps_median_m": metrics.get("gps_median_m"),
        "seconds": result.filter_seconds,
    }


def learned(found: Tuning) -> dict[str, float]:
    """What is set of the systematic errors."""
    return {value.key: value.value for value in found.values if value.significant and value.unit is not None}


def table(rows: list[dict[str, Any]]) -> str:
    """Medians with the worst, a line for each kind of log."""
    heads = ("log", "identities", "logs", "refused", "false landmarks", "map [m]", "live [m]", "smoothed [m]")
    heads = (*heads, "map / truth told", f"at most {WELL}")
    lines = ["| " + " | ".join(heads) + " |", "|---" * len(heads) + "|"]
    groups: dict[tuple[str, str], list[dict[str, Any]]] = {}
    for row in rows:
        title = f"`{row['world']}`: {row['title']}" if row["world"] else row["title"]
        groups.setdefault((title, row["association"]), []).append(row)
    for (title, association), group in groups.items():
        done = [row for row in group if "after" in row]
        columns = ("false", "landmark_rmse_m", "ate_rmse_m", "smoothed_ate_rmse_m")
        shown = [pair(done, column) for column in columns] + list(against_truth(group))
        if all(row["before"]["landmark_rmse_m"] is None for row in group):
            shown[0] = pair(done, "landmarks") + " in all"
            shown[2] = pair(done, "gps_median_m") + " (GPS median)"
        refused = str(len(group) - len(done))
        lines.append("| " + " | ".join((title, association, str(len(group)), refused, *shown)) + " |")
    return "\n".join(lines)


def against_truth(group: list[dict[str, Any]]) -> tuple[str, str]:
    """The map against that with the truth told, median and worst, and on how many logs it is as good."""
    told = [row for row in group if "told" in row]
    if not told:
        return "-", "-"
    ratios = [row["after"]["landmark_rmse_m"] / row["told"]["landmark_rmse_m"] for row in told]
    good = sum(ratio <= WELL for ratio in ratios)
    return f"{np.median(ratios):.2f} ({max(ratios):.2f})", f"{good} of {len(group)}"


def coverage(rows: list[dict[str, Any]]) -> str:
    """How many of the intervals hold what was put in."""
    every = [held for row in rows for held in row.get("covered", ())]
    if not every:
        return ""
    return (
        f"\n\nOf {len(every)} intervals of systematic errors, over all simulated logs that were not refused, "
        f"{sum(every) / len(every):.1%} hold what was put in."
    )


def pair(rows: list[dict[str, Any]], column: str) -> str:
    """Before and after, as median and worst in brackets."""

    def side(name: str) -> str:
        values = [row[name][column] for row in rows if row[name][column] is not None]
        if not values:
            return "-"
        form = ".0f" if column in ("false", "landmarks") else ".3f"
        return f"{np.median(values):{form}} ({max(values):{form}})"

    before, after = side("before"), side("after")
    return "-" if before == after == "-" else f"{before} → {after}"


def until(log: Log, end_s: float) -> Log:
    """The log as it was at a time."""
    rows, seen = log.controls.stamp_s <= end_s, log.sightings
    kept = seen.stamp_s <= end_s
    columns = {field.name: getattr(seen, field.name) for field in fields(seen)}
    sightings = replace(
        seen, **{name: values[kept] for name, values in columns.items() if values is not None}
    )
    controls = replace(log.controls, stamp_s=log.controls.stamp_s[rows], values=log.controls.values[rows])
    return replace(log, controls=controls, sightings=sightings)


def figure(path: Path) -> None:
    """Draws what is learned as a log grows: gains off, a late sensor, noise told three times too large."""
    import matplotlib.pyplot as plt

    case = Case(FIGURE, "unknown", world="demo", seed=100)
    ERRORS[FIGURE] = {"turn": 0.65, "distance": 1.06, "delay_s": 0.3, "told": 3.0}
    log, sound = world_with(case), sound_world(case)
    times = np.linspace(5.0, log.controls.stamp_s[-1], 12)
    tunings = [fastslam.tune(until(log, end_s), {"association": {"mode": "unknown"}}) for end_s in times]
    values = [
        {value.key: value for attempt in one.attempts if attempt.learned for value in attempt.learned.values}
        for one in tunings
    ]
    truth = truth_of(case) | {key: sound.config["sensor"][key.split(".")[1]] for key in NOISES}
    drawn, axes = plt.subplots(2, 3, figsize=(10.0, 5.0), sharex=True, layout="constrained")
    for panel, (key, title) in zip(axes.flat, SHOWN.items(), strict=True):
        found = [one[key] for one in values]
        half = [0.0 if np.isnan(one.standard_error) else 2.26 * one.standard_error for one in found]
        panel.axhline(truth.get(key, 0.0), color="tab:red", linewidth=1.0, label="put in")
        panel.axhline(found[0].stated, color="0.6", linestyle=":", linewidth=1.0, label="stated")
        panel.errorbar(
            times, [one.value for one in found], half, fmt="o-", markersize=3, capsize=2, label="learned"
        )
        panel.set_title(title, fontsize=10)
        panel.grid(alpha=0.3)
    axes[0, 0].legend(fontsize=8)
    for panel in axes[1]:
        panel.set_xlabel("log until [s]")
    drawn.savefig(path, dpi=110)


def main() -> None:
    """Measures, or writes the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("what", choices=("measure", "table", "figure"))
    parser.add_argument("rows", type=Path)
    parser.add_argument("--worlds", type=int, default=5)
    parser.add_argument("--only", default="")
    parser.add_argument("--out", type=Path, default=Path("docs/self-calibration.md"))
    given = parser.parse_args()
    if given.what == "figure":
        figure(given.rows)
        return
    lines = given.rows.read_text().splitlines() if given.rows.exists() else []
    rows = [json.loads(line) for line in lines]
    if given.what == "table":
        page = given.out.read_text().split(MARK)
        given.out.write_text(f"{page[0]}{MARK}\n{table(rows)}{coverage(rows)}\n{MARK}{page[2]}")
        return
    done = {row["name"] + str(row["robot"]) for row in rows}
    data = Path(os.environ.get("FASTSLAM_DATA", "../shared/data"))
    for case in cases(given.worlds):
        if given.only not in case.name or case.name + str(case.robot) in done:
            continue
        row = measure(case, data)
        with given.rows.open("a") as out:
            out.write(json.dumps(row) + "\n")
        print(case.name, case.robot, row.get("refused"), row["before"], row.get("after"), flush=True)


if __name__ == "__main__":
    main()

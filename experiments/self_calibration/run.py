"""Measures `fastslam tune` with nothing told, on real logs and on simulated ones with errors put in.

    python experiments/self_calibration/run.py measure ROWS.jsonl [--worlds 5] [--only TEXT]
    python experiments/self_calibration/run.py table ROWS.jsonl --out docs/self-calibration.md

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
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import fastslam
import numpy as np
from fastslam.datasets import load
from fastslam.errors import FastSlamError
from fastslam.evaluation import evaluate
from fastslam.log import Log
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
    "noise told x 1/3": {"told": 1 / 3},
    "noise told x 3": {"told": 3.0},
}
WORLDS = ("demo", "loop")


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


def world_with(case: Case) -> Log:
    """A simulated log with the error of the case put into its numbers, or into what it states."""
    error = ERRORS[case.title]
    settings: dict[str, Any] = {"seed": case.seed}
    if "mounting" in error:
        settings["sensor"] = {"mounting": error["mounting"]}
    log = simulate(resolve_simulation(settings, preset=case.world))
    values = log.controls.values / np.array([error.get("distance", 1.0), error.get("turn", 1.0)])
    late = log.sightings.stamp_s + error.get("delay_s", 0.0)
    sensor, motion = dict(log.config["sensor"]), dict(log.config["motion"])
    sensor.pop("mounting", None)
    for section in (sensor, motion):
        for key in section:
            section[key] = section[key] * error.get("told", 1.0) if "_std_" in key else section[key]
    return replace(
        log,
        controls=replace(log.controls, values=values),
        sightings=replace(log.sightings, stamp_s=late),
        config={**log.config, "sensor": sensor, "motion": motion},
    )


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
        return {**row, "refused": str(error), "before": figures(fastslam.run(log, settings), log)}
    row["seconds"] = time.perf_counter() - began
    row["before"] = figures(found.attempts[0].result, log)
    row["after"] = figures(found.result, log)
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
    lines = ["| " + " | ".join(heads) + " |", "|---" * len(heads) + "|"]
    groups: dict[tuple[str, str], list[dict[str, Any]]] = {}
    for row in rows:
        title = f"`{row['world']}`: {row['title']}" if row["world"] else row["title"]
        groups.setdefault((title, row["association"]), []).append(row)
    for (title, association), group in groups.items():
        done = [row for row in group if "after" in row]
        columns = ("false", "landmark_rmse_m", "ate_rmse_m", "smoothed_ate_rmse_m")
        shown = [pair(done, column) for column in columns]
        if all(row["before"]["landmark_rmse_m"] is None for row in group):
            shown[0] = pair(done, "landmarks") + " in all"
            shown[2] = pair(done, "gps_median_m") + " (GPS median)"
        refused = str(len(group) - len(done))
        lines.append("| " + " | ".join((title, association, str(len(group)), refused, *shown)) + " |")
    return "\n".join(lines)


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


def main() -> None:
    """Measures, or writes the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("what", choices=("measure", "table"))
    parser.add_argument("rows", type=Path)
    parser.add_argument("--worlds", type=int, default=5)
    parser.add_argument("--only", default="")
    parser.add_argument("--out", type=Path, default=Path("docs/self-calibration.md"))
    given = parser.parse_args()
    lines = given.rows.read_text().splitlines() if given.rows.exists() else []
    rows = [json.loads(line) for line in lines]
    if given.what == "table":
        page = given.out.read_text().split(MARK)
        given.out.write_text(f"{page[0]}{MARK}\n{table(rows)}\n{MARK}{page[2]}")
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

"""Measures logs of ranges or bearings alone, made by others, beside a batch solution of the same data.

    python experiments/partial_logs/run.py [labyrinth] [tiers] [bearings] [--seeds 10]
        [--out docs/partial-logs.md]

`FASTSLAM_DATA` names the folder of `indoor_uwb_tuc`, `range_aided_pyfg` and `bearing_only_2d`. Without
names all are measured. With `--out` the table takes the place of that between the marks of the page.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import fastslam
import numpy as np
from batch import Floats, Solution, motions, solve
from fastslam.evaluation.align import align_points
from fastslam.log import Log, TruthLandmarks, TruthTrajectory
from fastslam.resultfiles import write_measured
from fastslam.runner import configure


def bearings(data: Path) -> Log:
    """The graph with its vertices as truth, which in this file they are."""
    file = data / "bearing_only_2d" / "slam-2d-bearing-only.g2o"
    log = fastslam.load(file)
    rows = [line.split() for line in file.read_text().splitlines()]
    poses = {row[1]: [float(v) for v in row[2:5]] for row in rows if row[0] == "VERTEX_SE2"}
    places = {row[1]: [float(v) for v in row[2:4]] for row in rows if row[0] == "VERTEX_XY"}
    path = np.array([poses[name] for name in sorted(poses, key=int)])
    truth = TruthTrajectory(np.arange(len(path), dtype=np.float64), path)
    return replace(
        log,
        truth_trajectory=truth,
        truth_landmarks=TruthLandmarks(tuple(places), np.array(list(places.values()))),
    )


LOGS: dict[str, dict[str, Callable[[Path], Log]]] = {
    "labyrinth": {"labyrinth": lambda data: fastslam.load(data / "indoor_uwb_tuc")},
    "tiers": {
        f"tiers, robot {letter}": lambda data, robot=robot: fastslam.load(
            data / "range_aided_pyfg" / "tiers.pyfg.gz", robot=robot
        )
        for robot, letter in enumerate("ABCD", start=1)
    },
    "bearings": {"2-D bearings": bearings},
}


def batch(log: Log) -> Solution:
    """The batch solution near the truth."""
    config = configure(log, {})
    stamp_s, increments, _ = motions(log, config)
    truth = log.truth_trajectory
    assert truth is not None and log.truth_landmarks is not None
    xy = [np.interp(stamp_s, truth.stamp_s, truth.T_world_robot[:, k]) for k in (0, 1)]
    heading = np.interp(stamp_s, truth.stamp_s, np.unwrap(truth.T_world_robot[:, 2]))
    if not truth.heading_known:
        # That of the odometry, turned as the true path goes where the robot drives.
        turned = np.concatenate([[0.0], np.cumsum(increments[:, 2])])
        ahead = np.gradient(xy[0]) + 1j * np.gradient(xy[1])
        heading = turned + np.angle(np.sum(ahead * np.exp(-1j * turned)))
    poses = np.column_stack([*xy, heading])
    places = dict(zip(log.truth_landmarks.names, log.truth_landmarks.position_m, strict=True))
    return solve(log, config, poses, np.array([places[name] for name in log.identity_names]))


def errors(
    log: Log, path: tuple[Floats, Floats], names: Sequence[str], places: Floats
) -> tuple[float, float]:
    """RMSE of a path after alignment, and of the landmarks as that turns them."""
    truth = log.truth_trajectory
    assert truth is not None and log.truth_landmarks is not None
    stamp_s, at_m = path
    inside = (truth.stamp_s >= stamp_s[0]) & (truth.stamp_s <= stamp_s[-1])
    own = np.column_stack([np.interp(truth.stamp_s[inside], stamp_s, at_m[:, k]) for k in (0, 1)])
    true_m = truth.T_world_robot[inside, :2]
    transform = align_points(own, true_m)
    off = np.linalg.norm(transform.apply_points(own) - true_m, axis=1)
    if len(names) == 0:
        return float(np.sqrt(np.mean(off**2))), float("nan")
    where = dict(zip(log.truth_landmarks.names, log.truth_landmarks.position_m, strict=True))
    found = transform.apply_points(places) - np.array([where[name] for name in names])
    return float(np.sqrt(np.mean(off**2))), float(np.sqrt(np.mean(np.sum(found**2, axis=1))))


def measure(name: str, log: Log, seeds: int) -> str:
    """A row: live, smoothed and map errors, those of the batch solution, and the worst ratio."""
    solved = batch(log)
    of_batch = (solved.stamp_s, solved.poses[:, :2])
    number = {name: k for k, name in enumerate(log.identity_names)}
    rows, left = [], 0
    for seed in range(1, seeds + 1):
        result = fastslam.run(log, {"seed": seed})
        smooth = (result.path.stamp_s, result.path.T_world_robot[:, :2])
        placed = np.asarray(result.landmarks.confirmed)
        names = [one for one, is_placed in zip(result.landmarks.ids, placed, strict=True) if is_placed]
        left = max(left, len(placed) - len(names))
        path_m, map_m = errors(log, smooth, names, result.landmarks.mean_m[placed])
        live_m, _ = errors(
            log,
            (result.trajectory.stamp_s, result.trajectory.T_world_robot[:, :2]),
            names,
            result.landmarks.mean_m[placed],
        )
        rows.append((live_m, path_m, map_m))
        # Of the landmarks that the filter has placed; the batch solution places all, as well as they can be.
        theirs = errors(log, of_batch, names, solved.landmarks[[number[name] for name in names]])
    worst = np.max(rows, axis=0)
    middle = np.median(rows, axis=0)
    cells = [f"{m:.3f} ({w:.3f}) m" for m, w in zip(middle, worst, strict=True)]
    cells += [f"{theirs[0]:.3f} m, {theirs[1]:.3f} m", f"{worst[1] / theirs[0]:.2f}", f"{left}"]
    return f"| {name} | {' | '.join(cells)} |"


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("logs", nargs="*", metavar="LOG", help=f"{', '.join(LOGS)}; all where none is named")
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--out", type=Path, help="a page with the marks of the table")
    options = parser.parse_args(arguments)
    data = Path(os.environ.get("FASTSLAM_DATA", "FASTSLAM_DATA"))
    if not data.is_dir():
        print(f"{data} is no folder: set FASTSLAM_DATA", file=sys.stderr)
        return 2
    seeds = f"{options.seeds} seeds, median (worst)"
    head = f"| {seeds} | live path | smoothed path | map | batch: path, map | ratio of paths | not placed |"
    lines = [head, "|---|---|---|---|---|---|---|"]
    for kind in options.logs or LOGS:
        for name, load in LOGS[kind].items():
            lines.append(measure(name, load(data), options.seeds))
            print(lines[-1], flush=True)
    table = "\n".join(lines) + "\n"
    print(table)
    if options.out is not None:
        write_measured(options.out, table)
    return 0


if __name__ == "__main__":
    sys.exit(main())

"""Figure 4: a rover drives through rocks; from raw laser scans to a map with ten particles."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from .. import _core
from ..datasets import load
from ..detection import detect, with_sightings
from ..evaluation import Metrics, evaluate, summarize
from ..log import BeamGeometry, Controls, Floats, Log, Scans, Sightings, TruthLandmarks, TruthTrajectory
from ..plots import new_figure, plot_map
from ..result import RunResult
from ..runner import run
from ..settings import Partial
from .experiment import Claim, Scale, interval

PARTICLES = 10
# The paper of 2002 never removes a landmark.
_SETTINGS: Partial = {
    "filter": {"particles": PARTICLES},
    "association": {"existence": {"removal": "never"}},
}
PAPER_ERROR = "8.3 cm (M = 10)"
ARENA_M = (40.0, 16.0)
ROCKS = 40
LANE_M = 1.2
"""No rock stands nearer than this to the middle line, along which the rover drives."""
SPEED_M_PER_S, DT_S, SCAN_PERIOD_S = 0.4, 0.1, 0.5
SPEED_STD, YAW_RATE_STD = 0.04, 0.03
"""Of the true motion about the commanded one, at each step."""


@dataclass(frozen=True)
class _Drive:
    name: str
    log: Log
    result: RunResult


def rover(scale: Scale) -> list[Claim]:
    """The simulated arena with a laser of 180° and of 360°, and the car park where its log is at hand."""
    seeds = scale.seeds(quick=5, full=30)
    drives, claims, rows = [], [], []
    for view_deg in (180, 360):
        logs = [arena_log(view_deg, seed=seed) for seed in seeds]
        results = [run(log, {**_SETTINGS, "seed": 1}) for log in logs]
        metrics = [evaluate(result, log) for result, log in zip(results, logs, strict=True)]
        name = f"arena, {view_deg}° laser"
        drives.append(_Drive(name, logs[0], results[0]))
        rows += [_row(name, seed, found) for seed, found in zip(seeds, metrics, strict=True)]
        claims.append(
            Claim("4: residual error of a map of rocks", PAPER_ERROR, f"{name}: {_said(metrics)} (worlds)")
        )
    park = _car_park()
    if park is not None:
        results = [run(park, {**_SETTINGS, "seed": seed}) for seed in seeds]
        metrics = [evaluate(result, park) for result in results]
        drives.append(_Drive("car park", park, results[0]))
        rows += [_row("car park", seed, found) for seed, found in zip(seeds, metrics, strict=True)]
        claims.append(
            Claim(
                "4: the same on a real log, posts surveyed by GPS",
                PAPER_ERROR,
                f"car park, run 3: {_said(metrics)} (seeds)",
            )
        )
    scale.write_csv("figure4", rows)
    scale.write_figure("figure4", lambda: _draw(drives))
    return claims


def arena_log(view_deg: int, *, seed: int) -> Log:
    """A drive along the middle of an arena of rocks, seen by a laser of half a degree and 2 cm.

    The rocks are found in the scans; nobody says which is which.
    """
    rng = np.random.default_rng(seed)
    rocks = _rocks(rng)
    stamp_s, T_world_robot, controls = _drive(rng)
    every = round(SCAN_PERIOD_S / DT_S)
    half_view = math.radians(view_deg) / 2.0
    geometry = BeamGeometry(-half_view, math.radians(0.5), 0.1, 20.0)
    beams = 2 * view_deg + (1 if view_deg < 360 else 0)
    a, b = ARENA_M[0] / 2.0, ARENA_M[1] / 2.0
    walls = np.array([[-a, -b, a, -b], [a, -b, a, b], [a, b, -a, b], [-a, b, -a, -b]])
    at = T_world_robot[::every]
    shape = json.dumps(asdict(geometry))
    ranges_m = _core.scan_arena(rocks, walls, at, shape, beams, 0.02, 0.002, seed)
    names = tuple(f"rock {k}" for k in range(len(rocks)))
    empty, none = np.zeros(0), np.zeros(0, dtype=np.int64)
    x_m, y_m, heading_rad = T_world_robot[0].tolist()
    log = Log(
        name=f"arena-{view_deg}-{seed}",
        source="simulation",
        format="native",
        controls=Controls(stamp_s, controls),
        sightings=Sightings(empty, empty, empty, none, none, empty),
        truth_trajectory=TruthTrajectory(stamp_s, T_world_robot),
        truth_landmarks=TruthLandmarks(names, rocks[:, :2]),
        scans=Scans(stamp_s[::every], ranges_m, geometry),
        config={
            "motion": {
                "model": "velocity",
                "speed_std_m_per_s": SPEED_STD,
                "yaw_rate_std_rad_per_s": YAW_RATE_STD,
                "noise_period_s": DT_S,
            },
            "sensor": {"range_std_m": 0.05, "bearing_std_rad": 0.01, "field_of_view_rad": 2.0 * half_view},
            "initial_pose": {"x_m": x_m, "y_m": y_m, "heading_rad": heading_rad},
        },
    )
    return detect(log)


def _rocks(rng: np.random.Generator) -> Floats:
    """Rocks (x, y, radius) that leave the lane free and do not touch each other. Shapes: (N, 3)."""
    rocks: list[Floats] = []
    half = np.array(ARENA_M) / 2.0 - 1.0
    while len(rocks) < ROCKS:
        radius = rng.uniform(0.1, 0.4)
        place = rng.uniform(-half, half)
        apart = all(np.hypot(*(place - other[:2])) > radius + other[2] + 0.8 for other in rocks)
        if apart and abs(place[1]) > radius + LANE_M:
            rocks.append(np.array([*place, radius]))
    return np.array(rocks)


def _drive(rng: np.random.Generator) -> tuple[Floats, Floats, Floats]:
    """Stamps, true poses (T, 3) and commands (T, 2): a rover that is steered back to the middle line."""
    steps = int((ARENA_M[0] - 8.0) / SPEED_M_PER_S / DT_S)
    pose = np.array([4.0 - ARENA_M[0] / 2.0, 0.0, 0.0])
    poses, controls = [pose], []
    for _ in range(steps):
        command = np.array([SPEED_M_PER_S, np.clip(-0.3 * pose[1] - 0.8 * pose[2], -0.3, 0.3)])
        speed, turn = command + rng.normal(0.0, (SPEED_STD, YAW_RATE_STD))
        middle = pose[2] + 0.5 * turn * DT_S
        chord = speed * DT_S * np.sinc(0.5 * turn * DT_S / np.pi)
        pose = pose + np.array([chord * np.cos(middle), chord * np.sin(middle), turn * DT_S])
        controls.append(command)
        poses.append(pose)
    controls.append(np.zeros(2))
    return np.arange(steps + 1, dtype=np.float64) * DT_S, np.array(poses), np.array(controls)


def _car_park() -> Log | None:
    """The car park in the folder FASTSLAM_DATA; None where it is absent."""
    folder = Path(os.environ.get("FASTSLAM_DATA", "../shared/data")) / "car_park"
    return with_sightings(load(folder)) if folder.is_dir() else None


def _row(name: str, seed: int, found: Metrics) -> dict[str, Any]:
    metrics = ("landmark_rmse_m", "landmark_matched", "landmark_recall", "ate_rmse_m")
    return {"log": name, "seed": seed, **{metric: found[metric] for metric in metrics}}


def _said(metrics: Sequence[Metrics]) -> str:
    found = summarize(metrics)
    error, recall = found["landmark_rmse_m"], found["landmark_recall"]
    return (
        f"{interval(error, scale=100.0, unit='cm')} RMS, {100 * recall.mean:.0f} % of the landmarks found, "
        f"{error.runs} runs"
    )


def _draw(drives: Sequence[_Drive]) -> Figure:
    figure = new_figure(7.5, 4.4 * len(drives))
    for axis, drive in zip(np.atleast_1d(figure.subplots(len(drives))), drives, strict=True):
        plot_map(axis, drive.result, drive.log)
        axis.set_title(f"{drive.name.capitalize()}, M = {PARTICLES}")
    return figure

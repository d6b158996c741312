"""GTSAM's iSAM2 and batch solver on the logs that FastSLAM and EKF-SLAM run on.

What is compared, and what is not: GTSAM keeps the whole path and relinearises, so its estimate of the past
is smoothed; it is given the associations, which it does not make itself. FastSLAM and EKF-SLAM are given them
here too. All get the same motion and sensor noise. Times are those of the solver, without reading and without
building factors.

Needs `pip install 'fastslam[peers]'`. Run: `python benchmarks/peers/gtsam_peer.py [LOG ...]`; without a log
two simulated worlds. A log needs identities and a motion model `velocity` or `increments`.
"""

from __future__ import annotations

import argparse
import csv
import itertools
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import gtsam
import numpy as np
from fastslam import Log, load, run
from fastslam.config import Config
from fastslam.errors import ConfigError
from fastslam.evaluation import trajectory_errors
from fastslam.result import Trajectory
from fastslam.simulation import resolve_simulation, simulate

PRIOR_STD = 1e-6
"""The start is known: it defines the world."""


@dataclass(frozen=True)
class Outcome:
    """What one solver did: `live` is the estimate at each stamp when it was new, `smoothed` at the end."""

    solver: str
    seconds: float
    step_ms: float
    live_rmse_m: float | None
    smoothed_rmse_m: float | None


@dataclass(frozen=True)
class Step:
    """The motion since the last scan, with its covariance in the frame where it ends, and the scan's rows."""

    stamp_s: float
    motion: Any
    covariance: np.ndarray
    rows: np.ndarray


def steps(log: Log, config: Config) -> Iterator[Step]:
    """Cuts the log at its scans."""
    stamps, values = log.controls.stamp_s, log.controls.values
    motion_config = config["motion"]
    if motion_config["model"] not in ("velocity", "increments"):
        raise ConfigError(f"motion.model: got {motion_config['model']}, expected velocity or increments")
    now_s, index = min(stamps[0], log.sightings.stamp_s[0]), 0
    for stamp_s, rows in _scans(log):
        motion, covariance = gtsam.Pose2(), np.zeros((3, 3))
        if motion_config["model"] == "increments":
            std = [
                motion_config[f"{name}_std_{unit}"]
                for name, unit in (("x", "m"), ("y", "m"), ("heading", "rad"))
            ]
            while index < len(stamps) and stamps[index] <= stamp_s:
                motion, covariance = _then(
                    motion, covariance, gtsam.Pose2(*values[index]), np.diag(np.square(std))
                )
                index += 1
        else:
            cuts = [now_s, *stamps[(stamps > now_s) & (stamps < stamp_s)], stamp_s]
            for begin_s, end_s in itertools.pairwise(cuts):
                held = int(np.searchsorted(stamps, begin_s, side="right")) - 1
                if held >= 0 and end_s > begin_s:
                    turn, noise = _velocity(values[held], end_s - begin_s, motion_config)
                    motion, covariance = _then(motion, covariance, turn, noise)
        now_s = stamp_s
        yield Step(stamp_s, motion, covariance, rows)


def _scans(log: Log) -> Iterator[tuple[float, np.ndarray]]:
    stamps = log.sightings.stamp_s
    starts = np.flatnonzero(np.diff(stamps, prepend=-np.inf) > 0.0)
    for begin, end in zip(starts, [*starts[1:], len(stamps)], strict=True):
        rows = np.arange(begin, end)
        yield float(stamps[begin]), rows[log.sightings.identity[rows] >= 0]


def _velocity(control: np.ndarray, dt_s: float, motion: dict[str, Any]) -> tuple[Any, np.ndarray]:
    period_s = motion["noise_period_s"]
    white = 1.0 if period_s is None else np.sqrt(period_s / dt_s)
    names = ("speed_std_m_per_s", "lateral_std_m_per_s", "yaw_rate_std_rad_per_s")
    std = np.array([motion[name] for name in names]) * white * dt_s
    return gtsam.Pose2.Expmap(np.array([control[0] * dt_s, 0.0, control[1] * dt_s])), np.diag(std**2)


def _then(motion: Any, covariance: np.ndarray, step: Any, noise: np.ndarray) -> tuple[Any, np.ndarray]:
    """Composition; the covariance is carried into the frame where the motion ends."""
    adjoint = step.inverse().AdjointMap()
    return motion.compose(step), adjoint @ covariance @ adjoint.T + noise


class Graph:
    """Factors and first guesses, step by step."""

    def __init__(self, log: Log, config: Config) -> None:
        self._log, self._sensor = log, config["sensor"]
        if any(self._sensor["mounting"].values()):
            raise ConfigError("sensor.mounting: must be zero here")
        start = config["initial_pose"]
        self._start = gtsam.Pose2(start["x_m"], start["y_m"], start["heading_rad"])
        std = np.array([self._sensor["bearing_std_rad"], self._sensor["range_std_m"]])
        self._noise = gtsam.noiseModel.Diagonal.Sigmas(std)
        self._known: set[int] = set()
        self.stamps_s: list[float] = []

    def add(self, step: Step, pose: Any) -> tuple[Any, Any]:
        """New factors and values; `pose` is the estimate at the last step (None at the first)."""
        graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        number = len(self.stamps_s)
        key = gtsam.symbol("x", number + 1)
        if pose is None:
            pose, tight = self._start, gtsam.noiseModel.Isotropic.Sigma(3, PRIOR_STD)
            graph.add(gtsam.PriorFactorPose2(gtsam.symbol("x", 0), pose, tight))
            values.insert(gtsam.symbol("x", 0), pose)
        covariance = step.covariance + PRIOR_STD**2 * np.eye(3)
        noise = gtsam.noiseModel.Gaussian.Covariance(covariance)
        graph.add(gtsam.BetweenFactorPose2(gtsam.symbol("x", number), key, step.motion, noise))
        guess = pose.compose(step.motion)
        values.insert(key, guess)
        sightings = self._log.sightings
        for row in step.rows:
            range_m, bearing = sightings.range_m[row], gtsam.Rot2(sightings.bearing_rad[row])
            identity = int(sightings.identity[row])
            landmark = gtsam.symbol("l", identity)
            graph.add(gtsam.BearingRangeFactor2D(key, landmark, bearing, range_m, self._noise))
            if identity not in self._known:
                self._known.add(identity)
                direction = bearing.theta()
                values.insert(
                    landmark, guess.transformFrom(range_m * np.array([np.cos(direction), np.sin(direction)]))
                )
        self.stamps_s.append(step.stamp_s)
        return graph, values


def isam2(log: Log, config: Config) -> Outcome:
    """One update per scan."""
    graph, solver, pose = Graph(log, config), gtsam.ISAM2(), None
    seconds, live = [], []
    for step in steps(log, config):
        factors, values = graph.add(step, pose)
        begun = time.perf_counter()
        solver.update(factors, values)
        pose = solver.calculateEstimatePose2(gtsam.symbol("x", len(graph.stamps_s)))
        seconds.append(time.perf_counter() - begun)
        live.append(pose)
    estimate = solver.calculateEstimate()
    smoothed = [estimate.atPose2(gtsam.symbol("x", k + 1)) for k in range(len(live))]
    return _outcome("GTSAM iSAM2", log, graph.stamps_s, live, smoothed, seconds)


def batch(log: Log, config: Config) -> Outcome:
    """All factors at once, Levenberg-Marquardt, from dead reckoning through the guesses."""
    graph, factors, values, pose = Graph(log, config), gtsam.NonlinearFactorGraph(), gtsam.Values(), None
    for step in steps(log, config):
        more, guesses = graph.add(step, pose)
        factors.push_back(more)
        values.insert(guesses)
        pose = guesses.atPose2(gtsam.symbol("x", len(graph.stamps_s)))
    begun = time.perf_counter()
    estimate = gtsam.LevenbergMarquardtOptimizer(factors, values).optimize()
    seconds = time.perf_counter() - begun
    smoothed = [estimate.atPose2(gtsam.symbol("x", k + 1)) for k in range(len(graph.stamps_s))]
    return _outcome("GTSAM batch (Levenberg-Marquardt)", log, graph.stamps_s, None, smoothed, [seconds])


def ours(name: str, log: Log, layer: dict[str, Any]) -> Outcome:
    """A filter of this package."""
    result = run(log, layer)
    smoothed = None if layer["algorithm"] == "ekf" else _rmse(log, result.smoothed)
    step_ms = 1e3 * result.filter_seconds / max(1, len(result.steps.stamp_s))
    return Outcome(name, result.filter_seconds, step_ms, _rmse(log, result.trajectory), smoothed)


def _outcome(
    name: str,
    log: Log,
    stamps_s: list[float],
    live: list[Any] | None,
    smoothed: list[Any],
    seconds: list[float],
) -> Outcome:
    def rmse(poses: list[Any]) -> float | None:
        return _rmse(
            log, Trajectory(np.array(stamps_s), np.array([[p.x(), p.y(), p.theta()] for p in poses]))
        )

    total = sum(seconds)
    live_rmse_m = None if live is None else rmse(live)
    return Outcome(name, total, 1e3 * total / len(stamps_s), live_rmse_m, rmse(smoothed))


def _rmse(log: Log, trajectory: Trajectory) -> float | None:
    errors = None if log.truth_trajectory is None else trajectory_errors(trajectory, log.truth_trajectory)
    return None if errors is None else float(errors.aligned_m.rmse)


def compare(log: Log) -> list[Outcome]:
    """All solvers on one log with identities."""
    config = Config.resolve(log.config)
    outcomes = [isam2(log, config), batch(log, config), ours("EKF-SLAM", log, {"algorithm": "ekf"})]
    for particles in (10, 100):
        layer = {"algorithm": "fastslam2", "filter": {"particles": particles}}
        outcomes.append(ours(f"FastSLAM 2.0, M = {particles}", log, layer))
    return outcomes


def main() -> None:
    """Prints a table as CSV: log, solver, seconds in all, milliseconds per step, live and smoothed error."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("logs", nargs="*", type=Path)
    parser.add_argument("--robot", type=int, help="robot number in a log of several")
    arguments = parser.parse_args()
    logs = [load(path, robot=arguments.robot) for path in arguments.logs]
    if not logs:
        logs = [simulate(resolve_simulation(preset="demo"), name="demo, K = 60")]
        logs.append(
            simulate(resolve_simulation(preset="headline", landmarks=1000), name="lawn mower, K = 1,000")
        )
    writer = csv.writer(sys.stdout, lineterminator="\n")
    writer.writerow(["log", "solver", "seconds", "step_ms", "live_rmse_m", "smoothed_rmse_m"])
    for log in logs:
        for o in compare(log):
            numbers = [o.seconds, o.step_ms, o.live_rmse_m, o.smoothed_rmse_m]
            writer.writerow([log.name, o.solver, *("" if v is None else f"{v:.4g}" for v in numbers)])
            sys.stdout.flush()


if __name__ == "__main__":
    main()

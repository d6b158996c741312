"""A fabricated log and run whose errors are known by construction, for the tests of scoring and drawing."""

from __future__ import annotations

from typing import Any

import numpy as np
from fastslam import _core
from fastslam.evaluation import RigidTransform
from fastslam.log import Controls, Floats, Log, PositionFixes, Sightings, TruthLandmarks, TruthTrajectory
from fastslam.result import LandmarkMap, RunResult, Steps, Trajectory

T_WORLD_TRUTH = RigidTransform(0.7, np.array([3.0, -2.0]))
"""The run's world frame differs from that of the truth by this."""

LANDMARKS_M = np.array(
    [[0.0, 0.0], [7.0, 1.0], [2.0, 5.0], [9.0, 6.5], [-3.0, 4.0], [4.5, 9.0], [-2.0, -3.0], [6.0, -4.0]]
)


def truth_path(count: int = 200) -> TruthTrajectory:
    """One and a half turns of an ellipse, not centred, at 10 Hz; headings pass through pi."""
    phase = np.linspace(0.0, 3.0 * np.pi, count)
    position = np.column_stack([4.0 * np.cos(phase) + 2.0, 3.0 * np.sin(phase) + 1.0])
    heading = np.arctan2(3.0 * np.cos(phase), -4.0 * np.sin(phase))
    return TruthTrajectory(0.1 * np.arange(count), np.column_stack([position, heading]))


def make_log(*, identities: bool = True, truth: bool = True, fixes: bool = False) -> Log:
    """A log around `truth_path` and `LANDMARKS_M`; its own readings do not matter for scoring."""
    path = truth_path()
    names = tuple(f"tree{k}" for k in range(len(LANDMARKS_M)))
    empty = np.zeros(0)
    none = np.zeros(0, dtype=np.int64)
    return Log(
        name="made-up",
        source="nowhere",
        format="native",
        controls=Controls(empty, np.zeros((0, 2))),
        sightings=Sightings(empty, empty, empty, none, none, empty),
        identity_names=names if identities else (),
        truth_trajectory=path if truth else None,
        truth_landmarks=TruthLandmarks(names, LANDMARKS_M.copy()) if truth else None,
        position_fixes=PositionFixes(path.stamp_s, path.T_world_robot[:, :2].copy()) if fixes else None,
    )


def make_run(
    *,
    path_error_m: Floats | None = None,
    landmark_error_m: Floats | None = None,
    ids: tuple[str, ...] | None = None,
    **changes: Any,
) -> RunResult:
    """A run that found everything, plus the given errors, in a frame turned and shifted by `T_WORLD_TRUTH`.

    Errors are (T, 2) and (K, 2), added in the frame of the truth. `changes` replace members of the result.
    """
    truth = truth_path()
    poses = truth.T_world_robot.copy()
    if path_error_m is not None:
        poses[:, :2] += path_error_m
    points = LANDMARKS_M if landmark_error_m is None else LANDMARKS_M + landmark_error_m
    poses = T_WORLD_TRUTH.apply_poses(poses)
    poses[:, 2] = (poses[:, 2] + np.pi) % (2.0 * np.pi) - np.pi
    covariance = np.tile(np.diag([0.04, 0.01, 0.0025]), (len(poses), 1, 1))
    members: dict[str, Any] = {
        "log_name": "made-up",
        "config": {
            "seed": 7,
            "filter": {"particles": 100},
            "association": {"mode": "known"},
            "sensor": {"range_std_m": 0.1},
        },
        "version": "0.0.test",
        "trajectory": Trajectory(truth.stamp_s, poses, covariance),
        "smoothed": Trajectory(truth.stamp_s, poses),
        "landmarks": make_map(ids or tuple(f"tree{k}" for k in range(len(points))), points),
        "steps": make_steps(truth.stamp_s),
        "filter_seconds": 2.0,
        "peak_memory_bytes": 12_345_678,
        "map_bytes": 4_321,
        "counts": {"covariance_repairs": 3},
    }
    return RunResult(**{**members, **changes})


def make_map(ids: tuple[str, ...], points_in_truth_m: Floats, *, sightings: int = 20) -> LandmarkMap:
    """Landmarks given in the frame of the truth, as a run would report them in its world."""
    count = len(points_in_truth_m)
    covariance = np.tile(np.array([[0.02, 0.008], [0.008, 0.01]]), (count, 1, 1))
    return LandmarkMap(
        ids=ids,
        mean_m=T_WORLD_TRUTH.apply_points(points_in_truth_m.reshape(-1, 2)),
        covariance_m2=covariance,
        sightings=np.full(count, sightings, dtype=np.int64),
    )


def make_steps(stamp_s: Floats) -> Steps:
    """Two sightings a step, resampled every tenth, latencies 1, 2, 3 ... microseconds."""
    count = len(stamp_s)
    resampled = np.arange(count) % 10 == 9
    counts = {name: np.zeros(count, dtype=np.int64) for name, kind in _core.step_fields() if kind == "count"}
    numbers = {name: np.zeros(count) for name, kind in _core.step_fields() if kind == "number"}
    flags = {name: np.zeros(count, dtype=np.bool_) for name, kind in _core.step_fields() if kind == "flag"}
    given: dict[str, Any] = {
        "stamp_s": stamp_s,
        "step": np.arange(count),
        "effective_sample_size": 100.0 - 5.0 * (np.arange(count) % 10),
        "resampled": resampled,
        "log_likelihood": np.full(count, -0.5),
        "sightings": np.full(count, 2, dtype=np.int64),
        "landmarks": np.full(count, 8, dtype=np.int64),
        "latency_us": np.arange(1.0, count + 1.0),
        "matched": np.full(count, 2, dtype=np.int64),
        "particles": np.full(count, 100, dtype=np.int64),
        "nis": np.full(count, 2.1),
        "health": np.where(np.arange(count) < 10, 0, np.where(np.arange(count) % 50 < 45, 1, 2)),
        "health_reasons": np.where((np.arange(count) >= 10) & (np.arange(count) % 50 >= 45), 6, 0),
    }
    return Steps(**{**counts, **numbers, **flags, **given})

"""Where odometry alone takes the robot, from stamp to stamp, and how uncertain each stretch is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from .datasets.graph import UPPER_3, GraphPath
from .datasets.planar import increments_between
from .errors import DataError
from .log import Floats, Log
from .runner import configure, run

BY_ROWS = ("increments",)
"""Motion models whose controls are the stretches themselves."""
NOTHING_IS_NEAR_M = 1e-9
"""A range limit below which no sighting lies, so that a filter predicts only."""


def path_of_odometry(log: Log) -> GraphPath:
    """The path of odometry with a pose at every sighting, at the start and at the end.

    Where the controls are displacements and nothing was seen between them, they are the stretches as they
    stand. For any other log the filter's own motion model is asked, by a Kalman filter without corrections.

    Errors: DataError for a log without motion settings.
    """
    if "model" not in log.config.get("motion", {}):
        raise DataError(f"log {log.name} has no motion model", log.source)
    if log.config["motion"]["model"] in BY_ROWS and _seen_at_rows(log):
        return _by_rows(log)
    return _by_prediction(log)


def start_pose(log: Log) -> Floats:
    """The pose that a run of the log begins with: x, y, heading."""
    start = configure(log)["initial_pose"]
    return np.array([start["x_m"], start["y_m"], start["heading_rad"]], dtype=np.float64)


def _seen_at_rows(log: Log) -> bool:
    stamps = log.sightings.stamp_s
    later = stamps[stamps >= log.controls.stamp_s[0]]
    before = np.unique(stamps[stamps < log.controls.stamp_s[0]])
    return len(before) <= 1 and bool(np.isin(later, log.controls.stamp_s).all())


def _by_rows(log: Log) -> GraphPath:
    stamps = log.controls.stamp_s
    first_s = stamps[0] - (stamps[1] - stamps[0] if len(stamps) > 1 else 1.0)
    if len(log.sightings.stamp_s) and log.sightings.stamp_s[0] < stamps[0]:
        first_s = log.sightings.stamp_s[0]
    settings = configure(log)["motion"]
    stds = np.array([settings[name] for name in ("x_std_m", "y_std_m", "heading_std_rad")])
    constant = np.diag(stds**2)[UPPER_3]
    covariance = np.tile(constant, (len(stamps), 1))
    if log.controls.covariance is not None:
        known = ~np.isnan(log.controls.covariance).any(axis=1)
        covariance[known] = log.controls.covariance[known]
    return _path(np.concatenate([[first_s], stamps]), log.controls.values, covariance)


def _by_prediction(log: Log) -> GraphPath:
    """Poses and covariances of a Kalman filter that sees nothing; what each stretch added to that."""
    stamps = np.concatenate([log.controls.stamp_s, log.sightings.stamp_s])
    span_s = float(np.ptp(stamps))
    settings = {
        "algorithm": "ekf",
        "filter": {"path_period_s": 2.0 * span_s + 1.0},
        "sensor": {"min_range_m": 0.1 * NOTHING_IS_NEAR_M, "max_range_m": NOTHING_IS_NEAR_M},
    }
    found = run(replace(log, scans=None), settings).trajectory
    stamp_s, poses, covariances = found.stamp_s, found.T_world_robot, found.covariance
    if covariances is None:
        raise DataError(f"log {log.name} gives no path with covariances", log.source)
    if stamp_s[0] > stamps.min():
        stamp_s = np.concatenate([[stamps.min()], stamp_s])
        poses = np.vstack([start_pose(log), poses])
        covariances = np.concatenate([np.zeros((1, 3, 3)), covariances])
    return _path(stamp_s, increments_between(poses), _added(poses, covariances)[:, UPPER_3[0], UPPER_3[1]])


def _added(poses: Floats, covariances: Floats) -> Floats:
    """Covariance of each stretch in the frame of its start: Q = P' - F P Fᵀ, turned back."""
    moved = np.diff(poses[:, :2], axis=0)
    by_pose = np.tile(np.eye(3), (len(moved), 1, 1))
    by_pose[:, 0, 2], by_pose[:, 1, 2] = -moved[:, 1], moved[:, 0]
    added = covariances[1:] - by_pose @ covariances[:-1] @ by_pose.swapaxes(1, 2)
    cosine, sine = np.cos(poses[:-1, 2]), np.sin(poses[:-1, 2])
    back = np.zeros_like(by_pose)
    back[:, 0, 0], back[:, 0, 1], back[:, 1, 0], back[:, 1, 1] = cosine, sine, -sine, cosine
    back[:, 2, 2] = 1.0
    result: Floats = back @ added @ back.swapaxes(1, 2)
    return result


def _path(stamp_s: Floats, increments: Floats, covariance: Floats) -> GraphPath:
    return GraphPath(tuple(map(str, range(len(stamp_s)))), stamp_s, increments, covariance, 0)

"""Where odometry alone takes the robot: at any stamp, and from stamp to stamp with how uncertain that is.

`DeadReckoning` integrates rows in closed form, fast enough to try many readings of a log. `path_of_odometry`
asks the filter's own motion model, which knows the noise; a test holds the two to each other.
"""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np

from . import _core
from .datasets.graph import UPPER_3, GraphPath
from .datasets.planar import chain_increments, increments_between
from .errors import ConfigError, DataError
from .log import Controls, Floats, Log
from .runner import configure, run
from .settings import Partial

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


class DeadReckoning:
    """Poses by the odometry alone, as it stands or with other gains; the last few paths are kept."""

    def __init__(self, controls: Controls, motion: Partial) -> None:
        self._controls = controls
        self._motion = motion
        self._paths: dict[tuple[float, float], tuple[Floats, Floats]] = {}

    def poses_at(self, stamp_s: Floats, *, speed_gain: float = 1.0, turn_gain: float = 1.0) -> Floats:
        """Poses (K, 3) in the frame of the first control, headings not wrapped.

        Speeds (or displacements) count times `speed_gain`, turns (yaw rates, steering angles, turns of rows)
        times `turn_gain`. What holds at the last row holds on; before the first one the robot stands.
        """
        key = (speed_gain, turn_gain)
        if key not in self._paths:
            controls = _with_gains(self._controls, speed_gain, turn_gain)
            twists = arc_twists(controls, self._motion)
            whole = chain_increments(_moved(twists[:-1], np.diff(controls.stamp_s)))
            self._paths = {**dict(list(self._paths.items())[-2:]), key: (twists, whole)}
        twists, at_row = self._paths[key]
        start_s = self._controls.stamp_s
        rows = np.clip(np.searchsorted(start_s, stamp_s, side="right") - 1, 0, len(at_row) - 1)
        rest = _moved(twists[rows], np.maximum(stamp_s - start_s[rows], 0.0))
        cosine, sine = np.cos(at_row[rows, 2]), np.sin(at_row[rows, 2])
        x, y = cosine * rest[:, 0] - sine * rest[:, 1], sine * rest[:, 0] + cosine * rest[:, 1]
        poses: Floats = at_row[rows] + np.column_stack([x, y, rest[:, 2]])
        return poses


def _with_gains(controls: Controls, speed: float, turn: float) -> Controls:
    if speed == turn == 1.0:
        return controls
    # An odometer that turns the other way is mirrored: its left is right as well.
    gains = [speed, turn] if controls.values.shape[1] == 2 else [speed, speed * np.sign(turn), turn]
    return replace(controls, values=controls.values * np.array(gains))


def turning_points(controls: Controls, motion: Partial) -> Controls:
    """The rows at which a speed or turn that is held changes, first and last: the same motion by fewer.

    Rows that tell of poses, or carry a covariance, are all kept.
    """
    if motion["model"] not in ("velocity", "ackermann") or controls.covariance is not None:
        return controls
    kept = np.ones(len(controls.stamp_s), dtype=np.bool_)
    kept[1:-1] = (np.diff(controls.values, axis=0) != 0.0).any(axis=1)[:-1]
    return replace(controls, stamp_s=controls.stamp_s[kept], values=controls.values[kept])


def arc_twists(controls: Controls, motion: Partial) -> Floats:
    """Velocities of the robot from each control until the next, whose arcs end where the rows say.

    Shapes: (C, 3) as forward and left in m/s, turn in rad/s; gains and biases of `motion` are applied.
    Errors: `ConfigError` for a motion model that is not known.
    """
    try:
        return _core.robot_twists(json.dumps(dict(motion)), controls.stamp_s, controls.values)
    except ValueError as error:
        raise ConfigError(f"motion: {error}") from None


def _moved(twists: Floats, dt_s: Floats) -> Floats:
    """The pose after a twist held for a time, in the frame of the pose before: an arc."""
    turn = twists[:, 2] * dt_s
    chord = np.sinc(0.5 * turn / np.pi) * dt_s
    cosine, sine = np.cos(0.5 * turn) * chord, np.sin(0.5 * turn) * chord
    x, y = cosine * twists[:, 0] - sine * twists[:, 1], sine * twists[:, 0] + cosine * twists[:, 1]
    return np.column_stack([x, y, turn])

"""A small native log with truth, made without the simulator, for tests of the command line and of runs."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from fastslam.datasets import write_native
from fastslam.log import Controls, Log, Sightings, TruthLandmarks, TruthTrajectory
from fastslam.robot import Robot, Step

LANDMARKS_M = np.array([[4.0, 1.0], [9.0, 5.0], [3.0, 9.0], [-4.0, 6.0], [0.5, 4.5], [6.0, -2.0]])
SPEED_M_PER_S = 1.0
YAW_RATE_RAD_PER_S = 0.25
DT_S = 0.1
RANGE_STD_M = 0.05
BEARING_STD_RAD = 0.02


def make_small_log(*, steps: int = 300, seed: int = 1) -> Log:
    """A robot drives on a circle of 4 m and sees every landmark in every fifth step; identities are known."""
    rng = np.random.default_rng(seed)
    stamp_s = DT_S * np.arange(1, steps + 1)
    heading = YAW_RATE_RAD_PER_S * stamp_s
    radius_m = SPEED_M_PER_S / YAW_RATE_RAD_PER_S
    position_m = radius_m * np.column_stack([np.sin(heading), 1.0 - np.cos(heading)])
    wrapped = (heading + np.pi) % (2.0 * np.pi) - np.pi
    values = np.tile([SPEED_M_PER_S, YAW_RATE_RAD_PER_S], (steps, 1)) + rng.normal(0.0, 0.02, (steps, 2))
    start = np.array([[0.0, SPEED_M_PER_S, YAW_RATE_RAD_PER_S]])
    controls = np.vstack([start, np.column_stack([stamp_s, values])])
    return Log(
        name="circle",
        source="made by a test",
        format="native",
        controls=Controls(controls[:, 0], controls[:, 1:]),
        sightings=_sightings(stamp_s[4::5], position_m[4::5], heading[4::5], rng),
        identity_names=tuple(f"post{k}" for k in range(len(LANDMARKS_M))),
        truth_trajectory=TruthTrajectory(stamp_s, np.column_stack([position_m, wrapped])),
        truth_landmarks=TruthLandmarks(tuple(f"post{k}" for k in range(len(LANDMARKS_M))), LANDMARKS_M),
        config={
            "motion": {"model": "velocity"},
            "sensor": {
                "model": "range_bearing",
                "range_std_m": RANGE_STD_M,
                "bearing_std_rad": BEARING_STD_RAD,
            },
        },
    )


def _sightings(
    stamp_s: np.ndarray, position_m: np.ndarray, heading: np.ndarray, rng: np.random.Generator
) -> Sightings:
    offset = LANDMARKS_M[None] - position_m[:, None]
    shape = offset.shape[:2]
    range_m = np.hypot(offset[..., 0], offset[..., 1]) + rng.normal(0.0, RANGE_STD_M, shape)
    bearing = np.arctan2(offset[..., 1], offset[..., 0]) - heading[:, None]
    bearing = bearing + rng.normal(0.0, BEARING_STD_RAD, shape)
    count = range_m.size
    return Sightings(
        stamp_s=np.repeat(stamp_s, len(LANDMARKS_M)),
        range_m=range_m.ravel(),
        bearing_rad=((bearing + np.pi) % (2.0 * np.pi) - np.pi).ravel(),
        identity=np.tile(np.arange(len(LANDMARKS_M), dtype=np.int64), len(stamp_s)),
        class_index=np.full(count, -1, dtype=np.int64),
        signature=np.full(count, np.nan),
    )


def write_small_log(folder: Path, *, steps: int = 300) -> Path:
    """Writes the log as a native folder."""
    return write_native(make_small_log(steps=steps), folder)


def events(log: Log) -> Iterator[tuple[float, int]]:
    """Stamp and kind (0: odometry) of each row in time order."""
    for stamp in log.controls.stamp_s:
        yield float(stamp), 0
    for stamp in np.unique(log.sightings.stamp_s):
        yield float(stamp), 1


def tell(robot: Robot, log: Log, row: tuple[float, int]) -> tuple[Step, ...]:
    stamp_s, kind = row
    if kind == 0:
        at = int(np.searchsorted(log.controls.stamp_s, stamp_s))
        return robot.odometry(stamp_s, log.controls.values[at])
    seen = log.sightings.stamp_s == stamp_s
    names = [log.identity_names[index] for index in log.sightings.identity[seen]]
    return robot.sightings(
        stamp_s,
        range_m=log.sightings.range_m[seen],
        bearing_rad=log.sightings.bearing_rad[seen],
        identity=names,
    )

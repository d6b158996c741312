"""Simulated logs in space, with truth: something that flies loops among landmarks and looks ahead."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..errors import ConfigError
from ..log import Floats, Ints
from .evaluation import matrices, quaternions
from .log import WITHOUT_ODOMETRY, SpaceLog, SpaceTruth

SENSORS = ("point", "range_bearing_elevation")
MOTIONS = ("odometry", "gyro", "wandering")
ROW_S = 0.05
SCAN_ROWS = 4
SECONDS = 120.0
ROOM_M = (16.0, 12.0, 5.0)
POSITION_STD = (0.02, 0.02, 0.02)
"""Of the motion, metres after one second."""
TURN_STD = (0.02, 0.02, 0.03)
"""Radians after one second."""
STD = {"point": (0.06, 0.06, 0.06), "range_bearing_elevation": (0.06, 0.01, 0.01)}
HALF_VIEW_RAD = 1.0
SWAY_STD = (0.3, 0.3, 0.3, 0.4, 0.4, 0.4)
"""How much the velocities of something in a hand differ from those that it is carried with, m/s and rad/s."""
SWAY_S = 0.5
"""Time after which such a difference is another one."""


def simulate(
    *,
    sensor: str = "point",
    motion: str = "odometry",
    landmarks: int = 40,
    max_range_m: float = 10.0,
    seed: int = 0,
    name: str = "space",
) -> SpaceLog:
    """Two minutes through a room of 16 m by 12 m by 5 m, the motion known to 2 cm and 1 degree a root second.

    With `motion` "gyro" only turns are known so, and with "wandering" nothing: somebody carries the sensor
    then, and it sways.

    >>> log = simulate(landmarks=12, seed=3)
    >>> log.velocity.shape, len(log.names), log.truth.T_world_robot.shape
    ((2400, 6), 12, (2400, 7))

    Errors: `ConfigError` for a sensor that is not one of `SENSORS`, a motion not of `MOTIONS`, and for
    numbers that are not positive.
    """
    for key, got, known in (("sensor", sensor, SENSORS), ("motion", motion, MOTIONS)):
        if got not in known:
            raise ConfigError(f"{key}: got {got}, expected {' or '.join(known)}")
    if not landmarks > 0 or not max_range_m > 0:
        raise ConfigError(
            f"landmarks, max_range_m: got {landmarks}, {max_range_m}, expected positive numbers"
        )
    rng = np.random.default_rng(seed)
    places = rng.uniform(-0.5, 0.5, (landmarks, 3)) * ROOM_M
    velocity, positions, rotations = _flight(rng, is_carried=motion != "odometry")
    stamp_s: Floats = ROW_S * np.arange(1, len(velocity) + 1, dtype=np.float64)
    scans = np.arange(SCAN_ROWS - 1, len(velocity), SCAN_ROWS)
    row, seen, value = _sightings(places, positions[scans + 1], rotations[scans + 1], (max_range_m, sensor))
    std = np.array(STD[sensor])
    poses: Floats = np.column_stack([positions, quaternions(rotations)])
    names = tuple(f"star-{number}" for number in range(1, landmarks + 1))
    keys = ("x_m", "y_m", "z_m", "qw", "qx", "qy", "qz")
    rows = slice(0 if motion == "wandering" else None)
    # Without odometry the first scan is where the path begins.
    start = 0 if motion == "odometry" or not len(row) else scans[row[0]] + 1
    return SpaceLog(
        name=name,
        source="simulation",
        format="space",
        row_stamp_s=np.asarray(stamp_s - ROW_S)[rows],
        velocity=(velocity * _MEASURED[motion])[rows],
        sighting_stamp_s=stamp_s[scans][row],
        value=value + rng.normal(size=value.shape) * std,
        identity=seen,
        names=names,
        truth=SpaceTruth(stamp_s, poses[1:], names, places),
        config={
            "motion": _motion(motion),
            **({} if motion == "odometry" else {"filter": WITHOUT_ODOMETRY}),
            "sensor": {"model": sensor, "max_range_m": 2.0 * max_range_m, **_noise(sensor)},
            "initial_pose": dict(zip(keys, map(float, poses[start]), strict=True)),
        },
    )


_MEASURED = {
    "odometry": np.ones(6),
    "gyro": np.array([0.0, 0.0, 0.0, 1.0, 1.0, 1.0]),
    "wandering": np.zeros(6),
}
"""Which velocities somebody notes."""


def _noise(sensor: str) -> dict[str, object]:
    if sensor == "point":
        return {"position_std_m": list(STD[sensor])}
    names = ("range_std_m", "bearing_std_rad", "elevation_std_rad")
    return dict(zip(names, STD[sensor], strict=True))


def _motion(motion: str) -> dict[str, object]:
    """What the log says of its motion: how velocities wander it does not know."""
    turn = {"turn_std_rad_per_sqrt_s": list(TURN_STD)}
    if motion == "odometry":
        return {"position_std_m_per_sqrt_s": list(POSITION_STD), **turn}
    return {"kind": motion, **(turn if motion == "gyro" else {})}


def _flight(rng: np.random.Generator, *, is_carried: bool) -> tuple[Floats, Floats, Floats]:
    """What is commanded in each row, and positions and rotations, the start first: the motion errs.

    What is carried sways: an error of the velocity that decays and is made anew.
    """
    std = np.array([*POSITION_STD, *TURN_STD]) * np.sqrt(ROW_S)
    sway, decay = np.zeros(6), np.exp(-ROW_S / SWAY_S)
    fresh = np.array(SWAY_STD) * np.sqrt(1.0 - decay**2)
    velocities, positions, rotations = [], [np.array([0.0, -4.0, 0.0])], [np.eye(3)]
    for row in range(round(SECONDS / ROW_S)):
        velocity = _steered(positions[-1], rotations[-1], ROW_S * row)
        if is_carried:
            sway = decay * sway + rng.normal(size=6) * fresh
            velocity = velocity + sway
        way = velocity * ROW_S + rng.normal(size=6) * std
        # The chord of an arc points half of its turn aside, to the third order of a turn of a few degrees.
        half, whole = turns(np.array([0.5 * way[3:], way[3:]]))
        positions.append(positions[-1] + rotations[-1] @ half @ way[:3])
        rotations.append(rotations[-1] @ whole)
        velocities.append(velocity)
    return np.array(velocities), np.array(positions), np.array(rotations)


def _steered(position: Floats, rotation: Floats, time_s: float) -> Floats:
    """The velocity of somebody who flies round the room, up and down, and rolls a little."""
    x, y, z = position
    off = float(np.hypot(x, y)) - 4.0
    goal = np.array([-y, x, 0.0]) / 4.0 - 0.4 * off * np.array([x, y, 0.0]) / 4.0
    goal[2] = 0.6 * (1.2 * np.sin(0.3 * time_s) - z)
    ahead, up = rotation.T @ goal, rotation[2]
    yaw = np.arctan2(ahead[1], ahead[0])
    pitch = -np.arctan2(ahead[2], np.hypot(ahead[0], ahead[1]))
    return np.array([0.8, 0.0, 0.1 * np.cos(0.7 * time_s), 0.3 * np.sin(0.5 * time_s) - up[1], pitch, yaw])


def turns(vectors: Floats) -> Floats:
    """Rotation matrices (N, 3, 3) of rotation vectors (N, 3)."""
    angle = np.linalg.norm(vectors, axis=1, keepdims=True)
    half = 0.5 * angle
    return matrices(np.hstack([np.cos(half), 0.5 * np.sinc(half / np.pi) * vectors]))


def _sightings(
    places: Floats, positions: Floats, rotations: Floats, limits: tuple[float, str]
) -> tuple[Ints, Ints, Floats]:
    """Scan, landmark and true numbers of all that is in view: ahead, and not too far."""
    max_range_m, sensor = limits
    off = places[None, :, :] - positions[:, None, :]
    point = np.einsum("nij,nki->nkj", rotations, off)
    range_m = np.linalg.norm(point, axis=2)
    away = np.arccos(np.clip(point[:, :, 0] / np.maximum(range_m, 1e-9), -1.0, 1.0))
    scan, landmark = np.nonzero((range_m < max_range_m) & (range_m > 0.3) & (away < HALF_VIEW_RAD))
    return scan.astype(np.int64), landmark.astype(np.int64), _MEASURE[sensor](point[scan, landmark])


def _polar(point: Floats) -> Floats:
    x, y, z = point.T
    level = np.hypot(x, y)
    return np.column_stack([np.hypot(level, z), np.arctan2(y, x), np.arctan2(z, level)])


_MEASURE: dict[str, Callable[[Floats], Floats]] = {
    "point": lambda point: point,
    "range_bearing_elevation": _polar,
}

"""What may be wrong with the conventions of a log, as changes of its numbers that a score can compare."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..datasets.planar import chain_increments
from ..detection import robot_twists
from ..log import Controls, Floats, Sightings
from ..settings import Layer


@dataclass(frozen=True)
class Hypothesis:
    """How the numbers of a log are to be read. The default reads them as they stand.

    A bearing is read as `bearing_sign * bearing_unit * bearing_rad + bearing_offset_rad`, a speed (or a
    displacement) times `speed_gain`, a turn (yaw rate, steering angle or turn of a row) times `turn_gain`,
    and a sighting belongs to the pose `delay_s` before its stamp.
    """

    bearing_sign: int = 1
    bearing_offset_rad: float = 0.0
    bearing_unit: float = 1.0
    speed_gain: float = 1.0
    turn_gain: float = 1.0
    delay_s: float = 0.0


AS_IS = Hypothesis()
DEGREE = float(np.pi / 180)


@dataclass(frozen=True)
class Places:
    """Sightings under a hypothesis, in the frame of the odometry.

    Shapes: `T_odometry_sensor` (S, 3), pose of the sensor at each sighting; `point_m` (S, 2), what it shows;
    `sight` (S, 2), the unit vector from the sensor to it.
    """

    T_odometry_sensor: Floats
    point_m: Floats
    sight: Floats


class DeadReckoning:
    """Poses by the odometry alone, under hypotheses about its gains; the last few paths are kept."""

    def __init__(self, controls: Controls, motion: Layer) -> None:
        self._controls = controls
        self._motion = motion
        self._paths: dict[tuple[float, float], tuple[Floats, Floats]] = {}

    def poses_at(self, stamp_s: Floats, hypothesis: Hypothesis = AS_IS) -> Floats:
        """Poses (K, 3) in the frame of the first control, headings not wrapped.

        What holds at the last row holds on; before the first one the robot stands.
        """
        key = (hypothesis.speed_gain, hypothesis.turn_gain)
        if key not in self._paths:
            controls = _reread(self._controls, hypothesis)
            twists = _twists(controls, self._motion)
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


def places(
    sightings: Sightings, sensor: Layer, reckoning: DeadReckoning, hypothesis: Hypothesis = AS_IS
) -> Places:
    """Where the robot was and what it saw, if the hypothesis is true and the odometry without noise.

    `sensor` holds complete settings.
    """
    mounting = sensor["mounting"]["x_m"], sensor["mounting"]["y_m"], sensor["mounting"]["yaw_rad"]
    T_odometry_robot = reckoning.poses_at(sightings.stamp_s - hypothesis.delay_s, hypothesis)
    heading = T_odometry_robot[:, 2]
    cosine, sine = np.cos(heading), np.sin(heading)
    sensor_m = T_odometry_robot[:, :2] + np.column_stack(
        [cosine * mounting[0] - sine * mounting[1], sine * mounting[0] + cosine * mounting[1]]
    )
    gain = hypothesis.bearing_sign * hypothesis.bearing_unit
    bearing = gain * (sightings.bearing_rad - sensor["bearing_bias_rad"])
    facing = heading + mounting[2]
    direction = facing + bearing + hypothesis.bearing_offset_rad
    sight = np.column_stack([np.cos(direction), np.sin(direction)])
    range_m = (sightings.range_m - sensor["range_bias_m"]) / sensor["range_scale"]
    point_m = sensor_m + range_m[:, None] * sight
    return Places(np.column_stack([sensor_m, facing]), point_m, sight)


def _reread(controls: Controls, hypothesis: Hypothesis) -> Controls:
    if hypothesis.speed_gain == hypothesis.turn_gain == 1.0:
        return controls
    speed, turn = hypothesis.speed_gain, hypothesis.turn_gain
    # An odometer that turns the other way is mirrored: its left is right as well.
    gains = [speed, turn] if controls.values.shape[1] == 2 else [speed, speed * np.sign(turn), turn]
    return replace(controls, values=controls.values * np.array(gains))


def _twists(controls: Controls, motion: Layer) -> Floats:
    """Velocities (C, 3) whose arcs end where the rows say."""
    twists = robot_twists(controls, dict(motion))
    if controls.values.shape[1] == 2 or len(twists) < 2:
        return twists
    # Rows of increments are chords; an arc with that chord leaves half the turn beside it.
    half = 0.5 * np.append(controls.values[1:, 2], 0.0)
    cosine, sine, stretch = np.cos(half), np.sin(half), 1.0 / np.sinc(np.clip(half, -3.0, 3.0) / np.pi)
    x, y = twists[:, 0] * stretch, twists[:, 1] * stretch
    return np.column_stack([cosine * x + sine * y, cosine * y - sine * x, twists[:, 2]])


def _moved(twists: Floats, dt_s: Floats) -> Floats:
    """The pose after a twist held for a time, in the frame of the pose before: an arc."""
    turn = twists[:, 2] * dt_s
    chord = np.sinc(0.5 * turn / np.pi) * dt_s
    cosine, sine = np.cos(0.5 * turn) * chord, np.sin(0.5 * turn) * chord
    x, y = cosine * twists[:, 0] - sine * twists[:, 1], sine * twists[:, 0] + cosine * twists[:, 1]
    return np.column_stack([x, y, turn])

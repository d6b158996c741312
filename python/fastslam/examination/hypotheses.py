"""What may be wrong with the conventions of a log, as changes of its numbers that a score can compare."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..dead_reckoning import DeadReckoning
from ..log import Floats, Sightings
from ..settings import Partial


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


def places(
    sightings: Sightings, sensor: Partial, reckoning: DeadReckoning, hypothesis: Hypothesis = AS_IS
) -> Places:
    """Where the robot was and what it saw, if the hypothesis is true and the odometry without noise.

    `sensor` holds complete settings.
    """
    mounting = sensor["mounting"]["x_m"], sensor["mounting"]["y_m"], sensor["mounting"]["yaw_rad"]
    T_odometry_robot = reckoning.poses_at(
        sightings.stamp_s - sensor["delay_s"] - hypothesis.delay_s,
        speed_gain=hypothesis.speed_gain,
        turn_gain=hypothesis.turn_gain,
    )
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

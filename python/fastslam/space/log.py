"""A log in space: body velocities, sightings and truth as arrays."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from ..log import Floats, Ints, Problem

MEASURED = {
    "point": ("x_m", "y_m", "z_m"),
    "range_bearing_elevation": ("range_m", "bearing_rad", "elevation_rad"),
    "stereo": ("column_px", "row_px", "disparity_px"),
}
"""The three numbers of a sighting, by `sensor.model`."""

WITHOUT_ODOMETRY = {"draw_every_scans": 1, "draw_fraction": 0.0}
"""`filter` of a log without odometry: particles spread so far between scans that each draws them anew."""


@dataclass(frozen=True)
class SpaceTruth:
    """What is true. Shapes: `stamp_s` (T,), `T_world_robot` (T, 7), `names` (K), `position_m` (K, 3).

    A pose is x, y, z in metres and the quaternion w, x, y, z. Both parts may be empty.
    """

    stamp_s: Floats
    T_world_robot: Floats
    names: tuple[str, ...]
    position_m: Floats


@dataclass(frozen=True)
class SpaceLog:
    """Everything that was read from one log in space.

    Shapes: `row_stamp_s` (N,) growing, `velocity` (N, 6) in the robot's axes (m/s, rad/s), each row holding
    until the next, with zeros for what is not measured; `sighting_stamp_s` (S,) in order, `value` (S, 3) as
    `MEASURED` has it, `identity` (S,) into `names` (-1: nobody says), `covariance` (S, 6) the upper triangle
    of each, row by row, NaN or None where the sensor's settings hold.
    """

    name: str
    source: str
    format: str
    row_stamp_s: Floats
    velocity: Floats
    sighting_stamp_s: Floats
    value: Floats
    identity: Ints
    names: tuple[str, ...]
    covariance: Floats | None = None
    truth: SpaceTruth | None = None
    config: dict[str, Any] = field(default_factory=dict)
    problems: tuple[Problem, ...] = ()

    @property
    def sensor(self) -> str:
        """Which three numbers a sighting has."""
        return str(self.config.get("sensor", {}).get("model", "point"))

    @property
    def motion(self) -> str:
        """What is measured of the motion: odometry, gyro (turns alone), or wandering (nothing)."""
        return str(self.config.get("motion", {}).get("kind", "odometry"))

    @property
    def duration_s(self) -> float:
        """From the first row or sighting to the last."""
        ends = [stamps[[0, -1]] for stamps in (self.row_stamp_s, self.sighting_stamp_s) if len(stamps)]
        return float(max(e[1] for e in ends) - min(e[0] for e in ends)) if ends else 0.0

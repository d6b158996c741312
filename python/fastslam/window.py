"""What a live stream takes and gives: which rows may come when, and the steps that they make possible."""

from __future__ import annotations

from dataclasses import dataclass

from .filter import StepInfo
from .log import Floats


@dataclass(frozen=True)
class Window:
    """What may come when, in seconds of the rows' own stamps; no clock is asked.

    A row may be `late_s` older than the newest one: nothing is computed before, so this is also how far the
    map lags. Sightings wait `wait_s` for the row of odometry after them; then the robot is taken to move on
    as it did (where odometry is a speed) or to stand (where it is a displacement). A row further than `gap_s`
    ahead of all others is refused, unless another row confirms that the clock was set.
    """

    late_s: float = 0.2
    wait_s: float = 2.0
    gap_s: float = 60.0


@dataclass(frozen=True)
class Step:
    """A step of the filter: when, pose (3,) and covariance (3, 3) as x, y, heading, and what happened."""

    stamp_s: float
    T_world_robot: Floats
    covariance: Floats
    info: StepInfo

"""Motion between stamps by the odometry, its derivatives by gains, biases, delay, and parts of its noise."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from .._between import Between
from ..config import merge
from ..dead_reckoning import arc_twists, turning_points
from ..log import Controls, Floats

DELAY = "sensor.delay_s"
DISTANCE = "motion.correction.distance_gain"


@dataclass(frozen=True)
class Known:
    """A parameter before the log has spoken: key, unit, and how far from the stated value it may be."""

    key: str
    unit: str
    prior_std: float
    step: float
    """A change so small that the motion is linear in it."""


def motion_parameters(motion: Mapping[str, Any]) -> tuple[Known, ...]:
    """What a motion model may err in systematically, the delay of the sensor against it last."""
    delay = Known(DELAY, "s", 0.3, 0.01)
    distance = Known(DISTANCE, "", 0.1, 1e-4)
    if motion["model"] == "ackermann":
        gain = Known("motion.steering_gain", "", 0.1, 1e-4)
        return distance, gain, Known("motion.steering_bias_rad", "rad", 0.05, 1e-5), delay
    turn = Known("motion.correction.turn_gain", "", 0.3, 1e-4)
    return distance, turn, Known("motion.correction.yaw_rate_bias_rad_per_s", "rad/s", 0.02, 1e-5), delay


def value_of(settings: Mapping[str, Any], key: str) -> float:
    """The number at a dotted key of complete settings."""
    value: Any = settings
    for part in key.split("."):
        value = value[part]
    return float(value)


def nested(key: str, value: Any) -> dict[str, Any]:
    """The partial settings that hold a value at a dotted key."""
    for part in reversed(key.split(".")):
        value = {part: value}
    return dict(value)


@dataclass(frozen=True)
class Part:
    """One part of the noise of motion, with variance per second `square * density` along an axis.

    `axis` is 0 ahead, 1 left, 2 the turn; `density` (C,) is of each row of the controls; the setting `key` is
    the root of `square`, or with `squared` the square itself.
    """

    key: str
    axis: int
    density: Floats
    squared: bool = False

    def setting(self, square: float) -> dict[str, Any]:
        """The partial settings of a variance."""
        return nested(self.key, float(square if self.squared else np.sqrt(square)))


def noise_parts(controls: Controls, motion: dict[str, Any], twists: Floats | None = None) -> tuple[Part, ...]:
    """The parts that the noise of a motion model is made of; `twists`: its `arc_twists`, if there already."""
    twists = arc_twists(controls, motion) if twists is None else twists
    return tuple(part for part in _parts(controls, motion, twists) if float(np.mean(part.density)) > 0)


def _parts(controls: Controls, motion: dict[str, Any], twists: Floats) -> Iterator[Part]:
    speed, turn = np.hypot(twists[:, 0], twists[:, 1]), np.abs(twists[:, 2])
    period_s = np.diff(controls.stamp_s, append=controls.stamp_s[-1:])
    period_s[-1] = np.median(period_s) if len(period_s) > 1 else 1.0
    yield from _constant_parts(controls, motion, twists, period_s)
    yield Part("motion.proportional.distance_std_m_per_sqrt_m", 0, speed)
    yield Part("motion.proportional.lateral_std_m_per_sqrt_m", 1, speed)
    yield Part("motion.proportional.turn_std_rad_per_sqrt_m", 2, speed)
    yield Part("motion.proportional.turn_std_rad_per_sqrt_rad", 2, turn)


def _constant_parts(
    controls: Controls, motion: dict[str, Any], twists: Floats, period_s: Floats
) -> Iterator[Part]:
    model = motion["model"]
    if model == "increments":
        for axis, name in enumerate(("x_std_m", "y_std_m", "heading_std_rad")):
            yield Part(f"motion.{name}", axis, 1 / period_s)
        return
    if model == "odometry":
        way_m, turn_rad = np.hypot(twists[:, 0], twists[:, 1]) * period_s, twists[:, 2] * period_s
        yield Part("motion.alpha3", 0, way_m**2 / period_s, squared=True)
        yield Part("motion.alpha4", 0, turn_rad**2 / period_s, squared=True)
        yield Part("motion.alpha1", 2, turn_rad**2 / period_s, squared=True)
        yield Part("motion.alpha2", 2, 2 * way_m**2 / period_s, squared=True)
        return
    held_s = motion["noise_period_s"] * np.ones(len(period_s)) if motion["noise_period_s"] else period_s
    yield Part("motion.speed_std_m_per_s", 0, held_s)
    yield Part("motion.lateral_std_m_per_s", 1, held_s)
    if model == "velocity":
        yield Part("motion.yaw_rate_std_rad_per_s", 2, held_s)
        return
    steering = controls.values[:, 1] * motion["steering_gain"] + motion["steering_bias_rad"]
    by_steering = twists[:, 0] / motion["wheelbase_m"] / np.cos(steering) ** 2
    yield Part("motion.steering_std_rad", 2, by_steering**2 * held_s)


@dataclass(frozen=True)
class Links:
    """What the odometry says of the motion from each stamp to the next.

    Shapes: `motion` (K - 1, 3) ahead, left and turn in the frame of the earlier pose; `by_parameter`
    (K - 1, 3, N) in the order of `motion_parameters`; `share` (K - 1, P), what each part of the noise adds to
    its variance for a `square` of one.
    """

    motion: Floats
    by_parameter: Floats
    share: Floats


def links(controls: Controls, config: Mapping[str, Any], stamp_s: Floats) -> Links:
    """The links between the stamps of sightings under complete settings."""
    turning = turning_points(controls, config["motion"])
    here_twists = arc_twists(turning, config["motion"])
    analysed: dict[float, Between] = {}

    def moved(settings: Mapping[str, Any]) -> Floats:
        delay_s = settings["sensor"]["delay_s"]
        if delay_s not in analysed:
            analysed[delay_s] = Between(turning, stamp_s - delay_s)
        same = settings["motion"] == config["motion"]
        return analysed[delay_s].motion(here_twists if same else arc_twists(turning, settings["motion"]))

    motion, columns = moved(config), []
    for known in motion_parameters(config["motion"]):
        here = value_of(config, known.key)
        up = moved(merge(config, nested(known.key, here + known.step)))
        # By a delay the motion goes from row to row: the mean of both sides tells how.
        both = known.key == DELAY
        down = moved(merge(config, nested(known.key, here - known.step))) if both else motion
        columns.append((up - down) / (2 * known.step if both else known.step))
    every_row = here_twists[np.searchsorted(turning.stamp_s, controls.stamp_s, side="right") - 1]
    parts = noise_parts(controls, config["motion"], every_row)
    density = np.column_stack([part.density for part in parts])
    share = Between(controls, stamp_s - config["sensor"]["delay_s"]).gathered(density)
    return Links(motion, np.stack(columns, axis=2), share)

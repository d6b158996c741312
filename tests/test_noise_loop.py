"""Who follows the advice about the noise ends at the truth, whichever noise was mis-set, and which way."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

import fastslam
import pytest
from fastslam.config import merge
from fastslam.log import Log
from fastslam.simulation import resolve_simulation, simulate

# Between two scans the motion must add more uncertainty than a scan takes away, else no log tells its noise.
MODELS: dict[str, dict[str, Any]] = {
    "velocity": {
        "model": "velocity",
        "speed_std_m_per_s": 0.2,
        "yaw_rate_std_rad_per_s": 0.08,
        "noise_period_s": 0.1,
    },
    "ackermann": {
        "model": "ackermann",
        "wheelbase_m": 1.5,
        "encoder_left_m": 0.0,
        "sensor_ahead_m": 0.5,
        "sensor_left_m": 0.0,
        "speed_std_m_per_s": 0.2,
        "steering_std_rad": 0.06,
        "noise_period_s": 0.1,
    },
    "increments": {"model": "increments", "x_std_m": 0.02, "y_std_m": 0.02, "heading_std_rad": 0.008},
    "odometry": {"model": "odometry", "alpha1": 0.02, "alpha2": 0.002, "alpha3": 0.02, "alpha4": 0.001},
}
SENSOR = ("sensor.range_std_m", "sensor.bearing_std_rad")
# Keys that are one noise, and the power of a standard deviation that they are.
NOISES: dict[str, tuple[tuple[tuple[str, ...], int], ...]] = {
    "velocity": (
        *(((key,), 1) for key in SENSOR),
        (("motion.speed_std_m_per_s",), 1),
        (("motion.yaw_rate_std_rad_per_s",), 1),
    ),
    "ackermann": ((("motion.speed_std_m_per_s",), 1), (("motion.steering_std_rad",), 1)),
    "increments": tuple(((f"motion.{key}",), 1) for key in ("x_std_m", "y_std_m", "heading_std_rad")),
    "odometry": ((("motion.alpha1", "motion.alpha2"), 2), (("motion.alpha3", "motion.alpha4"), 2)),
}
ADVICE = re.compile(r"((?:sensor|motion)\.\w+) to about ([0-9.]+(?:e-?[0-9]+)?)")
ENOUGH = 1.3
"""A standard deviation within this factor of the truth is as good as right."""


def world(model: str, seed: int) -> Log:
    settings = {
        "seed": seed,
        "motion": MODELS[model],
        "sensor": {"range_std_m": 0.05, "bearing_std_rad": 0.01},
        "scan": {"period_s": 1.0},
        "trajectory": {"laps": 9},
        "max_duration_s": 600.0,
        "vehicle": {"max_yaw_rate_rad_per_s": 0.5},
    }
    return simulate(resolve_simulation(settings))


def value(config: Mapping[str, Any], key: str) -> float:
    section, name = key.split(".")
    return float(config[section][name])


def with_value(config: Mapping[str, Any], key: str, number: float) -> dict[str, Any]:
    section, name = key.split(".")
    return merge(config, {section: {name: number}})


def advised(log: Log, config: dict[str, Any]) -> dict[str, float]:
    """What a run with these settings says to set."""
    result = fastslam.run(log, merge({"seed": 1, "filter": {"particles": 50}}, config), auto=False)
    return {key: float(text) for warning in result.warnings for key, text in ADVICE.findall(warning)}


def after_advice(log: Log, config: dict[str, Any]) -> dict[str, Any]:
    """The settings after the advice of a run and at most one more round, which must not take it back."""
    rounds: list[dict[str, float]] = []
    for _ in range(2):
        advice = advised(log, config)
        rounds.append({key: number / value(config, key) for key, number in advice.items()})
        for key, number in advice.items():
            config = with_value(config, key, number)
    for key in rounds[0].keys() & rounds[1].keys():
        assert (rounds[0][key] > 1.0) == (rounds[1][key] > 1.0), f"{key}: advice against itself: {rounds}"
    return config


WORST = 1.5
"""What chance does to one run: over 480 of them where advice ends scatters by up to 0.1, one in 100 ends
beyond 1.3, at most at 1.4. From five times the range noise the end is at 1.27 in the median."""
SEEDS = (3, 5, 12)


@pytest.mark.slow(but="sensor.range_std_m-2.0")
@pytest.mark.parametrize("factor", [0.2, 0.5, 2.0, 5.0])
@pytest.mark.parametrize(
    ("model", "keys", "power"),
    [(model, keys, power) for model, noises in NOISES.items() for keys, power in noises],
    ids=[keys[0] for noises in NOISES.values() for keys, _ in noises],
)
def test_following_the_advice_ends_near_the_truth(
    model: str, keys: tuple[str, ...], power: int, factor: float
) -> None:
    watched = {key: power for noise, power in NOISES[model] for key in noise} | dict.fromkeys(SENSOR, 1)
    assert len(watched) >= 4
    ends: dict[str, list[float]] = {key: [] for key in watched}
    for seed in SEEDS:
        log = world(model, seed)
        truth = {"sensor": dict(log.config["sensor"]), "motion": dict(log.config["motion"])}
        config: dict[str, Any] = truth
        for key in keys:
            config = with_value(config, key, value(truth, key) * factor**power)
        config = after_advice(log, config)
        for key, of_power in watched.items():
            ends[key].append((value(config, key) / value(truth, key)) ** (1.0 / of_power))
    for key, off in ends.items():
        assert 1.0 / ENOUGH <= sorted(off)[len(off) // 2] <= ENOUGH, f"{key}: {off} times the truth"
        assert min(off) >= 1.0 / WORST and max(off) <= WORST, f"{key}: {off} times the truth"


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("model", MODELS)
def test_right_noise_gets_no_advice(model: str, seed: int) -> None:
    log = world(model, seed)
    assert advised(log, {}) == {}

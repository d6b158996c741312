"""Odometry followed in closed form and by the filter's own motion model leads to the same place."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from fastslam.config import Config
from fastslam.datasets.planar import chain_increments
from fastslam.dead_reckoning import DeadReckoning, path_of_odometry
from fastslam.log import Controls, Floats, Log
from small_log import make_small_log

MODELS: dict[str, dict[str, Any]] = {
    "velocity": {"model": "velocity"},
    "velocity with gains": {
        "model": "velocity",
        "correction": {"distance_gain": 1.1, "turn_gain": 0.8, "yaw_rate_bias_rad_per_s": 0.02},
    },
    "ackermann": {"model": "ackermann"},
    "increments": {"model": "increments"},
    "odometry": {"model": "odometry"},
}


def log_of(motion: dict[str, Any]) -> Log:
    """Rows of uneven length, sightings between them, and after the last."""
    log = make_small_log(steps=80)
    rng = np.random.default_rng(5)
    stamp_s = np.cumsum(rng.uniform(0.02, 0.4, 40))
    columns = 2 if motion["model"] in ("velocity", "ackermann") else 3
    values = rng.normal([0.8, 0.3, 0.2][:columns], 0.1, (40, columns))
    return replace(log, controls=Controls(stamp_s, values), config={**log.config, "motion": motion})


def from_the_first(poses: Floats) -> Floats:
    x, y = (poses[:, :2] - poses[0, :2]).T
    cosine, sine = np.cos(poses[0, 2]), np.sin(poses[0, 2])
    return np.column_stack([cosine * x + sine * y, cosine * y - sine * x, poses[:, 2] - poses[0, 2]])


@pytest.mark.parametrize("name", MODELS)
def test_both_lead_to_the_same_place(name: str) -> None:
    log = log_of(MODELS[name])
    found = path_of_odometry(log)
    inside = (found.stamp_s > log.controls.stamp_s[0]) & (found.stamp_s <= log.controls.stamp_s[-1])
    assert inside.sum() > 10
    whole = chain_increments(found.increments)[inside]
    motion = Config.resolve(log.config)["motion"]
    poses = DeadReckoning(log.controls, motion).poses_at(found.stamp_s[inside])
    # The first row of displacements leads to its own stamp, where only one of the two begins.
    poses, whole = from_the_first(poses), from_the_first(whole)
    np.testing.assert_allclose(poses[:, :2], whole[:, :2], atol=1e-9)
    np.testing.assert_allclose(np.exp(1j * poses[:, 2]), np.exp(1j * whole[:, 2]), atol=1e-9)

"""What every kind of case offers, and what is a fault in all of them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from pathlib import Path
from random import Random
from typing import Protocol

import numpy as np
from fastslam.errors import FastSlamError
from fastslam.log import Log
from fastslam.result import RunResult


class FaultError(Exception):
    """A case found what must not be."""


class Case(Protocol):
    """An input with all that is to be done to it."""

    def exercise(self, folder: Path) -> Counter[str]:
        """Works with the input, its files in `folder`; what became of it, `mutated` being how many inputs."""

    def files(self) -> dict[str, bytes]:
        """What a person needs to see the input."""


Maker = Callable[[Random], Case]


def refused(call: Callable[[], object]) -> bool:
    """Whether a call ends with an error of the package, in one line that says something."""
    try:
        call()
    except FastSlamError as error:
        check_message(error)
        return True
    return False


def check_message(error: FastSlamError) -> None:
    """An error is one line with words in it."""
    text = str(error)
    if not text.strip() or "\n" in text or len(text) > 3000:
        raise FaultError(f"no message of one line: {text[:300]!r}") from error


def check_finite(what: str, *arrays: np.ndarray) -> None:
    """Every number is one."""
    for array in arrays:
        if not np.isfinite(array).all():
            raise FaultError(f"{what}: not finite: {array[~np.isfinite(array)][:3]}")


def check_log(log: Log) -> None:
    """What every reader promises of its log."""
    controls, seen = log.controls, log.sightings
    check_finite("controls", controls.stamp_s, controls.values)
    check_finite("sightings", seen.stamp_s)
    # A sensor that measures one of the two has no number for the other.
    alone = log.config.get("sensor", {}).get("model")
    for what, values, lacking in [
        ("ranges", seen.range_m, "bearing"),
        ("bearings", seen.bearing_rad, "range"),
    ]:
        if not (alone == lacking and np.isnan(values).all()):
            check_finite(what, values)
    if (np.diff(controls.stamp_s) <= 0).any() or (np.diff(seen.stamp_s) < 0).any():
        raise FaultError("stamps out of order")
    if len(seen.identity) and not -1 <= seen.identity.min() <= seen.identity.max() < len(log.identity_names):
        raise FaultError("an identity without a name")
    for covariance in (controls.covariance, seen.covariance):
        if covariance is not None and np.isinf(covariance).any():
            raise FaultError("an infinite covariance")
    if log.truth_trajectory is not None:
        known = 3 if log.truth_trajectory.heading_known else 2
        check_finite("truth", log.truth_trajectory.stamp_s, log.truth_trajectory.T_world_robot[:, :known])
    if log.truth_landmarks is not None:
        check_finite("true landmarks", log.truth_landmarks.position_m)


def check_result(result: RunResult) -> None:
    """What every run promises of its result."""
    found = result.landmarks
    check_finite("trajectory", result.trajectory.stamp_s, result.trajectory.T_world_robot)
    if result.trajectory.covariance is not None:
        check_finite("covariance", result.trajectory.covariance)
    check_finite("smoothed", result.smoothed.stamp_s, result.smoothed.T_world_robot)
    check_finite("landmarks", found.mean_m, found.covariance_m2)
    steps = result.steps
    check_finite("steps", steps.log_likelihood, steps.effective_sample_size, steps.nis, steps.latency_us)
    if len(set(found.ids)) != len(found.ids):
        raise FaultError("two landmarks of one id")
    variances = np.diagonal(found.covariance_m2, axis1=1, axis2=2)
    if len(variances) and variances.min() <= 0.0:
        raise FaultError(f"variances of landmarks: {variances.min()}")

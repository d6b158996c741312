"""Whether one run explains a log better than another, and whether a run is worth learning from."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..health import health_summary
from ..log import Bools
from ..result import RunResult
from ..verdict import not_found_again

MOST_LOST = 0.2
"""A run that is lost in more of its steps teaches nothing."""
MOST_UNEXPLAINED = 0.5
"""A map of which more of the sightings show nothing is none."""
MOST_DOUBLED = 0.4
"""Share of landmarks that stand beside another, nearer than their uncertainty lets two be told apart."""
DOUBLED_STDS = 3.0
NEIGHBOURS = 6
"""So many of the nearest landmarks are looked at: those that are one lie next to each other."""
LEAST_LANDMARKS = 4


def log_new_density(config: Mapping[str, Any]) -> float:
    """ln of the density that the filter gives a sighting of a new landmark, or one that it leaves out."""
    association, sensor = config["association"], config["sensor"]
    density = association["new_landmark_density"]
    if density is None:
        outer = -2 * np.log(1 - association["new_landmark_gate_probability"])
        tail = sensor["tail_degrees_of_freedom"]
        excess = 0.0 if tail is None else 0.5 * outer - 0.5 * (tail + 2) * np.log1p(outer / tail)
        determinant = (2 * sensor["range_std_m"] * sensor["bearing_std_rad"]) ** 2
        found = -0.5 * (outer + np.log(determinant)) - np.log(2 * np.pi) + excess
    else:
        found = np.log(density)
    clutter = association["clutter_density"]
    return float(found if clutter is None else np.logaddexp(found, np.log(clutter)))


def evidence(result: RunResult, from_s: float, common: Mapping[str, Any]) -> float:
    """ln of the probability of the sightings after a time, each told by all before it, in nats.

    What a filter takes for new or leaves out counts with the density of the settings `common`: with that of
    its own a run would gain by founding many landmarks, the more the narrower its noise. A likelihood that
    the settings raise to a power is taken back to one of plain sightings.
    """
    steps, config = result.steps, result.config
    judged = steps.stamp_s + config["sensor"]["delay_s"] > from_s
    exponent = float(config["filter"]["likelihood_exponent"])
    total = float(np.sum(steps.log_likelihood[judged])) / exponent
    if config["association"]["mode"] == "known":
        return total + float(np.sum(steps.ignored[judged])) * log_new_density(common)
    unexplained = float(np.sum(steps.new_landmarks[judged] + steps.ignored[judged]))
    return total + unexplained * (log_new_density(common) - log_new_density(config))


@dataclass(frozen=True)
class Fault:
    """Why a run is not to be learned from, in a sentence."""

    message: str


def fault_of(result: RunResult) -> Fault | None:
    """What makes a run worthless for learning: lost, or its map there twice. None for a sound one."""
    health = health_summary(result.steps)
    if health.lost is not None and health.lost > MOST_LOST:
        return Fault(f"the filter was lost in {health.lost:.0%} of its steps")
    landmarks = result.landmarks
    if len(landmarks.ids) == 0:
        return Fault("nothing was mapped")
    steps = result.steps
    unexplained = float(np.sum(steps.new_landmarks + steps.ignored)) / max(
        float(np.sum(steps.sightings)), 1.0
    )
    if unexplained > MOST_UNEXPLAINED:
        return Fault(f"{unexplained:.0%} of the sightings show no landmark of the map")
    missing = not_found_again(result)
    if missing is not None:
        return Fault(missing)
    # Names keep two landmarks apart however near they are.
    twice = (
        doubled(result) if result.config["association"]["mode"] == "unknown" else np.zeros(0, dtype=np.bool_)
    )
    if len(twice) >= LEAST_LANDMARKS and np.mean(twice) > MOST_DOUBLED:
        return Fault(
            f"{int(twice.sum())} of {len(twice)} landmarks stand so near another one that the map seems "
            "to be there twice"
        )
    return None


def doubled(result: RunResult) -> Bools:
    """Which of the landmarks that are believed (n,) stand within DOUBLED_STDS deviations of another one."""
    landmarks, sensor = result.landmarks, result.config["sensor"]
    believed = landmarks.sightings > 2
    if landmarks.confirmed is not None:
        believed &= landmarks.confirmed
    mean = landmarks.mean_m[believed]
    if len(mean) < 2:
        return np.zeros(len(mean), dtype=np.bool_)
    from scipy.spatial import cKDTree

    # The nearest of all is the landmark itself, or one in the same place.
    _, near = cKDTree(mean).query(mean, k=min(NEIGHBOURS + 1, len(mean)))
    apart = mean[:, None] - mean[near]
    covariance = landmarks.covariance_m2[believed]
    both = covariance[:, None] + covariance[near] + sensor["range_std_m"] ** 2 * np.eye(2)
    squared = np.einsum("ijk,ijkl,ijl->ij", apart, np.linalg.inv(both), apart)
    squared[near == np.arange(len(mean))[:, None]] = np.inf
    return np.asarray(squared.min(axis=1) < DOUBLED_STDS**2)

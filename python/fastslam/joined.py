"""Runs over parts of one log as one result, and times in which the robot was looked for in its map."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import fields, replace

import numpy as np

from .health import HealthStatus
from .result import RunResult, Steps, Trajectory


def joined(parts: Sequence[RunResult]) -> RunResult:
    """The results of successive parts as one: path and steps of all of them, the map of the last.

    What speaks against a part speaks against the whole.
    """
    last, counts = parts[-1], Counter[str]()
    for part in parts:
        counts.update(part.counts)
    return replace(
        last,
        trajectory=_path([part.trajectory for part in parts]),
        smoothed=_path([part.smoothed for part in parts]),
        steps=_steps([part.steps for part in parts]),
        filter_seconds=sum(part.filter_seconds for part in parts),
        counts=dict(counts),
        verdict=tuple(dict.fromkeys(sentence for part in parts for sentence in part.verdict)),
        warnings=tuple(dict.fromkeys(sentence for part in parts for sentence in part.warnings)),
    )


def searched(result: RunResult, begin_s: float, end_s: float) -> RunResult:
    """The result with the health of its steps within these stamps as that of a robot that is searched for."""
    steps = result.steps
    within = (steps.stamp_s >= begin_s) & (steps.stamp_s <= end_s)
    health = np.where(within, int(HealthStatus.SEARCHING), steps.health)
    return replace(result, steps=replace(steps, health=health))


def _path(parts: Sequence[Trajectory]) -> Trajectory:
    covariances = [part.covariance for part in parts if part.covariance is not None]
    return Trajectory(
        np.concatenate([part.stamp_s for part in parts]),
        np.concatenate([part.T_world_robot for part in parts]),
        np.concatenate(covariances) if len(covariances) == len(parts) else None,
    )


def _steps(parts: Sequence[Steps]) -> Steps:
    columns = {
        field.name: np.concatenate([getattr(part, field.name) for part in parts]) for field in fields(Steps)
    }
    # Each part counts from 0.
    columns["step"] = np.arange(len(columns["step"]))
    return Steps(**columns)

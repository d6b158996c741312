"""When a robot in a kept map is to be searched for again."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from .health import HealthStatus, has_reason

if TYPE_CHECKING:
    from .result import Steps
    from .window import Step

LOST_S = 2.0
"""A robot is searched for again that has been lost for so long."""
_ELSEWHERE = {"sightings_unexplained", "innovations_too_large"}
"""Reasons that say that it is somewhere else; that nobody knows where it started is none."""


@dataclass
class Lost:
    """Since when a robot has been lost without a break; None while it is not."""

    since_s: float | None = None

    def is_settled(self, steps: Sequence[Step]) -> bool:
        """Takes further steps; whether after the last one it has been lost for too long."""
        settled = False
        for step in steps:
            lost = step.info.health == "lost" and not _ELSEWHERE.isdisjoint(step.info.health_reasons)
            if not lost:
                self.since_s = None
            elif self.since_s is None:
                self.since_s = step.stamp_s
            settled = self.since_s is not None and step.stamp_s - self.since_s >= LOST_S
        return settled


def lost_since_s(steps: Steps) -> float | None:
    """Stamp from which on the robot of a whole run was first lost for too long; None where it never was."""
    elsewhere = np.any([has_reason(steps.health_reasons, name) for name in _ELSEWHERE], axis=0)
    lost = (steps.health == HealthStatus.LOST) & elsewhere
    changes = np.flatnonzero(np.diff(lost, prepend=False, append=False))
    for begin, end in zip(changes[::2], changes[1::2], strict=True):
        if steps.stamp_s[end - 1] - steps.stamp_s[begin] >= LOST_S:
            return float(steps.stamp_s[begin])
    return None

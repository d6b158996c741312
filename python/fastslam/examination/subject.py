"""The log that the checks look at, with what several of them need, worked out once."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from ..config import Config
from ..dead_reckoning import DeadReckoning
from ..detection import with_detector, with_sightings
from ..errors import FastSlamError
from ..log import Floats, Log
from ..settings import Layer, Partial
from ..several import as_of_one
from .evidence import Explanation, explain
from .stretches import Bench, Trial, only_used, stretches


@dataclass(frozen=True)
class Subject:
    """A log under examination. `log` has sightings where it has scans; `config` holds complete settings."""

    log: Log
    config: Partial

    @property
    def motion_model(self) -> str:
        """The kind of the controls."""
        return str(self.config["motion"]["model"])

    @property
    def steps(self) -> bool:
        """Whether the controls are displacements, not velocities."""
        return self.motion_model in ("increments", "odometry")

    @cached_property
    def moment_s(self) -> Floats:
        """Distinct stamps of the sightings."""
        return np.unique(self.log.sightings.stamp_s)

    @cached_property
    def moment_period_s(self) -> float:
        """Median time from one stamp with sightings to the next; 0 where there are fewer than two."""
        return float(np.median(np.diff(self.moment_s))) if len(self.moment_s) > 1 else 0.0

    @cached_property
    def control_period_s(self) -> float:
        """Median time from one control to the next; 0 where there are fewer than two."""
        stamp_s = self.log.controls.stamp_s
        return float(np.median(np.diff(stamp_s))) if len(stamp_s) > 1 else 0.0

    @cached_property
    def speed_m_per_s(self) -> Floats:
        """Speed of the robot from each control to the next, without sign (C - 1,)."""
        controls = self.log.controls
        if self.steps:
            way_m = np.hypot(controls.values[1:, 0], controls.values[1:, 1])
            return np.asarray(way_m / np.diff(controls.stamp_s))
        return np.abs(controls.values[:-1, 0])

    @cached_property
    def _driven(self) -> tuple[Floats, Floats]:
        """Metres and radians of all motion up to each control, without sign."""
        controls = self.log.controls
        period_s = np.diff(controls.stamp_s)
        heading = self.reckoning.poses_at(controls.stamp_s)[:, 2]
        way_m = np.concatenate([[0.0], np.cumsum(self.speed_m_per_s * period_s)])
        return way_m, np.concatenate([[0.0], np.cumsum(np.abs(np.diff(heading)))])

    @property
    def path_m(self) -> float:
        """Length of the way by the odometry."""
        return float(self._driven[0][-1])

    def driven_at(self, stamp_s: Floats) -> tuple[Floats, Floats]:
        """Metres driven and radians turned up to each stamp, all motion counted without sign."""
        at_s = self.log.controls.stamp_s
        return np.interp(stamp_s, at_s, self._driven[0]), np.interp(stamp_s, at_s, self._driven[1])

    @cached_property
    def reckoning(self) -> DeadReckoning:
        """Where the robot is by its odometry."""
        return DeadReckoning(self.log.controls, self.config["motion"])

    @cached_property
    def bench(self) -> Bench:
        """Where readings of the log's numbers are tried out on its short stretches."""
        sightings = self.log.sightings
        used, asked = only_used(sightings, stretches(sightings))
        return Bench(used, self.config["sensor"], self.reckoning, asked)

    @cached_property
    def as_is(self) -> Trial:
        """How the log fits as it stands."""
        return self.bench.trial()

    @cached_property
    def explanation(self) -> Explanation | None:
        """What reading of the numbers fits decisively better than they do as they stand, if any does."""
        return explain(self.bench)


def prepare(log: Log, config: Layer | None = None) -> Subject:
    """The log ready to be examined: landmarks are detected where it has scans and no sightings.

    `config` is laid over the log's own settings. Errors: ConfigError where these are at fault.
    """
    settings: dict[str, Any] = dict(Config.resolve(log.config, config or {}))
    log = with_detector(log, config or {})
    try:
        seen = with_sightings(log)
    except FastSlamError:
        return Subject(log, settings)
    return Subject(*as_of_one(seen, Config.resolve(seen.config, config or {})))

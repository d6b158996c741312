"""Sightings of a live stream of which none is used: how many, since when, and why."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from .several import each_sensor


@dataclass
class Unused:
    """What was skipped since a sighting was used."""

    since_s: float | None = None
    """Stamp of the scan of which something was used last; before that of the first scan."""
    count: int = 0
    """Sightings skipped since."""

    def of_step(self, stamp_s: float, answer: dict[str, Any], config: Mapping[str, Any]) -> tuple[str, ...]:
        """Takes from a step what the core says of it; a sentence where for long nothing was used."""
        if self.since_s is None or answer["sightings"]:
            self.since_s, self.count = stamp_s, 0
        if answer["sightings"]:
            return ()
        self.count += answer["skipped"]
        blind_s = stamp_s - self.since_s
        if self.count == 0 or blind_s <= config["health"]["longest_blindness_s"]:
            return ()
        sensors = each_sensor(config)
        nearest = min(sensor["min_range_m"] for sensor in sensors)
        farthest = max(sensor["max_range_m"] for sensor in sensors)
        return (
            f"no sighting was used for {blind_s:.3g} s, and {self.count:,} were skipped: they were below "
            f"sensor.min_range_m = {nearest:g}, above sensor.max_range_m = {farthest:g}, no finite numbers, "
            "without the identity that all should have, or with a covariance that is none",
        )

    def to_json(self) -> list[Any] | None:
        return None if self.since_s is None else [self.since_s, self.count]

    @classmethod
    def of_json(cls, kept: list[Any] | None) -> Unused:
        return cls() if kept is None else cls(kept[0], kept[1])

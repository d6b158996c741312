"""What speaks against a drive that goes on: the part of the verdict that needs no log."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

from .several import config_as_of_one
from .trust import against, of_innovations, of_kept_map, of_lost_steps
from .verdict import MOSTLY, dropped_sentences, not_found_sentence, nothing_mapped, nothing_matched

if TYPE_CHECKING:
    from .maps import Changes
    from .result import LandmarkMap
    from .trust import KeptPlaces
    from .window import Step

ANEW_S = 1.0
"""What asks at each step is told again what it was told, for so long in time of the stamps."""
LEAST_SIGHTINGS = 100
"""Before so many sightings nothing is said: at the start every landmark is a new one."""


@dataclass
class SoFar:
    """Sums over the steps of a drive, from which its verdict so far is told at any time."""

    sightings: int = 0
    """Sightings that were used,"""
    skipped: int = 0
    """and those that could not be."""
    matched: int = 0
    judged: int = 0
    """Steps once there was enough to judge,"""
    lost: int = 0
    """and those of them in which the filter was lost."""
    landmarks: int = 0
    """In the map of the best particle at the last step."""

    def add(self, steps: Sequence[Step]) -> None:
        """Takes further steps."""
        for step in steps:
            info = step.info
            self.sightings += info.sightings
            self.skipped += info.skipped
            self.matched += info.matched
            self.judged += info.health not in ("initializing", "searching")
            self.lost += info.health == "lost"
            self.landmarks = info.landmarks

    def verdict(
        self,
        found: Mapping[str, Any],
        config: Mapping[str, Any],
        kept: tuple[LandmarkMap, KeptPlaces | None, Changes] | None = None,
    ) -> tuple[str, ...]:
        """What speaks against the drive; `found` is what the core counts, `kept` is of a kept map."""
        total = self.sightings + self.skipped
        if total < LEAST_SIGHTINGS:
            return ()
        config = config_as_of_one(config)
        dropped = tuple(dropped_sentences(found["skipped"], total, config["sensor"]))
        missing = not_found_sentence(found["skipped"], config)
        said = [*dropped, *self._of_map(config, explained=bool(dropped)), *filter(None, [missing])]
        if self.sightings >= MOSTLY * total:
            said += self._doubts(found, config, kept)
        return tuple(said)

    def _of_map(self, config: Mapping[str, Any], *, explained: bool) -> Iterator[str]:
        if self.landmarks == 0 and not explained:
            yield nothing_mapped(self.sightings + self.skipped)
        elif self.landmarks and not self.matched:
            yield nothing_matched(self.sightings, self.landmarks, config["sensor"]["model"])

    def _doubts(
        self,
        found: Mapping[str, Any],
        config: Mapping[str, Any],
        kept: tuple[LandmarkMap, KeptPlaces | None, Changes] | None,
    ) -> tuple[str, ...]:
        doubts = [*of_innovations(found["noise"], config)]
        if self.judged:
            doubts.append(of_lost_steps(self.lost / self.judged, in_kept_map=kept is not None))
        if kept is not None:
            doubts += of_kept_map(*kept)
        return against(sorted(doubts, key=lambda doubt: -doubt.ratio))

    def to_json(self) -> dict[str, int] | None:
        return asdict(self) if self != SoFar() else None

    @classmethod
    def of_json(cls, kept: Mapping[str, int] | None) -> SoFar:
        return cls(**(kept or {}))

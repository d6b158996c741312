"""What a caller may say about a path besides the path: which robot or run, how far to trust."""

from __future__ import annotations

from dataclasses import dataclass, fields


@dataclass(frozen=True)
class LoadOptions:
    """Options of `load`; None means the format's default. A format rejects those that it does not know."""

    robot: int | None = None
    """Number of the robot in a log of several."""
    run: int | None = None
    """Number of the run in a folder of several."""
    max_range_m: float | None = None
    """Sightings beyond this are dropped while reading."""
    topics: tuple[tuple[str, str], ...] | None = None
    """Role and name of topics of a bag; the others are chosen by what they hold."""

    def given(self) -> tuple[str, ...]:
        """Names of the options that are set."""
        return tuple(option.name for option in fields(self) if getattr(self, option.name) is not None)

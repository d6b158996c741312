"""Odometry of two driven wheels, from their speeds or from counters of their turns."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import DataError
from ..limits import bounds_of
from ..log import Floats

WRAP_TICKS = 2**15
"""A step of a counter beyond this, where others are a hundred times smaller, is taken for a wrap-around."""


@dataclass(frozen=True)
class Wheels:
    """Geometry of two driven wheels, as the section `wheels` of `log.yaml` has it; None where it is silent.

    The robot turns left when the right wheel is the faster one.
    """

    track_width_m: float | None = None
    """Distance between the wheels."""
    radius_m: float | None = None
    """Radius of a wheel."""
    ticks_per_turn: float | None = None
    """Counts of a whole turn of a wheel."""
    m_per_tick: float | None = None
    """Way of the rim for each count; instead of radius and counts of a turn."""
    counter_bits: int | None = None
    """Width of a counter that starts again at its end."""

    def needed(self, name: str, path: Path, line: int | None) -> float:
        """A figure that the columns of a file need. Errors: DataError that says where to give it."""
        value = getattr(self, name)
        if value is None:
            message = (
                f"the columns of wheels need wheels.{name}: add it to log.yaml, as wheels: {{{name}: ...}}"
            )
            raise DataError(message, path, line)
        return float(value)

    def metres_of_tick(self, path: Path, line: int | None) -> float:
        """Way of the rim for each count. Errors: DataError that says what is missing."""
        if self.m_per_tick is not None:
            return self.m_per_tick
        if self.radius_m is None or self.ticks_per_turn is None:
            message = (
                "ticks need wheels.m_per_tick, or wheels.radius_m and wheels.ticks_per_turn: add to log.yaml"
            )
            raise DataError(message, path, line)
        return 2 * np.pi * self.radius_m / self.ticks_per_turn


def parse_wheels(section: Any, path: Path, line_of_key: Mapping[str, int]) -> Wheels:
    """The section `wheels` of a settings file. Errors: DataError for unknown keys or values out of range."""
    known = [entry.name for entry in fields(Wheels)]
    if not isinstance(section, dict):
        raise DataError(f"wheels: got {section}, expected a section of {', '.join(known)}", path)
    for key, value in section.items():
        line = line_of_key.get(f"wheels.{key}")
        if key not in known:
            raise DataError(f"unknown key wheels.{key}; known: {', '.join(known)}", path, line)
        whole = key == "counter_bits"
        if isinstance(value, bool) or not isinstance(value, int if whole else (int, float)):
            kind = "a whole number" if whole else "a number"
            raise DataError(f"wheels.{key}: got {value}, expected {kind}", path, line)
        least, most = (1, 64) if whole else bounds_of(key)
        if not least <= value <= most:
            expected = f"expected a positive number ({least:g} to {most:g})"
            raise DataError(f"wheels.{key}: got {value}, {expected}", path, line)
    return Wheels(**section)


def twist_of_wheels(left_m_per_s: Floats, right_m_per_s: Floats, track_width_m: float) -> Floats:
    """Speed and yaw rate, shape (N, 2)."""
    return np.column_stack(
        [(left_m_per_s + right_m_per_s) / 2, (right_m_per_s - left_m_per_s) / track_width_m]
    )


def arcs_of_ticks(ticks: Floats, wheels: Wheels, *, path: Path, lines: Sequence[int | None]) -> Floats:
    """Way and turn from each row to the next. Shapes: `ticks` (N, 2) left and right gives (N - 1, 2).

    `lines` are those of the rows. Errors: DataError for missing geometry or a counter that seems to wrap.
    """
    steps = np.diff(ticks, axis=0)
    if wheels.counter_bits is not None:
        turn = 2.0**wheels.counter_bits
        steps = (steps + turn / 2) % turn - turn / 2
    else:
        _refuse_wraps(steps, path, lines)
    way_m = steps * wheels.metres_of_tick(path, lines[0])
    track_width_m = wheels.needed("track_width_m", path, lines[0])
    return np.column_stack([way_m.mean(axis=1), (way_m[:, 1] - way_m[:, 0]) / track_width_m])


def _refuse_wraps(steps: Floats, path: Path, lines: Sequence[int | None]) -> None:
    size = np.abs(steps).max(axis=1)
    jumps = (size > WRAP_TICKS) & (size > 100 * np.median(size))
    if jumps.any():
        row = int(np.argmax(jumps))
        jump = steps[row][np.argmax(np.abs(steps[row]))]
        bits = int(np.clip(np.ceil(np.log2(abs(jump))), 16, 64))
        message = f"a counter jumps by {jump:.0f}: where it wraps around, give wheels.counter_bits: {bits}"
        raise DataError(message, path, lines[row + 1])


def increments_of_arcs(arcs: Floats) -> Floats:
    """Displacement at the end of each arc in the frame of its start. Shapes: (N, 2) gives (N, 3)."""
    way_m, turn_rad = arcs.T
    half = np.sinc(turn_rad / (2 * np.pi))
    return np.column_stack([way_m * np.sinc(turn_rad / np.pi), way_m * np.sin(turn_rad / 2) * half, turn_rad])


def held_twists(stamp_s: Floats, arcs: Floats) -> Floats:
    """Speed and yaw rate from each row to the next, the last held on. (N,), (N - 1, 2) give (N, 2)."""
    twists = arcs / np.diff(stamp_s)[:, None]
    return np.vstack([twists, twists[-1:]])

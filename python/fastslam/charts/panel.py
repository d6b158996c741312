"""The parts of a figure: panels with marks in them, and where they stand."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np

from ..log import Floats

Range: TypeAlias = "tuple[float, float]"


@dataclass(frozen=True, kw_only=True)
class Line:
    """A line through points; with `stairs` it goes on level to the next. Shapes: (N,). Widths in points."""

    x: Floats
    y: Floats
    color: str
    width: float = 1.2
    dashed: bool = False
    stairs: bool = False
    label: str = ""
    order: float = 2.0


DotShape: TypeAlias = Literal["disc", "cross", "tick", "triangle", "square"]


@dataclass(frozen=True, kw_only=True)
class Dots:
    """Marks of one look. Shapes: (N,). `size` is their diameter in points."""

    x: Floats
    y: Floats
    color: str
    shape: DotShape = "disc"
    size: float = 3.0
    alpha: float = 1.0
    label: str = ""
    order: float = 3.0


@dataclass(frozen=True, kw_only=True)
class Band:
    """What lies between two lines. Shapes: (N,)."""

    x: Floats
    low: Floats
    high: Floats
    color: str
    alpha: float = 0.25
    label: str = ""
    order: float = 1.0


@dataclass(frozen=True, kw_only=True)
class Level:
    """A line across the whole panel, at a value of y or, `upright`, of x."""

    at: float
    color: str
    width: float = 1.0
    dashed: bool = True
    upright: bool = False
    label: str = ""
    order: float = 1.5


@dataclass(frozen=True, kw_only=True)
class Bars:
    """Filled rectangles. Shapes: (N,) each."""

    left: Floats
    right: Floats
    low: Floats
    high: Floats
    color: str
    alpha: float = 1.0
    label: str = ""
    order: float = 1.0


@dataclass(frozen=True, kw_only=True)
class Ellipses:
    """Ellipses: full lengths of their axes, angle of the major one. Shapes: `center` (N, 2), others (N,)."""

    center: Floats
    major: Floats
    minor: Floats
    angle_deg: Floats
    color: str
    edge_width: float = 0.9
    alpha: float = 0.19
    label: str = ""
    order: float = 5.0


Mark: TypeAlias = "Line | Dots | Band | Level | Bars | Ellipses"


@dataclass(frozen=True, kw_only=True)
class Panel:
    """Axes with what is drawn in them. The ranges are those of the data, with room around it."""

    title: str
    x_label: str
    y_label: str
    marks: tuple[Mark, ...]
    x_range: Range
    y_range: Range
    x_log: bool = False
    y_log: bool = False
    equal: bool = False
    """Whether a metre is as long upwards as sideways; one of the ranges becomes wider for that."""
    rows: tuple[str, ...] = ()
    """Names of the whole numbers of y, which then counts downwards."""
    x_numbers: bool = True
    legend_columns: int = 4


@dataclass(frozen=True, kw_only=True)
class Chart:
    """Panels side by side or, `stacked`, above each other, sharing the room by `shares`."""

    panels: tuple[Panel, ...]
    width_in: float
    height_in: float
    stacked: bool = False
    shares: tuple[float, ...] = (1.0,)


def range_of(*values: Floats, margin: float, log: bool = False) -> Range:
    """The range of all finite values (for `log` positive ones) with this part of it as room on each side."""
    known = np.concatenate([np.ravel(part) for part in values]) if values else np.zeros(0)
    known = known[np.isfinite(known) & (known > 0.0)] if log else known[np.isfinite(known)]
    if len(known) == 0:
        return (1.0, 10.0) if log else (0.0, 1.0)
    low, high = float(known.min()), float(known.max())
    if log:
        room = (high / low) ** margin if high > low else 10.0**0.5
        return low / room, high * room
    room = margin * (high - low) if high > low else max(abs(low), 1.0) * 0.05
    return low - room, high + room


def range_from_zero(*values: Floats) -> Range:
    """From zero to a little above the largest finite value."""
    high = range_of(*values, margin=0.0)[1]
    return 0.0, 1.05 * high if high > 0.0 else 1.0

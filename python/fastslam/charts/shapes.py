"""Marks as SVG elements. What cannot be told apart on paper is written once: long logs stay small."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import Any

import numpy as np

from ..log import Floats
from . import palette
from .layout import Place
from .panel import Band, Bars, Dots, Ellipses, Level, Line, Mark
from .scales import Scale

_FINE = 0.3
"""Points of paper; successive points of a line that are closer than this are one."""
_LONGEST = 10_000
"""Of more points of a line, or dots, those are one that are closer than something larger."""
_DENSE = 3000
"""Lines of more points are drawn by their range within each half point of paper."""
_CROWDED = 2000
"""Of more dots such as lie on each other are one."""
_WIDE = 20.0
"""Length of a sample in a legend."""


def draw_mark(mark: Mark, place: Place) -> str:
    """One mark of a panel; empty where nothing of it can be drawn."""
    return _DRAWN[type(mark)](mark, place)


def sample_of(mark: Mark, x: float, y: float) -> str:
    """The mark as it looks in a legend, from x on, about the height y."""
    ends, middle, height = np.array([x, x + _WIDE]), np.array([x + 0.5 * _WIDE]), np.array([y])
    unit = Scale((0.0, 1.0), (0.0, 1.0))
    place = Place(unit, unit)
    if isinstance(mark, Line | Level):
        look = Line(x=ends, y=np.full(2, y), color=mark.color, width=mark.width, dashed=mark.dashed)
        return _line(look, place)
    if isinstance(mark, Dots):
        return _dots(replace(mark, x=middle, y=height, size=max(mark.size, 3.0)), place)
    if isinstance(mark, Ellipses):
        center = np.array([[x + 0.5 * _WIDE, y]])
        major, minor, flat = np.array([13.0]), np.array([8.0]), np.zeros(1)
        return _ellipses(replace(mark, center=center, major=major, minor=minor, angle_deg=flat), place)
    return _element(
        _rectangles(ends[:1], ends[1:], height - 3.5, height + 3.5), fill=mark.color, opacity=mark.alpha
    )


def number(value: float) -> str:
    """A length in tenths of a point."""
    text = f"{value:.1f}"
    return text[:-2] if text.endswith(".0") else text


def _element(path: str, *, opacity: float = 1.0, **look: Any) -> str:
    """A path with its look; attributes are named with `_` for `-`, colours follow the theme."""
    if not path:
        return ""
    says = {name.replace("_", "-"): value for name, value in look.items() if value is not None}
    if opacity < 1.0:
        says["opacity"] = f"{opacity:g}"
    says = {
        name: f"{value:g}" if isinstance(value, float) else _themed(str(value))
        for name, value in says.items()
    }
    attributes = "".join(f' {name}="{value}"' for name, value in says.items())
    return f'<path{attributes} d="{path}"/>'


def _themed(value: str) -> str:
    return f"var(--{palette.THEMED[value]})" if value in palette.THEMED else value


def _line(mark: Line, place: Place) -> str:
    x, y = _on_paper(mark.x, mark.y, place)
    if mark.stairs and len(x):
        x, y = np.repeat(x, 2)[1:], np.repeat(y, 2)[:-1]
    path = _through(*_simpler(x, y))
    dashes = "4 2.5" if mark.dashed else None
    return _element(path, fill="none", stroke=mark.color, stroke_width=mark.width, stroke_dasharray=dashes)


def _dots(mark: Dots, place: Place) -> str:
    x, y = _on_paper(mark.x, mark.y, place)
    if len(x) > _CROWDED:
        x, y = _apart(x, y, max(0.5, mark.size / 3.0))
    half = 0.5 * mark.size
    if mark.shape == "disc":
        path = _each("M{},{}h0", x, y)
        return _element(
            path, opacity=mark.alpha, stroke=mark.color, stroke_width=mark.size, stroke_linecap="round"
        )
    if mark.shape in ("triangle", "square"):
        shape = f"h{number(2 * half)}v{number(-2 * half)}h{number(-2 * half)}z"
        if mark.shape == "triangle":
            shape = f"h{number(2 * half)}l{number(-half)},{number(-2 * half)}z"
        path = _each("M{},{}" + shape, x - half, y + half)
        return _element(path, fill=mark.color, stroke=palette.INK, stroke_width=1.0, stroke_linejoin="round")
    if mark.shape == "tick":
        path, width = _each("M{},{}v" + number(mark.size), x, y - half), 1.0
    else:
        size = number(mark.size)
        path = _each("M{},{}l" + f"{size},{size}m-{size},0l{size},-{size}", x - half, y - half)
        width = 1.4
    return _element(path, opacity=mark.alpha, fill="none", stroke=mark.color, stroke_width=width)


def _apart(x: Floats, y: Floats, size: float) -> tuple[Floats, Floats]:
    """One point for each square of this size that holds any, or of a larger one where these are too many."""
    while True:
        cells = np.round(np.column_stack([x, y]) / size).astype(np.int64)
        chosen = np.sort(np.unique(cells[:, 0] * 100_000 + cells[:, 1], return_index=True)[1])
        if len(chosen) <= _LONGEST:
            return x[chosen], y[chosen]
        size *= 1.5


def _band(mark: Band, place: Place) -> str:
    x, low = _on_paper(mark.x, mark.low, place)
    _, high = _on_paper(mark.x, mark.high, place)
    if len(x) == 0 or len(high) != len(low):
        return ""
    starts = _columns(x) if len(x) > _DENSE else np.arange(len(x))
    x, low, high = x[starts], np.maximum.reduceat(low, starts), np.minimum.reduceat(high, starts)
    path = _through(np.append(x, x[::-1]), np.append(high, low[::-1])) + "z"
    return _element(path, opacity=mark.alpha, fill=mark.color)


def _level(mark: Level, place: Place) -> str:
    if mark.upright:
        x, ends = place.x.at(np.array([mark.at]))[0], place.y.ends
        path = f"M{number(x)},{number(ends[0])}V{number(ends[1])}"
    else:
        y, ends = place.y.at(np.array([mark.at]))[0], place.x.ends
        path = f"M{number(ends[0])},{number(y)}H{number(ends[1])}"
    dashes = "4 2.5" if mark.dashed else None
    return _element(path, stroke=mark.color, stroke_width=mark.width, stroke_dasharray=dashes)


def _bars(mark: Bars, place: Place) -> str:
    left, right = place.x.at(mark.left), place.x.at(mark.right)
    high, low = place.y.at(mark.high), place.y.at(mark.low)
    if len(left) and np.ptp(mark.low) == np.ptp(mark.high) == 0.0:
        # Of one height: what touches is one.
        apart = np.append(True, left[1:] > right[:-1] + 0.05)
        last = np.append(apart[1:], True)
        left, right, high, low = left[apart], right[last], high[apart], low[apart]
    path = _rectangles(left, right, high, low)
    return _element(path, opacity=mark.alpha, fill=mark.color)


def _ellipses(mark: Ellipses, place: Place) -> str:
    x, y = place.x.at(mark.center[:, 0]), place.y.at(mark.center[:, 1])
    major, minor = place.x.length(0.5 * mark.major), place.x.length(0.5 * mark.minor)
    # Smaller ones are hidden by their dots; very many of them would make the page large.
    drawn = np.isfinite(x + y + major + minor) & (major > (0.5 if len(x) > _CROWDED else 0.05))
    turn = np.radians(mark.angle_deg)
    u, v = major * np.cos(turn), -major * np.sin(turn)
    rows = (
        array[drawn].tolist()
        for array in (x - u, y - v, major, np.maximum(minor, 0.02), -mark.angle_deg, 2 * u, 2 * v)
    )
    path = "".join(
        f"M{x0:.1f},{y0:.1f}a{a:.2f},{b:.2f} {angle:.0f} 1 0 {du:.2f},{dv:.2f}"
        f"a{a:.2f},{b:.2f} {angle:.0f} 1 0 {-du:.2f},{-dv:.2f}"
        for x0, y0, a, b, angle, du, dv in zip(*rows, strict=True)
    )
    edge: dict[str, Any] = {"stroke": mark.color, "stroke_width": mark.edge_width} if mark.edge_width else {}
    return _element(path, fill=mark.color, fill_opacity=mark.alpha, **edge)


_DRAWN: dict[type, Callable[[Any, Place], str]] = {
    Line: _line,
    Dots: _dots,
    Band: _band,
    Level: _level,
    Bars: _bars,
    Ellipses: _ellipses,
}


def _on_paper(x: Floats, y: Floats, place: Place) -> tuple[Floats, Floats]:
    """Where finite points lie; on logarithmic scales those that are positive."""
    known = np.isfinite(x) & np.isfinite(y)
    known &= (np.asarray(y) > 0.0) if place.y.log else True
    return place.x.at(np.asarray(x)[known]), place.y.at(np.asarray(y)[known])


def _simpler(x: Floats, y: Floats) -> tuple[Floats, Floats]:
    """A line that looks the same, of no more points than that needs."""
    if len(x) > _DENSE and bool((np.diff(x) >= 0.0).all()):
        starts = _columns(x)
        at = x[starts]
        lows, highs = np.minimum.reduceat(y, starts), np.maximum.reduceat(y, starts)
        # Up and down in turns, so that a line goes on where the one before it ended.
        up = np.arange(len(at)) % 2 == 0
        ends = np.column_stack([np.where(up, lows, highs), np.where(up, highs, lows)])
        return np.repeat(at, 2), ends.ravel()
    size = _FINE
    while True:
        cells = np.round(np.column_stack([x, y]) / size)
        kept = np.ones(len(x), dtype=bool)
        kept[1:-1] = (np.diff(cells, axis=0) != 0.0).any(axis=1)[:-1]
        if np.count_nonzero(kept) <= _LONGEST:
            return x[kept], y[kept]
        size *= 1.5


def _columns(x: Floats) -> np.ndarray[Any, np.dtype[np.intp]]:
    """Where each half point of paper begins in ascending places."""
    column = np.floor(2.0 * x)
    return np.flatnonzero(np.append(True, np.diff(column) != 0.0))


def _through(x: Floats, y: Floats) -> str:
    points = [f"{a:.1f},{b:.1f}" for a, b in zip(x.tolist(), y.tolist(), strict=True)]
    return "M" + "L".join(points) if points else ""


def _each(pattern: str, x: Floats, y: Floats) -> str:
    return "".join(pattern.format(number(a), number(b)) for a, b in _pairs(x, y))


def _rectangles(left: Floats, right: Floats, top: Floats, bottom: Floats) -> str:
    rows = zip(left.tolist(), right.tolist(), top.tolist(), bottom.tolist(), strict=True)
    return "".join(f"M{a:.1f},{c:.1f}H{b:.1f}V{d:.1f}H{a:.1f}z" for a, b, c, d in rows)


def _pairs(x: Floats, y: Floats) -> Iterable[tuple[float, float]]:
    return zip(x.tolist(), y.tolist(), strict=True)

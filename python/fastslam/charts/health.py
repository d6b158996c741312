"""How far the filter could be believed over time: status, reasons, innovations against the noise."""

from __future__ import annotations

import numpy as np

from ..health import REASONS, HealthStatus, has_reason, health_summary
from ..log import Bools, Floats
from ..result import RunResult
from . import palette
from .panel import Bars, Level, Line, Mark, Panel, range_of

_COLORS = {
    HealthStatus.INITIALIZING: palette.GRID,
    HealthStatus.OK: palette.GOOD,
    HealthStatus.DEGRADED: palette.SMOOTHED,
    HealthStatus.LOST: palette.LANDMARK,
    HealthStatus.SEARCHING: palette.EVENT,
}
_LOWEST, _HIGHEST = 0.5, 8.0
"""What the axis of the NIS shows at least."""


def health_panel(result: RunResult) -> Panel:
    """A strip that is coloured by the status of each step, and one line per reason that ever applied."""
    steps = result.steps
    edges_s = _edges(result)
    met = [name for name in REASONS if has_reason(steps.health_reasons, name).any()]
    marks: list[Mark] = [
        _bars(edges_s, steps.health == status, row=0, color=color, label=status.name.lower())
        for status, color in _COLORS.items()
        if status != HealthStatus.SEARCHING or (steps.health == status).any()
    ]
    for row, name in enumerate(met, start=1):
        marks.append(_bars(edges_s, has_reason(steps.health_reasons, name), row=row, color=palette.MUTED))
    summary = health_summary(steps)
    title = "Health: too little was seen again to judge"
    if summary.ok is not None:
        title = f"Health: ok in {100.0 * summary.ok:.1f} % of the steps after initialising"
    return Panel(
        title=title,
        x_label="",
        y_label="",
        marks=tuple(marks),
        x_range=range_of(edges_s, margin=0.01),
        y_range=(max(len(met) + 1, 2) - 0.45, -0.55),
        rows=("status", *(name.replace("_", " ") for name in met)),
        x_numbers=False,
    )


def innovations_panel(result: RunResult) -> Panel:
    """The mean normalised innovation squared of the sliding window against what right noise gives."""
    steps, edges_s = result.steps, _edges(result)
    time_s = steps.stamp_s - (steps.stamp_s[0] if len(steps.stamp_s) else 0.0)
    known = steps.nis > 0.0
    marks: list[Mark] = []
    band = result.noise.get("nis_band")
    x_range = range_of(edges_s, margin=0.01)
    if band is not None and known.any():
        (left, right), (low, high) = np.array(x_range)[:, None], np.array(band, dtype=np.float64)[:, None]
        label = "95 % band of the run's mean"
        marks.append(
            Bars(left=left, right=right, low=low, high=high, color=palette.BAND, alpha=0.25, label=label)
        )
    marks.append(
        Line(x=time_s[known], y=steps.nis[known], color=palette.LIVE, label="mean NIS, sliding window")
    )
    marks.append(Level(at=2.0, color=palette.MUTED, label="expected"))
    least, most = range_of(steps.nis[known], margin=0.05, log=True)
    return Panel(
        title="",
        x_label="time since the first step [s]",
        y_label="NIS per sighting",
        marks=tuple(marks),
        x_range=x_range,
        y_range=(min(max(least, 0.1), _LOWEST), max(most, _HIGHEST)),
        y_log=True,
    )


def _edges(result: RunResult) -> Floats:
    """Begin of every step and end of the last, seconds since the first."""
    stamps = result.steps.stamp_s
    if len(stamps) == 0:
        return np.zeros(1)
    last = np.diff(stamps[-2:]).sum() if len(stamps) > 1 else 1.0
    return np.asarray(np.append(stamps, stamps[-1] + last) - stamps[0])


def _bars(edges_s: Floats, where: Bools, *, row: int, color: str, label: str = "") -> Bars:
    """One bar per stretch of steps in which something holds."""
    padded = np.concatenate([[False], where, [False]])
    changes = np.flatnonzero(padded[1:] != padded[:-1])
    left, right = edges_s[changes[::2]], edges_s[changes[1::2]]
    # A single step of a long run would be thinner than a hair.
    right = np.maximum(right, left + 0.002 * (edges_s[-1] - edges_s[0]))
    low, high = np.full(len(left), row - 0.4), np.full(len(left), row + 0.4)
    return Bars(left=left, right=right, low=low, high=high, color=color, label=label)

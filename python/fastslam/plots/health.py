"""How far the filter could be believed over time: status, reasons, innovations against the noise."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Patch

from ..health import REASONS, HealthStatus, has_reason, health_summary
from ..log import Bools, Floats
from ..result import RunResult
from . import style

_COLORS = {
    HealthStatus.INITIALIZING: style.GRID,
    HealthStatus.OK: style.GOOD,
    HealthStatus.DEGRADED: style.SMOOTHED,
    HealthStatus.LOST: style.LANDMARK,
}


def plot_health(axis: Axes, result: RunResult) -> Axes:
    """Draw a strip that is coloured by the status of each step, and one line per reason that ever applied."""
    steps = result.steps
    edges_s = _edges(result)
    met = [name for name in REASONS if has_reason(steps.health_reasons, name).any()]
    rows = ["status", *(name.replace("_", " ") for name in met)]
    for status, color in _COLORS.items():
        _bars(axis, edges_s, steps.health == status, row=0, color=color)
    for row, name in enumerate(met, start=1):
        _bars(axis, edges_s, has_reason(steps.health_reasons, name), row=row, color=style.MUTED)
    axis.set_yticks(range(len(rows)), rows)
    axis.set_ylim(max(len(rows), 2) - 0.45, -0.55)
    axis.grid(visible=False)
    axis.margins(x=0.01)
    summary = health_summary(steps)
    title = "Health: too little was seen again to judge"
    if summary.ok is not None:
        title = f"Health: ok in {100.0 * summary.ok:.1f} % of the steps after initialising"
    axis.set_title(title)
    handles = [Patch(color=color, label=status.name.lower()) for status, color in _COLORS.items()]
    axis.tick_params(axis="x", labelbottom=False)
    axis.legend(handles=handles, loc="upper center", bbox_to_anchor=(0.5, -0.04), ncols=4, borderaxespad=0.0)
    return axis


def plot_innovations(axis: Axes, result: RunResult) -> Axes:
    """Draw the mean normalised innovation squared of the sliding window against what right noise gives."""
    steps = result.steps
    time_s = steps.stamp_s - (steps.stamp_s[0] if len(steps.stamp_s) else 0.0)
    known = steps.nis > 0.0
    line: dict[str, Any] = {"color": style.LIVE, "linewidth": 1.2, "label": "mean NIS, sliding window"}
    axis.plot(time_s[known], steps.nis[known], rasterized=style.is_heavy(int(known.sum())), **line)
    axis.axhline(2.0, color=style.MUTED, linewidth=1.0, linestyle=(0, (4, 2)), label="expected")
    band = result.noise.get("nis_band")
    if band is not None and known.any():
        axis.axhspan(*band, color=style.BAND, alpha=0.25, linewidth=0, label="95 % band of the run's mean")
    axis.set_yscale("log")
    low, high = axis.get_ylim()
    axis.set_ylim(min(max(low, 0.1), 0.5), max(high, 8.0))
    style.plain_log_ticks(axis.yaxis)
    axis.set_xlabel("time since the first step [s]")
    axis.set_ylabel("NIS per sighting")
    axis.margins(x=0.01)
    style.legend_below(axis)
    return axis


def _edges(result: RunResult) -> Floats:
    """Begin of every step and end of the last, seconds since the first."""
    stamps = result.steps.stamp_s
    if len(stamps) == 0:
        return np.zeros(1)
    last = np.diff(stamps[-2:]).sum() if len(stamps) > 1 else 1.0
    return np.asarray(np.append(stamps, stamps[-1] + last) - stamps[0])


def _bars(axis: Axes, edges_s: Floats, where: Bools, *, row: int, color: str) -> None:
    """One bar per stretch of steps in which something holds."""
    padded = np.concatenate([[False], where, [False]])
    changes = np.flatnonzero(padded[1:] != padded[:-1])
    begins_s, ends_s = edges_s[changes[::2]], edges_s[changes[1::2]]
    # A single step of a long run would be thinner than a hair.
    least_s = 0.002 * (edges_s[-1] - edges_s[0])
    spans = [
        (float(begin), float(max(end - begin, least_s))) for begin, end in zip(begins_s, ends_s, strict=True)
    ]
    axis.broken_barh(spans, (row - 0.4, 0.8), facecolors=color, linewidth=0)

"""What happened when: position error against the reported uncertainty, effective sample size, latency."""

from __future__ import annotations

import numpy as np

from ..evaluation import Evaluation
from ..evaluation.metrics import particle_count
from ..log import Floats
from ..result import RunResult
from . import palette
from .panel import Band, Bars, Dots, Level, Line, Mark, Panel, range_from_zero, range_of

BAND_SIGMAS = 2.0
MAX_CLEAR_STEPS = 2000
"""A jagged line of more steps than this turns into a solid block; its range and median are drawn instead."""
_TIME = "time since the first step [s]"


def error_panel(result: RunResult, evaluation: Evaluation) -> Panel:
    """The live position error after alignment with the 2-sigma band of the reported covariance.

    The band is twice the standard deviation along the major axis of the position's covariance. Without true
    poses the distance to position fixes is drawn, and without those the band alone.
    """
    trajectory, start_s = result.trajectory, _start_s(result)
    marks: list[Mark] = []
    if trajectory.covariance is not None and len(trajectory.stamp_s):
        reach_m, label = (
            BAND_SIGMAS * position_std_m(trajectory.covariance),
            f"{BAND_SIGMAS:g}σ of the reported position",
        )
        time_s = trajectory.stamp_s - start_s
        marks.append(Band(x=time_s, low=np.zeros(len(time_s)), high=reach_m, color=palette.BAND, label=label))
    title, label, top_m = (
        "Reported position uncertainty (this log has no truth)",
        "2σ of the position [m]",
        None,
    )
    if evaluation.live is not None:
        errors = (
            (evaluation.live, "live", palette.LIVE, 1.8),
            (evaluation.smoothed, "smoothed", palette.SMOOTHED, 0.8),
        )
        for found, name, color, width in errors:
            if found is not None:
                time_s, says = found.stamp_s - start_s, f"error, {name} path"
                marks.append(Line(x=time_s, y=found.error_m, color=color, width=width, label=says))
        title = f"Position error after alignment, RMSE {evaluation.live.aligned_m.rmse:.3g} m"
        label = "position error [m]"
    elif evaluation.fixes is not None:
        dots, top_m = _fix_errors(evaluation.fixes.stamp_s - start_s, evaluation.fixes.error_m)
        marks.append(dots)
        title = f"Distance to position fixes after alignment, median {evaluation.fixes.median_m:.3g} m"
        label = "distance to fix [m]"
    y_range = (0.0, top_m) if top_m is not None else None
    return _timed(title, label, marks, y_range)


def position_std_m(covariance: Floats) -> Floats:
    """Standard deviation (T,) along the major axis of the position part of pose covariances (T, 3, 3)."""
    largest = np.linalg.eigvalsh(covariance[:, :2, :2])[:, -1]
    return np.asarray(np.sqrt(np.maximum(largest, 0.0)))


def sample_size_panel(result: RunResult) -> Panel:
    """The effective sample size before resampling at each step, with the steps that resampled marked."""
    steps, time_s = result.steps, result.steps.stamp_s - _start_s(result)
    size, marks = steps.effective_sample_size, []
    if len(time_s) > MAX_CLEAR_STEPS:
        marks += _envelope(time_s, size, "effective sample size")
    else:
        marks.append(Line(x=time_s, y=size, color=palette.LIVE, width=0.9, label="effective sample size"))
    particles = particle_count(result.config)
    if len(np.unique(steps.particles)) > 1:
        kept = np.asarray(steps.particles, dtype=np.float64)
        marks.append(Line(x=time_s, y=kept, color=palette.MUTED, width=1.0, stairs=True, label="particles"))
    elif particles is not None:
        marks.append(Level(at=float(particles), color=palette.MUTED, label=f"{particles:,} particles"))
    if steps.resampled.any():
        at = time_s[steps.resampled]
        alpha = 1.0 if len(at) <= 200 else 0.25
        ticks = Dots(
            x=at,
            y=np.zeros(len(at)),
            color=palette.EVENT,
            shape="tick",
            size=7.0,
            alpha=alpha,
            label="resampled",
        )
        marks.append(ticks)
    count = int(np.count_nonzero(steps.resampled))
    return _timed(
        f"Effective sample size, {count:,} resamplings in {len(time_s):,} steps", "particles", marks
    )


def latency_panel(result: RunResult) -> Panel:
    """The computing time of each step on a logarithmic axis."""
    time_s, latency_us = result.steps.stamp_s - _start_s(result), result.steps.latency_us
    measured = latency_us > 0
    dots = Dots(x=time_s, y=latency_us, color=palette.LIVE, size=2.0, alpha=0.5)
    return Panel(
        title="Latency of each step",
        x_label=_TIME,
        y_label="latency [µs]",
        marks=(dots,),
        x_range=range_of(time_s, margin=0.01),
        y_range=range_of(latency_us, margin=0.05, log=bool(measured.any())),
        y_log=bool(measured.any()),
    )


def latency_histogram_panel(result: RunResult) -> Panel:
    """How often each latency occurs, with the median and the 99th percentile."""
    latency_us = result.steps.latency_us[result.steps.latency_us > 0]
    marks: list[Mark] = []
    counts, edges = np.zeros(0), np.zeros(1)
    if len(latency_us):
        low, high = latency_us.min(), latency_us.max()
        counts, edges = np.histogram(latency_us, bins=np.geomspace(low * 0.99, high * 1.01, 61))
        zero = np.zeros(len(counts))
        marks.append(
            Bars(left=edges[:-1], right=edges[1:], low=zero, high=counts, color=palette.LIVE, alpha=0.75)
        )
        for quantile, color in ((50, palette.GOOD), (99, palette.LANDMARK)):
            value = float(np.percentile(latency_us, quantile))
            says = f"p{quantile}: {value:,.0f} µs" if value >= 100.0 else f"p{quantile}: {value:.3g} µs"
            marks.append(Level(at=value, color=color, width=1.6, dashed=False, upright=True, label=says))
    return Panel(
        title="Distribution",
        x_label="latency [µs]",
        y_label="steps",
        marks=tuple(marks),
        x_range=range_of(edges, margin=0.05, log=len(latency_us) > 0),
        y_range=range_from_zero(counts),
        x_log=len(latency_us) > 0,
        legend_columns=2,
    )


def _envelope(time_s: Floats, values: Floats, label: str) -> list[Mark]:
    """Range and median of the values within each of 300 equal stretches of steps."""
    pieces = np.array_split(np.arange(len(time_s)), 300)
    middle_s = np.array([time_s[piece].mean() for piece in pieces])
    low, median, high = np.array([np.percentile(values[piece], [0, 50, 100]) for piece in pieces]).T
    band = Band(x=middle_s, low=low, high=high, color=palette.BAND, alpha=0.3, label=f"{label}, range")
    return [band, Line(x=middle_s, y=median, color=palette.LIVE, width=1.1, label=f"{label}, median")]


def _fix_errors(time_s: Floats, error_m: Floats) -> tuple[Dots, float | None]:
    """Distances as dots, and where the axis ends so that 95 % lie well inside; says what it leaves out."""
    limit_m = 3.0 * max(float(np.percentile(error_m, 90)), 1e-3)
    beyond = int(np.count_nonzero(error_m > limit_m))
    label = "distance to fix" + (f" ({beyond} beyond this axis)" if beyond else "")
    dots = Dots(x=time_s, y=error_m, color=palette.LIVE, size=2.5, alpha=0.7, label=label)
    return dots, limit_m if beyond else None


def _timed(title: str, label: str, marks: list[Mark], y_range: tuple[float, float] | None = None) -> Panel:
    """A panel over time whose values start at zero."""
    times = [mark.x for mark in marks if isinstance(mark, Line | Dots | Band)]
    heights = [
        mark.high if isinstance(mark, Band) else mark.y
        for mark in marks
        if isinstance(mark, Line | Dots | Band)
    ]
    heights += [np.array([mark.at]) for mark in marks if isinstance(mark, Level)]
    return Panel(
        title=title,
        x_label=_TIME,
        y_label=label,
        marks=tuple(marks),
        x_range=range_of(*times, margin=0.01),
        y_range=range_from_zero(*heights) if y_range is None else y_range,
    )


def _start_s(result: RunResult) -> float:
    return float(result.steps.stamp_s[0]) if len(result.steps.stamp_s) else 0.0

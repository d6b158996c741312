"""What happened when: position error against the reported uncertainty, effective sample size, latency."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes

from ..evaluation import Evaluation, evaluate_run
from ..evaluation.metrics import particle_count
from ..log import Floats, Log
from ..result import RunResult
from . import style

BAND_SIGMAS = 2.0
MAX_CLEAR_STEPS = 2000
"""A jagged line of more steps than this turns into a solid block; its range and median are drawn instead."""


def plot_error_over_time(
    axis: Axes, result: RunResult, log: Log, *, evaluation: Evaluation | None = None
) -> Axes:
    """Draw the live position error after alignment with the 2-sigma band of the reported covariance.

    The band is twice the standard deviation along the major axis of the position's covariance. Without true
    poses the distance to position fixes is drawn, and without those the band alone.
    """
    found = evaluate_run(result, log) if evaluation is None else evaluation
    trajectory = result.trajectory
    start_s = _start_s(result)
    if trajectory.covariance is not None and len(trajectory.stamp_s):
        reach_m = BAND_SIGMAS * position_std_m(trajectory.covariance)
        band: dict[str, Any] = {"color": style.BAND, "alpha": 0.25, "linewidth": 0}
        band["label"] = f"{BAND_SIGMAS:g}σ of the reported position"
        axis.fill_between(trajectory.stamp_s - start_s, 0.0, reach_m, **band)
    title, label = "Reported position uncertainty (this log has no truth)", "2σ of the position [m]"
    if found.live is not None:
        _line(
            axis,
            found.live.stamp_s - start_s,
            found.live.error_m,
            label="error, live path",
            color=style.LIVE,
            linewidth=1.8,
        )
        if found.smoothed is not None:
            smoothed = found.smoothed
            _line(
                axis,
                smoothed.stamp_s - start_s,
                smoothed.error_m,
                label="error, smoothed path",
                color=style.SMOOTHED,
                linewidth=0.8,
            )
        title, label = (
            f"Position error after alignment, RMSE {found.live.aligned_m.rmse:.3g} m",
            "position error [m]",
        )
    elif found.fixes is not None:
        _plot_fix_errors(axis, found.fixes.stamp_s - start_s, found.fixes.error_m)
        title = f"Distance to position fixes after alignment, median {found.fixes.median_m:.3g} m"
        label = "distance to fix [m]"
    axis.set_ylim(bottom=0.0)
    return _finish(axis, title=title, label=label)


def position_std_m(covariance: Floats) -> Floats:
    """Standard deviation (T,) along the major axis of the position part of pose covariances (T, 3, 3)."""
    largest = np.linalg.eigvalsh(covariance[:, :2, :2])[:, -1]
    return np.asarray(np.sqrt(np.maximum(largest, 0.0)))


def plot_effective_sample_size(axis: Axes, result: RunResult) -> Axes:
    """Draw the effective sample size before resampling at each step, with the steps that resampled marked."""
    steps, time_s = result.steps, result.steps.stamp_s - _start_s(result)
    if len(time_s) > MAX_CLEAR_STEPS:
        _plot_envelope(axis, time_s, steps.effective_sample_size, label="effective sample size")
    else:
        _line(
            axis,
            time_s,
            steps.effective_sample_size,
            label="effective sample size",
            color=style.LIVE,
            linewidth=0.9,
        )
    particles = particle_count(result.config)
    if len(np.unique(steps.particles)) > 1:
        varied: dict[str, Any] = {"color": style.MUTED, "linewidth": 1.0, "drawstyle": "steps-post"}
        axis.plot(
            time_s, steps.particles, **varied, rasterized=style.is_heavy(len(time_s)), label="particles"
        )
    elif particles is not None:
        ceiling: dict[str, Any] = {"color": style.MUTED, "linestyle": (0, (4, 2)), "linewidth": 1.0}
        axis.axhline(particles, **ceiling, label=f"{particles:,} particles")
    if steps.resampled.any():
        marks: dict[str, Any] = {"marker": "|", "markersize": 7, "linestyle": "none", "color": style.EVENT}
        at = time_s[steps.resampled]
        marks["alpha"] = 1.0 if len(at) <= 200 else 0.25
        heavy = style.is_heavy(10 * len(at))
        axis.plot(at, np.zeros(len(at)), **marks, clip_on=False, rasterized=heavy, label="resampled")
    axis.set_ylim(bottom=0.0)
    count = int(np.count_nonzero(steps.resampled))
    title = f"Effective sample size, {count:,} resamplings in {len(time_s):,} steps"
    return _finish(axis, title=title, label="particles")


def plot_latency(axis: Axes, result: RunResult) -> Axes:
    """Draw the computing time of each step on a logarithmic axis."""
    time_s, latency_us = result.steps.stamp_s - _start_s(result), result.steps.latency_us
    dots: dict[str, Any] = {
        "marker": ".",
        "markersize": 2.5,
        "linestyle": "none",
        "color": style.LIVE,
        "alpha": 0.5,
    }
    axis.plot(time_s, latency_us, **dots, rasterized=style.is_heavy(5 * len(time_s)), label="one step")
    if np.any(latency_us > 0):
        axis.set_yscale("log")
        style.plain_log_ticks(axis.yaxis)
    return _finish(axis, title="Latency of each step", label="latency [µs]")


def plot_latency_histogram(axis: Axes, result: RunResult) -> Axes:
    """Draw how often each latency occurs, with the median and the 99th percentile."""
    latency_us = result.steps.latency_us[result.steps.latency_us > 0]
    if len(latency_us):
        low, high = latency_us.min(), latency_us.max()
        counts, edges = np.histogram(latency_us, bins=np.geomspace(low * 0.99, high * 1.01, 61))
        axis.stairs(counts, edges, fill=True, color=style.LIVE, alpha=0.75)
        axis.set_xscale("log")
        for quantile, color in ((50, style.GOOD), (99, style.LANDMARK)):
            value = np.percentile(latency_us, quantile)
            axis.axvline(value, color=color, linewidth=1.6, label=f"p{quantile}: {value:,.3g} µs")
        style.plain_log_ticks(axis.xaxis)
        style.legend_below(axis)
    axis.set_title("Distribution")
    axis.set_xlabel("latency [µs]")
    axis.set_ylabel("steps")
    return axis


def _plot_envelope(axis: Axes, time_s: Floats, values: Floats, *, label: str) -> None:
    """Range and median of the values within each of 300 equal stretches of steps."""
    pieces = np.array_split(np.arange(len(time_s)), 300)
    middle_s = [time_s[piece].mean() for piece in pieces]
    low, median, high = np.array([np.percentile(values[piece], [0, 50, 100]) for piece in pieces]).T
    axis.fill_between(middle_s, low, high, color=style.BAND, alpha=0.3, linewidth=0, label=f"{label}, range")
    axis.plot(middle_s, median, color=style.LIVE, linewidth=1.1, label=f"{label}, median")


def _plot_fix_errors(axis: Axes, time_s: Floats, error_m: Floats) -> None:
    """Distances as dots; the axis ends where 95 % of them lie well inside, and says what it leaves out."""
    limit_m = 3.0 * max(float(np.percentile(error_m, 90)), 1e-3)
    beyond = int(np.count_nonzero(error_m > limit_m))
    label = "distance to fix" + (f" ({beyond} beyond this axis)" if beyond else "")
    dots: dict[str, Any] = {
        "marker": ".",
        "markersize": 3,
        "linestyle": "none",
        "color": style.LIVE,
        "alpha": 0.7,
    }
    axis.plot(time_s, error_m, **dots, label=label)
    if beyond:
        axis.set_ylim(top=limit_m)


def _line(axis: Axes, time_s: Floats, values: Floats, **line: Any) -> None:
    axis.plot(time_s, values, **{"linewidth": 1.2, **line}, rasterized=style.is_heavy(len(time_s)))


def _start_s(result: RunResult) -> float:
    return float(result.steps.stamp_s[0]) if len(result.steps.stamp_s) else 0.0


def _finish(axis: Axes, *, title: str, label: str) -> Axes:
    axis.set_title(title)
    axis.set_xlabel("time since the first step [s]")
    axis.set_ylabel(label)
    axis.margins(x=0.01)
    if axis.get_legend_handles_labels()[0]:
        style.legend_below(axis)
    return axis

"""What happened when: position error against the reported uncertainty, effective sample size, latency."""

from __future__ import annotations

from matplotlib.axes import Axes

from ..charts.over_time import error_panel, latency_histogram_panel, latency_panel, sample_size_panel
from ..evaluation import Evaluation, evaluate_run
from ..log import Log
from ..result import RunResult
from .panel import draw_panel


def plot_error_over_time(
    axis: Axes, result: RunResult, log: Log, *, evaluation: Evaluation | None = None
) -> Axes:
    """Draw the live position error after alignment with the 2-sigma band of the reported covariance.

    The band is twice the standard deviation along the major axis of the position's covariance. Without true
    poses the distance to position fixes is drawn, and without those the band alone.
    """
    found = evaluate_run(result, log) if evaluation is None else evaluation
    return draw_panel(axis, error_panel(result, found))


def plot_effective_sample_size(axis: Axes, result: RunResult) -> Axes:
    """Draw the effective sample size before resampling at each step, with the steps that resampled marked."""
    return draw_panel(axis, sample_size_panel(result))


def plot_latency(axis: Axes, result: RunResult) -> Axes:
    """Draw the computing time of each step on a logarithmic axis."""
    return draw_panel(axis, latency_panel(result))


def plot_latency_histogram(axis: Axes, result: RunResult) -> Axes:
    """Draw how often each latency occurs, with the median and the 99th percentile."""
    return draw_panel(axis, latency_histogram_panel(result))

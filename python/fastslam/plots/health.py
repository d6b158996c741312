"""How far the filter could be believed over time: status, reasons, innovations against the noise."""

from __future__ import annotations

from matplotlib.axes import Axes

from ..charts.health import health_panel, innovations_panel
from ..result import RunResult
from .panel import draw_panel


def plot_health(axis: Axes, result: RunResult) -> Axes:
    """Draw a strip that is coloured by the status of each step, and one line per reason that ever applied."""
    return draw_panel(axis, health_panel(result))


def plot_innovations(axis: Axes, result: RunResult) -> Axes:
    """Draw the mean normalised innovation squared of the sliding window against what right noise gives."""
    return draw_panel(axis, innovations_panel(result))

"""The figures that every run gets."""

from __future__ import annotations

from ..evaluation import Evaluation
from ..log import Log
from ..result import RunResult
from .health import health_panel, innovations_panel
from .map import map_panel
from .over_time import error_panel, latency_histogram_panel, latency_panel, sample_size_panel
from .panel import Chart, Panel

WIDE_IN = 6.0
"""Figures that are wider have room for a legend of four columns."""


def map_chart(result: RunResult, log: Log, evaluation: Evaluation, *, width_in: float = 8.0) -> Chart:
    """The map with path and truth. Letters are of one size: 4 inches can be read on a phone."""
    panel = map_panel(result, log, evaluation, small=width_in <= WIDE_IN)
    return Chart(
        panels=(panel,), width_in=width_in, height_in=0.9 * width_in + max(0.0, 2.0 - 0.25 * width_in)
    )


def run_charts(
    result: RunResult, log: Log, evaluation: Evaluation, *, width_in: float = 8.0
) -> dict[str, Chart]:
    """The figures `map`, `error`, `health`, `effective_sample_size` and `latency`, by name.

    Where they are no wider than `WIDE_IN`, nothing stands side by side.
    """
    narrow = width_in <= WIDE_IN
    health = (health_panel(result), innovations_panel(result))
    latency = (latency_panel(result), latency_histogram_panel(result))

    def chart(panels: tuple[Panel, ...], height_in: float, *shares: float, stacked: bool = False) -> Chart:
        return Chart(
            panels=panels,
            width_in=width_in,
            height_in=height_in,
            stacked=stacked,
            shares=shares or (1.0,),
        )

    return {
        "map": map_chart(result, log, evaluation, width_in=width_in),
        "error": chart((error_panel(result, evaluation),), 3.8),
        "health": chart(health, 4.2, 2.0, 3.0, stacked=True),
        "effective_sample_size": chart((sample_size_panel(result),), 3.4),
        "latency": chart(latency, 5.6 if narrow else 3.4, 3.0, 2.0, stacked=narrow),
    }

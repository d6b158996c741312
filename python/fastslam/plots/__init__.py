"""Figures of a run. Importing this imports Matplotlib; nothing else in the package does."""

from .comparison import comparison_figure
from .consistency import consistency_figure, plot_coverage, plot_nees
from .figures import make_figures, map_figure, render, save_figures, write_figures
from .health import plot_health, plot_innovations
from .map import plot_map
from .over_time import plot_effective_sample_size, plot_error_over_time, plot_latency, plot_latency_histogram
from .style import house_style, new_figure

__all__ = [
    "comparison_figure",
    "consistency_figure",
    "house_style",
    "make_figures",
    "map_figure",
    "new_figure",
    "plot_coverage",
    "plot_effective_sample_size",
    "plot_error_over_time",
    "plot_health",
    "plot_innovations",
    "plot_latency",
    "plot_latency_histogram",
    "plot_map",
    "plot_nees",
    "render",
    "save_figures",
    "write_figures",
]

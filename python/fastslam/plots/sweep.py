"""Results of a sweep: each metric against the first key that was varied over numbers."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ..evaluation.metrics import METRIC_UNITS
from ..sweep.table import Group
from .style import CLASSES, house_style, legend_below, new_figure, plain_log_ticks

METRICS = ("ate_rmse_m", "smoothed_ate_rmse_m", "landmark_rmse_m", "gps_median_m", "filter_seconds")


def varied_key(groups: Sequence[Group]) -> str | None:
    """The first key of the grid whose values are numbers, more than one of them; None where there is none."""
    for key in groups[0].point if groups else ():
        values = {group.point[key] for group in groups if _is_number(group.point[key])}
        if len(values) > 1:
            return key
    return None


def plot_sweep(axis: Axes, *, groups: Sequence[Group], metric: str, key: str) -> Axes:
    """Means of a metric with 95 % intervals against a key, one line per log and setting of the other keys."""
    lines: dict[str, list[tuple[float, float, float]]] = {}
    for group in groups:
        found = group.summary.get(metric)
        if found is None or not _is_number(group.point[key]):
            continue
        others = [f"{name}: {value}" for name, value in group.point.items() if name != key]
        point = (float(group.point[key]), found.mean, found.ci95 or 0.0)
        lines.setdefault(", ".join([group.log, *others]), []).append(point)
    axis.set_prop_cycle(color=CLASSES)
    for label, points in lines.items():
        x, mean, half_width = zip(*sorted(points), strict=True)
        axis.errorbar(x, mean, yerr=half_width, marker="o", capsize=3, label=label)
    positive = sorted(point[0] for points in lines.values() for point in points)
    if positive and positive[0] > 0 and positive[-1] >= 10 * positive[0]:
        axis.set_xscale("log")
        plain_log_ticks(axis.xaxis)
    axis.set_ylim(bottom=0.0)
    axis.set_xlabel(key)
    axis.set_ylabel(f"{metric} [{METRIC_UNITS[metric]}]" if metric in METRIC_UNITS else metric)
    axis.set_title(f"{metric}, mean ± 95 %")
    return axis


def sweep_figures(groups: Sequence[Group]) -> dict[str, Figure]:
    """One figure per metric that the sweep measured; none where no key was varied over numbers."""
    key = varied_key(groups)
    figures = {}
    for metric in METRICS if key is not None else ():
        if not any(metric in group.summary for group in groups):
            continue
        with house_style():
            figures[metric] = new_figure(4.6, 3.6)
            axis = plot_sweep(figures[metric].add_subplot(), groups=groups, metric=metric, key=str(key))
            legend_below(axis, columns=1)
    return figures


def write_sweep_figures(groups: Sequence[Group], folder: Path | str) -> list[Path]:
    """The figures as PNG, named after their metrics."""
    written = []
    for metric, figure in sweep_figures(groups).items():
        written.append(Path(folder) / f"{metric}.png")
        with house_style():
            figure.savefig(written[-1])
    return written


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)

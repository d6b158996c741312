"""Metrics of several runs, usually of one log with different seeds, brought together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .._quantiles import student_t_quantile
from .metrics import Metrics


@dataclass(frozen=True)
class MetricSummary:
    """One metric over the runs that have it.

    `ci95` is the half width of the 95 % confidence interval of the mean (Student t); None for a single run.
    """

    runs: int
    mean: float
    ci95: float | None
    median: float
    min: float
    max: float


def flatten(metrics: Metrics) -> dict[str, float | int | None]:
    """Nested metrics as `name.member`, in order."""
    flat: dict[str, float | int | None] = {}
    for name, value in metrics.items():
        if isinstance(value, dict):
            flat.update({f"{name}.{member}": number for member, number in value.items()})
        else:
            flat[name] = value
    return flat


def summarize(runs: Sequence[Metrics]) -> dict[str, MetricSummary]:
    """Mean with 95 % confidence interval, median, least and largest of each metric.

    Nested metrics appear as `name.member`. A run that lacks a metric, or has None, does not count for it;
    `MetricSummary.runs` says how many did. A counter that a run did not report is zero in that run.
    """
    flat = [flatten(metrics) for metrics in runs]
    summary = {}
    for name in dict.fromkeys(name for metrics in flat for name in metrics):
        missing = 0 if name.startswith("counts.") else None
        found = [value for metrics in flat if (value := metrics.get(name, missing)) is not None]
        if found:
            summary[name] = _summarize(np.array(found, dtype=float))
    return summary


def _summarize(values: np.ndarray[tuple[int, ...], np.dtype[np.float64]]) -> MetricSummary:
    count = len(values)
    ci95 = None
    if count > 1:
        ci95 = float(student_t_quantile(0.975, count - 1) * np.std(values, ddof=1) / np.sqrt(count))
    return MetricSummary(
        runs=count,
        mean=float(values.mean()),
        ci95=ci95,
        median=float(np.median(values)),
        min=float(values.min()),
        max=float(values.max()),
    )

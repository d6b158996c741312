"""How metrics are shown to people: a unit for each, and numbers with a sensible number of digits."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from .metrics import METRIC_UNITS, Metrics
from .runs import flatten, summarize

_SCALES = {"B": ((1e9, "GB"), (1e6, "MB"), (1e3, "kB")), "1/s": ((1e6, "million/s"),)}


@dataclass(frozen=True)
class MetricRow:
    """One line of a table: the metric's name as in metrics.json, its value as text, and the unit."""

    name: str
    value: str
    unit: str


@dataclass(frozen=True)
class SummaryRow:
    """One line of a table over several runs; `ci95` is the half width around the mean."""

    name: str
    runs: int
    mean: str
    ci95: str
    median: str
    min: str
    max: str
    unit: str


def metric_rows(metrics: Metrics) -> list[MetricRow]:
    """Rows for a table, nested metrics as `name.member`, in the order of the metrics."""
    return [MetricRow(name, *format_metric(name, value)) for name, value in flatten(metrics).items()]


def summary_rows(runs: Sequence[Metrics]) -> list[SummaryRow]:
    """Rows for a table over several runs, all values of a row in the same unit."""
    rows = []
    for name, found in summarize(runs).items():
        factor, unit = _scale(metric_unit(name), found.mean)
        mean, median, low, high = (
            _compact(value / factor) for value in (found.mean, found.median, found.min, found.max)
        )
        ci95 = "-"
        if found.ci95 is not None:
            # Runs that agree to rounding have no spread worth showing.
            ci95 = format_number(0 if found.ci95 < 1e-9 * abs(found.mean) else found.ci95 / factor)
        rows.append(SummaryRow(name, found.runs, mean, ci95, median, low, high, unit))
    return rows


def metric_unit(name: str) -> str:
    """Unit of a metric given as `name` or `name.member`; empty for a plain number."""
    return METRIC_UNITS.get(name, METRIC_UNITS.get(name.split(".")[0], ""))


def format_metric(name: str, value: float | int | None) -> tuple[str, str]:
    """Text and unit of one value: large memory and rates scaled, `-` where it is not determined."""
    if value is None:
        return "-", metric_unit(name)
    factor, unit = _scale(metric_unit(name), value)
    return format_number(value if factor == 1.0 else value / factor), unit


def format_number(value: float | int) -> str:
    """Integers with thousands separated, other numbers with four significant digits."""
    if isinstance(value, int):
        return f"{value:,}"
    if not math.isfinite(value):
        return "-"
    if value != 0 and not 1e-4 <= abs(value) < 1e6:
        return f"{value:.3g}"
    digits = 3 - math.floor(math.log10(abs(value))) if value != 0 else 0
    return f"{value:,.{min(max(digits, 0), 6)}f}"


def _scale(unit: str, value: float) -> tuple[float, str]:
    for factor, scaled in _SCALES.get(unit, ()):
        if abs(value) >= factor:
            return factor, scaled
    return 1.0, unit


def _compact(value: float) -> str:
    """As `format_number`, whole numbers without decimals."""
    return format_number(int(value) if value.is_integer() else value)

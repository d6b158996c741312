"""How metrics are shown to people: a unit for each, and numbers with a sensible number of digits."""

from __future__ import annotations

import math
from dataclasses import dataclass

from .metrics import METRIC_UNITS, Metrics
from .runs import flatten

_SCALES = {"B": ((1e9, "GB"), (1e6, "MB"), (1e3, "kB")), "1/s": ((1e6, "million/s"),)}


@dataclass(frozen=True)
class MetricRow:
    """One line of a table: the metric's name as in metrics.json, its value as text, and the unit."""

    name: str
    value: str
    unit: str


def metric_rows(metrics: Metrics) -> list[MetricRow]:
    """Rows for a table, nested metrics as `name.member`, in the order of the metrics."""
    return [MetricRow(name, *format_metric(name, value)) for name, value in flatten(metrics).items()]


def metric_unit(name: str) -> str:
    """Unit of a metric given as `name` or `name.member`; empty for a plain number."""
    return METRIC_UNITS.get(name, METRIC_UNITS.get(name.split(".")[0], ""))


def format_metric(name: str, value: float | int | None) -> tuple[str, str]:
    """Text and unit of one value: large memory and rates scaled, `-` where it is not determined."""
    unit = metric_unit(name)
    if value is None:
        return "-", unit
    for factor, scaled in _SCALES.get(unit, ()):
        if abs(value) >= factor:
            return format_number(value / factor), scaled
    return format_number(value), unit


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

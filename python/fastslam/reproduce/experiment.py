"""What the experiments have in common: where they write, how large they are, what they claim."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ..errors import FastSlamError
from ..evaluation import MetricSummary
from ..plots import house_style, render
from ..resultfiles import write_atomically
from ..settings import Partial
from ..sweep import Group, Progress, ResultStore, SweepSpec, group_rows, sweep_cells

PLAIN: Partial = {"filter": {"rejuvenation": {"every_steps": 0}}}
"""The filter of the papers, which never draws paths anew."""


@dataclass(frozen=True)
class Claim:
    """A statement of the paper: what it reports and what was measured here."""

    statement: str
    paper: str
    ours: str


@dataclass(frozen=True)
class Scale:
    """How much to compute and where to put it."""

    folder: Path
    quick: bool
    processes: int | None = None
    progress: Progress | None = None

    def seeds(self, *, quick: int, full: int) -> range:
        """Seeds of a sweep."""
        return range(1, 1 + (quick if self.quick else full))

    def sweep(self, name: str, spec: SweepSpec, *, processes: int | None = None) -> list[Group]:
        """Runs a sweep in a folder of its own; `processes=1` where times are measured.

        Errors: `FastSlamError` for the first run that failed; those that are done stay.
        """
        rows = sweep_cells(
            spec.cells(),
            ResultStore(self.folder / ".sweeps" / name),
            processes=self.processes if processes is None else processes,
            progress=self.progress,
            retry_failed=True,
        )
        for row in rows:
            if row["error"] is not None:
                raise FastSlamError(f"{name}, {row['log']}, seed {row['seed']}: {row['error']}")
        return group_rows(rows)

    def write_csv(self, name: str, rows: Sequence[Mapping[str, Any]]) -> None:
        """Writes the data of a figure."""
        text = io.StringIO()
        writer = csv.DictWriter(
            text, list(dict.fromkeys(k for row in rows for k in row)), lineterminator="\n"
        )
        writer.writeheader()
        writer.writerows(rows)
        write_atomically(self.folder / f"{name}.csv", text.getvalue())

    def write_figure(self, name: str, draw: Callable[[], Figure]) -> None:
        """Draws in the house style and writes PNG and SVG."""
        with house_style():
            figure = draw()
            for kind in ("png", "svg"):
                write_atomically(self.folder / f"{name}.{kind}", render(figure, kind))


@dataclass(frozen=True)
class Experiment:
    """One figure or table of the paper."""

    name: str
    title: str
    run: Callable[[Scale], list[Claim]]


def series_rows(groups: Sequence[Group], metrics: Sequence[str]) -> list[dict[str, Any]]:
    """The groups as rows of a CSV file: log, grid point, and per metric its mean and half interval."""
    rows = []
    for group in groups:
        row: dict[str, Any] = {"log": group.log, **group.point, "failed": group.failed}
        for name in metrics:
            found = group.summary.get(name)
            row[f"{name}_mean"] = None if found is None else found.mean
            row[f"{name}_ci95"] = None if found is None else found.ci95
            row["runs"] = None if found is None else found.runs
        rows.append(row)
    return rows


def plot_series(
    axis: Axes,
    x: Sequence[float],
    values: Sequence[MetricSummary],
    *,
    label: str,
    color: str,
    marker: str = "o",
) -> None:
    """A line through means with their 95 % intervals."""
    axis.errorbar(
        x,
        [value.mean for value in values],
        yerr=[value.ci95 or 0.0 for value in values],
        label=label,
        color=color,
        marker=marker,
        markersize=4,
        capsize=2.5,
        elinewidth=1.0,
    )


def interval(value: MetricSummary, *, scale: float = 1.0, unit: str = "m") -> str:
    """`0.120 ± 0.014 m`: as many digits as the interval has sense in."""
    mean, half = scale * value.mean, scale * (value.ci95 or 0.0)
    if half <= 0.0:
        return f"{mean:.3g} {unit}"
    digits = max(0, 1 - math.floor(math.log10(half)))
    return f"{mean:.{digits}f} ± {half:.{digits}f} {unit}"

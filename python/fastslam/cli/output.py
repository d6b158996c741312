"""What runs leave behind: tables on the terminal, and the folder's note of which log was run."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from rich.table import Table

from ..errors import DataError
from ..evaluation import METRIC_UNITS, Metrics, flatten, summarize
from ..resultfiles import to_json, write_atomically
from .console import for_display, make_table, number_text, unit_of

_LOG_FILE = "log.json"


@dataclass(frozen=True)
class LogReference:
    """Which log a results folder is about, enough to read it again."""

    path: Path
    format: str
    robot: int | None = None


def write_log_reference(folder: Path, reference: LogReference) -> None:
    """Notes the log beside the results; relative paths are made absolute."""
    facts = {**asdict(reference), "path": str(reference.path.resolve())}
    write_atomically(folder / _LOG_FILE, to_json(facts))


def read_log_reference(folder: Path) -> LogReference:
    """Errors: `DataError` when the folder does not say which log it is about."""
    path = folder / _LOG_FILE
    try:
        facts = json.loads(path.read_text(encoding="utf-8"))
        return LogReference(Path(facts["path"]), str(facts["format"]), facts["robot"])
    except FileNotFoundError:
        raise DataError("does not say which log was run: name one with --truth", folder) from None
    except (OSError, ValueError, KeyError, TypeError):
        raise DataError("is no note of a log: name the log with --truth", path) from None


def metrics_table(title: str, metrics: Metrics) -> Table:
    """One row per metric, with its unit."""
    rows = []
    for name, value in flatten(metrics).items():
        shown, unit = for_display(value, unit_of(name, METRIC_UNITS))
        rows.append((name, number_text(shown), unit))
    return make_table(title, ("metric", ">value", "unit"), rows)


def summary_table(title: str, runs: Sequence[Metrics]) -> Table:
    """One row per metric: mean over the runs with the half width of its 95 % confidence interval."""
    rows = []
    for name, summary in summarize(runs).items():
        unit = unit_of(name, METRIC_UNITS)
        values = (summary.mean, summary.ci95, summary.median, summary.min, summary.max)
        cells = [number_text(for_display(value, unit)[0]) for value in values]
        rows.append((name, *cells, for_display(None, unit)[1], str(summary.runs)))
    headings = ("metric", ">mean", ">± 95 %", ">median", ">min", ">max", "unit", ">runs")
    return make_table(title, headings, rows)

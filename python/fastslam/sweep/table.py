"""The rows of a sweep as tables: one row per cell, and means over the seeds."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

from ..csv_cells import guarded
from ..evaluation import MetricSummary, summarize

Row: TypeAlias = "dict[str, Any]"


@dataclass(frozen=True)
class Group:
    """The cells that differ only in their seed."""

    log: str
    point: Mapping[str, Any]
    summary: Mapping[str, MetricSummary]
    failed: int
    """Cells that ended with an error; the summary is over the others."""


def read_rows(rows: Sequence[Row]) -> list[Row]:
    """Rows with `point` and `metrics` laid flat: log, grid keys, seed, metrics, error."""
    return [
        {
            "log": row["log"],
            **{key: _cell(value) for key, value in row["point"].items()},
            "seed": row["seed"],
            **row["metrics"],
            "wall_seconds": row["wall_seconds"],
            "error": row["error"],
        }
        for row in rows
    ]


def group_rows(rows: Sequence[Row]) -> list[Group]:
    """Groups over the seeds, in the order of the rows."""
    groups: dict[str, list[Row]] = {}
    for row in rows:
        groups.setdefault(json.dumps([row["log"], row["point"]]), []).append(row)
    return [
        Group(
            log=members[0]["log"],
            point=members[0]["point"],
            summary=summarize([row["metrics"] for row in members if row["error"] is None]),
            failed=sum(row["error"] is not None for row in members),
        )
        for members in groups.values()
    ]


def tidy_csv(rows: Sequence[Row]) -> str:
    """One line per cell; empty where a cell lacks a metric."""
    return _csv(read_rows(rows))


def summary_csv(rows: Sequence[Row]) -> str:
    """One line per grid point and metric: mean, half width of its 95 % interval, median, least, largest."""
    lines = []
    for group in group_rows(rows):
        for metric, value in group.summary.items():
            lines.append(
                {
                    "log": group.log,
                    **{key: _cell(v) for key, v in group.point.items()},
                    "metric": metric,
                    "runs": value.runs,
                    "failed": group.failed,
                    "mean": value.mean,
                    "ci95": value.ci95,
                    "median": value.median,
                    "min": value.min,
                    "max": value.max,
                }
            )
    return _csv(lines)


def _cell(value: Any) -> Any:
    """Lists and sections of a grid in one field."""
    return json.dumps(value) if isinstance(value, list | dict) else value


def _csv(rows: Sequence[Mapping[str, Any]]) -> str:
    columns = list(dict.fromkeys(name for row in rows for name in row))
    text = io.StringIO()
    writer = csv.DictWriter(text, columns, lineterminator="\n")
    writer.writeheader()
    writer.writerows(
        {name: guarded(value) if isinstance(value, str) else value for name, value in row.items()}
        for row in rows
    )
    return text.getvalue()

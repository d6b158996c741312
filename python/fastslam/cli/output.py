"""What runs leave behind: tables on the terminal, and the folder's note of which log was run."""

from __future__ import annotations

import json
import textwrap
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from ..errors import DataError
from .console import make_table, stdout

if TYPE_CHECKING:
    from rich.table import Table

    from ..evaluation import Metrics
    from ..settings import KeyInfo


@dataclass(frozen=True)
class LogReference:
    """Which log a results folder is about, enough to read it again."""

    path: Path
    format: str
    robot: int | None = None
    run: int | None = None
    topics: dict[str, str] | None = None


def write_log_reference(folder: Path, reference: LogReference) -> None:
    """Notes the log beside the results; relative paths are made absolute."""
    from ..resultfiles import LOG_FILE, to_json, write_atomically

    facts = {**asdict(reference), "path": str(reference.path.resolve())}
    write_atomically(folder / LOG_FILE, to_json(facts))


def read_log_reference(folder: Path) -> LogReference:
    """Errors: `DataError` when the folder does not say which log it is about."""
    from ..resultfiles import LOG_FILE

    path = folder / LOG_FILE
    try:
        facts = json.loads(path.read_text(encoding="utf-8"))
        return LogReference(
            Path(facts["path"]), str(facts["format"]), facts["robot"], facts.get("run"), facts.get("topics")
        )
    except FileNotFoundError:
        raise DataError("does not say which log was run: name one with --truth", folder) from None
    except (OSError, ValueError, KeyError, TypeError):
        raise DataError("is no note of a log: name the log with --truth", path) from None


def keys_text(keys: Sequence[KeyInfo], width: int) -> str:
    """Every configuration key with its default, and under it what it may be and what it means."""
    return "".join(f"{info.name}: {json.dumps(info.default)}\n{_meaning(info, width)}\n" for info in keys)


def _meaning(info: KeyInfo, width: int) -> str:
    only_for = f"Only for {info.only_for}. " if info.only_for else ""
    text = f"{info.type}. {only_for}{info.description}"
    indent = "    "
    return textwrap.fill(text, max(width, 20), initial_indent=indent, subsequent_indent=indent)


def say_verdict(line: str) -> None:
    """Whether what was computed is to be believed, on the console; never missing."""
    stdout().print(f"verdict: {line}", markup=False, highlight=False, soft_wrap=True)


def in_one_line_of_runs(runs: int, unsound: int) -> str:
    """What speaks against several runs, `unsound` of which have a verdict; some may be too short for one."""
    if not unsound:
        return f"no check speaks against any of {runs:,} runs"
    return f"not all believable: checks speak against {unsound:,} of {runs:,} runs"


def metrics_table(title: str, metrics: Metrics) -> Table:
    """One row per metric, with its unit; counts of skips and repairs only where there were any."""
    from ..evaluation.display import metric_rows

    rows = [
        (row.name, row.value, row.unit)
        for row in metric_rows(metrics)
        if not (row.name.startswith("counts.") and row.value == "0")
    ]
    return make_table(title, ("metric", ">value", "unit"), rows)


def summary_table(title: str, runs: Sequence[Metrics]) -> Table:
    """One row per metric: mean over the runs with the half width of its 95 % confidence interval."""
    from ..evaluation.display import summary_rows

    rows = [
        (row.name, row.mean, row.ci95, row.median, row.min, row.max, row.unit, str(row.runs))
        for row in summary_rows(runs)
    ]
    headings = ("metric", ">mean", ">± 95 %", ">median", ">min", ">max", "unit", ">runs")
    return make_table(title, headings, rows)

"""`fastslam eval`: scores results folders again, against the truth of their log or another."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ..datasets.registry import load
from ..errors import DataError
from ..evaluation import evaluate
from ..log import Log
from ..resultfiles import read_result, to_json
from .console import stdout
from .options import Format, Robot, Run
from .output import metrics_table, read_log_reference, summary_table


def evaluate_results(
    results: Annotated[list[Path], typer.Argument(help="Results folders.", metavar="RESULT...")],
    truth: Annotated[
        Path | None, typer.Option(help="Log with the truth; that of the run when left out.", metavar="PATH")
    ] = None,
    format: Format = None,
    robot: Robot = None,
    run: Run = None,
    json: Annotated[bool, typer.Option("--json", help="Print the metrics as JSON.")] = False,
) -> None:
    """Score one results folder, or several together with the 95 % confidence interval of each metric.

    \b
    Examples:
      fastslam eval results/latest
      fastslam eval results/latest --truth LOG
      fastslam eval results/seed*
    """
    metrics = [
        evaluate(read_result(folder), _log_of(folder, truth, format, robot, run)) for folder in results
    ]
    if json:
        typer.echo(to_json(metrics[0] if len(metrics) == 1 else metrics), nl=False)
    elif len(metrics) == 1:
        stdout().print(metrics_table(str(results[0]), metrics[0]))
    else:
        stdout().print(summary_table(f"{len(results)} results", metrics))


def _log_of(folder: Path, truth: Path | None, format: str | None, robot: int | None, run: int | None) -> Log:
    if truth is not None:
        return load(truth, format=format, robot=robot, run=run)
    reference = read_log_reference(folder)
    if not reference.path.exists():
        raise DataError("the log of this run is no longer there: name one with --truth", reference.path)
    return load(
        reference.path,
        format=format or reference.format,
        robot=robot or reference.robot,
        run=run or reference.run,
    )

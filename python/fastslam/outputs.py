"""Everything that a run leaves in its folder: numbers, figures, report."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

from .evaluation import EvaluationOptions, Metrics, evaluate_run, summarize
from .log import Log
from .result import RunResult
from .resultfiles import RUNS_FILE, to_json, write_atomically, write_result
from .timing import stage


def write_outputs(
    result: RunResult,
    log: Log,
    folder: Path | str,
    *,
    report: bool = True,
    figures: bool = False,
    other_runs: Sequence[Metrics] = (),
    options: EvaluationOptions | None = None,
) -> Metrics:
    """Writes result files, with `report` the page `report.html`, with `figures` PNG; returns the metrics.

    `other_runs` are the metrics of further runs over the same log (other seeds): then `runs.json` holds those
    of every run and their summary, and the report shows it. The numbers are written before the pictures, so
    that nothing is lost should drawing fail; what an older run left in the folder goes with them. Errors:
    `DataError` where the folder cannot be written.
    """
    target = Path(folder)
    with stage("evaluation"):
        evaluation = evaluate_run(result, log, options=options)
    with stage("files"):
        write_result(result, log, target, metrics=evaluation.metrics)
    runs = [evaluation.metrics, *other_runs] if other_runs else []
    if runs:
        summary = {name: asdict(value) for name, value in summarize(runs).items()}
        write_atomically(target / RUNS_FILE, to_json({"runs": runs, "summary": summary}))
    if report:
        with stage("page"):
            from .report import write_report

            write_report(result, log, target, evaluation=evaluation, runs=runs)
    if figures:
        # Matplotlib takes a second to load and is needed only here.
        with stage("figures"):
            from .plots import write_figures

            write_figures(result, log, target, evaluation=evaluation)
    return evaluation.metrics

"""`fastslam compare`: several results folders on one page."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from .console import make_table, stdout
from .encoding import print_json
from .evaluate import log_of
from .options import Format, Json, Robot, Run
from .output import in_one_line_of_runs, say_verdict


def compare_results(
    results: Annotated[list[Path], typer.Argument(help="Results folders.", metavar="RESULT...")],
    out: Annotated[Path, typer.Option("--out", help="The page.", metavar="FILE")] = Path("comparison.html"),
    truth: Annotated[
        Path | None, typer.Option(help="Log with the truth; that of the runs when left out.", metavar="PATH")
    ] = None,
    format: Format = None,
    robot: Robot = None,
    run: Run = None,
    json: Json = False,
) -> None:
    """Lay paths and maps of several results over each other, with their metrics and the settings that differ.

    Results of one log that differ only in the seed count as one, with 95 % confidence intervals.

    \b
    Examples:
      fastslam compare results/a results/b
      fastslam compare results/ekf results/seed* --out page.html
    """
    from ..comparison import (
        Scored,
        compared_metrics,
        differing_settings,
        group_results,
        short_names,
        shown_unit,
        write_comparison,
    )
    from ..evaluation import evaluate_run
    from ..evaluation.runs import summarize
    from ..resultfiles import read_result
    from ..verdict import in_one_line

    scored = []
    for folder, name in zip(results, short_names(results), strict=True):
        result, log = read_result(folder), log_of(folder, truth, format, robot, run)
        scored.append(Scored(name, result, log, evaluate_run(result, log)))
    groups = group_results(scored)
    page = write_comparison(groups, out)
    settings = differing_settings(groups)
    if json:
        numbers = [{name: asdict(one) for name, one in summarize(g.metrics).items()} for g in groups]
        found = {"results": [g.name for g in groups], "metrics": numbers, "settings": settings}
        print_json({**found, "page": str(page)})
        return
    metrics = compared_metrics(groups)
    columns = [f">{group.name}" for group in groups]
    rows = [(name, *values, shown_unit(name)) for name, values in metrics.items()]
    stdout().print(make_table("metrics", ("metric", *columns, "unit"), rows))
    for group in groups:
        unsound = sum(bool(member.result.verdict) for member in group.members)
        runs = len(group.members)
        said = in_one_line(group.first.result) if runs == 1 else in_one_line_of_runs(runs, unsound)
        say_verdict(f"{group.name}: {said}")
    if settings:
        rows = [(name, *values) for name, values in settings.items()]
        stdout().print(make_table("settings that differ", ("setting", *columns), rows))
    stdout().print(f"page: {page}", soft_wrap=True, highlight=False, markup=False)

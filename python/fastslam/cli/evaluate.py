"""`fastslam eval`: scores results folders again, against the truth of their log or another."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ..errors import DataError
from .console import make_table, progress_bar, stderr, stdout
from .encoding import print_json
from .options import Format, Json, Robot, Run
from .output import in_one_line_of_runs, metrics_table, read_log_reference, say_verdict, summary_table
from .simulate import SETTINGS_FILE
from .space import evaluate_in_space, in_space, refuse

if TYPE_CHECKING:
    from ..evaluation import Metrics
    from ..evaluation.monte_carlo import Consistency, NeesSummary
    from ..log import Log


def evaluate_results(
    results: Annotated[list[Path], typer.Argument(help="Results folders.", metavar="RESULT...")],
    truth: Annotated[
        Path | None, typer.Option(help="Log with the truth; that of the run when left out.", metavar="PATH")
    ] = None,
    format: Format = None,
    robot: Robot = None,
    run: Run = None,
    json: Json = False,
    runs: Annotated[
        int | None,
        typer.Option(min=2, metavar="N", help="Run again N times: can the uncertainty be believed?"),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option("--out", help="With --runs: folder for consistency.json and .png.", metavar="OUT"),
    ] = None,
) -> None:
    """Score one results folder, or several together with the 95 % confidence interval of each metric.

    \b
    Examples:
      fastslam eval results/latest
      fastslam eval results/latest --truth LOG
      fastslam eval results/seed*
      fastslam eval results/latest --runs 50

    With --runs the configuration of one results folder is run again with other seeds, and the errors are
    compared with the reported covariances: NEES against its bounds, coverage of the ellipses. Of a simulated
    log (with `simulation.yaml`) every run gets new noise and a new world; any other log stays the same.
    """
    from ..evaluation import evaluate
    from ..resultfiles import read_result
    from ..verdict import in_one_line

    if any(in_space(folder) for folder in results):
        refuse({"--runs": runs, "--robot": robot, "--run": run})
        evaluate_in_space(results, truth, format, json=json)
        return
    if runs is not None:
        if len(results) != 1:
            raise typer.BadParameter(f"--runs takes one results folder, got {len(results)}")
        log = log_of(results[0], truth, format, robot, run)
        _show_consistency(results[0], log, runs, json=json, out=out or results[0])
        return
    read = [read_result(folder) for folder in results]
    metrics = [
        evaluate(result, log_of(folder, truth, format, robot, run))
        for result, folder in zip(read, results, strict=True)
    ]
    if json:
        print_json(metrics[0] if len(metrics) == 1 else _several(results, metrics))
    elif len(metrics) == 1:
        stdout().print(metrics_table(str(results[0]), metrics[0]))
        say_verdict(in_one_line(read[0]))
    else:
        stdout().print(summary_table(f"{len(results)} results", metrics))
        say_verdict(in_one_line_of_runs(len(read), sum(bool(result.verdict) for result in read)))


def _several(folders: Sequence[Path], metrics: Sequence[Metrics]) -> dict[str, Any]:
    """Metrics of each folder, and their summary, as `runs.json` has it."""
    from ..evaluation import summarize

    results = [{"results": str(f), "metrics": m} for f, m in zip(folders, metrics, strict=True)]
    return {"runs": results, "summary": {name: asdict(value) for name, value in summarize(metrics).items()}}


def log_of(folder: Path, truth: Path | None, format: str | None, robot: int | None, run: int | None) -> Log:
    from ..datasets.registry import load

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
        topics=reference.topics,
    )


def _show_consistency(folder: Path, log: Log, runs: int, *, json: bool, out: Path) -> None:
    from ..monte_carlo import consistency_facts, monte_carlo, simulated_logs
    from ..resultfiles import read_result, to_json, write_atomically
    from ..simulation import SCHEMA

    config = read_result(folder).config
    settings = Path(log.source) / SETTINGS_FILE
    simulated = settings.is_file()
    log_of = simulated_logs(SCHEMA.load(settings)) if simulated else lambda _: log
    if not simulated:
        stderr().print(
            "note: every run is over the same log, so the runs are not independent", soft_wrap=True
        )
    first = int(config["seed"])
    with progress_bar(log.name, unit="runs") as advance:
        found = monte_carlo(
            log_of, config, seeds=range(first, first + runs), progress=lambda done: advance(done, runs)
        )
    # Matplotlib takes a second to load and is needed only here.
    from ..plots import consistency_figure, house_style, render

    write_atomically(out / "consistency.json", to_json(consistency_facts(found)))
    with house_style():
        figure = consistency_figure({log.name: found}, title=f"NEES over {runs} runs")
    write_atomically(out / "consistency.png", render(figure, "png"))
    if json:
        print_json(consistency_facts(found))
        return
    stdout().print(make_table(f"{log.name}: {runs} runs", ("quantity", ">value", "expected"), _rows(found)))
    stdout().print(f"results: {out / 'consistency.png'}", soft_wrap=True, highlight=False, markup=False)


def _rows(found: Consistency) -> list[tuple[str, str, str]]:
    rows = _nees_rows("pose", found.pose)
    quarters = ", ".join(f"{value:.1f}" for value in found.pose_median_of_quarter)
    rows.append(("pose: NEES, median of each quarter", quarters, ""))
    rows += _nees_rows("position", found.position)
    if found.landmarks is not None:
        rows += _nees_rows("landmarks", found.landmarks)
    rows.append(("stamps with a collapsed covariance", f"{found.floored:,}", "0"))
    return rows


def _nees_rows(name: str, nees: NeesSummary) -> list[tuple[str, str, str]]:
    from ..evaluation.monte_carlo import LEVELS

    low, high = nees.bounds
    found = nees.coverage.found.items()
    coverage = [
        (f"{name}: inside the {level} ellipse", f"{100 * value:.1f} %", f"{100 * stated:g} %")
        for (level, value), stated in zip(found, LEVELS, strict=True)
    ]
    return [(f"{name}: NEES, mean", f"{nees.mean:.2f}", f"{low:.2f} to {high:.2f}"), *coverage]

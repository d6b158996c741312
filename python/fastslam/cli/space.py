"""What `run` and `info` do with a log in space."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from .._entry import INTERRUPTED
from ..errors import ConfigError, DataError
from .console import make_table, progress_bar, stderr, stdout
from .encoding import print_json
from .errors import RUN_FAILED, refuse_unsound
from .output import (
    LogReference,
    in_one_line_of_runs,
    read_log_reference,
    say_verdict,
    write_log_reference,
)

if TYPE_CHECKING:
    from ..space import SpaceLog, SpaceResult
    from ..space.evaluation import Metrics


IN_SPACE = {"point3d": "point", "elevation": "range_bearing_elevation"}
"""Sensors that `simulate` knows in space."""


@dataclass(frozen=True)
class SpaceRequest:
    """What `run` was asked for."""

    path: Path
    format: str
    config: Path | None
    assignments: list[str]
    runs: int
    report: bool
    json: bool
    learn: bool
    strict: bool = False


def format_in_space(path: Path, format: str | None) -> str | None:
    """The format of a log in space, or None where the path is none, or another format is named."""
    from ..space.reading import READERS, matches

    if format is not None:
        return format if format in READERS else None
    return matches(path)


def refuse(options: Mapping[str, Any]) -> None:
    """Errors: `ConfigError` for the first option that was given, in one line."""
    for name, value in options.items():
        if value:
            raise ConfigError(f"{name}: not for a log in three dimensions (docs/space.md)")


def run_in_space(request: SpaceRequest, folder: Path) -> None:
    """Runs the filter with `runs` seeds, writes the files of the first run and shows all metrics."""
    from ..space import evaluate, load, run, write_outputs
    from ..space.config import SCHEMA
    from ..space.runner import configure
    from ..space.verdict import is_unsound

    log = load(request.path, format=request.format)
    layers = [SCHEMA.load(request.config)] if request.config is not None else []
    layers.append(SCHEMA.parse_assignments(request.assignments))
    config = configure(log, *layers)
    if request.learn:
        from ..space.learning import learn

        with progress_bar(f"{log.name}: noise", unit="rounds") as advance:
            config = configure(log, learn(log, SCHEMA.merge(*layers), progress=advance))
    results: list[SpaceResult] = []
    others: list[Metrics] = []
    unsound = 0
    for number in range(request.runs):
        with progress_bar(log.name) as advance:
            result = run(log, {**config, "seed": config["seed"] + number}, progress=advance)
        unsound += is_unsound(result)
        if not results:
            results.append(result)
        elif not result.interrupted:
            others.append(evaluate(result, log))
        if result.interrupted:
            break
    first = results[0]
    metrics = write_outputs(first, log, folder, report=request.report, other_runs=others)
    write_log_reference(folder, LogReference(request.path, log.format))
    _show(first, [metrics, *others], folder, unsound, json=request.json)
    if result.interrupted:
        stderr().print("interrupted: the results end where the run was stopped")
        raise typer.Exit(INTERRUPTED)
    if not first.landmarks.ids:
        raise typer.Exit(RUN_FAILED)
    if request.strict:
        refuse_unsound(unsound, request.runs)


def _show(result: SpaceResult, metrics: list[Metrics], folder: Path, unsound: int, *, json: bool) -> None:
    from ..space.evaluation import shown
    from ..space.verdict import in_one_line, is_believable

    if json:
        facts = {"log": result.log_name, "results": str(folder), "interrupted": result.interrupted}
        facts |= {"believable": is_believable(result)}
        facts |= {"warnings": result.warnings, "metrics": metrics[0]}
        print_json({**facts, "runs": metrics} if len(metrics) > 1 else facts)
        return
    console = stdout()
    if len(metrics) == 1:
        console.print(make_table(result.log_name, ("metric", ">value", "unit"), shown(metrics[0])))
    else:
        console.print(_summary(result.log_name, metrics))
    for warning in result.warnings:
        stderr().print(f"warning: {warning}", markup=False, highlight=False, soft_wrap=True)
    if len(metrics) == 1:
        say_verdict(in_one_line(result))
    else:
        say_verdict(in_one_line_of_runs(len(metrics), unsound))
    console.print(f"results: {folder}", soft_wrap=True, highlight=False, markup=False)


def _summary(title: str, runs: list[Metrics]) -> Any:
    import numpy as np

    from ..space.evaluation import shown

    names = [name for name in runs[0] if all(name in run for run in runs)]
    columns = []
    for of in (np.mean, np.min, np.max):
        columns.append(shown({name: float(of([run[name] for run in runs])) for name in names}))
    rows = [(mean[0], mean[1], low[1], high[1], mean[2]) for mean, low, high in zip(*columns, strict=True)]
    heads = ("metric", ">mean", ">least", ">largest", "unit")
    return make_table(f"{title}: {len(runs)} runs", heads, rows)


def simulate_in_space(
    out: Path,
    sensor: str,
    *,
    motion: str | None,
    landmarks: int | None,
    max_range_m: float | None,
    seed: int | None,
) -> None:
    """Writes a simulated log in space; what is None is as the simulation has it."""
    from ..space.native_write import write_native
    from ..space.simulation import simulate

    given = {"motion": motion, "landmarks": landmarks, "max_range_m": max_range_m, "seed": seed}
    chosen: dict[str, Any] = {name: value for name, value in given.items() if value is not None}
    log = simulate(sensor=sensor, name=out.resolve().name, **chosen)
    write_native(log, out)
    typer.echo(f"{out}: {len(log.sighting_stamp_s):,} sightings of {len(log.names):,} landmarks in space")


def info_in_space(path: Path, format: str, *, json: bool) -> None:
    """Shows what is in a log in space."""
    from ..space import load

    log = load(path, format=format)
    facts = _facts(log)
    if json:
        problems = [{"message": p.message, "count": p.count} for p in log.problems]
        print_json({**{name: value for name, value, _ in facts}, "problems": problems})
        return
    rows = [
        (name, f"{value:,.4g}" if isinstance(value, float) else f"{value}", unit)
        for name, value, unit in facts
    ]
    title = f"{log.name} (format {log.format}, three dimensions, sensor {log.sensor})"
    stdout().print(make_table(title, ("quantity", ">value", "unit"), rows))
    for problem in log.problems:
        stdout().print(f"problem: {problem.message} ({problem.count:,})", markup=False, highlight=False)
    if not log.problems:
        stdout().print("no problems found", markup=False, highlight=False)


def _facts(log: SpaceLog) -> list[tuple[str, float | int | str, str]]:
    import numpy as np

    stamps, counts = np.unique(log.sighting_stamp_s, return_counts=True)
    gaps = np.diff(stamps)
    truth = log.truth
    return [
        ("duration", log.duration_s, "s"),
        ("motion", log.motion, ""),
        ("velocities", len(log.row_stamp_s), ""),
        ("longest row", float(np.max(np.diff(log.row_stamp_s), initial=0.0)), "s"),
        ("sightings", len(log.sighting_stamp_s), ""),
        ("scans", len(stamps), ""),
        ("longest time without sightings", float(np.max(gaps, initial=0.0)), "s"),
        ("sightings per scan, at most", int(np.max(counts, initial=0)), ""),
        ("sightings without identity", int(np.sum(log.identity < 0)), ""),
        ("landmarks named", len(log.names), ""),
        ("true poses", 0 if truth is None else len(truth.stamp_s), ""),
        ("true landmarks", 0 if truth is None else len(truth.names), ""),
    ]


def in_space(folder: Path) -> bool:
    """Whether a results folder is that of a run in space."""
    from ..space.reading_back import is_result

    return is_result(folder)


def evaluate_in_space(folders: list[Path], truth: Path | None, format: str | None, *, json: bool) -> None:
    """Scores results in space again, against the truth of their logs or another."""
    from ..space import evaluate, load
    from ..space.evaluation import shown
    from ..space.reading_back import read_result

    runs: list[Metrics] = []
    for folder in folders:
        path = truth if truth is not None else read_log_reference(folder).path
        if not path.exists():
            raise DataError("the log of this run is no longer there: name one with --truth", path)
        runs.append(evaluate(read_result(folder), load(path, format=format)))
    if json:
        print_json(runs[0] if len(runs) == 1 else {"runs": runs})
    elif len(runs) == 1:
        stdout().print(make_table(str(folders[0]), ("metric", ">value", "unit"), shown(runs[0])))
    else:
        stdout().print(_summary(f"{len(runs)} results", runs))

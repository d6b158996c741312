"""`fastslam run`: from a log to a map, a path, numbers and pictures."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from .._entry import INTERRUPTED
from .._hints import kind_of_folder
from ..errors import ConfigError, DataError
from ..timing import stage
from .console import progress_bar, stderr, stdout
from .encoding import print_json
from .errors import RUN_FAILED, refuse_unsound
from .options import (
    ConfigFile,
    Figures,
    Format,
    Json,
    LogPath,
    Robot,
    Run,
    Seed,
    Settings,
    Strict,
    Topics,
    Verbose,
    topics_named,
)
from .output import (
    LogReference,
    in_one_line_of_runs,
    metrics_table,
    say_verdict,
    summary_table,
    write_log_reference,
)
from .space import SpaceRequest, format_in_space, refuse, run_in_space
from .times import times_shown
from .tune import learned_into, sounder_into
from .watch import DEFAULT_PORT, Watching, WatchPort, watched

if TYPE_CHECKING:
    from ..checkpoint import Checkpoints
    from ..config import Config
    from ..evaluation import Metrics
    from ..examination import Finding
    from ..log import Log
    from ..result import RunResult
    from ..watching import Watch

# Flags that stand for a configuration key; the schema checks their values as it checks those of --set.
_KEY_OF_FLAG = {
    "association": "association.mode",
    "algorithm": "algorithm",
    "particles": "filter.particles",
    "store": "filter.store",
    "threads": "filter.threads",
    "seed": "seed",
}

Out = Annotated[
    Path | None,
    typer.Option(help="Folder for the results; results/<stamp> and the link results/latest by default."),
]
Unexamined = Annotated[
    bool, typer.Option("--unexamined", help="Run without examining the log, also where it seems meaningless.")
]
CheckpointEvery = Annotated[
    float | None,
    typer.Option(metavar="S", help="Leave the state in the results folder every S seconds, for --resume."),
]
Resume = Annotated[
    bool, typer.Option("--resume", help="Go on from the state in --out, if there is one; else start anew.")
]
MapOut = Annotated[
    Path | None, typer.Option(metavar="FOLDER", help="Keep the map in this folder too, for `localize`.")
]
Auto = Annotated[
    bool | None,
    typer.Option(
        "--auto/--no-auto",
        help="Tune first: find noise, gains, mounting and delay, and run with them; by default where nothing "
        "states the noise of the robot or the sensor.",
        show_default=False,
    ),
]
BestOf = Annotated[
    int | None,
    typer.Option(
        min=1,
        metavar="N",
        help="Run with seeds S, S+1, ... and keep the likeliest; by default as many as it takes.",
    ),
]
NoReport = Annotated[bool, typer.Option("--no-report", help="Write the numbers only, no pictures.")]


def run_log(
    path: LogPath,
    format: Format = None,
    robot: Robot = None,
    run: Run = None,
    topic: Topics = None,
    config: ConfigFile = None,
    settings: Settings = None,
    association: Annotated[
        str | None, typer.Option(metavar="known|unknown", help="Trust identities?")
    ] = None,
    algorithm: Annotated[str | None, typer.Option(metavar="NAME", help="The filter: `algorithm`.")] = None,
    particles: Annotated[int | None, typer.Option(metavar="M", help="Number of particles.")] = None,
    store: Annotated[str | None, typer.Option(metavar="NAME", help="Kept maps: `filter.store`.")] = None,
    threads: Annotated[
        int | None, typer.Option(metavar="N", help="Threads; results do not depend on it.")
    ] = None,
    seed: Seed = None,
    runs: Annotated[int, typer.Option(min=1, metavar="N", help="Runs with seeds S, S+1, ...")] = 1,
    best_of: BestOf = None,
    out: Out = None,
    checkpoint_every: CheckpointEvery = None,
    resume: Resume = False,
    map_out: MapOut = None,
    no_report: NoReport = False,
    figures: Figures = False,
    json: Json = False,
    verbose: Verbose = False,
    unexamined: Unexamined = False,
    auto: Auto = None,
    strict: Strict = False,
    watch: Watching = False,
    watch_port: WatchPort = DEFAULT_PORT,
) -> None:
    """Run the filter over a log and write map, path, numbers and a report with pictures.

    Settings come from: defaults < the log's own < --config < --set and the flags below.

    Ctrl-C or SIGTERM stops the run: what was computed until then is written, and the exit code is 130.
    A run that comes to its end has exit code 0, also where its verdict (printed, and in --json) says that it
    is not to be believed; with --strict the code is 1 then. A run that mapped nothing has 1 always.
    Where neither the log nor the settings state the noise of the robot or the sensor it tunes first, as
    `fastslam tune` does, and leaves what was learned in `learned.json`; where they do it tunes afterwards if
    the map is doubted, and keeps what makes a sound one. --auto tunes always, --no-auto never; by itself it
    does not with --checkpoint-every, --resume, --runs or --watch. Stopped meanwhile, it leaves the best run.
    With --checkpoint-every the same command and --resume goes on from there, to the same bits.
    --watch serves a page on this machine that draws the run and can hold it.

    \b
    Examples:
      fastslam run LOG
      fastslam run MRCLAM_Dataset1 --robot 2 --particles 200
      fastslam run LOG --association unknown --set sensor.range_std_m=0.2
      fastslam run LOG --runs 10 --seed 1 --out results/ten-seeds
      fastslam run LOG --association unknown --best-of 4
      fastslam run LOG --out results/night --checkpoint-every 60 --resume
      fastslam run LOG --map-out yard.map
      fastslam run LOG --strict && cp results/latest/landmarks.csv trees.csv
      fastslam run drive.mcap --config car.yaml --topic odometry=/wheels --topic detections=/cones
    """
    from ..config import load_config, merge, parse_assignments
    from ..datasets.registry import load
    from ..detection import with_detector
    from ..runner import configure, detected

    in_space = format_in_space(path, format)
    if in_space is not None:
        planar: dict[str, object] = {"--robot": robot, "--run": run, "--topic": topic, "--store": store}
        planar |= {"--association": association, "--algorithm": algorithm, "--best-of": best_of}
        planar |= {"--checkpoint-every": checkpoint_every, "--resume": resume, "--map-out": map_out}
        refuse({**planar, "--watch": watch})
        own = {"filter.particles": particles, "filter.threads": threads, "seed": seed}
        assigned = [*(settings or []), *(f"{key}={value}" for key, value in own.items() if value is not None)]
        request = SpaceRequest(
            path, in_space, config, assigned, runs, not no_report, json, bool(auto), strict
        )
        with results_folder(out) as folder:
            run_in_space(request, folder)
        return
    flags = {"association": association, "algorithm": algorithm, "particles": particles}
    flags |= {"store": store, "threads": threads, "seed": seed}
    given = [f"{_KEY_OF_FLAG[name]}={value}" for name, value in flags.items() if value is not None]
    layers = [
        load_config(config) if config is not None else {},
        parse_assignments([*(settings or []), *given]),
    ]
    topics = topics_named(topic)
    if (best_of or 1) > 1 and (runs > 1 or resume or checkpoint_every is not None):
        raise ConfigError("--best-of: goes with neither --runs nor --checkpoint-every and --resume")
    if resume and out is None:
        raise ConfigError("--resume: say with --out in which folder the run left its state")
    with times_shown(verbose), ExitStack() as at_end:
        with stage("load"):
            log = with_detector(load(path, format=format, robot=robot, run=run, topics=topics), *layers)
        configuration = configure(log, *layers)
        for problem in log.problems:
            stderr().print(f"note: {problem.message} ({problem.count:,})", markup=False, soft_wrap=True)
        with stage("examine"):
            findings = () if unexamined else _examined(log, configuration)
        reference = LogReference(path, log.format, robot, run, topics)
        folder = at_end.enter_context(results_folder(out))
        log = detected(log)
        port = watch_port if watch else None
        watcher = at_end.enter_context(watched(log.name, configuration, port=port, kind="run"))
        # A run that leaves its state begins at once, so that it can be stopped at any time.
        wanted = False if auto is None and (resume or checkpoint_every is not None) else auto
        learning = learned_into(folder, log, merge(*layers), wanted=wanted, quiet=json, watcher=watcher)
        warnings = () if learning is None else learning.warnings
        against = () if learning is None else learning.verdict
        results = Results(folder, reference, not no_report, figures, findings, warnings, against)
        results = replace(results, learned=learning is not None and learning.found is not None)
        if learning is not None and learning.found is not None and learning.found.interrupted:
            show(kept_run(learning.found.result, log, results), json=json)
        configuration = configure(log, *layers, {} if learning is None else learning.settings)
        if watcher is not None:
            watcher.configure(configuration)
        checkpoints = _checkpoints(folder, checkpoint_every, resume=resume)
        by_need = best_of is None and runs == 1 and checkpoints is None
        if by_need or (best_of or 1) > 1:
            doubting = by_need and auto is None and learning is None and watcher is None
            finished = run_tries(log, configuration, results, tries=best_of, watch=watcher, doubting=doubting)
        else:
            finished = run_all(log, configuration, results, runs=runs, checkpoints=checkpoints, watch=watcher)
        if map_out is not None:
            finished.result.map.save(map_out)
        show(finished, json=json, strict=strict)


def _checkpoints(folder: Path, every_s: float | None, *, resume: bool) -> Checkpoints | None:
    """Where the state is left on the way; with `resume` alone it is left where the run is stopped."""
    from ..checkpoint import CHECKPOINT_FILE, Checkpoints

    if every_s is None and not resume:
        return None
    return Checkpoints(folder / CHECKPOINT_FILE, every_s if every_s is not None else 60.0, resume)


def _examined(log: Log, configuration: Config) -> tuple[Finding, ...]:
    """What is wrong with the log, said before the run. Errors: DataError where a run would mean nothing."""
    from ..examination import examine

    findings = examine(log, configuration)
    for finding in findings:
        if finding.severity == "error":
            raise DataError(f"{finding.line}; --unexamined runs all the same", log.source)
        if finding.severity == "problem":
            stderr().print(f"problem: {finding.line}", markup=False, highlight=False, soft_wrap=True)
    return findings


def prepare_folder(out: Path | None) -> Path:
    """Makes the folder before the run, so that a long run is not lost to a path that cannot be written."""
    from ..resultfiles import RUN_FILE, new_result_folder

    if out is None:
        return new_result_folder("results")
    if out.is_file():
        raise DataError("is a file; results need a folder", out)
    kind = kind_of_folder(out)
    if kind is not None and not (out / RUN_FILE).exists():
        raise DataError(f"is {kind}: name another folder for the results", out)
    try:
        out.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=out):
            pass
    except OSError as error:
        raise DataError(f"cannot make a results folder: {error.strerror or error}", out) from None
    return out


@contextmanager
def results_folder(out: Path | None) -> Iterator[Path]:
    """The folder that `prepare_folder` makes; it goes again if nothing is left in it, as by a stopped run."""
    is_new = out is None or not out.exists()
    folder = prepare_folder(out)
    try:
        yield folder
    finally:
        if is_new:
            with suppress(OSError):
                folder.rmdir()


@dataclass(frozen=True)
class Results:
    """Where a run leaves its files, of which log, whether with pictures, and what was said before the run."""

    folder: Path
    reference: LogReference
    report: bool = True
    figures: bool = False
    findings: tuple[Finding, ...] = ()
    warnings: tuple[str, ...] = ()
    against: tuple[str, ...] = ()
    """What speaks against the run beside its own verdict."""
    learned: bool = False
    """Whether the log was asked for its noise."""

    @property
    def pictures(self) -> bool:
        """Whether more than numbers is written."""
        return self.report or self.figures

    def write(
        self, result: RunResult, log: Log, *, pictures: bool, others: Sequence[Metrics] = ()
    ) -> Metrics:
        """Writes the files, in the place of those of an older run."""
        from ..outputs import write_outputs

        page, figures = pictures and self.report, pictures and self.figures
        metrics = write_outputs(result, log, self.folder, report=page, figures=figures, other_runs=others)
        write_log_reference(self.folder, self.reference)
        return metrics


@dataclass(frozen=True)
class Finished:
    """What one command computed: the first run, the metrics of every run, and where the files lie."""

    result: RunResult
    metrics: list[Metrics]
    folder: Path
    report: bool
    interrupted: bool
    unsound: int
    """How many of the runs have a verdict that speaks against them."""

    @property
    def warnings(self) -> list[str]:
        """What speaks against the first run, a sentence each."""
        from ..verdict import warnings_of

        return list(warnings_of(self.result))

    @property
    def verdict_line(self) -> str:
        """Whether the run, or each of several, is to be believed."""
        from ..verdict import in_one_line

        runs = len(self.metrics)
        return in_one_line(self.result) if runs == 1 else in_one_line_of_runs(runs, self.unsound)

    @property
    def mapped_nothing(self) -> bool:
        """Whether the first run made no map at all."""
        from ..verdict import is_empty

        return is_empty(self.result)


def run_all(
    log: Log,
    config: Config,
    results: Results,
    *,
    runs: int = 1,
    checkpoints: Checkpoints | None = None,
    watch: Watch | None = None,
) -> Finished:
    """Runs with `runs` seeds, at least one, from the configured one on, and writes all files."""
    from ..evaluation import evaluate
    from ..runner import run_many

    seeds = range(config["seed"], config["seed"] + runs)
    others: list[Metrics] = []
    with progress_bar(log.name) as advance:
        computed = run_many(log, config, seeds=seeds, progress=advance, checkpoints=checkpoints, watch=watch)
        first = _with_findings(next(computed), results)
        interrupted, unsound = first.interrupted, int(bool(first.verdict))
        # Kept safe at once when further runs, which may fail, are to come.
        metrics = results.write(first, log, pictures=False)
        for result in computed:
            interrupted = result.interrupted
            if not interrupted:
                others.append(evaluate(result, log))
                unsound += bool(result.verdict)
    if results.pictures or others:
        metrics = results.write(first, log, pictures=True, others=others)
    return Finished(first, [metrics, *others], results.folder, results.report, interrupted, unsound)


def run_tries(
    log: Log,
    config: Config,
    results: Results,
    *,
    tries: int | None,
    watch: Watch | None = None,
    doubting: bool = False,
) -> Finished:
    """Runs with so many seeds from the configured one on, or as many as it takes, and writes what is kept.

    With `doubting` a run whose map is doubted gives way to a sounder one that the log teaches.
    """
    from ..opinion import best_of, run_by_need

    with progress_bar(log.name) as advance:
        if tries is None:
            kept = run_by_need(log, config, progress=advance, watch=watch)
            if doubting:
                kept = sounder_into(results.folder, kept, log, config, progress=advance)
        else:
            seeds = range(config["seed"], config["seed"] + tries)
            kept = best_of(log, config, seeds=seeds, progress=advance, watch=watch)
    if len(kept.tries) > 2 or tries is not None:
        _list_tries(kept)
    return kept_run(kept, log, results)


def kept_run(result: RunResult, log: Log, results: Results) -> Finished:
    """Writes all files of a run that was made."""
    kept = _with_findings(result, results)
    metrics = results.write(kept, log, pictures=True)
    unsound = int(bool(kept.verdict))
    return Finished(kept, [metrics], results.folder, results.report, kept.interrupted, unsound)


def _with_findings(result: RunResult, results: Results) -> RunResult:
    """The result with what was found in its log, before which no advice on noise is given."""
    from ..noise import after_findings, after_learning

    told = tuple(finding.to_dict() for finding in results.findings)
    advice = after_learning(result.warnings) if results.learned else result.warnings
    warnings = after_findings(advice, told)
    said = replace(result, findings=told, verdict=(*results.against, *result.verdict))
    return replace(said, warnings=(*results.warnings, *warnings))


def _list_tries(result: RunResult) -> None:
    for one in result.tries:
        kept = ", kept" if one.seed == result.config["seed"] else ""
        line = f"seed {one.seed}: evidence {one.log_evidence:,.1f} nats, {one.landmarks:,} landmarks{kept}"
        stderr().print(line, markup=False, highlight=False, soft_wrap=True)


def show(finished: Finished, *, json: bool = False, strict: bool = False) -> None:
    """Prints tables, warnings and where the files lie, or one JSON object, and ends with the exit code."""
    if json:
        print_json(_facts(finished))
    else:
        from ..cards import calibration_text

        name, console = finished.result.log_name, stdout()
        several = len(finished.metrics) > 1
        console.print(
            summary_table(name, finished.metrics) if several else metrics_table(name, finished.metrics[0])
        )
        if finished.result.calibration:
            learned = calibration_text(finished.result.calibration)
            console.print(f"learned: {learned}", soft_wrap=True, highlight=False, markup=False)
        for warning in finished.warnings:
            stderr().print(f"warning: {warning}", markup=False, highlight=False, soft_wrap=True)
        say_verdict(finished.verdict_line)
        console.print(f"results: {finished.folder}", soft_wrap=True, highlight=False, markup=False)
        if finished.report:
            page = finished.folder / "report.html"
            console.print(f"report:  {page}", soft_wrap=True, highlight=False, markup=False)
    if finished.interrupted:
        stderr().print("interrupted: the results end where the run was stopped")
        raise typer.Exit(INTERRUPTED)
    if finished.mapped_nothing:
        raise typer.Exit(RUN_FAILED)
    if strict:
        refuse_unsound(finished.unsound, len(finished.metrics))


def _facts(finished: Finished) -> dict[str, Any]:
    from ..verdict import is_believable

    facts = {
        "log": finished.result.log_name,
        "results": str(finished.folder),
        "report": str(finished.folder / "report.html") if finished.report else None,
        "interrupted": finished.interrupted,
        "calibration": finished.result.calibration,
        "believable": is_believable(finished.result),
        "verdict": finished.result.verdict,
        "warnings": finished.warnings,
        "findings": finished.result.findings,
        "metrics": finished.metrics[0],
    }
    return {**facts, "runs": finished.metrics} if len(finished.metrics) > 1 else facts

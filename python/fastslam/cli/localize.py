"""`fastslam localize`: where a robot is in a map that was kept."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ..errors import ConfigError
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
    StartPose,
    StartStd,
    Strict,
    Topics,
    start_given,
    topics_named,
)
from .output import LogReference, metrics_table, say_verdict

if TYPE_CHECKING:
    from ..localisation import Localisation, Mode


def localize_log(
    path: LogPath,
    map: Annotated[
        Path, typer.Option("--map", metavar="MAP", help="The map: a folder, or a table of landmarks.")
    ],
    start: StartPose = None,
    start_std: StartStd = None,
    extend: Annotated[
        bool,
        typer.Option(
            "--extend/--keep", help="Let prior landmarks improve and add new ones, or keep the map."
        ),
    ] = False,
    format: Format = None,
    robot: Robot = None,
    run: Run = None,
    topic: Topics = None,
    config: ConfigFile = None,
    settings: Settings = None,
    association: Annotated[
        str | None, typer.Option(metavar="known|unknown", help="Trust identities?")
    ] = None,
    seed: Seed = None,
    out: Annotated[
        Path | None, typer.Option(help="Folder for the results; results/<stamp> by default.")
    ] = None,
    map_out: Annotated[
        Path | None, typer.Option(metavar="FOLDER", help="Where --extend leaves the map.")
    ] = None,
    no_report: Annotated[bool, typer.Option("--no-report", help="Write the numbers only.")] = False,
    figures: Figures = False,
    strict: Strict = False,
    json: Json = False,
) -> None:
    """Follow a robot through a map: from a known start, or from anywhere in it.

    With --keep, the default, the map is never changed; what is new and what is gone is listed. Without
    --start the robot starts at the initial_pose of the configuration or the log; where neither states one,
    and with --start anywhere, it is searched for. So is one that is lost on the way, from there on: health is
    `searching` until it is found. Where several places remain likely they are listed, no map is left, and the
    exit code is 1; with --strict also where the verdict says that the run is not to be believed.

    \b
    Examples:
      fastslam localize LOG --map yard.map
      fastslam localize LOG --map yard.map --start 3,2,0.5 --start-std 0.5,0.5,0.1
      fastslam localize LOG --map yard.map --start anywhere
      fastslam localize LOG --map yard.map --extend --map-out yard-2.map
    """
    from ..config import load_config, merge, parse_assignments
    from ..datasets.registry import load
    from ..localisation import localize
    from ..maps import Map

    flags = {"association.mode": association, "seed": seed}
    given = [f"{key}={value}" for key, value in flags.items() if value is not None]
    layers = [
        load_config(config) if config is not None else {},
        parse_assignments([*(settings or []), *given]),
    ]
    if map_out is not None and not extend:
        raise ConfigError("--map-out: only --extend changes a map")
    begin = start_given(start, start_std)
    topics = topics_named(topic)
    log, chart = load(path, format=format, robot=robot, run=run, topics=topics), Map.load(map)
    with progress_bar(log.name) as advance:
        found = localize(log, chart, start=begin, config=merge(*layers), keep=not extend, progress=advance)
    reference = LogReference(path, log.format, robot, run, topics)
    written = _written(found, log, reference, out, report=not no_report, figures=figures)
    if map_out is not None and found.result is not None and found.status == "found":
        found.result.map.save(map_out)
    if json:
        print_json(_facts(found, written))
    else:
        _show(found, written)
    if found.status == "searching":
        raise typer.Exit(RUN_FAILED)
    if strict and found.result is not None:
        refuse_unsound(int(bool(found.result.verdict)))


def _written(
    found: Localisation, log: Any, reference: LogReference, out: Path | None, *, report: bool, figures: bool
) -> tuple[Path, Any] | None:
    """The folder of the results and their metrics; None where there are none."""
    from ..outputs import write_outputs
    from .output import write_log_reference
    from .run import prepare_folder

    if found.result is None:
        return None
    folder = prepare_folder(out)
    metrics = write_outputs(found.result, log, folder, report=report, figures=figures)
    write_log_reference(folder, reference)
    return folder, metrics


def _begin(found: Localisation) -> str:
    """Which start was used, and what came of it."""
    if found.start == "given":
        return "start: as --start says"
    if found.start == "stated":
        return "start: the initial_pose of the settings; --start anywhere searches the map"
    hint = "; --start X,Y,HEADING says where it is" if found.result is None else ""
    return f"start: anywhere; {found.sentence}{hint}"


def _show(found: Localisation, written: tuple[Path, Any] | None) -> None:
    from ..resultfiles import REPORT_FILE
    from ..verdict import in_one_line, warnings_of

    console = stdout()
    console.print(_begin(found), highlight=False, markup=False, soft_wrap=True)
    if found.status == "searching" and found.again and found.modes:
        lost = f"lost at stamp {found.again[-1].lost_s:.2f} s; where it may have been then:"
        console.print(lost, highlight=False, markup=False)
    for mode in found.modes:
        x, y, heading = mode.T_map_robot
        line = f"  x {x:.2f} m, y {y:.2f} m, heading {heading:.3f} rad: probability {mode.probability:.4f}"
        console.print(line, highlight=False, markup=False)
    if found.result is None or written is None:
        return
    console.print(metrics_table(found.result.log_name, written[1]))
    if found.result.changes is not None:
        for line in found.result.changes.lines():
            console.print(line, highlight=False, markup=False, soft_wrap=True)
    for warning in warnings_of(found.result):
        stderr().print(f"warning: {warning}", markup=False, highlight=False, soft_wrap=True)
    say_verdict(in_one_line(found.result))
    console.print(f"results: {written[0]}", soft_wrap=True, highlight=False, markup=False)
    page = written[0] / REPORT_FILE
    if page.exists():
        console.print(f"report:  {page}", soft_wrap=True, highlight=False, markup=False)


def _facts(found: Localisation, written: tuple[Path, Any] | None) -> dict[str, Any]:
    from ..verdict import is_believable, warnings_of

    result = found.result
    changes = None if result is None else result.changes
    return {
        "status": found.status,
        "start": found.start,
        "searched_s": found.searched_s,
        "modes": _modes(found.modes),
        "again": [
            {
                "lost_s": one.lost_s,
                "status": one.status,
                "searched_s": one.searched_s,
                "modes": _modes(one.modes),
            }
            for one in found.again
        ],
        "changes": None
        if changes is None
        else {"new": changes.new, "gone": changes.gone, "renamed": changes.renamed},
        "believable": None if result is None else is_believable(result),
        "verdict": None if result is None else result.verdict,
        "warnings": None if result is None else warnings_of(result),
        "results": None if written is None else str(written[0]),
        "metrics": None if written is None else written[1],
    }


def _modes(modes: Sequence[Mode]) -> list[dict[str, Any]]:
    return [{"T_map_robot": mode.T_map_robot.tolist(), "probability": mode.probability} for mode in modes]

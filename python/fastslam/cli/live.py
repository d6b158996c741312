"""`fastslam live`: events as lines of JSON in, estimates as lines of JSON out."""

from __future__ import annotations

import re
import socket
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TextIO

import typer

from .._entry import INTERRUPTED
from ..errors import ConfigError, DataError
from .console import stderr
from .options import ConfigFile, Settings, StartPose, StartStd, start_given
from .output import LogReference, write_log_reference
from .run import MapOut, NoReport, prepare_folder
from .watch import DEFAULT_PORT, Watching, WatchPort, watched

if TYPE_CHECKING:
    from ..live import Estimate, Session
    from ..robot import Robot
    from ..watching import Watcher


class Known(str, Enum):
    """Whether sightings say which landmark they are of."""

    all = "all"
    some = "some"
    none = "none"


class WhenLate(str, Enum):
    """What a step does where a draw of paths is late."""

    await_ = "await"
    put_off = "put_off"


LateDraws = Annotated[
    WhenLate, typer.Option(help="What steps do where a draw of paths is late: wait for it, or go on.")
]
InMap = Annotated[
    Path | None, typer.Option("--map", metavar="MAP", help="A map that was kept: a folder, or a table.")
]
Names = Annotated[Known, typer.Option(help="Which sightings name their landmark.")]
Classes = Annotated[str, typer.Option(metavar="A,B,..", help="Names of the classes, in order.")]
Out = Annotated[Path | None, typer.Option(help="Folder for the results, as `run` writes them.")]
Laser = Annotated[
    Path | None, typer.Option("--scanner", metavar="FILE", help="YAML of the laser whose turns are told.")
]
State = Annotated[
    Path | None, typer.Option("--checkpoint", help="Go on from this file, if there is one; keep the state.")
]


def live_stream(
    config: ConfigFile = None,
    settings: Settings = None,
    source: Annotated[str, typer.Option("--in", metavar="stdin|tcp:PORT", help="Where events come from.")] = (
        "stdin"
    ),
    late_s: Annotated[float, typer.Option(metavar="S", help="How late events may come.")] = 0.2,
    rate_hz: Annotated[float, typer.Option(metavar="HZ", help="Estimates per second of the stamps.")] = 20.0,
    identities: Names = Known.some,
    classes: Classes = "",
    map: InMap = None,
    start: StartPose = None,
    start_std: StartStd = None,
    extend: Annotated[
        bool,
        typer.Option(
            "--extend/--keep", help="Let prior landmarks of --map improve and add new ones, or keep it."
        ),
    ] = True,
    scanner: Laser = None,
    checkpoint: State = None,
    out: Out = None,
    map_out: MapOut = None,
    no_report: NoReport = False,
    late_draws: LateDraws = WhenLate.await_,
    watch: Watching = False,
    watch_port: WatchPort = DEFAULT_PORT,
) -> None:
    """Read odometry, sightings and laser scans as lines of JSON, write estimates as lines of JSON.

    {"t": 12.30, "odom": [5.9, 0.11]} is a row of odometry in the columns of the motion model,
    {"t": 12.21, "see": [[7.2, 0.31, "blue"], [9.0, -0.2]]} what was seen at 12.21: range, bearing, and
    class where association.classes is configured, else name; of several sensors "sensor" names the one that
    saw it, and null stands for what that does not measure. With --scanner,
    {"t": 12.25, "scan": [3.2, null, ..]} is a turn of the laser, a range per beam, in which landmarks are
    detected. Lines that are none of these are counted and reported, and so are sightings of a class that
    is none of --classes; null or a word such as "unknown" says that nobody knows it. What speaks against the
    noise that is set, or is skipped all the time, is said on stderr, once.

    tcp:PORT listens on this machine only, and ends when the sender closes. The end of the input, Ctrl-C and
    SIGTERM keep the state in --checkpoint, from which the same command goes on.

    With --map the robot drives in a map that was kept, whose landmarks are what their roles say; with --keep
    nothing changes it. With --start anywhere, and where nothing says where the robot begins, it is searched
    for there: until one place is sure, health is `searching`, there is no pose, and `modes` are the places
    that are likely.

    --map-out keeps the map when the stream ends or is stopped: after a lap, some 30 m behind the line.

    --out leaves the files of a run over all that came, and that as a log, when the stream ends or is stopped.

    --late-draws put_off lets no estimate wait for a draw of paths: where the machine is late, the next ones
    take it over, and results depend on the machine. What was waited for, or put off, is said at the end.

    --watch serves a page on this machine that draws what is known; it can hold its picture, not the robot.

    \b
    Examples:
      fastslam live --config car.yaml < events.jsonl
      fastslam live --config car.yaml --in tcp:9000 --checkpoint state.fslam
      fastslam live --config car.yaml --scanner laser.yaml --identities none < events.jsonl
      fastslam live --config car.yaml --map lap-1.map --start 3,2,0.5 --start-std 0.5,0.5,0.1
      fastslam live --config cart.yaml --map reflectors.csv --keep --start anywhere < events.jsonl
    """
    from ..config import load_config, merge, parse_assignments
    from ..live import session_of
    from ..robot import Robot, Window
    from ..scanner import Scanner

    layers = [load_config(config) if config is not None else {}, parse_assignments(settings or [])]
    begin = start_given(start, start_std)
    if map_out is not None and not extend:
        raise ConfigError("--map-out: only --extend changes a map")
    if map is None and not extend:
        raise ConfigError("--keep: say with --map which map to keep")
    folder = None if out is None else prepare_folder(out)
    if checkpoint is not None and checkpoint.exists():
        robot = Robot.load(checkpoint)
    else:
        robot = Robot(
            merge(*layers),
            identities=identities.value,
            window=Window(late_s=late_s),
            classes=tuple(name.strip() for name in classes.split(",") if name.strip()),
            map=map,
            start=begin,
            keep=not extend,
            scanner=None if scanner is None else Scanner.load(scanner),
            late_draws=late_draws.value,
        )
        if map is not None and start is None and "initial_pose" not in merge(*layers):
            said = "start: anywhere, since nothing says where; --start 0,0,0 is the origin of the map"
            if scanner is not None:
                said = "start: the origin of the map, since nothing says another (--start X,Y,HEADING)"
            stderr().print(said, markup=False, highlight=False, soft_wrap=True)
    session = session_of(robot, rate_hz=rate_hz)
    if folder is not None:
        robot.keep_result()
    interrupted = False
    with watched("live", robot.config, port=watch_port if watch else None, kind="live") as watcher:
        try:
            with _opened(source) as lines:
                _pump(session, lines, watcher)
        except KeyboardInterrupt:
            interrupted = True
        last = _finish(session, checkpoint)
        if watcher is not None and robot.last_step is not None:
            watcher.show(robot.view(robot.last_step))
    if map_out is not None:
        _write_map(session, map_out)
    if folder is not None:
        _write_results(session, folder, report=not no_report)
    elif last is not None:
        _say_verdict(last)
    if interrupted:
        stderr().print("interrupted: the state was kept" if checkpoint else "interrupted")
        raise typer.Exit(INTERRUPTED)


def _pump(session: Session, lines: Iterator[str], watcher: Watcher | None) -> None:
    shown, kinds = 0, set[str]()
    for line in lines:
        try:
            estimate = session.take(line)
        except DataError as error:
            if session.faults.count <= 10:
                stderr().print(f"passed over: {error}", markup=False, highlight=False, soft_wrap=True)
            continue
        for why in session.left_out.shown[shown:]:
            stderr().print(f"left out: {why}", markup=False, highlight=False, soft_wrap=True)
        shown = len(session.left_out.shown)
        _warn(session, kinds)
        if estimate is not None:
            _write(estimate.to_line())
        if watcher is not None and session.robot.last_step is not None and watcher.is_due():
            watcher.show(session.robot.view(session.robot.last_step))


def _warn(session: Session, kinds: set[str]) -> None:
    """Says what the newest step warns of; what differs in its numbers alone is said once."""
    if session.step is None:
        return
    for warning in session.step.info.warnings:
        kind = re.split(r"[0-9]", warning, maxsplit=1)[0]
        if kind not in kinds:
            kinds.add(kind)
            at = f"warning: at {session.step.stamp_s:.1f} s: {warning}"
            stderr().print(at, markup=False, highlight=False, soft_wrap=True)


def _finish(session: Session, checkpoint: Path | None) -> Estimate | None:
    """Keeps the state, then the last estimate, which is returned; what was refused is said."""
    if checkpoint is not None:
        session.robot.save(checkpoint)
    last = session.end()
    if last is not None:
        _write(last.to_line())
        why = f" ({', '.join(name.replace('_', ' ') for name in last.why)})" if last.why else ""
        stderr().print(f"health at the end: {last.health}{why}", markup=False, highlight=False)
    _say_lateness(session.robot)
    refused = {key: count for key, count in session.robot.counts.items() if count and key != "waiting"}
    if session.faults.count:
        refused["lines that are no events"] = session.faults.count
    if session.left_out.count:
        refused["sightings of a class that is not configured"] = session.left_out.count
    if refused:
        what = ", ".join(f"{count:,} {key}" for key, count in refused.items())
        stderr().print(f"passed over in all: {what}", markup=False, highlight=False, soft_wrap=True)
    return last


def _say_verdict(last: Estimate) -> None:
    """What speaks against a drive of which no log was kept."""
    for sentence in last.verdict:
        stderr().print(f"warning: {sentence}", markup=False, highlight=False, soft_wrap=True)
    found = "not believable" if last.verdict else "nothing speaks against the drive"
    line = f"verdict: {found}, of what can be told without a log (--out)"
    stderr().print(line, markup=False, highlight=False, soft_wrap=True)


def _say_lateness(robot: Robot) -> None:
    """How often a draw of paths was late on this machine."""
    for count, what in ((robot.waits, "have waited for a draw"), (robot.put_off, "have gone on without one")):
        if count:
            said = f"draws of paths were late: {count:,} steps {what}"
            stderr().print(said, markup=False, highlight=False, soft_wrap=True)


def _write_map(session: Session, folder: Path) -> None:
    if session.robot.searching:
        raise DataError("the robot was not found in its map: there is none to keep", folder)
    written = session.robot.map.save(folder)
    stderr().print(f"map: {written}", markup=False, highlight=False, soft_wrap=True)


def _write_results(session: Session, folder: Path, *, report: bool) -> None:
    """The files of a run over what came, with what came as a log of its own."""
    from ..datasets.native_write import write_native
    from ..outputs import write_outputs
    from ..verdict import in_one_line, warnings_of

    if session.robot.searching or session.step is None:
        why = "the robot was not found in its map" if session.robot.searching else "nothing came"
        raise DataError(f"{why}: there are no results", folder)
    result, log = session.robot.result(name=folder.name)
    write_outputs(result, log, folder, report=report)
    reference = LogReference(write_native(log, folder / "log"), "native")
    write_log_reference(folder, reference)
    for warning in warnings_of(result):
        stderr().print(f"warning: {warning}", markup=False, highlight=False, soft_wrap=True)
    stderr().print(f"verdict: {in_one_line(result)}", markup=False, highlight=False, soft_wrap=True)
    stderr().print(f"results: {folder}", markup=False, highlight=False, soft_wrap=True)


def _write(line: str) -> None:
    sys.stdout.write(line + "\n")
    sys.stdout.flush()


@contextmanager
def _opened(source: str) -> Iterator[Iterator[str]]:
    """The lines of a source; bytes that are no UTF-8 make a line that is no event."""
    if source == "stdin":
        with open(0, encoding="utf-8", errors="replace", closefd=False) as stream:
            yield _lines(stream)
        return
    kind, _, port = source.partition(":")
    if kind != "tcp" or not port.isdecimal() or not 0 <= int(port) < 65536:
        raise ConfigError(f"--in: got {source}, expected stdin or tcp:PORT")
    with socket.create_server(("127.0.0.1", int(port))) as server:
        stderr().print(f"listening on 127.0.0.1:{server.getsockname()[1]}", highlight=False)
        connection, _ = server.accept()
        with connection, connection.makefile("r", encoding="utf-8", errors="replace") as stream:
            yield _lines(stream)


def _lines(stream: TextIO) -> Iterator[str]:
    """Line by line, each bounded: the rest of a longer one is a line of its own."""
    from ..live import LONGEST_LINE

    while line := stream.readline(LONGEST_LINE + 2):
        yield line

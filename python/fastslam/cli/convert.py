"""`fastslam convert`: writes a log in another format."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from .options import Format, LogPath, Robot, Run, Topics, topics_named


def convert_log(
    path: LogPath,
    out: Annotated[
        Path, typer.Argument(help="What to write: a new folder, .g2o, .tum or .jsonl.", metavar="OUT")
    ],
    to: Annotated[
        str | None, typer.Option(metavar="NAME", help="Format to write: native, g2o, tum, jsonl.")
    ] = None,
    format: Format = None,
    robot: Robot = None,
    run: Run = None,
    topic: Topics = None,
) -> None:
    """Write a log in another format: native (a folder of tables), g2o (graph), tum (path), jsonl (events).

    A g2o file holds odometry and sightings with their noise, not the truth. A tum file holds the true path,
    or that of odometry where there is no truth. A jsonl file holds the events that `fastslam live` reads.

    \b
    Examples:
      fastslam convert LOG my-log
      fastslam convert LOG graph.g2o
      fastslam convert LOG path.tum
      fastslam convert LOG events.jsonl && fastslam live < events.jsonl
      fastslam convert drive.mcap my-log --topic odometry=/wheels
    """
    from ..conversion import convert, format_of
    from ..datasets.registry import load
    from ..events import left_out

    log = load(path, format=format, robot=robot, run=run, topics=topics_named(topic))
    scans = "" if log.scans is None else f", {len(log.scans.stamp_s):,} scans"
    written = convert(log, out, to=to)
    missing = left_out(log)
    without = f"; without {', '.join(missing)}" if missing else ""
    told = f"{len(log.sightings.stamp_s):,} sightings" if len(log.sightings.stamp_s) else scans.lstrip(", ")
    held = {
        "g2o": f"{len(log.sightings.stamp_s):,} sightings; no truth, fixes or scans",
        "tum": "the path of odometry" if log.truth_trajectory is None else "the true path",
        "jsonl": f"{len(log.controls.stamp_s):,} controls, {told or 'nothing seen'}{without}",
        "native": f"{len(log.controls.stamp_s):,} controls, {len(log.sightings.stamp_s):,} sightings{scans}",
    }
    typer.echo(f"{written}: {held[to or format_of(out)]}")

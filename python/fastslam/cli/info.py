"""`fastslam info`: what is in a log."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ..errors import DataError
from .console import make_table, stdout
from .encoding import print_json
from .options import Format, LogPath, Robot, Run, Topics, topics_named
from .space import format_in_space, info_in_space

if TYPE_CHECKING:
    from ..datasets.bag_topics import Topic
    from ..datasets.info import Extent, LogInfo, StreamInfo
    from ..examination import Finding

Row = tuple[str, str, str]


Json = Annotated[bool, typer.Option("--json", help="Print one JSON object, findings included.")]


def info(
    path: LogPath,
    format: Format = None,
    robot: Robot = None,
    run: Run = None,
    topic: Topics = None,
    json: Json = False,
) -> None:
    """Examine a log before any filter: what is in it, what was repaired, and what is visibly wrong with it.

    Of a bag the topics are listed, with what each may serve for.

    \b
    Examples:
      fastslam info LOG
      fastslam info LOG --json
      fastslam info MRCLAM_Dataset1 --robot 2
      fastslam info drive.mcap
    """
    from ..datasets.info import describe
    from ..datasets.registry import load
    from ..examination import examine

    in_space = format_in_space(path, format)
    if in_space is not None:
        info_in_space(path, in_space, json=json)
        return
    topics = _topics(path)
    if topics and not json:
        _show_topics(topics)
    try:
        log = load(path, format=format, robot=robot, run=run, topics=topics_named(topic))
    except DataError as error:
        if not topics:
            raise
        # What cannot be run may be listed all the same.
        if json:
            print_json({"topics": [asdict(entry) for entry in topics], "fault": str(error)})
        else:
            stdout().print(f"no run: {error}", markup=False, highlight=False, soft_wrap=True)
        return
    summary, findings = describe(log), examine(log)
    if json:
        facts = {**asdict(summary), "findings": [finding.to_dict() for finding in findings]}
        if topics:
            facts["topics"] = [asdict(entry) for entry in topics]
        print_json(facts)
    else:
        _show(summary, findings, log.notes)


def _topics(path: Path) -> list[Topic]:
    """Those of a bag; none where it is no bag."""
    from ..datasets import bag

    return bag.list_topics(path) if bag.matches(path) else []


def _show_topics(topics: list[Topic]) -> None:
    rows = [
        (topic.name, topic.type, f"{topic.messages:,}", ", ".join(topic.uses) or "-", topic.holds)
        for topic in topics
    ]
    stdout().print(make_table("topics", ("topic", "type", ">messages", "serves for", "holds"), rows))


def _show(summary: LogInfo, findings: tuple[Finding, ...], notes: tuple[str, ...]) -> None:
    console = stdout()
    title = f"{summary.name} (format {summary.format}, motion model {summary.motion_model})"
    console.print(make_table(title, ("quantity", ">value", "unit"), _rows(summary)))
    if summary.sightings_per_landmark:
        tally = sorted(summary.sightings_per_landmark.items(), key=lambda item: -item[1])
        shown = ", ".join(f"{name}: {count:,}" for name, count in tally[:20])
        more = f", and {len(tally) - 20} more" if len(tally) > 20 else ""
        console.print(f"sightings per landmark: {shown}{more}", markup=False, highlight=False)
    for note in notes:
        console.print(f"note: {note}", markup=False, highlight=False)
    lines = [f"problem: {problem.message} ({problem.count:,})" for problem in summary.problems]
    for finding in findings:
        lines += [f"{finding.severity}: {finding.message} [{finding.code}]", f"  {finding.remedy}"]
    for line in lines or ["no problems found"]:
        console.print(line, markup=False, highlight=False, soft_wrap=True)


def _rows(summary: LogInfo) -> list[Row]:
    from ..evaluation.display import format_number

    rows: list[Row] = [("duration", format_number(summary.duration_s), "s")]
    rows += _stream_rows("controls", summary.controls)
    if summary.sightings is None:
        rows.append(("sightings", "0", ""))
    else:
        rows += _stream_rows("sightings", summary.sightings)
    rows += [(f"sightings of sensor {name}", format_number(n), "") for name, n in summary.sensors.items()]
    rows += _extent_rows("sightings per stamp", summary.sightings_per_stamp, "")
    rows += _extent_rows("range", summary.range_m, "m")
    rows += _extent_rows("bearing", summary.bearing_rad, "rad")
    rows.append(("sightings with identity", format_number(summary.identified), ""))
    rows.append(("landmarks named", format_number(len(summary.sightings_per_landmark)), ""))
    rows += [
        (f"sightings of class {name}", format_number(count), "") for name, count in summary.classes.items()
    ]
    if summary.with_signature:
        rows.append(("sightings with signature", format_number(summary.with_signature), ""))
    if summary.scans is not None:
        rows += _stream_rows("laser scans", summary.scans)
        rows.append(("beams per scan", format_number(summary.beams_per_scan), ""))
    heading = "" if summary.truth_heading_known or not summary.truth_poses else " (no heading)"
    rows.append((f"true poses{heading}", format_number(summary.truth_poses), ""))
    rows.append(("true landmarks", format_number(summary.truth_landmarks), ""))
    rows.append(("position fixes", format_number(summary.position_fixes), ""))
    return rows


def _stream_rows(name: str, stream: StreamInfo) -> list[Row]:
    from ..evaluation.display import format_number

    return [
        (name, format_number(stream.rows), ""),
        (f"{name}: rate", format_number(stream.rate_hz), "Hz"),
        (f"{name}: longest gap", format_number(stream.longest_gap_s), "s"),
    ]


def _extent_rows(name: str, extent: Extent | None, unit: str) -> list[Row]:
    if extent is None:
        return []
    from ..evaluation.display import format_number

    values = (extent.minimum, extent.median, extent.maximum)
    shown = (format_number(int(value) if value.is_integer() else value) for value in values)
    return [(f"{name}: min, median, max", ", ".join(shown), unit)]

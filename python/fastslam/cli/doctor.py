"""`fastslam doctor`: what the numbers of a log may mean, with log-odds and remedies."""

from __future__ import annotations

from typing import TYPE_CHECKING

import typer

from .console import make_table, stdout
from .encoding import print_json
from .options import ConfigFile, Format, Json, LogPath, Robot, Run, Settings

if TYPE_CHECKING:
    from ..tuning import Diagnosis

SHOWN = 8


def doctor(
    path: LogPath,
    format: Format = None,
    robot: Robot = None,
    run: Run = None,
    config: ConfigFile = None,
    settings: Settings = None,
    json: Json = False,
) -> None:
    """Say how a log's numbers may be meant, with log-odds and the line that puts it right.

    Sightings of one moment, moved by the odometry, are held against those of a moment later; no filter runs.
    A reading above 10 nats, on which parts of the log agree, is suspected, a gain or a delay where `tune`
    takes it for real too; below zero the log as it stands fits better.

    \b
    Examples:
      fastslam doctor LOG
      fastslam doctor LOG --json
      fastslam run LOG --set sensor.delay_s=0.4
    """
    from ..config import load_config, merge, parse_assignments
    from ..datasets.registry import load
    from ..tuning.doctor import diagnose

    layers = (load_config(config) if config is not None else {}, parse_assignments(settings or []))
    log = load(path, format=format, robot=robot, run=run)
    found = diagnose(log, merge(*layers))
    if json:
        print_json({"log": log.name, **found.to_dict()})
        return
    for finding in found.findings:
        typer.echo(f"{finding.severity}: {finding.line}")
    if not found.verdicts:
        typer.echo(f"{found.questions:,} sightings can be compared: too few to tell readings apart")
        return
    rows = [(one.name, f"{one.log_odds:+,.0f}", one.remedy) for one in found.verdicts[:SHOWN]]
    title = f"{log.name}: readings against the numbers as they stand, by {found.questions:,} comparisons"
    stdout().print(make_table(title, ("reading", "!>nats", "remedy"), rows))
    for value in found.kept:
        low, high = value.interval95
        typer.echo(
            f"kept: {value.key} = {value.stated:.4g} is stated, and the log says {low:.3g} to {high:.3g}: "
            "too near to overrule it, for `tune` and `--auto` as well"
        )
    typer.echo(_conclusion(found))


def _conclusion(found: Diagnosis) -> str:
    if found.suspected:
        return f"suspected: {found.suspected[0].name}: {found.suspected[0].remedy}"
    if any(finding.severity != "note" for finding in found.findings):
        return "no other reading fits better; what is said above comes first"
    if found.verdicts[0].log_odds > 0:
        return "nothing fits surely better than the numbers as they stand"
    return "the numbers fit best as they stand"

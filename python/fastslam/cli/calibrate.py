"""`fastslam calibrate`: noise, systematic errors and mounting of the sensor, from a log."""

from __future__ import annotations

import math
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, cast

import typer

from .console import make_table, stderr, stdout
from .encoding import print_json
from .options import ConfigFile, Format, Json, LogPath, Robot, Run, Seed, Settings

if TYPE_CHECKING:
    from ..calibration import Calibration, Parameter, Reference


def calibrate_sensor(
    path: LogPath,
    format: Format = None,
    robot: Robot = None,
    run: Run = None,
    config: ConfigFile = None,
    settings: Settings = None,
    seed: Seed = None,
    reference: Annotated[
        str, typer.Option(metavar="sensor|odometry|survey", help="Whose scale is right.")
    ] = "sensor",
    noise: Annotated[bool, typer.Option("--noise", help="Write the noise too, not only print it.")] = False,
    out: Annotated[Path, typer.Option(help="YAML file for the settings found.")] = Path("calibration.yaml"),
    json: Json = False,
) -> None:
    """Estimate the sensor's mounting, systematic errors and noise from what a run leaves unexplained.

    What differs from the configured value by three standard errors goes into a file that `fastslam run
    --config` takes; what the log cannot tell is named and left alone. Ranges and odometry alone do not
    tell which of them is in true metres: --reference does.

    Settings come from: defaults < the log's own < --config < --set.

    \b
    Examples:
      fastslam calibrate LOG
      fastslam run LOG --config calibration.yaml
      fastslam calibrate MRCLAM_Dataset2 --robot 3 --reference survey --out robot3.yaml
    """
    from .._yaml import write_yaml
    from ..calibration import calibrate
    from ..config import load_config, merge, parse_assignments
    from ..datasets.registry import load
    from ..resultfiles import write_atomically

    given = [*(settings or []), *([] if seed is None else [f"seed={seed}"])]
    layers = (load_config(config) if config is not None else {}, parse_assignments(given))
    log = load(path, format=format, robot=robot, run=run)
    # `calibrate` refuses any other word with an error of its own.
    found = calibrate(log, merge(*layers), reference=cast("Reference", reference), noise=noise)
    if json:
        write_atomically(out, write_yaml(found.settings))
        print_json(_facts(found, out))
        return
    rows = [_row(parameter) for parameter in found.parameters]
    title = f"{log.name}: {found.sightings:,} sightings of {found.landmarks:,} landmarks"
    headings = ("parameter", ">configured", ">found", ">95 % interval", "unit", "")
    stdout().print(make_table(title, headings, rows))
    for warning in _warnings(found):
        stderr().print(f"[yellow]warning[/] {warning}", highlight=False)
    typer.echo(write_atomically(out, write_yaml(found.settings)))


def _facts(found: Calibration, out: Path) -> dict[str, Any]:
    parameters = [
        {**asdict(parameter), "interval95": parameter.interval95, "significant": parameter.significant}
        for parameter in found.parameters
    ]
    counts = {"sightings": found.sightings, "landmarks": found.landmarks, "converged": found.converged}
    told = {"settings": found.settings, "file": str(out), "warnings": _warnings(found)}
    return {**counts, "parameters": parameters, **told}


def _warnings(found: Calibration) -> list[str]:
    hidden = [parameter.key for parameter in found.parameters if not parameter.observable]
    warnings = []
    if hidden:
        warnings.append(
            f"this log does not tell {', '.join(hidden)}: drive curves, see landmarks from all sides"
        )
    if found.evidence_gain < 0 and not found.settings:
        warnings.append(
            f"a run with what was found explains the log worse by {-found.evidence_gain:,.0f} nats: "
            "nothing is written"
        )
    if not found.converged:
        warnings.append("the estimate had not settled when it was stopped: take it with care")
    return warnings


def _row(parameter: Parameter) -> tuple[str, ...]:
    from ..evaluation.display import format_number

    interval, note = "", ""
    if not math.isnan(parameter.standard_error):
        interval = " to ".join(format_number(value) for value in parameter.interval95)
        note = "within chance" if not parameter.significant else ""
    if not parameter.observable:
        note = "not observable"
    values = (format_number(parameter.configured), format_number(parameter.value))
    return (parameter.key, *values, interval, parameter.unit, note)

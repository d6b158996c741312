"""Options that several commands share."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeAlias

import typer

from ..errors import ConfigError

if TYPE_CHECKING:
    from ..maps import StartLike

ANYWHERE = "anywhere"

LogPath: TypeAlias = Annotated[Path, typer.Argument(help="Log: a folder or a file.", metavar="PATH")]
Format: TypeAlias = Annotated[
    str | None,
    typer.Option(
        "--format", help="Format of the log; guessed from its contents when left out.", metavar="FORMAT"
    ),
]
Robot: TypeAlias = Annotated[int | None, typer.Option(help="Robot number in a log of several.", metavar="N")]
Run: TypeAlias = Annotated[
    int | None, typer.Option("--run", help="Run number in a folder of several.", metavar="N")
]
ConfigFile: TypeAlias = Annotated[
    Path | None, typer.Option("--config", help="YAML file of settings.", metavar="FILE")
]
Settings: TypeAlias = Annotated[
    list[str] | None,
    typer.Option("--set", help="One setting; may be given again.", metavar="KEY=VALUE"),
]
Topics: TypeAlias = Annotated[
    list[str] | None,
    typer.Option(
        "--topic",
        metavar="ROLE=NAME",
        help="Topic of a bag for odometry, detections, scan or truth; may be given again.",
    ),
]
Verbose: TypeAlias = Annotated[
    bool, typer.Option("--verbose", "-v", help="Say at the end where the time went.")
]
Json: TypeAlias = Annotated[bool, typer.Option("--json", help="Print one JSON object instead of tables.")]
Strict: TypeAlias = Annotated[
    bool, typer.Option("--strict", help="Exit code 1 where the verdict says that it is not to be believed.")
]
Seed: TypeAlias = Annotated[int | None, typer.Option(help="Seed of all random numbers.", metavar="S")]
StartPose: TypeAlias = Annotated[
    str | None,
    typer.Option(
        "--start",
        metavar="X,Y,HEADING|anywhere",
        help="Where the robot starts; as configured by default.",
    ),
]
StartStd: TypeAlias = Annotated[
    str | None,
    typer.Option("--start-std", metavar="X,Y,HEADING", help="Standard deviations of the start (m, m, rad)."),
]
Figures: TypeAlias = Annotated[
    bool, typer.Option("--figures", help="Write the pictures of the report as PNG files too (a second more).")
]


def start_given(start: str | None, std: str | None) -> StartLike:
    """The start that the options say: a pose, perhaps known roughly, anywhere, or none."""
    from ..maps import Anywhere, Start

    if start == ANYWHERE:
        if std is not None:
            raise ConfigError("--start-std: a start anywhere has none")
        return Anywhere()
    if start is None:
        if std is not None:
            raise ConfigError("--start-std: say with --start where the robot starts")
        return None
    spread = _three("--start-std", std) if std is not None else (0.0, 0.0, 0.0)
    return Start(*_three("--start", start), std=spread)


def _three(option: str, text: str) -> tuple[float, float, float]:
    try:
        x_m, y_m, heading_rad = map(float, text.split(","))
    except ValueError:
        raise ConfigError(f"{option} {text}: expected three numbers (m, m, rad)") from None
    return x_m, y_m, heading_rad


def topics_named(given: list[str] | None) -> dict[str, str] | None:
    """Names of topics by role. Errors: `ConfigError` for text that is no assignment."""
    named: dict[str, str] = {}
    for text in given or []:
        role, equals, name = text.partition("=")
        if not equals or not name:
            raise ConfigError(f"--topic {text}: expected role=name, for example odometry=/odom")
        named[role.strip()] = name.strip()
    return named or None

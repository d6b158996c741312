"""Options that several commands share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, TypeAlias

import typer

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
Verbose: TypeAlias = Annotated[
    bool, typer.Option("--verbose", "-v", help="Say at the end where the time went.")
]
Json: TypeAlias = Annotated[bool, typer.Option("--json", help="Print one JSON object instead of tables.")]
Seed: TypeAlias = Annotated[int | None, typer.Option(help="Seed of all random numbers.", metavar="S")]

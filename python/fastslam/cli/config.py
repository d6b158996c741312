"""`fastslam config`: dump, validate and explain configurations."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated, Any

import typer

from .console import width_of_stdout
from .encoding import as_document
from .options import ConfigFile, Format, Robot, Run, Settings
from .output import keys_text

app = typer.Typer()


@app.command(short_help="Print the effective configuration as YAML.")
def dump(
    config: ConfigFile = None,
    settings: Settings = None,
    log: Annotated[Path | None, typer.Option(help="Start from this log's own settings.")] = None,
    format: Format = None,
    robot: Robot = None,
    run: Run = None,
) -> None:
    """Print the effective configuration as YAML, every key under its description.

    \b
    Examples:
      fastslam config dump > settings.yaml
      fastslam config dump --log LOG --set filter.particles=500
    """
    from ..config import Config, load_config, parse_assignments

    layers: list[Any] = []
    if log is not None:
        from ..datasets import load

        layers.append(load(log, format=format, robot=robot, run=run).config)
    if config is not None:
        layers.append(load_config(config))
    layers.append(parse_assignments(settings or []))
    typer.echo(as_document(Config.resolve(*layers).dump()), nl=False)


@app.command(short_help="Check a configuration file.")
def validate(file: Annotated[Path, typer.Argument(help="YAML file to check.", metavar="FILE")]) -> None:
    """Check a configuration file: exit code 0 when it is fine, 2 with the place and the reason when not."""
    from ..config import Config, load_config

    Config.resolve(load_config(file))
    typer.echo(f"{file}: ok")


@app.command("explain", short_help="Show type, default and meaning of keys.")
def explain_keys(
    key: Annotated[
        str | None, typer.Argument(help="A key or a section; all keys when left out.", metavar="[KEY]")
    ] = None,
) -> None:
    """Show type, default and meaning of every key, or of one key or section.

    \b
    Examples:
      fastslam config explain
      fastslam config explain filter.resampling
    """
    from ..config import explain

    sys.stdout.write(keys_text(explain(key), width_of_stdout()))

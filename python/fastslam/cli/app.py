"""The application object and the commands it gathers."""

from __future__ import annotations

from typing import Annotated

import typer

from .. import __version__
from .calibrate import calibrate_sensor
from .config import app as config_app
from .convert import convert_log
from .datasets import app as datasets_app
from .demo import demo
from .detect import detect_landmarks
from .errors import OneLineErrors
from .evaluate import evaluate_results
from .info import info
from .reproduce import reproduce_figure
from .run import run_log
from .simulate import simulate_log
from .sweep import sweep

app = typer.Typer(
    name="fastslam",
    cls=OneLineErrors,
    help="Landmark SLAM by Rao-Blackwellized particle filtering: a log goes in, a map and a path come out.",
    epilog="Exit codes: 0 done, 1 run failed, 2 usage or configuration, 130 interrupted (results are kept).",
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
    context_settings={"help_option_names": ["-h", "--help"]},
)
app.command("demo")(demo)
app.command("run")(run_log)
app.command("simulate")(simulate_log)
app.command("eval")(evaluate_results)
app.command("detect")(detect_landmarks)
app.command("calibrate")(calibrate_sensor)
app.command("info")(info)
app.command("convert")(convert_log)
app.command("sweep")(sweep)
app.command("reproduce")(reproduce_figure)
app.add_typer(config_app, name="config")
app.add_typer(datasets_app, name="datasets")


def _print_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"fastslam {__version__}")
        raise typer.Exit


@app.callback(invoke_without_command=True)
def _top(
    context: typer.Context,
    version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    if context.invoked_subcommand is None:
        typer.echo(context.get_help())


def main() -> None:
    """Entry point of the `fastslam` program."""
    app()

"""The application object and the commands it gathers."""

from __future__ import annotations

import sys
from typing import Annotated

import typer

from .. import __version__
from .calibrate import calibrate_sensor
from .compare import compare_results
from .config import app as config_app
from .convert import convert_log
from .datasets import app as datasets_app
from .demo import demo
from .detect import detect_landmarks
from .doctor import doctor
from .encoding import never_fail_to_print
from .errors import OneLineErrors
from .evaluate import evaluate_results
from .info import info
from .live import live_stream
from .localize import localize_log
from .maps import app as map_app
from .reproduce import reproduce_figure
from .run import run_log
from .simulate import simulate_log
from .sweep import sweep
from .tune import tune_log

app = typer.Typer(
    name="fastslam",
    cls=OneLineErrors,
    help="Landmark SLAM by Rao-Blackwellized particle filtering: a log goes in, a map and a path come out.",
    epilog="Exit codes: 0 done, 1 run failed, 2 usage or configuration, 130 interrupted (results are kept).",
    pretty_exceptions_enable=False,
    # Plain help: rich takes longer to load than the rest of the program.
    rich_markup_mode=None,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
)
app.command("demo", short_help="Simulate a world, run the filter, write a report.")(demo)
app.command("run", short_help="Run the filter over a log: map, path, numbers, report.")(run_log)
app.command("live", short_help="Read events as lines of JSON, write estimates.")(live_stream)
app.command("localize", short_help="Follow a robot through a map that was kept.")(localize_log)
app.command("simulate", short_help="Simulate a drive and write it as a log with truth.")(simulate_log)
app.command("eval", short_help="Score results against the truth of their log.")(evaluate_results)
app.command("compare", short_help="Lay several results over each other on one page.")(compare_results)
app.command("detect", short_help="Detect landmarks in the laser scans of a log.")(detect_landmarks)
app.command("tune", short_help="Find noise, gains, mounting and delay from a log.")(tune_log)
app.command("calibrate", short_help="Estimate noise and mounting of the sensor.")(calibrate_sensor)
app.command("doctor", short_help="Say how a log's numbers may be meant, with log-odds.")(doctor)
app.command("info", short_help="Say what is in a log.")(info)
app.command("convert", short_help="Write a log in another format.")(convert_log)
app.command("sweep", short_help="Run a grid of configurations, seeds and logs.")(sweep)
app.command("reproduce", short_help="Remake figures of the FastSLAM paper.")(reproduce_figure)
app.add_typer(map_app, name="map")
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


def make_only(name: str) -> None:
    """Leaves out all commands but the one of this name, if there is one.

    **Why** Typer makes every command before it runs one, which takes longer than loading them.
    """
    commands = [command for command in app.registered_commands if command.name == name]
    groups = [group for group in app.registered_groups if group.name == name]
    if commands or groups:
        app.registered_commands, app.registered_groups = commands, groups


def main() -> None:
    """Runs the program; `fastslam._entry` starts it."""
    never_fail_to_print()
    make_only(sys.argv[1] if len(sys.argv) > 1 else "")
    app()

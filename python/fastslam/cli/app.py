"""The application object and the commands it gathers."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from importlib import import_module
from typing import Annotated

import typer

from .. import __version__
from .encoding import never_fail_to_print
from .errors import OneLineErrors

_HELP = "Landmark SLAM by Rao-Blackwellized particle filtering: a log goes in, a map and a path come out."
_CODES = "Exit codes: 0 done, 1 run failed, 2 usage or configuration, 130 interrupted (results are kept)."
_COMMANDS = {
    "demo": ("demo.demo", "Simulate a world, run the filter, write a report."),
    "run": ("run.run_log", "Run the filter over a log: map, path, numbers, report."),
    "live": ("live.live_stream", "Read events as lines of JSON, write estimates."),
    "localize": ("localize.localize_log", "Follow a robot through a map that was kept."),
    "simulate": ("simulate.simulate_log", "Simulate a drive and write it as a log with truth."),
    "eval": ("evaluate.evaluate_results", "Score results against the truth of their log."),
    "compare": ("compare.compare_results", "Lay several results over each other on one page."),
    "detect": ("detect.detect_landmarks", "Detect landmarks in the laser scans of a log."),
    "tune": ("tune.tune_log", "Find noise, gains, mounting and delay from a log."),
    "calibrate": ("calibrate.calibrate_sensor", "Estimate noise and mounting of the sensor."),
    "doctor": ("doctor.doctor", "Say how a log's numbers may be meant, with log-odds."),
    "info": ("info.info", "Say what is in a log."),
    "convert": ("convert.convert_log", "Write a log in another format."),
    "export": ("export.export_results", "Write results for other programs: a bag for viewers."),
    "sweep": ("sweep.sweep", "Run a grid of configurations, seeds and logs."),
    "reproduce": ("reproduce.reproduce_figure", "Remake figures of the FastSLAM paper."),
}
"""Each command's function, below this package, and what the list of commands says about it."""
_GROUPS = {
    "map": ("maps.app", "Check, draw, edit, compare, join and export kept maps."),
    "config": ("config.app", "Print, check and explain configurations."),
    "datasets": ("datasets.app", "List and fetch public logs."),
}
"""The same of commands that hold others."""


def application(words: Sequence[str] | None = None) -> typer.Typer:
    """The program; for the words of a command line with no more than these need.

    **Why** Loading and making every command takes longer than most of them run. The one that the first word
    names is made alone; where none is named, the list of them is all that can be asked for.
    """
    made = typer.Typer(
        name="fastslam",
        cls=OneLineErrors,
        help=_HELP,
        epilog=_CODES,
        pretty_exceptions_enable=False,
        # Plain help: rich takes longer to load than the rest of the program.
        rich_markup_mode=None,
        context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
    )
    made.callback(invoke_without_command=True)(_top)
    known = {**_COMMANDS, **_GROUPS}
    first = words[0] if words else ""
    named = known.keys() if words is None or known.keys() & {*words} else ()
    for name in [first] if first in known else known:
        _add(made, name, is_listed_only=name not in named)
    return made


def _add(made: typer.Typer, name: str, *, is_listed_only: bool) -> None:
    place, says = _COMMANDS.get(name) or _GROUPS[name]
    if is_listed_only:
        made.command(name, short_help=says)(_listed)
        return
    module, _, attribute = place.partition(".")
    found = getattr(import_module(f".{module}", __package__), attribute)
    if name in _GROUPS:
        made.add_typer(found, name=name, help=says)
    else:
        made.command(name, short_help=says)(found)


def _listed() -> None:
    """Stands for a command in the list of them."""


def _print_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"fastslam {__version__}")
        raise typer.Exit


def _top(
    context: typer.Context,
    version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    if context.invoked_subcommand is None:
        typer.echo(context.get_help())


def _words() -> list[str]:
    """The words of the command line; those that a shell wants completed, where it asks for that."""
    if any(name.startswith("_") and name.endswith("_COMPLETE") for name in os.environ):
        line = os.environ.get("COMP_WORDS") or os.environ.get("_TYPER_COMPLETE_ARGS", "")
        return line.split()[1:]
    return sys.argv[1:]


def main() -> None:
    """Runs the program; `fastslam._entry` starts it."""
    never_fail_to_print()
    application(_words())(prog_name="fastslam")

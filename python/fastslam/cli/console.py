"""Terminal output: tables with units on stdout, progress and errors on stderr."""

from __future__ import annotations

import os
import shutil
import sys
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from typing import TYPE_CHECKING, TextIO

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

_WIDTH_WITHOUT_TERMINAL = 120


def stdout() -> Console:
    """The console for what a command was asked for."""
    return _console(sys.stdout)


def stderr() -> Console:
    """The console for progress, notes and errors."""
    return _console(sys.stderr)


def _console(stream: TextIO) -> Console:
    from rich.console import Console

    # Made anew each time: tests and embedding programs replace the streams. Rich reads COLUMNS; FORCE_COLOR
    # makes it take a file for a terminal, and NO_COLOR wins.
    plain = bool(os.environ.get("NO_COLOR")) and not stream.isatty()
    width = None if _has_width(stream) else _WIDTH_WITHOUT_TERMINAL
    return Console(file=stream, width=width, force_terminal=False if plain else None)


def width_of_stdout() -> int:
    """So many signs a line has room for: those of COLUMNS or of the terminal, where there is one."""
    return shutil.get_terminal_size().columns if _has_width(sys.stdout) else _WIDTH_WITHOUT_TERMINAL


def _has_width(stream: TextIO) -> bool:
    return stream.isatty() or os.environ.get("COLUMNS", "").isdigit()


def progress_bar(
    description: str, *, unit: str = "steps"
) -> AbstractContextManager[Callable[[int, int], None]]:
    """Shows a bar with rate and remaining time on a terminal; yields what to call with (done, total)."""
    if not sys.stderr.isatty():
        return nullcontext(lambda done, total: None)
    from .progress import shown_on

    return shown_on(stderr(), description, unit=unit)


def make_table(title: str, columns: Sequence[str], rows: Sequence[Sequence[str]]) -> Table:
    """A table; a heading's `>` aligns its column to the right, `!` keeps it from being broken."""
    from rich.table import Table
    from rich.text import Text

    table = Table(title=title, title_justify="left")
    for column in columns:
        table.add_column(
            Text(column.lstrip(">!")),
            justify="right" if column.startswith(">") else "left",
            no_wrap=column.startswith("!"),
            overflow="fold",
        )
    for row in rows:
        table.add_row(*(Text(cell) for cell in row))
    return table

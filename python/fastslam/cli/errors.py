"""Expected errors end a command with one line and an exit code; unexpected ones keep their traceback."""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import typer
from typer.core import TyperGroup

from .._entry import INTERRUPTED, interruptible
from ..errors import ConfigError, FastSlamError
from .console import stderr

RUN_FAILED = 1
USAGE = 2

# typer names this base class of all usage errors (bad option, missing argument, ...) nowhere in public.
_UsageError: type[Exception] = typer.BadParameter.__mro__[1]


class OneLineErrors(TyperGroup):
    """A command group that reports expected errors of all its commands in one line on stderr."""

    def make_context(self, *args: Any, **kwargs: Any) -> Any:
        """Parses the group's own options."""
        with one_line_errors():
            return super().make_context(*args, **kwargs)

    def invoke(self, ctx: Any) -> Any:
        """Parses and runs a command."""
        with one_line_errors():
            return super().invoke(ctx)


@contextmanager
def one_line_errors() -> Iterator[None]:
    """Turns expected exceptions into `error: ...` on stderr and an exit code."""
    interruptible()
    try:
        yield
    except FastSlamError as error:
        raise _reported(str(error), USAGE if isinstance(error, ConfigError) else RUN_FAILED) from None
    except _UsageError as error:
        message = _in_plain_words(getattr(error, "format_message", error.__str__)())
        command = getattr(getattr(error, "ctx", None), "command_path", "fastslam")
        raise _reported(f"{message.rstrip('.')} (see {command} --help)", USAGE) from None
    except KeyboardInterrupt:
        raise _reported("interrupted", INTERRUPTED) from None
    except BrokenPipeError:
        # Whoever read the output has seen enough; Python would complain once more when it ends.
        sys.stdout = open(os.devnull, "w")  # noqa: SIM115
        raise typer.Exit(RUN_FAILED) from None
    except OSError as error:
        where = "" if error.filename is None else f"{error.filename}: "
        raise _reported(f"{where}{error.strerror or error}", RUN_FAILED) from None
    except MemoryError:
        raise _reported("not enough memory", RUN_FAILED) from None


def _in_plain_words(message: str) -> str:
    """A usage error without the names that Python has for types."""
    for theirs, ours in (("a valid int", "a whole number"), ("a valid float", "a number")):
        message = re.sub(rf"is not {theirs}(eger|ing point)?\b", f"is not {ours}", message)
    return message


def _reported(message: str, code: int) -> typer.Exit:
    from rich.markup import escape

    line = " ".join(message.split())
    stderr().print(f"[bold red]error:[/] {escape(line)}", soft_wrap=True, highlight=False)
    return typer.Exit(code)


def refuse_unsound(unsound: int, runs: int = 1) -> None:
    """What --strict does once all is written and shown: exit code 1 where a verdict speaks against a run."""
    if unsound:
        which = "this run" if runs == 1 else f"{unsound:,} of {runs:,} runs"
        stderr().print(f"[bold red]error:[/] the verdict speaks against {which} (--strict)", highlight=False)
        raise typer.Exit(RUN_FAILED)

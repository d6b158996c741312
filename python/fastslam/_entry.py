"""Entry point of the program. Ctrl-C and SIGTERM are one line from the start.

What is loaded before `main` is this file, its package's `__init__` and `signal`; before that the interpreter
starts, and a Ctrl-C that comes so early ends it in its own way.
"""

from __future__ import annotations

import os
import signal
import sys

TYPE_CHECKING = False
if TYPE_CHECKING:
    from types import FrameType

INTERRUPTED = 130
_USUAL = {signal.SIGINT: signal.default_int_handler, signal.SIGTERM: signal.SIG_DFL}
"""The signals that end a command in order, and what they do as long as nobody says otherwise."""


def main() -> None:
    """The `fastslam` program."""
    ours = [number for number, usual in _USUAL.items() if signal.getsignal(number) is usual]
    for number in ours:
        signal.signal(number, _end_at_once)
    try:
        from .cli.app import main as run_program

        run_program()
    finally:
        for number in ours:
            # What was to be done is done: nothing may break into the interpreter's own end.
            signal.signal(number, signal.SIG_IGN)


def interruptible() -> None:
    """From here on Ctrl-C, or the request to end, is the exception that commands expect."""
    for number in _USUAL:
        if signal.getsignal(number) is _end_at_once:
            signal.signal(number, signal.default_int_handler)


def _end_at_once(_number: int, _frame: FrameType | None) -> None:
    # Nothing has been begun, and modules that are half loaded may not be unloaded in order.
    sys.stderr.write("error: interrupted\n")
    sys.stderr.flush()
    os._exit(INTERRUPTED)

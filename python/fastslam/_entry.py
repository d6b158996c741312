"""Entry point of the program. Imports nothing heavy, so that Ctrl-C is one line from the first moment on."""

from __future__ import annotations

import os
import signal
import sys
from types import FrameType

INTERRUPTED = 130


def main() -> None:
    """The `fastslam` program."""
    ours = signal.getsignal(signal.SIGINT) is signal.default_int_handler
    if ours:
        signal.signal(signal.SIGINT, _end_at_once)
    try:
        from .cli.app import main as run_program

        run_program()
    finally:
        if ours:
            # What was to be done is done: nothing may break into the interpreter's own end.
            signal.signal(signal.SIGINT, signal.SIG_IGN)


def interruptible() -> None:
    """From here on Ctrl-C is the exception that commands expect."""
    if signal.getsignal(signal.SIGINT) is _end_at_once:
        signal.signal(signal.SIGINT, signal.default_int_handler)


def _end_at_once(_number: int, _frame: FrameType | None) -> None:
    # Nothing has been begun, and modules that are half loaded may not be unloaded in order.
    sys.stderr.write("error: interrupted\n")
    sys.stderr.flush()
    os._exit(INTERRUPTED)

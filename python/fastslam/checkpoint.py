"""Checkpoints of a run: its state in a file, from which it goes on to the same result."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from .errors import ConfigError, DataError
from .resultfiles import write_atomically

CHECKPOINT_FILE = "checkpoint.fastslam"
"""Name of the file in a folder of results."""


@dataclass(frozen=True)
class Checkpoints:
    """Where a run leaves its state, and how often: every `every_s` seconds, and when it is stopped.

    The file is the old state or the new one, whatever happens while it is written. It is removed when the run
    has come to its end. With `resume` a run goes on from the file; where there is none it starts anew.

    Errors: `ConfigError` for a period that is none.
    """

    path: Path
    every_s: float = 60.0
    resume: bool = False
    failures: list[str] = field(default_factory=list, compare=False)
    """Why files could not be written; the run goes on without them."""

    def __post_init__(self) -> None:
        if not 0.0 < self.every_s < float("inf"):
            raise ConfigError(f"checkpoints: got every {self.every_s} s, expected a time above 0")

    def begin(self) -> bytes | None:
        """The state to go on from, if that is wanted and there is one; else an older file is removed."""
        try:
            for unfinished in self.path.parent.glob(f".{self.path.name}.*"):
                # Of a process that was killed while it wrote.
                unfinished.unlink(missing_ok=True)
            if self.resume and self.path.exists():
                return self.path.read_bytes()
            self.path.unlink(missing_ok=True)
        except OSError as error:
            raise DataError(f"checkpoint: {error.strerror or error}", self.path) from None
        return None

    def keep(self, snapshot: bytes) -> None:
        """Writes the file; a failure is remembered."""
        try:
            write_atomically(self.path, snapshot, durable=True)
        except DataError as error:
            self.failures.append(str(error))

    def end(self) -> None:
        """Removes the file of a run that has come to its end."""
        self.path.unlink(missing_ok=True)

    @property
    def warnings(self) -> tuple[str, ...]:
        """What speaks against relying on the file."""
        if not self.failures:
            return ()
        return (f"{len(self.failures)} checkpoints could not be written; the last: {self.failures[-1]}",)

"""The errors that users see; the command line prints them as one line."""

from __future__ import annotations

from pathlib import Path

_LONGEST = 1000
"""Characters of a message; what a file or a caller gives may be as long as it likes."""


def _short(message: str) -> str:
    return message if len(message) <= _LONGEST else message[: _LONGEST - 3] + "..."


class FastSlamError(Exception):
    """Base of all expected errors."""


class ConfigError(FastSlamError):
    """A configuration value is unknown, of the wrong type or out of range."""

    def __init__(self, message: str) -> None:
        # As below: values and keys may stand in the message.
        super().__init__(_short(" ".join(message.split())))


class DataError(FastSlamError):
    """A file cannot be used. The message starts with the path and, where known, the line."""

    def __init__(self, message: str, path: Path | str | None = None, line: int | None = None) -> None:
        self.path = None if path is None else Path(path)
        self.line = line
        where = "" if path is None else f"{path}:{line}: " if line is not None else f"{path}: "
        # What a file holds may stand in the message, line breaks included.
        super().__init__(where + _short(" ".join(message.splitlines())))


class ModelError(FastSlamError):
    """A motion or measurement model was given parameters that it cannot work with."""


class NumericalError(FastSlamError):
    """The filter cannot go on (step and particle are in the message)."""

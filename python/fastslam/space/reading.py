"""Reads logs in space: which format a path is of, and `load`."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from .._hints import does_not_exist
from ..errors import DataError
from . import native, starloc, starry_night
from .log import SpaceLog

READERS: dict[str, tuple[Callable[[Path], bool], Callable[[Path], SpaceLog]]] = {
    "space": (native.matches, native.load),
    "starry_night": (starry_night.matches, starry_night.load),
    "starloc": (starloc.matches, starloc.load),
}
"""How each format is recognised, from names and first bytes, and read."""


def matches(path: Path) -> str | None:
    """The format of a log in space, or None where the path is none."""
    return next((name for name, (fits, _) in READERS.items() if fits(path)), None)


def load(path: Path | str, *, format: str | None = None) -> SpaceLog:
    """Read a log in space; the format is guessed unless `format` names one of `READERS`.

    Errors: `DataError` when the path is no such log, or a file is at fault.
    """
    path = Path(path)
    if not path.exists():
        raise DataError(does_not_exist(path), path)
    name = matches(path) if format is None else format
    if name not in READERS:
        raise DataError(f"is no log in three dimensions; read are {', '.join(READERS)}: docs/space.md", path)
    return READERS[name][1](path)

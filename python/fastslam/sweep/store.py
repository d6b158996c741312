"""The finished cells of a sweep on disk: one JSON line each, safe against being killed at any moment."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO

from ..errors import DataError


class ResultStore:
    """Rows of finished cells in `<folder>/cells.jsonl`.

    A row counts from the moment that its line, newline included, is on the disk. A line that was cut short by
    a crash is the last one; it is dropped on opening, and its cell is run again.
    """

    def __init__(self, folder: Path | str) -> None:
        self.path = Path(folder) / "cells.jsonl"

    def rows(self) -> list[dict[str, Any]]:
        """All finished rows in the order in which they were finished.

        Errors: `DataError` with file and line for a whole line that is no row: somebody else wrote there.
        """
        if not self.path.exists():
            return []
        try:
            data = self.path.read_bytes()
        except OSError as error:
            raise DataError(error.strerror or str(error), self.path) from None
        whole = data[: data.rfind(b"\n") + 1]
        rows = []
        for number, line in enumerate(whole.splitlines(), start=1):
            try:
                row = json.loads(line)
                row["key"], row["metrics"]
            except (ValueError, KeyError, TypeError):
                raise DataError("is no row of a sweep", self.path, number) from None
            rows.append(row)
        return rows

    @contextmanager
    def appending(self) -> Iterator[Appender]:
        """Opens for adding rows, by one process at a time.

        Errors: `DataError` when another sweep is writing here, or the folder cannot be written.
        """
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            with self.path.open("a+b") as file:
                _lock(file, self.path)
                _drop_torn_line(file)
                yield Appender(file)
        except OSError as error:
            raise DataError(f"cannot write: {error.strerror or error}", self.path) from None


class Appender:
    """Adds rows to an open store."""

    def __init__(self, file: BinaryIO) -> None:
        self._file = file

    def add(self, row: dict[str, Any]) -> None:
        """Adds a row; it is on the disk when this returns."""
        self._file.write(json.dumps(row, separators=(",", ":")).encode() + b"\n")
        self._file.flush()
        os.fsync(self._file.fileno())


def _drop_torn_line(file: BinaryIO) -> None:
    file.seek(0)
    end = file.read().rfind(b"\n") + 1
    file.truncate(end)
    file.seek(end)


def _lock(file: BinaryIO, path: Path) -> None:
    """Held until the file is closed, or the process dies. Windows has no such lock that readers can pass."""
    if sys.platform == "win32":
        return
    import fcntl

    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        raise DataError("another sweep is writing here", path) from None

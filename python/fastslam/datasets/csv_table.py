"""CSV files with a header whose column names carry the unit, read by column with faults located by line."""

from __future__ import annotations

import csv
import difflib
import io
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..errors import DataError
from ..log import Floats, Ints, Problem
from .text import CUT_OFF_HINT, is_number, read_text

UNITS = ("s", "m", "rad", "m_per_s", "rad_per_s")
"""Endings of column names; the longest that fits is the unit."""


@dataclass(frozen=True)
class CsvTable:
    """Columns of text by name, with the line of the file that each row came from."""

    path: Path
    columns: dict[str, tuple[str, ...]]
    lines: tuple[int, ...]
    problems: tuple[Problem, ...]

    def numbers(self, name: str, *, empty: float | None = None) -> Floats:
        """A column as numbers (NaN and infinity pass); `empty` stands for empty fields where it is given.

        Errors: DataError with the line of the first field that is no number.
        """
        texts: Sequence[str] = self.columns[name]
        if empty is not None:
            texts = [text if text.strip() else repr(empty) for text in texts]
        try:
            values = np.array([float(text) for text in texts], dtype=np.float64)
        except ValueError:
            values = None
        if values is None or any("_" in text for text in texts):
            row = next(index for index, text in enumerate(texts) if not is_number(text))
            message = f"{name}: got '{texts[row]}', expected a number"
            raise DataError(message, self.path, self.lines[row])
        return values

    def labels(self, name: str) -> tuple[Ints, tuple[str, ...]]:
        """A column of names as indices into the names in order of first appearance; -1 for an empty field."""
        index_of: dict[str, int] = {"": -1}
        stripped = [text.strip() for text in self.columns[name]]
        for text in stripped:
            index_of.setdefault(text, len(index_of) - 1)
        indices = np.array([index_of[text] for text in stripped], dtype=np.int64)
        return indices, tuple(index_of)[1:]


def read_csv(path: Path) -> CsvTable:
    """Read a comma-separated file with one header line; blank lines are skipped.

    Errors: DataError for an empty file, a repeated column name, a row of another width or no rows at all.
    """
    text = read_text(path)
    reader = csv.reader(io.StringIO(text, newline=""), strict=True)
    header: list[str] | None = None
    rows: list[list[str]] = []
    lines: list[int] = []
    try:
        for row in reader:
            if not row or (len(row) == 1 and not row[0].strip()):
                continue
            if header is None:
                header = _checked_header(row, path, reader.line_num)
                continue
            if len(row) != len(header):
                cut_off = not text.endswith(("\n", "\r")) and reader.line_num >= text.count("\n") + 1
                hint = CUT_OFF_HINT if cut_off else ""
                raise DataError(
                    f"got {len(row)} columns, expected {len(header)}{hint}", path, reader.line_num
                )
            rows.append(row)
            lines.append(reader.line_num)
    except csv.Error as error:
        raise DataError(f"is not well-formed CSV ({error})", path, reader.line_num) from error
    if header is None:
        raise DataError("is empty, expected a header line", path, 1)
    if not rows:
        raise DataError("holds a header and no rows", path, reader.line_num)
    columns = dict(zip(header, zip(*rows, strict=True), strict=True))
    return CsvTable(path, columns, tuple(lines), _line_end_problem(text, path))


def check_columns(table: CsvTable, *, required: Sequence[str], optional: Sequence[str] = ()) -> None:
    """Raise DataError unless the table has the required columns and none beyond the optional ones."""
    known = [*required, *optional]
    for name in table.columns:
        if name not in known:
            raise DataError(_unknown_column(name, known, table.columns), table.path, 1)
    missing = [name for name in required if name not in table.columns]
    if missing:
        expected = ",".join(required)
        got = ",".join(table.columns)
        raise DataError(f"column {missing[0]} is missing: got {got}, expected {expected}", table.path, 1)


def _checked_header(row: list[str], path: Path, line: int) -> list[str]:
    names = [name.strip() for name in row]
    if len(names) == 1 and (";" in names[0] or "\t" in names[0]):
        raise DataError("columns are separated by semicolons or tabs, expected commas", path, line)
    repeated = next((name for name in names if names.count(name) > 1), None)
    if repeated is not None:
        raise DataError(f"column {repeated or '(no name)'} appears more than once", path, line)
    return names


def _unknown_column(name: str, known: Sequence[str], present: dict[str, tuple[str, ...]]) -> str:
    open_names = [candidate for candidate in known if candidate not in present]
    for candidate in open_names:
        quantity, unit = split_unit(candidate)
        if unit and name == quantity:
            return f"column {name} has no unit: got {name}, expected {candidate}"
        if unit and name.startswith(f"{quantity}_"):
            return f"column {name} has another unit: got {name}, expected {candidate}"
    near = difflib.get_close_matches(name, open_names, n=1)
    hint = f", did you mean {near[0]}?" if near else ""
    return f"unknown column: got {name}, expected {','.join(known)}{hint}"


def split_unit(name: str) -> tuple[str, str]:
    """`range_m` gives (`range`, `m`); a name without a known unit gives (name, '')."""
    for unit in sorted(UNITS, key=len, reverse=True):
        if name.endswith(f"_{unit}"):
            return name[: -len(unit) - 1], unit
    return name, ""


def _line_end_problem(text: str, path: Path) -> tuple[Problem, ...]:
    if text.endswith(("\n", "\r")):
        return ()
    return (Problem(f"{path.name}: the last line has no line end and may be cut off: kept"),)

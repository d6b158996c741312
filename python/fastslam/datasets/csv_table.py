"""Tables of text with a header, in the dialects that programs and spreadsheets write, faults located by line.

Columns may be separated by commas, semicolons, tabs, bars or blanks. Lines before the header that begin with
`#` are comments; a header may stand in the last of them, as NumPy writes it. Numbers may have decimal commas
where commas separate nothing. What a column means is for `columns.py`.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from ..csv_cells import unguarded
from ..errors import DataError
from ..limits import LARGEST_STAMP_S
from ..log import Floats, Ints, Problem
from .stamps import ISO_STAMP, iso_seconds
from .text import CUT_OFF_HINT, is_number, read_sheet


class Rows(Protocol):
    """What stands below the names of the columns: lines of a file (`Body`), or rows of a data frame."""

    @property
    def all_lines(self) -> range:
        """Numbers of the rows, for messages."""

    def parse(self, is_text: Sequence[bool]) -> Sequence[NDArray[Any] | None] | None:
        """Columns as arrays, texts as objects; None for those that need a closer look, or for all."""

    @property
    def columns(self) -> tuple[Sequence[Sequence[str]], Sequence[int]]:
        """All columns as text, and the number of every row."""


@dataclass(frozen=True)
class CsvTable:
    """Columns of text by name, with the line of the file that each row came from.

    `index_of` has the place of each column in the file, from 0. `factors` turn a column into SI, `written_as`
    are the names in the file; both stand for those columns that were given another name. `parsed` holds the
    columns of a plain table, numbers as such. `notes` say what was assumed in reading. A data frame has no
    line for its header.
    """

    path: Path
    index_of: dict[str, int]
    body: Rows
    header_line: int | None
    problems: tuple[Problem, ...] = ()
    factors: dict[str, float] = field(default_factory=dict)
    written_as: dict[str, str] = field(default_factory=dict)
    parsed: dict[str, NDArray[Any]] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    @property
    def lines(self) -> Sequence[int]:
        """Line of the file that each row came from."""
        return self.body.all_lines if self.parsed else self.body.columns[1]

    def texts(self, name: str) -> Sequence[str]:
        """A column as it stands in the file."""
        parsed = self.parsed.get(name)
        if parsed is not None and parsed.dtype == np.object_:
            texts: list[str] = parsed.tolist()
            return texts
        return self.body.columns[0][self.index_of[name]]

    def numbers(self, name: str, *, empty: float | None = None) -> Floats:
        """A column as numbers in SI (NaN and infinity pass); `empty` stands for empty fields where given.

        Errors: DataError with the line of the first field that is no number.
        """
        factor = self.factors.get(name, 1.0)
        values: Floats | None = self.parsed.get(name)
        if values is None:
            texts = self.texts(name)
            if empty is not None and not all(texts):
                texts = [text if text.strip() else repr(empty) for text in texts]
            values = _floats(texts)
            if values is None:
                raise self._no_number(name, texts)
        return values if factor == 1.0 else values * factor

    def finite_numbers(self, name: str) -> Floats:
        """As `numbers`. Errors: DataError with the line of a field that is no finite number."""
        values = self.numbers(name)
        self.check_finite(name, values)
        return values

    def check_finite(self, name: str, values: Floats) -> None:
        """Refuses NaN and infinities in a column, by the line."""
        bad = ~np.isfinite(values)
        if bad.any():
            row = int(np.argmax(bad))
            raise DataError(
                f"{name}: got {values[row]}, expected a finite number", self.path, self.lines[row]
            )

    def _no_number(self, name: str, texts: Sequence[str]) -> DataError:
        commas = not any("." in text for text in texts)
        readable = ((is_number(_with_point(text) if commas else text)) for text in texts)
        row = next(index for index, good in enumerate(readable) if not good)
        mixed = is_number(_with_point(texts[row]))
        hint = " (decimal points stand elsewhere in this column)" if mixed else ""
        shown = self.written_as.get(name, name)
        return DataError(f"{shown}: got '{texts[row]}', expected a number{hint}", self.path, self.lines[row])

    def has_dates(self, name: str) -> bool:
        """Whether a column of stamps holds dates."""
        if name in self.parsed:
            return False
        texts = self.texts(name)
        return bool(texts) and ISO_STAMP.fullmatch(texts[0].strip()) is not None

    def stamps(self, name: str) -> Floats:
        """A column of seconds, or of dates by ISO 8601, which become seconds since 1970 (UTC without a zone).

        Errors: DataError with the line of a field that is neither, or of a stamp that no clock shows.
        """
        is_date = self.has_dates(name)
        values = iso_seconds(self.texts(name)) if is_date else self.numbers(name)
        if is_date:
            wrong = np.isnan(values)
            message = "got {}, expected a date such as 2024-05-01T10:00:00.0Z, as above"
        else:
            wrong = np.abs(values, where=np.isfinite(values), out=np.zeros(len(values))) > LARGEST_STAMP_S
            message = "got {}, which are no seconds: name the column stamp_ms, stamp_us or stamp_ns"
        if wrong.any():
            row = int(np.argmax(wrong))
            shown = self.texts(name)[row].strip() if is_date else repr(float(values[row]))
            where = self.written_as.get(name, name)
            raise DataError(f"{where}: {message.format(shown)}", self.path, self.lines[row])
        return values

    def labels(self, name: str) -> tuple[Ints, tuple[str, ...]]:
        """A column of names as indices into the names in order of first appearance; -1 for an empty field."""
        texts = self.texts(name)
        # Most names repeat: each is stripped once.
        stripped = {text: unguarded(text.strip()) for text in dict.fromkeys(texts)}
        index_of: dict[str, int] = {"": -1}
        for text in stripped.values():
            index_of.setdefault(text, len(index_of) - 1)
        index_of_text = {text: index_of[name] for text, name in stripped.items()}
        indices = np.fromiter(map(index_of_text.__getitem__, texts), dtype=np.int64, count=len(texts))
        return indices, tuple(index_of)[1:]


def read_csv(path: Path, *, example: str, allow_empty: bool = False) -> CsvTable:
    """Read a table with a header line; blank lines are skipped. `example` is a header for the message.

    A row of another width is an error when the first column is asked for. Errors: DataError for an empty
    file, a file without header, a repeated column name, or no rows at all unless `allow_empty`.
    """
    text, notes = read_sheet(path)
    lines = text.replace("\r\n", "\n").replace("\r", "\n").split("\n")
    cut_off = bool(lines[-1])
    if not cut_off:
        lines.pop()
    header_line, header = _header(lines, path, example)
    separator = _separator(header)
    names = _checked_names(_fields(header, separator), path, header_line)
    body = Body(path, lines[header_line:], header_line + 1, separator, len(names), cut_off)
    if not allow_empty and not any(map(str.strip, body.lines)):
        raise DataError("holds a header and no rows", path, header_line)
    problems = (Problem(f"{path.name}: the last line has no line end and may be cut off: kept"),)
    index_of = {name: index for index, name in enumerate(names)}
    return CsvTable(path, index_of, body, header_line, problems if cut_off else (), notes=notes)


@dataclass(frozen=True)
class Body:
    """The lines below the header, which begin at line `first` of the file."""

    path: Path
    lines: Sequence[str]
    first: int
    separator: str | None
    width: int
    cut_off: bool

    @property
    def all_lines(self) -> range:
        """Numbers of the lines."""
        return range(self.first, self.first + len(self.lines))

    def parse(self, is_text: Sequence[bool]) -> list[NDArray[Any]] | None:
        """All columns of a plain table, the fast way: texts as objects, others as numbers.

        None where there are no rows, or where something in the file needs a closer look.
        """
        quoted = self.separator is not None and any('"' in line for line in self.lines)
        if quoted or not self.lines or "" in self.lines:
            return None
        kinds = [(f"{index}", np.object_ if text else np.float64) for index, text in enumerate(is_text)]
        try:
            rows = np.loadtxt(self.lines, dtype=kinds, delimiter=self.separator, comments=None, ndmin=1)
        except ValueError:
            return None
        columns = [np.ascontiguousarray(rows[name]) for name, _ in kinds]
        return columns if len(rows) == len(self.lines) else None

    @cached_property
    def columns(self) -> tuple[list[Sequence[str]], Sequence[int]]:
        """The columns as text, and the line of every row. Errors: DataError for a row of another width."""
        rows: list[list[str]] = []
        numbers: list[int] = []
        for number, row in self._rows():
            if len(row) == self.width:
                rows.append(row)
                numbers.append(number)
            elif not row[0].lstrip().startswith("#"):
                raise DataError(self._other_width(row, number), self.path, number)
        if not rows:
            return [[] for _ in range(self.width)], numbers
        return [list(column) for column in zip(*rows, strict=True)], numbers

    def _rows(self) -> Iterator[tuple[int, list[str]]]:
        """Fields of every line that is not blank, with its number."""
        if self.separator is None or not any('"' in line for line in self.lines):
            for number, line in enumerate(self.lines, start=self.first):
                if line.strip():
                    yield number, line.split(self.separator)
            return
        reader = csv.reader((f"{line}\n" for line in self.lines), delimiter=self.separator, strict=True)
        try:
            for row in reader:
                if row and not (len(row) == 1 and not row[0].strip()):
                    yield self.first - 1 + reader.line_num, row
        except csv.Error as error:
            number = self.first - 1 + reader.line_num
            raise DataError(f"is not well-formed CSV ({error})", self.path, number) from error

    def _other_width(self, row: Sequence[str], number: int) -> str:
        hint = ""
        if self.cut_off and number == self.first + len(self.lines) - 1:
            hint = CUT_OFF_HINT
        elif self.separator == "," and len(row) > self.width:
            hint = " (decimal commas? Then separate the columns by semicolons or tabs)"
        return f"got {len(row)} columns, expected {self.width}{hint}"


def _header(lines: Sequence[str], path: Path, example: str) -> tuple[int, str]:
    """Line (from 1) and text of the header: the first line that is no comment, or one above numbers."""
    comment = ""
    for number, line in enumerate(lines, start=1):
        if not line.strip():
            continue
        if line.startswith("#"):
            comment = line.lstrip("# \t")
            continue
        fields = _fields(line, _separator(line))
        if not all(is_number(_with_point(value)) for value in fields):
            return number, line
        if len(_fields(comment, _separator(comment))) == len(fields):
            return number - 1, comment
        message = f"got numbers, expected a header that names the columns: put {example} above them"
        raise DataError(message, path, number)
    raise DataError(f"is empty, expected a header line such as {example}", path, 1)


def _separator(header: str) -> str | None:
    """What stands between columns; None for any number of blanks and tabs."""
    for separator in ("\t", ";", ",", "|"):
        if separator in header:
            return None if separator == "\t" and "\t\t" in header.strip() else separator
    return None


def _fields(line: str, separator: str | None) -> list[str]:
    if separator is None:
        # A unit in brackets belongs to the name before it.
        return re.sub(r"\s+(?=[\[(])", "", line).split()
    if '"' in line:
        return next(csv.reader([line], delimiter=separator), [])
    return line.split(separator)


def _checked_names(fields: list[str], path: Path, line: int) -> list[str]:
    names = [name.strip() for name in fields]
    repeated = next((name for name in names if names.count(name) > 1), None)
    if repeated is not None:
        raise DataError(f"column {repeated or '(no name)'} appears more than once", path, line)
    return names


def _floats(texts: Sequence[str]) -> Floats | None:
    """Numbers with decimal points or with decimal commas, not with both; None if one is no number."""
    if "_" in "".join(texts):
        return None
    try:
        return np.fromiter(map(float, texts), dtype=np.float64, count=len(texts))
    except ValueError:
        if any("." in text for text in texts):
            return None
    try:
        return np.fromiter((float(_with_point(text)) for text in texts), dtype=np.float64, count=len(texts))
    except ValueError:
        return None


def _with_point(text: str) -> str:
    """A number with a decimal comma, with a point instead."""
    return text.replace(",", ".") if text.count(",") == 1 and "." not in text else text

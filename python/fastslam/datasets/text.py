"""Reading text tables: fast when they are well formed, with the file and line of the fault when not."""

from __future__ import annotations

import gzip
import io
import zlib
from pathlib import Path

import numpy as np

from ..errors import DataError
from ..log import Floats, Ints

_GZIP = b"\x1f\x8b"
# The mark of UTF-32 begins as that of UTF-16 does.
_MARKS = (
    (b"\xff\xfe\0\0", "utf-32"),
    (b"\0\0\xfe\xff", "utf-32"),
    (b"\xff\xfe", "utf-16"),
    (b"\xfe\xff", "utf-16"),
    (b"\xef\xbb\xbf", "utf-8-sig"),
)
_SPREADSHEETS = (b"PK\x03\x04", b"\xd0\xcf\x11\xe0")
"""How files of .xlsx and .ods, and of .xls, begin."""
_WESTERN_SIGNS = frozenset("°²³µ±·×–—‘’“”€§")
"""Signs beside letters that tables in Windows-1252 hold: units, and what stands in names."""
_HEAD_BYTES = 4096
LARGEST_WHOLE = 2.0**53
"""From here on a float is not the one whole number that was written."""
CUT_OFF_HINT = " (the last line has no line end: the file seems cut off)"


def find_file(folder: Path, name: str) -> Path | None:
    """The file of that name in a folder, or its gzip-compressed form, or None."""
    for candidate in (folder / name, folder / f"{name}.gz"):
        if candidate.is_file():
            return candidate
    return None


def children(folder: Path) -> list[Path]:
    """What is in a folder, in order; nothing where it cannot be read."""
    try:
        return sorted(folder.iterdir())
    except OSError:
        return []


def require_file(folder: Path, name: str) -> Path:
    """Like `find_file`. Errors: DataError when there is neither form."""
    found = find_file(folder, name)
    if found is None:
        raise DataError(f"the file {name} (or {name}.gz) is missing", folder)
    return found


def read_text(path: Path) -> str:
    """The text of a file in UTF-8 or, where that shows, UTF-16; plain or gzip-compressed; without mark.

    Errors: DataError for a file that cannot be opened, is cut off or is not text.
    """
    return _decoded(read_bytes(path), path)


def read_sheet(path: Path) -> tuple[str, tuple[str, ...]]:
    """As `read_text`, or in Windows-1252, as spreadsheets save tables; then a note says so."""
    data = read_bytes(path)
    if data.startswith(_SPREADSHEETS):
        raise DataError("is a spreadsheet by another name: save the sheet as CSV", path)
    try:
        return _decoded(data, path), ()
    except DataError:
        text = _western(data)
        if text is None:
            raise
        return text, (f"{path.name}: is not UTF-8, taken as Windows-1252",)


def _decoded(data: bytes, path: Path) -> str:
    encoding = next((name for mark, name in _MARKS if data.startswith(mark)), "utf-8")
    if encoding == "utf-8" and b"\0" in data[:2]:
        encoding = "utf-16-be" if data[:1] == b"\0" else "utf-16-le"
    try:
        return data.decode(encoding)
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        message = f"is not {encoding[:6].upper().rstrip('-')} text: save it as UTF-8"
        raise DataError(message, path, line) from error


def _western(data: bytes) -> str | None:
    """Text of Windows-1252, if it is: nearly all bytes are, so letters and a few signs count alone."""
    try:
        text = data.decode("cp1252")
    except UnicodeDecodeError:
        return None
    strange = set(text) - set(map(chr, range(32, 127))) - set("\t\r\n")
    return text if all(sign.isalpha() or sign in _WESTERN_SIGNS for sign in strange) else None


def read_bytes(path: Path) -> bytes:
    """The content of a file, unpacked where it is gzip-compressed, whatever its name. Errors: DataError."""
    try:
        data = path.read_bytes()
        return gzip.decompress(data) if data.startswith(_GZIP) or path.suffix == ".gz" else data
    except (EOFError, zlib.error, gzip.BadGzipFile) as error:
        raise DataError(f"the gzip file is damaged or cut off ({error})", path) from error
    except OSError as error:
        raise DataError(f"cannot be read ({error.strerror})", path) from error


def first_words(path: Path) -> list[str]:
    """Words of the first line of a text file that is neither blank nor a comment, unpacked; empty for others.

    It looks at the beginning only, and raises nothing.
    """
    try:
        with path.open("rb") as opened:
            packed = opened.read(2) == _GZIP
        with gzip.open(path) if packed else path.open("rb") as file:
            head = file.read(_HEAD_BYTES).decode("ascii", errors="replace")
    except (OSError, EOFError, zlib.error):
        return []
    lines = (line for line in head.splitlines() if line.strip() and not line.startswith("#"))
    return next(lines, "").split()


def read_table(path: Path, columns: int, *, delimiter: str | None = None, header_lines: int = 0) -> Floats:
    """A table of numbers; `#` starts a comment and blank lines are skipped.

    Shapes: (rows, columns). Without `delimiter`, columns are separated by spaces and tabs. Errors: DataError
    with the line of the first value that is no number or row of another width, or for no rows at all.
    """
    text = read_text(path)
    lines = text.splitlines()[header_lines:]
    filled = [line for line in lines if line.strip() and not line.lstrip().startswith("#")]
    if not filled:
        raise DataError("holds no rows of data", path)
    try:
        table = np.loadtxt(io.StringIO("\n".join(filled)), ndmin=2, delimiter=delimiter)
    except ValueError as error:
        raise _first_fault(path, text, columns, delimiter, header_lines) from error
    if table.shape[1] != columns:
        raise _first_fault(path, text, columns, delimiter, header_lines)
    return table


def line_of_row(path: Path, row: int, *, header_lines: int = 0) -> int:
    """Line of the file, from 1, that holds row `row` (from 0) of the table that `read_table` gives."""
    lines = read_text(path).splitlines()
    filled = [
        number
        for number, line in enumerate(lines[header_lines:], start=header_lines + 1)
        if line.split("#", 1)[0].strip()
    ]
    return filled[row]


def whole_numbers(path: Path, column: Floats) -> Ints:
    """A column of `read_table` as integers. Errors: DataError with the line of the first that is none."""
    whole = (np.abs(column) < LARGEST_WHOLE) & (column == np.round(column))
    if not whole.all():
        row = int(np.argmin(whole))
        message = f"got '{column[row]:g}', expected a whole number"
        raise DataError(message, path, line_of_row(path, row))
    return column.astype(np.int64)


def refuse_not_finite(path: Path, table: Floats) -> None:
    """Refuses NaN and infinities in a table of `read_table`. Errors: DataError with the line of the first."""
    bad = ~np.isfinite(table).all(axis=1)
    if bad.any():
        row = int(np.argmax(bad))
        raise DataError("got NaN or infinite values, expected numbers", path, line_of_row(path, row))


def _first_fault(path: Path, text: str, columns: int, delimiter: str | None, header_lines: int) -> DataError:
    lines = text.splitlines()
    for number, line in enumerate(lines[header_lines:], start=header_lines + 1):
        content = line.split("#", 1)[0]
        if not content.strip():
            continue
        fields = content.split(delimiter)
        if len(fields) != columns:
            hint = CUT_OFF_HINT if number == len(lines) and not text.endswith("\n") else ""
            return DataError(f"got {len(fields)} columns, expected {columns}{hint}", path, number)
        for column_number, value in enumerate(fields, start=1):
            if not is_number(value):
                return DataError(f"column {column_number}: got '{value}', expected a number", path, number)
    return DataError(f"is no table of {columns} columns of numbers", path)


def is_number(value: str) -> bool:
    """Whether a field reads as a floating-point number (NaN and infinity included, Python's `1_000` not)."""
    try:
        float(value)
    except ValueError:
        return False
    return "_" not in value

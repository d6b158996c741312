"""MATLAB files: matrices of numbers by name, whatever the file holds.

SciPy reads them, and takes their tags at their word: a damaged one ends the process. So the tags are looked
at first.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Any

from ..errors import DataError

_HEADER_BYTES = 128
_MATRIX, _COMPRESSED = 14, 15
_NUMBER_TYPES = frozenset((1, 2, 3, 4, 5, 6, 7, 9, 12, 13))
"""Element types that hold numbers: integers of 1 to 8 bytes, floats of 4 and 8."""
_NUMBER_CLASSES = range(6, 16)
"""Classes of matrices of numbers: doubles to unsigned integers of 8 bytes."""
_MOST_BYTES = 2**31


def read_matrices(path: Path, names: Collection[str]) -> dict[str, Any]:
    """The matrices of these names that the file holds. Errors: DataError for a damaged file."""
    import scipy.io

    try:
        data = path.read_bytes()
        if _is_version_5(data):
            _check(data, names)
        content: dict[str, Any] = scipy.io.loadmat(path, variable_names=list(names))
    except Exception as error:  # SciPy raises errors of a dozen kinds for a damaged file
        reason = " ".join(str(error).split())
        raise DataError(f"is no readable MATLAB file, damaged or cut off ({reason})", path) from error
    return content


def names_in(path: Path) -> frozenset[str]:
    """Names of what the file holds; none where it is no MATLAB file. Raises nothing."""
    import scipy.io

    try:
        return frozenset(name for name, _, _ in scipy.io.whosmat(path))
    except Exception:  # as above
        return frozenset()


def files_with(path: Path, names: Collection[str]) -> list[Path]:
    """The MATLAB files of a folder, or the file itself, that hold all of these names."""
    files = [path] if path.is_file() else sorted(path.glob("*.mat"))
    return [file for file in files if file.suffix == ".mat" and names_in(file) >= set(names)]


def _is_version_5(data: bytes) -> bool:
    return data[126:128] in (b"IM", b"MI")


def _check(data: bytes, names: Collection[str]) -> None:
    """Errors (ValueError) for a matrix of these names whose tags are not those of a matrix of numbers."""
    order = "<" if data[126:128] == b"IM" else ">"
    for kind, body in _elements(data[_HEADER_BYTES:], order):
        if kind == _COMPRESSED:
            kind, body = next(_elements(_unpacked(body), order), (0, b""))
        if kind != _MATRIX:
            raise ValueError(f"an element of type {kind}, expected a matrix")
        _check_matrix(body, order, names)


def _check_matrix(body: bytes, order: str, names: Collection[str]) -> None:
    parts = list(_elements(body, order))
    if len(parts) < 3 or len(parts[0][1]) < 8:
        raise ValueError("a matrix without header")
    (flags,) = struct.unpack_from(order + "I", parts[0][1])
    if parts[2][1].decode("latin-1") not in names:
        return
    if flags & 0xFF not in _NUMBER_CLASSES:
        raise ValueError(f"a matrix of class {flags & 0xFF}, expected numbers")
    values = parts[3:]
    if len(values) != 1:
        raise ValueError(f"a matrix of {len(values)} parts, expected real numbers")
    if any(kind not in _NUMBER_TYPES for kind, _ in values):
        raise ValueError("a matrix of elements that are no numbers")


def _elements(data: bytes, order: str) -> Iterator[tuple[int, bytes]]:
    """Type and content of each element, one after the other."""
    at = 0
    while at + 8 <= len(data):
        kind, size = struct.unpack_from(order + "II", data, at)
        if kind >> 16:  # a small one: size and type share a word, the content is the other
            kind, size, start, step = kind & 0xFFFF, kind >> 16, at + 4, 8
            if size > 4:
                raise ValueError("a small element of more than four bytes")
        else:
            start = at + 8
            step = 8 + (size if kind == _COMPRESSED else -(-size // 8) * 8)
        if start + size > len(data):
            raise ValueError("an element is longer than what holds it")
        yield kind, data[start : start + size]
        at += step


def _unpacked(packed: bytes) -> bytes:
    unpacking = zlib.decompressobj()
    data = unpacking.decompress(packed, _MOST_BYTES)
    if unpacking.unconsumed_tail:
        raise ValueError(f"a matrix of more than {_MOST_BYTES} bytes")
    return data

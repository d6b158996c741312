"""Rows of the text formats of pose graphs: a word that says what a row is, names, numbers, and its noise."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from enum import Enum
from pathlib import Path

from ..errors import DataError
from ..limits import LARGEST_MAGNITUDE
from .text import CUT_OFF_HINT, is_number, read_text

PAGE = "docs/formats.md"
STAMP_COMMENT = "# stamp_s "
"""Begins a comment with the stamp of the pose in the next row, which these formats have no place for."""
NAME_COMMENT = "# landmark_id "
"""The same with the name of a landmark, where it has more than a number."""


class Kind(Enum):
    """What a row says."""

    POSE = "pose"
    LANDMARK = "landmark"
    MOTION = "motion"
    POINT = "point"
    """Where a landmark is in the frame of a pose, as x and y."""
    POLAR = "polar"
    """The same as bearing and range."""
    BEARING = "bearing"
    RANGE = "range"
    IGNORED = "ignored"


@dataclass(frozen=True)
class Shape:
    """A kind of row with its number of names, of values, and of entries of noise, which may be missing."""

    kind: Kind
    names: int = 0
    values: int = 0
    noise: int = 0


@dataclass(frozen=True)
class Row:
    """One row; `noise` is empty where the file gives none, `stamp_s` is NaN where it has none."""

    line: int
    tag: str
    kind: Kind
    names: tuple[str, ...]
    values: tuple[float, ...]
    noise: tuple[float, ...]
    stamp_s: float = math.nan
    label: str = ""
    """The name of a landmark in words."""


IN_SPACE: tuple[str, ...] = (
    "VERTEX_SE3:QUAT",
    "EDGE_SE3:QUAT",
    "VERTEX_SE3",
    "EDGE_SE3",
    "VERTEX3",
    "EDGE3",
    "VERTEX_XYZ",
)
IN_SPACE += ("VERTEX_TRACKXYZ", "EDGE_SE3_XYZ", "EDGE_SE3_TRACKXYZ")


def read_rows(path: Path, shapes: Mapping[str, Shape], *, format: str, stamped: bool = False) -> list[Row]:
    """All rows but ignored ones; with `stamped` a stamp follows the word of all but landmarks.

    Errors: DataError with the line for an unknown word, another number of columns, or a field that is no
    finite number. The message names the format, and the page that says how to convert.
    """
    rows: list[Row] = []
    text = read_text(path)
    lines = text.splitlines()
    stamp_s, label = math.nan, ""
    for number, line in enumerate(lines, start=1):
        fields = line.split()
        if not fields or line.startswith("#"):
            if line.startswith(STAMP_COMMENT) and is_number(line[len(STAMP_COMMENT) :]):
                stamp_s = float(line[len(STAMP_COMMENT) :])
            if line.startswith(NAME_COMMENT):
                label = line[len(NAME_COMMENT) :].strip()
            continue
        shape = shapes.get(fields[0])
        if shape is None:
            raise unusable(path, format, _unknown(fields[0], shapes), number)
        if shape.kind is Kind.IGNORED:
            continue
        try:
            row = _row(fields, number, shape, stamped, stamp_s)
            rows.append(replace(row, label=label) if label else row)
        except ValueError as error:
            hint = CUT_OFF_HINT if number == len(lines) and not text.endswith("\n") else ""
            raise unusable(path, format, f"{fields[0]}: {error}{hint}", number) from None
        stamp_s, label = math.nan, ""
    return rows


def unusable(path: Path, format: str, message: str, line: int | None = None) -> DataError:
    """The error of a file of a known format that cannot be used, with the page that says how to convert."""
    return DataError(f"{message} ({format} file; see {PAGE})", path, line)


def _unknown(tag: str, shapes: Mapping[str, Shape]) -> str:
    if tag in IN_SPACE:
        return f"{tag} is of a graph in space, and only the plane is supported"
    known = ", ".join(name for name, shape in shapes.items() if shape.kind is not Kind.IGNORED)
    return f"got row '{tag}', expected one of {known}"


def _row(fields: list[str], line: int, shape: Shape, stamped: bool, stamp_s: float) -> Row:
    """One row. ValueError with what is wrong."""
    rest = fields[1:]
    if stamped and shape.kind is not Kind.LANDMARK:
        stamp_s = _numbers(rest[:1], 1)[0]
        rest = rest[1:]
    names, rest = tuple(rest[: shape.names]), rest[shape.names :]
    if len(rest) not in (shape.values, shape.values + shape.noise):
        without = len(fields) - len(rest) + shape.values
        either = f" or {without + shape.noise}" if shape.noise else ""
        raise ValueError(f"got {len(fields)} columns, expected {without}{either}")
    numbers = _numbers(rest, len(rest))
    values, noise = numbers[: shape.values], numbers[shape.values :]
    return Row(line, fields[0], shape.kind, names, values, noise, stamp_s)


def _numbers(texts: list[str], count: int) -> tuple[float, ...]:
    if len(texts) < count:
        raise ValueError("got too few columns")
    for text in texts:
        if not is_number(text) or not math.isfinite(float(text)):
            raise ValueError(f"got '{text}', expected a finite number")
        if abs(float(text)) > LARGEST_MAGNITUDE:
            raise ValueError(f"got '{text}', expected at most {LARGEST_MAGNITUDE:g}")
    return tuple(float(text) for text in texts)

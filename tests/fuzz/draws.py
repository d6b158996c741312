"""Values that hurt, and changes of files."""

from __future__ import annotations

import gzip
import math
import re
from collections.abc import Callable
from random import Random
from typing import Any

import numpy as np

WILD_NUMBERS = (
    *(
        0.0,
        -0.0,
        1.0,
        -1.0,
        0.5,
        -0.5,
        2.0,
        1e-3,
        1e-9,
        1e-30,
        1e-300,
        5e-324,
        3.2,
        -3.2,
        6.3,
        12.6,
        45.0,
        -180.0,
    ),
    *(
        1e3,
        -1e3,
        1e6,
        -1e6,
        1e9,
        1e11,
        -1e11,
        1e12,
        1.7643132e9,
        1.7643132e18,
        1e30,
        -1e30,
        1e154,
        1e200,
        1e300,
    ),
    *(1.7e308, -1.7e308, math.inf, -math.inf, math.nan),
)
WILD_TEXTS = (
    *(
        "",
        " ",
        "nan",
        "inf",
        "-inf",
        "none",
        "null",
        "-1",
        "0",
        "1",
        "7",
        "1e999",
        "-1e999",
        "1e-999",
        "1e400",
        "0x10",
    ),
    *(
        "1_000",
        "1,5",
        "1.5.5",
        "--3",
        "+",
        ".",
        "e5",
        "9" * 400,
        "0." + "0" * 400 + "1",
        "½",
        "٣",
        "−1",
        "1e",
        "true",
    ),
    *(
        "2026-11-28T12:00:00Z",
        "2026-11-28 12:00:00",
        "oak",
        "L1",
        "oak#2",
        "=1+1",
        "'",
        '"',
        '"a',
        "a\x00b",
        "#",
        "//",
    ),
    *(
        "\ufeff",
        "é",
        "\u2028",
        "\r",
        "\t",
        ";",
        ",",
        "a b",
        "[",
        "{",
        "&a",
        "*a",
        "!!int x",
        "%",
        "~",
        "😀",
        "\udcff",
    ),
)
WILD_OBJECTS: tuple[Any, ...] = (
    *(
        None,
        True,
        False,
        "",
        "1",
        "nan",
        "x",
        b"1",
        [],
        [[]],
        [[1.0]],
        {},
        {"a": 1},
        (1.0,),
        1j,
        object(),
        10**400,
    ),
    *(
        -(2**63),
        2**63,
        2**64,
        np.nan,
        np.float32(1.5),
        np.int64(-1),
        np.uint8(3),
        np.bool_(True),
        np.zeros(0),
    ),
    *(
        np.zeros((2, 2)),
        np.array([1, 2], dtype=object),
        np.array(["a", "b"]),
        np.array([1 + 1j]),
        np.array(3.0),
    ),
    *(
        np.datetime64("2026-11-28"),
        np.ma.masked,
        float,
        len,
        range(3),
        iter(()),
        set(),
        [None],
        ["1", 2],
        [10**400],
    ),
)
NUMBER = re.compile(rb"[-+]?\d+\.?\d*(?:[eE][-+]?\d+)?")
WORD = re.compile(rb"[A-Za-z_][A-Za-z_0-9]*")
LARGEST = 200_000
"""Bytes beyond which a file is not made longer."""


def wild_number(rng: Random, *, near: float = 1.0) -> float:
    """A number: as likely as not of the usual size."""
    kind = rng.random()
    if kind < 0.4:
        return rng.gauss(0.0, 1.0) * near
    if kind < 0.5:
        return 10.0 ** rng.uniform(-320.0, 308.0) * rng.choice((1.0, -1.0))
    return rng.choice(WILD_NUMBERS)


def wild_text(rng: Random) -> str:
    """A cell, a name or a word."""
    if rng.random() < 0.5:
        return rng.choice(WILD_TEXTS)
    if rng.random() < 0.7:
        return repr(wild_number(rng))
    return "".join(
        chr(rng.choice((rng.randrange(1, 128), rng.randrange(128, 0x3000)))) for _ in range(rng.randrange(9))
    )


def encoded(text: str) -> bytes:
    """The text in a file, with what is no text as the bytes that it stands for."""
    return text.encode("utf-8", "surrogateescape")


def _replaced(rng: Random, data: bytes, pattern: re.Pattern[bytes]) -> bytes:
    found = list(pattern.finditer(data))
    if not found:
        return data + encoded(wild_text(rng))
    chosen = rng.choice(found)
    new = encoded(wild_text(rng)) if rng.random() < 0.7 else rng.choice(found).group()
    return data[: chosen.start()] + new + data[chosen.end() :]


def _number(rng: Random, data: bytes) -> bytes:
    return _replaced(rng, data, NUMBER)


def _word(rng: Random, data: bytes) -> bytes:
    return _replaced(rng, data, WORD)


def _bytes(rng: Random, data: bytes) -> bytes:
    at = rng.randrange(len(data) + 1)
    drop = rng.choice((0, 0, 1, 3, 40))
    return data[:at] + rng.randbytes(rng.choice((0, 1, 1, 2, 8))) + data[at + drop :]


def _cut(rng: Random, data: bytes) -> bytes:
    return data[: rng.randrange(len(data) + 1)]


def _lines(rng: Random, data: bytes) -> bytes:
    lines = data.splitlines(keepends=True) or [b""]
    at, other = rng.randrange(len(lines)), rng.randrange(len(lines))
    kind = rng.randrange(5)
    if kind == 0:
        del lines[at]
    elif kind == 1:
        lines.insert(other, lines[at])
    elif kind == 2:
        lines[at], lines[other] = lines[other], lines[at]
    elif kind == 3 and len(data) < LARGEST:
        lines[at : at + 1] = [lines[at]] * rng.choice((2, 3, 50))
    else:
        lines.insert(at, encoded(wild_text(rng)) + rng.choice((b"\n", b"\r\n", b"\r")))
    return b"".join(lines)


def _column(rng: Random, data: bytes) -> bytes:
    """One number of every line times a factor, or set to a value: units, constants."""
    nth, factor = rng.randrange(6), rng.choice((1e3, 1e-3, -1.0, 0.0, 57.3, 1e9, 1e300, math.nan))
    lines = []
    for line in data.splitlines(keepends=True):
        found = list(NUMBER.finditer(line))
        if len(found) > nth:
            at = found[nth]
            line = line[: at.start()] + repr(float(at.group()) * factor).encode() + line[at.end() :]
        lines.append(line)
    return b"".join(lines)


def _marks(rng: Random, data: bytes) -> bytes:
    old, new = rng.sample((b",", b";", b"\t", b" ", b"|", b".", b"\n", b"\r\n", b":", b'"', b"-"), 2)
    return data.replace(old, new)


def _coded(rng: Random, data: bytes) -> bytes:
    kind = rng.randrange(5)
    if kind == 0:
        return gzip.compress(data, 1)
    text = data.decode("utf-8", "replace")
    return text.encode(("utf-16", "utf-8-sig", "utf-16-le", "utf-32")[kind - 1])


def _nothing(rng: Random, data: bytes) -> bytes:
    return rng.choice((b"", b"\n", b"\x00" * 16, data + data))


TEXT_CHANGES: tuple[Callable[[Random, bytes], bytes], ...] = (
    *(
        _number,
        _number,
        _number,
        _number,
        _number,
        _number,
        _word,
        _word,
        _lines,
        _lines,
        _lines,
        _column,
        _column,
    ),
    *(_bytes, _bytes, _cut, _marks, _coded, _nothing),
)
BINARY_CHANGES: tuple[Callable[[Random, bytes], bytes], ...] = (_bytes, _bytes, _bytes, _cut, _nothing)


def changed(rng: Random, data: bytes, *, binary: bool = False) -> bytes:
    """A file after one to three changes."""
    for _ in range(rng.choice((1, 1, 1, 2, 3))):
        data = rng.choice(BINARY_CHANGES if binary else TEXT_CHANGES)(rng, data)
    return data[:LARGEST]

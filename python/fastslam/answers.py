"""What classes of users answer: copied, of the shape that was asked for, or in one line what is wrong."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .errors import ModelError
from .log import Floats

Given = Sequence[tuple[str, Floats]]
"""What was asked, array by array with what it holds; of equal lengths."""


def checked(who: str, answer: ArrayLike, shape: tuple[int, ...], given: Given = ()) -> Floats:
    """A copy of an answer. Errors: `ModelError` for another shape, or what is no number."""
    try:
        array: NDArray[np.float64] = np.array(answer, dtype=np.float64)
    except (TypeError, ValueError):
        raise ModelError(f"{who}: got what is no array of numbers, expected {shape_text(shape)}") from None
    if array.shape != shape:
        raise ModelError(f"{who}: got shape {array.shape}, expected {shape_text(shape)}")
    if not np.isfinite(array).all():
        row = int(np.argwhere(~np.isfinite(array))[0][0])
        asked = ", ".join(f"{what} {np.round(rows[row], 6).tolist()}" for what, rows in given)
        of = f" ({asked})" if asked else ""
        raise ModelError(f"{who}: row {row}{of} is not finite, expected numbers for every row")
    return array


@contextmanager
def in_one_line(who: str) -> Iterator[None]:
    """Whatever the user's class raises, as a `ModelError` that names the method."""
    try:
        yield
    except Exception as error:
        text = " ".join(str(error).split())
        raise ModelError(f"{who}: {type(error).__name__}: {text}") from error


def read_only(*arrays: Floats) -> tuple[Floats, ...]:
    """Views that a user's class cannot change."""
    views = tuple(array.view() for array in arrays)
    for view in views:
        view.flags.writeable = False
    return views


def shape_text(shape: tuple[int, ...]) -> str:
    """A shape as messages have it, with K where the class chooses."""
    return str(shape).replace("-1", "K")

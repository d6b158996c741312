"""Numbers that a caller gives, as arrays; what is none is an error of the package."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .errors import DataError
from .log import Floats

_KINDS = "biufUO"
"""Booleans, integers, floats; texts and objects where each reads as a float."""


def numbers(name: str, values: ArrayLike) -> Floats:
    """An array of the same shape, always a copy. Errors: `DataError` that names it."""
    try:
        given: NDArray[Any] = np.asarray(values)
        if given.dtype.kind not in _KINDS:
            raise TypeError
        return np.array(given, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        raise DataError(f"{name}: expected numbers, got {shown(values)}") from None


def shown(value: object) -> str:
    """A value in a message: on one line, and not too long."""
    text = " ".join(repr(value).split())
    return text if len(text) <= 60 else text[:57] + "..."

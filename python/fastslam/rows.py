"""Rows of a stream, kept to be given to another one."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from . import _core


@dataclass(frozen=True)
class Row:
    """A row that a stream has taken, to be given to another one."""

    kind: Literal["odometry", "sightings"]
    stamp_s: float
    values: tuple[Any, ...]

    def put(self, stream: _core.Stream) -> str:
        """Gives it to a stream; what became of it."""
        if self.kind == "odometry":
            return stream.odometry(self.stamp_s, *self.values)
        columns: _core._ScanColumns = self.values
        return stream.sightings(self.stamp_s, columns)

    def to_json(self) -> list[Any]:
        """As lists and numbers."""
        values = [value.tolist() if isinstance(value, np.ndarray) else value for value in self.values]
        return [self.kind, self.stamp_s, values]

    @classmethod
    def of_json(cls, kept: list[Any]) -> Row:
        """The inverse of `to_json`."""
        kind, stamp_s, values = kept
        if kind == "odometry":
            return cls("odometry", stamp_s, tuple(values))
        integers = (2, 4)
        columns = [
            None if value is None else np.array(value, dtype=np.int64 if place in integers else np.float64)
            for place, value in enumerate(values)
        ]
        if columns[3] is not None:
            columns[3] = columns[3].reshape(-1, 3)
        return cls("sightings", stamp_s, tuple(columns))

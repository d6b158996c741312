"""Logs from arrays in memory, checked as files are."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ._given import numbers, shown
from .errors import DataError
from .identity import nobody_knows
from .limits import DEGREES_HINT, LARGEST_BEARING_RAD, LARGEST_STAMP_S, stamp_fault
from .log import Controls, Floats, Ints, Log, Sightings

_SOURCE = "arrays"


def log_from_arrays(
    controls: tuple[ArrayLike, ArrayLike],
    sightings: tuple[ArrayLike, ArrayLike, ArrayLike] | tuple[ArrayLike, ArrayLike],
    *,
    identities: Sequence[object] | None = None,
    config: Mapping[str, Any] | None = None,
    name: str = "arrays",
) -> Log:
    """See `Log.from_arrays`."""
    stamps, table = _parts("controls", controls, ("stamp_s", "values"))
    stamp_s, values = _stamps("controls", stamps), _table("controls: values", table)
    if len(stamp_s) != len(values):
        raise DataError(f"controls: got {len(stamp_s):,} stamps and {len(values):,} rows of values")
    if np.any(np.diff(stamp_s) <= 0.0):
        row = int(np.flatnonzero(np.diff(stamp_s) <= 0.0)[0]) + 1
        raise DataError(f"controls: stamp_s must grow, but row {row} ({stamp_s[row]:g}) does not")
    names: tuple[str, ...] = ("stamp_s", "range_m", "bearing_rad")
    sensor = (config or {}).get("sensor")
    ranges_alone = isinstance(sensor, Mapping) and sensor.get("model") == "range"
    names = names[:2] if ranges_alone else names
    seen_stamps, *rest = _parts("sightings", sightings, names)
    columns = [_stamps("sightings", seen_stamps)]
    columns += [_column(f"sightings: {key}", value) for key, value in zip(names[1:], rest, strict=True)]
    given = [None] * len(columns[0]) if identities is None else _listed("identities", identities)
    lengths = {len(column) for column in (*columns, given)}
    if len(lengths) > 1:
        raise DataError(f"sightings: arrays and identities must be of one length, got {sorted(lengths)}")
    if np.any(columns[1] < 0.0):
        row = int(np.flatnonzero(columns[1] < 0.0)[0])
        raise DataError(f"sightings: range_m must not be negative, but row {row} is {columns[1][row]:g}")
    if ranges_alone:
        columns.append(np.full(len(columns[1]), np.nan))
    if np.any(np.abs(columns[2]) > LARGEST_BEARING_RAD):
        raise DataError(f"sightings: bearing_rad: {DEGREES_HINT}")
    order = np.argsort(columns[0], kind="stable")
    identity, known = _identities(given)
    seen = Sightings(
        stamp_s=columns[0][order],
        range_m=columns[1][order],
        bearing_rad=columns[2][order],
        identity=identity[order],
        class_index=np.full(len(order), -1, dtype=np.int64),
        signature=np.full(len(order), np.nan),
    )
    return Log(name, _SOURCE, "native", Controls(stamp_s, values), seen, known, config=dict(config or {}))


def _parts(what: str, given: object, names: tuple[str, ...]) -> list[Any]:
    """The columns of a tuple. Errors: `DataError` where there are more or fewer than these."""
    parts = _listed(what, given)
    if len(parts) != len(names):
        raise DataError(f"{what}: got {len(parts)} arrays, expected {', '.join(names)}")
    return parts


def _listed(what: str, given: object) -> list[Any]:
    # An array without dimensions is iterable by its type alone.
    if not isinstance(given, Iterable) or getattr(given, "ndim", 1) == 0:
        raise DataError(f"{what}: got {shown(given)}, expected a sequence")
    return list(given)


def _stamps(what: str, values: ArrayLike) -> Floats:
    stamp_s = _column(f"{what}: stamp_s", values)
    beyond = np.flatnonzero(np.abs(stamp_s) >= LARGEST_STAMP_S)
    if len(beyond):
        raise DataError(f"{what}: stamp_s: row {beyond[0]}: {stamp_fault(float(stamp_s[beyond[0]]))}")
    return stamp_s


def _column(name: str, values: ArrayLike) -> Floats:
    return _finite(name, values, dimensions=1)


def _table(name: str, values: ArrayLike) -> Floats:
    table = _finite(name, values, dimensions=2)
    if table.shape[1] not in (2, 3):
        raise DataError(f"{name}: got {table.shape[1]} columns, expected 2 or 3")
    return table


def _finite(name: str, values: ArrayLike, *, dimensions: int) -> Floats:
    array = numbers(name, values)
    if array.ndim != dimensions:
        raise DataError(f"{name}: got an array of shape {array.shape}, expected {dimensions} dimension(s)")
    bad = np.argwhere(~np.isfinite(array))
    if len(bad):
        raise DataError(f"{name}: row {bad[0][0]} is not finite")
    return array


def _identities(given: Sequence[object]) -> tuple[Ints, tuple[str, ...]]:
    """Indices and names in the order of appearance; None, NaN and `NOBODY_KNOWS` stand for unknown."""
    texts = [None if value is None or nobody_knows(str(value)) else str(value) for value in given]
    names = tuple(dict.fromkeys(text for text in texts if text is not None))
    index = {name: number for number, name in enumerate(names)}
    return np.array([-1 if text is None else index[text] for text in texts], dtype=np.int64), names

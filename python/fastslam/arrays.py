"""Logs from arrays in memory, checked as files are."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ._given import numbers, shown
from .errors import DataError
from .identity import nobody_knows
from .limits import DEGREES_HINT, LARGEST_BEARING_RAD, LARGEST_STAMP_S, stamp_fault
from .log import Controls, Floats, Ints, Log, Sightings
from .measured import BOTH, measured_by_sensor, measured_columns, measured_rows

_SOURCE = "arrays"


def log_from_arrays(
    controls: tuple[ArrayLike, ArrayLike],
    sightings: tuple[ArrayLike, ArrayLike, ArrayLike] | tuple[ArrayLike, ArrayLike],
    *,
    names: tuple[Sequence[object] | None, Sequence[object] | None] = (None, None),
    config: Mapping[str, Any] | None = None,
    name: str = "arrays",
) -> Log:
    """See `Log.from_arrays`; `names` are those of landmarks and of sensors."""
    stamp_s, values = checked_controls(controls)
    if values.shape[1] not in (2, 3):
        raise DataError(f"controls: values: got {values.shape[1]} columns, expected 2 or 3")
    sensor = (config or {}).get("sensor")
    measures = measured_columns(sensor.get("model") if isinstance(sensor, Mapping) else None)
    keys = ("stamp_s", *measures)
    seen_stamps, *rest = _parts("sightings", sightings, keys)
    columns = [_stamps("sightings", seen_stamps)]
    by_sensor = measured_by_sensor(config or {})
    finite = all(tuple(measured) == BOTH for measured in by_sensor.values())
    columns += [
        _column(f"sightings: {key}", value, finite=finite) for key, value in zip(keys[1:], rest, strict=True)
    ]
    given, makers = (
        [None] * len(columns[0]) if column is None else _listed(what, column)
        for what, column in zip(("identities", "sensors"), names, strict=True)
    )
    lengths = {len(column) for column in (*columns, given, makers)}
    if len(lengths) > 1:
        raise DataError(f"sightings: arrays and identities must be of one length, got {sorted(lengths)}")
    measured = dict(zip(measures, columns[1:], strict=True))
    nothing = np.full(len(columns[0]), np.nan)
    range_m, bearing_rad = (measured.get(column, nothing) for column in ("range_m", "bearing_rad"))
    if np.any(range_m < 0.0):
        row = int(np.flatnonzero(range_m < 0.0)[0])
        raise DataError(f"sightings: range_m must not be negative, but row {row} is {range_m[row]:g}")
    if np.any(np.abs(bearing_rad) > LARGEST_BEARING_RAD):
        raise DataError(f"sightings: bearing_rad: {DEGREES_HINT}")
    order = np.argsort(columns[0], kind="stable")
    identity, known = _identities(given)
    maker, sensor_names = _identities(makers)
    if not finite:
        _check_measured((range_m, bearing_rad), maker, sensor_names, by_sensor)
    seen = Sightings(
        stamp_s=columns[0][order],
        range_m=range_m[order],
        bearing_rad=bearing_rad[order],
        identity=identity[order],
        class_index=np.full(len(order), -1, dtype=np.int64),
        signature=np.full(len(order), np.nan),
        sensor_index=maker[order] if sensor_names else None,
    )
    controls_of_log, settings = Controls(stamp_s, values), dict(config or {})
    log = Log(name, _SOURCE, "native", controls_of_log, seen, known, config=settings)
    return replace(log, sensor_names=sensor_names)


def _check_measured(
    measured: tuple[Floats, Floats],
    maker: Ints,
    sensor_names: Sequence[str],
    by_sensor: Mapping[str, Sequence[str]],
) -> None:
    """Errors: `DataError` where a sighting lacks what its sensor measures, or has what it does not."""
    has = measured_rows(maker, sensor_names, by_sensor)
    if has is None:
        return
    for place, (key, values) in enumerate(zip(BOTH, measured, strict=True)):
        wrong = np.flatnonzero(np.isfinite(values) != has[:, place])
        if len(wrong):
            row = int(wrong[0])
            of = sensor_names[maker[row]] if maker[row] >= 0 else "no sensor"
            expected = "a finite number" if has[row, place] else "NaN: it is not measured"
            raise DataError(f"sightings: {key}: row {row} ({of}) is {values[row]:g}, expected {expected}")


def checked_controls(controls: tuple[ArrayLike, ArrayLike]) -> tuple[Floats, Floats]:
    """Stamps (N,) that grow, and values (N, C). Errors: `DataError` for what is neither."""
    stamps, table = _parts("controls", controls, ("stamp_s", "values"))
    stamp_s, values = _stamps("controls", stamps), _finite("controls: values", table, dimensions=2)
    if len(stamp_s) != len(values):
        raise DataError(f"controls: got {len(stamp_s):,} stamps and {len(values):,} rows of values")
    if np.any(np.diff(stamp_s) <= 0.0):
        row = int(np.flatnonzero(np.diff(stamp_s) <= 0.0)[0]) + 1
        raise DataError(f"controls: stamp_s must grow, but row {row} ({stamp_s[row]:g}) does not")
    return stamp_s, values


def _parts(what: str, given: object, names: tuple[str, ...]) -> list[Any]:
    """The columns of a tuple. Errors: `DataError` where there are more or fewer than these."""
    parts = _listed(what, given)
    if len(parts) != len(names):
        alone = what == "sightings" and len(parts) == 2
        hint = ' (ranges alone: config={"sensor": {"model": "range"}})' if alone else ""
        raise DataError(f"{what}: got {len(parts)} arrays, expected {', '.join(names)}{hint}")
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


def _column(name: str, values: ArrayLike, *, finite: bool = True) -> Floats:
    if not finite and isinstance(values, Sequence):
        values = [np.nan if value is None else value for value in values]
    return _finite(name, values, dimensions=1, finite=finite)


def _finite(name: str, values: ArrayLike, *, dimensions: int, finite: bool = True) -> Floats:
    array = numbers(name, values)
    if array.ndim != dimensions:
        raise DataError(f"{name}: got an array of shape {array.shape}, expected {dimensions} dimension(s)")
    bad = np.argwhere(~np.isfinite(array))
    if finite and len(bad):
        raise DataError(f"{name}: row {bad[0][0]} is not finite")
    return array


def _identities(given: Sequence[object]) -> tuple[Ints, tuple[str, ...]]:
    """Indices and names in the order of appearance; None, NaN and `NOBODY_KNOWS` stand for unknown."""
    texts = [None if value is None or nobody_knows(str(value)) else str(value) for value in given]
    names = tuple(dict.fromkeys(text for text in texts if text is not None))
    index = {name: number for number, name in enumerate(names)}
    return np.array([-1 if text is None else index[text] for text in texts], dtype=np.int64), names

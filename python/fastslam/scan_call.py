"""The sightings of one scan as a caller gives them, checked as those of a file are."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from . import _core
from ._given import numbers, shown
from .config import Config
from .covariances import pose_covariance
from .errors import DataError
from .identity import nobody_knows
from .limits import DEGREES_HINT, LARGEST_BEARING_RAD, is_definite, stamp_fault
from .log import Floats, Ints
from .measured import measured_columns
from .sensors import Adapter
from .several import each_sensor, sensor_names

Identity = str | float | None
"""Name or number (from 0) of a landmark; None, -1, NaN and some words where nobody says which one it is
(`fastslam.identity.NOBODY_KNOWS`)."""
ClassName = str | float | None
"""Name of a class; None, -1, NaN and the same words where nobody knows it."""


def checked_stamp(stamp_s: float) -> float:
    """A stamp in seconds. Errors: `DataError` for what is none."""
    stamp = number("stamp_s", stamp_s)
    fault = stamp_fault(stamp) if np.isfinite(stamp) else f"got {stamp}, expected seconds"
    if fault is not None:
        raise DataError(f"stamp_s: {fault}")
    return stamp


def checked_covariance(covariance: ArrayLike) -> list[list[float]]:
    """The covariance (3, 3) of a row of odometry. Errors: `DataError` that says why it is none."""
    rows: list[list[float]] = pose_covariance("covariance", covariance).tolist()
    return rows


def class_numbers(
    class_name: Sequence[ClassName] | None, index_of: Mapping[str, int], limit: int | None = None
) -> tuple[dict[str, int], list[int] | None]:
    """Numbers for classes that are new, and that of each sighting: -1 where nobody knows it.

    `limit` is `association.classes.number`, None where classes are not configured.
    Errors: `UnknownClassError` for names beyond it, `DataError` for what is none.
    """
    if class_name is None:
        return {}, None
    if isinstance(class_name, str):
        raise DataError(f"class_name: got the text {class_name!r}, expected one name per sighting")
    names = [_class_name(name) for name in class_name]
    new: dict[str, int] = {}
    for name in names:
        if name is not None and name not in index_of:
            new.setdefault(name, len(index_of) + len(new))
    known = {**index_of, **new}
    if limit is not None and any(known[name] >= limit for name in names if name is not None):
        raise UnknownClassError(known, limit, names)
    return new, [-1 if name is None else known[name] for name in names]


class UnknownClassError(DataError):
    """Classes of sightings that are none of those configured: `rows` says of which sightings."""

    def __init__(self, index_of: Mapping[str, int], limit: int, names: Sequence[str | None]) -> None:
        self.rows = [row for row, name in enumerate(names) if name is not None and index_of[name] >= limit]
        known = ", ".join(name for name, index in index_of.items() if index < limit)
        super().__init__(
            f"class_name: got {shown(names[self.rows[0]])}, expected one of {known}, or None for unknown "
            f"(association.classes.number is {limit})"
        )


def _class_name(name: object) -> str | None:
    """A class as text; None where nobody knows it."""
    if name is None or (isinstance(name, str | float | int | np.number) and nobody_knows(str(name))):
        return None
    if not isinstance(name, str):
        raise DataError(f"class_name: got {shown(name)}, expected a name, or None for unknown")
    return name


def measured_scan(
    config: Config,
    adapter: Adapter | None,
    range_m: ArrayLike | None,
    bearing_rad: ArrayLike | None,
    by: int = 0,
) -> tuple[Floats, Floats]:
    """Ranges and bearings of a call, NaN where it has none; `by` is the number of the sensor.

    Errors: `DataError` where one is missing.
    """
    model = each_sensor(config)[by]["model"]
    needed = measured_columns(model) if adapter is None else adapter.measures
    given = {"range_m": range_m, "bearing_rad": bearing_rad}
    columns = {name: column(name, values) for name, values in given.items() if values is not None}
    count = max((len(column) for column in columns.values()), default=0)
    for name in needed:
        if name not in columns and (count > 0 or not columns):
            names = sensor_names(config)
            key = f"sensors.{names[by]}" if names else "sensor"
            raise DataError(f"{name}: got none, but {key}.model is {model}")
    if sensor_names(config):
        columns = {name: values for name, values in columns.items() if name in needed}
    return columns.get("range_m", np.full(count, np.nan)), columns.get("bearing_rad", np.full(count, np.nan))


def checked_scan(
    config: Config,
    measured: tuple[Floats, Floats],
    identity: Sequence[Identity] | None,
    covariance: ArrayLike | None = None,
    class_index: ArrayLike | None = None,
    signature: ArrayLike | None = None,
) -> Scan:
    """The sightings of a call, checked as those of a file are."""
    range_m, bearing_rad = measured
    scan = Scan(
        range_m=range_m,
        bearing_rad=bearing_rad,
        names=None if identity is None else _names(identity),
        covariance=None if covariance is None else _covariances(covariance),
        class_index=None if class_index is None else _classes(class_index),
        signature=None if signature is None else column("signature", signature),
    )
    if (np.abs(scan.bearing_rad[np.isfinite(scan.bearing_rad)]) > LARGEST_BEARING_RAD).any():
        raise DataError(f"bearing_rad: {DEGREES_HINT}")
    if (
        scan.class_index is not None
        and (scan.class_index >= 0).any()
        and config["association"]["classes"] is None
    ):
        raise DataError("class_index: association.classes is not configured")
    return scan


@dataclass(frozen=True)
class Scan:
    """The arguments of one update, as arrays of the right kind."""

    range_m: Floats
    bearing_rad: Floats
    names: tuple[str | None, ...] | None
    covariance: Floats | None
    class_index: Ints | None
    signature: Floats | None

    def new_names(self, known: Mapping[str, int]) -> dict[str, int]:
        """Numbers for the names that are not known yet."""
        index_of: dict[str, int] = {}
        for name in self.names or ():
            if name is not None and name not in known:
                index_of.setdefault(name, len(known) + len(index_of))
        return index_of

    def check_lengths(self) -> None:
        """Errors: `DataError`, as the core has it, before anything has moved."""
        ranges, bearings = len(self.range_m), len(self.bearing_rad)
        names = ranges if self.names is None else len(self.names)
        if not ranges == bearings == names:
            counts = f"{ranges} ranges, {bearings} bearings and {names} identities"
            raise DataError(f"sightings: got {counts}, expected equal numbers")

    def columns(self, index_of: Mapping[str, int]) -> _core._ScanColumns:
        """What the core takes: names as their numbers, -1 where there is none."""
        count = len(self.range_m)
        names = (None,) * count if self.names is None else self.names
        identity = np.array([-1 if name is None else index_of[name] for name in names], dtype=np.int64)
        return (self.range_m, self.bearing_rad, identity, self.covariance, self.class_index, self.signature)


def number(name: str, value: float) -> float:
    try:
        return float(value)
    except (TypeError, ValueError, OverflowError):
        raise DataError(f"{name}: got {shown(value)}, expected a number") from None


def column(name: str, values: ArrayLike) -> Floats:
    column = np.atleast_1d(numbers(name, values))
    if column.ndim != 1:
        raise DataError(f"{name}: got shape {column.shape}, expected one number per sighting")
    return column


def _classes(class_index: ArrayLike) -> Ints:
    given = class_index
    if isinstance(given, Sequence) and not isinstance(given, str):
        given = [-1 if one is None or nobody_knows(str(one)) else one for one in given]
    classes = column("class_index", given)
    classes[np.isnan(classes)] = -1.0
    if not (
        np.isfinite(classes) & (classes == np.round(classes)) & (classes >= -1) & (classes < 2**32)
    ).all():
        raise DataError(
            f"class_index: expected whole numbers from 0, or -1 for none, got {shown(class_index)}"
        )
    return classes.astype(np.int64)


def _covariances(covariance: ArrayLike) -> Floats:
    rows = numbers("covariance", covariance)
    if rows.size % 3:
        raise DataError("covariance: expected n x 3 numbers (m², m·rad, rad²)")
    rows = rows.reshape(-1, 3)
    given = ~np.isnan(rows).all(axis=1)
    wrong = given & ~is_definite(rows)
    if wrong.any():
        row = rows[np.argmax(wrong)].tolist()
        raise DataError(f"covariance: got {row}, expected a positive definite one or three NaN")
    return rows


def _names(identity: Sequence[Identity]) -> tuple[str | None, ...]:
    if isinstance(identity, str):
        raise DataError(f"identity: got the text {identity!r}, expected one name per sighting")
    try:
        return tuple(_name(value) for value in identity)
    except TypeError:
        raise DataError(f"identity: got {shown(identity)}, expected one name per sighting") from None


def _name(identity: Identity) -> str | None:
    """A landmark's name as text; what logs write for nobody knows must not become a name."""
    if identity is None or (
        isinstance(identity, str | float | int | np.number) and nobody_knows(str(identity))
    ):
        return None
    number = isinstance(identity, int | np.integer) and not isinstance(identity, bool)
    if isinstance(identity, str) or (number and int(identity) >= 0):
        return str(identity)
    raise DataError(f"identity: got {shown(identity)}, expected a name, a number from 0, or None for unknown")

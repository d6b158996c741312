"""Reads `sightings.csv` of a native log: which landmarks were seen, and where."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..errors import DataError
from ..identity import nobody_knows
from ..log import Bools, Floats, Ints, Problem, Sightings
from ..measured import BOTH, measured_rows
from .clean import clean_sightings
from .columns import Quantity, name_columns
from .csv_table import CsvTable, read_csv
from .native_odometry import STAMP
from .planar import polar_covariance

COVARIANCE_COLUMNS = ("range_variance_m2", "range_bearing_covariance_m_rad", "bearing_variance_rad2")
POINT_COVARIANCE_COLUMNS = ("x_variance_m2", "xy_covariance_m2", "y_variance_m2")
QUANTITIES = (
    STAMP,
    Quantity("range_m", ("r", "distance", "dist", "rho"), "m"),
    Quantity("bearing_rad", ("angle", "azimuth", "bearing_angle", "phi", "theta"), "rad"),
    Quantity("x_m", ("position_x", "pos_x", "rel_x"), "m"),
    Quantity("y_m", ("position_y", "pos_y", "rel_y"), "m"),
    Quantity(
        "landmark_id",
        (
            *("id", "landmark", "landmark_name", "name", "object", "post", "tree", "tag", "tag_id"),
            *("marker", "marker_id", "beacon", "beacon_id", "fiducial_id"),
        ),
        is_text=True,
    ),
    Quantity("sensor", (), is_text=True),
    Quantity("class", ("color", "colour", "class_name", "category"), is_text=True),
    Quantity("signature", ("diameter_m",)),
    Quantity("range_variance_m2", (), "m2"),
    Quantity("range_bearing_covariance_m_rad", (), "m_rad"),
    Quantity("bearing_variance_rad2", (), "rad2"),
    *(Quantity(name, (), "m2") for name in POINT_COVARIANCE_COLUMNS),
)
IGNORED = ("confidence", "score", "probability", "seq", "sequence", "frame_id", "frame", "z", "elevation")
BySensor = Mapping[str, Sequence[str]]
"""The columns that each of several sensors measures, by name."""
EXAMPLE = "stamp_s,range_m,bearing_rad,landmark_id"


@dataclass(frozen=True)
class SightingsFile:
    """What `sightings.csv` holds."""

    sightings: Sightings
    identity_names: tuple[str, ...] = ()
    class_names: tuple[str, ...] = ()
    sensor_names: tuple[str, ...] = ()
    problems: tuple[Problem, ...] = ()
    notes: tuple[str, ...] = ()
    dated: bool = False
    """Whether the stamps are dates."""


def read_sightings(
    path: Path, *, measures: Sequence[str] = BOTH, sensors: BySensor | None = None
) -> SightingsFile:
    """The sightings, polar or Cartesian, in any of the dialects. Errors: DataError with file and line.

    `measures` are the columns of the sensor's model; the other one is not asked for, and not kept.
    `sensors` are the columns that each of the log's `sensors` measures, by name.
    """
    table = read_csv(path, example=EXAMPLE, allow_empty=True)
    return sightings_of(table, measures=measures, sensors=sensors)


def sightings_of(
    table: CsvTable, *, measures: Sequence[str] = BOTH, sensors: BySensor | None = None
) -> SightingsFile:
    """The sightings that a table holds under any of the names known. Errors: DataError with its line."""
    table = name_columns(table, QUANTITIES, ignored=IGNORED)
    sensors = sensors or {}
    sensor_index, sensor_names = _sensors(table, sensors)
    by_row = measured_rows(sensor_index, sensor_names, sensors)
    cartesian = _is_cartesian(table, measures=measures)
    identity, identity_names = _named(*_labels(table, "landmark_id"))
    class_index, class_names = _named(*_labels(table, "class"))
    signature: Floats = np.full(len(table.lines), np.nan)
    if "signature" in table.index_of:
        signature = table.numbers("signature", empty=float("nan"))
    if by_row is not None:
        makers = [sensor_names[index] for index in sensor_index.tolist()] if sensor_index is not None else []
        range_m, bearing_rad = _given_by_sensor(table, by_row, makers, cartesian=cartesian)
    else:
        range_m, bearing_rad = _polar(table) if cartesian else _given(table, measures=measures)
    raw = Sightings(
        stamp_s=table.stamps("stamp_s"),
        range_m=range_m,
        bearing_rad=bearing_rad,
        identity=identity,
        class_index=class_index,
        signature=signature,
        covariance=_point_covariance(table) if cartesian else _own_covariance(table, measures, by_row),
        sensor_index=sensor_index,
    )
    left_out = [column for column in BOTH if column not in measures and column in table.index_of]
    notes = tuple(
        f"sensor.model is {measures[0].partition('_')[0]}: the {column.partition('_')[0]}s are not used"
        for column in ([] if cartesian else left_out)
    )
    if len(sensor_names) > 1 and not sensors:
        notes += (
            f"sightings are of {', '.join(sensor_names)}, which a run needs `sensors` for: log.yaml has none",
        )
    rows = measures if by_row is None else by_row
    sightings, problems = clean_sightings(raw, path=table.path, lines=table.lines, measures=rows)
    if not table.lines:
        problems = (Problem(f"{table.path.name} holds no sighting: only the odometry is left"),)
    return SightingsFile(
        sightings,
        identity_names,
        class_names,
        sensor_names,
        table.problems + problems,
        table.notes + notes,
        dated=table.has_dates("stamp_s"),
    )


def _is_cartesian(table: CsvTable, *, measures: Sequence[str]) -> bool:
    """Whether sightings are given as x, y. Errors: DataError when neither form is complete."""
    present = set(table.index_of)
    if {"stamp_s", *measures} <= present:
        return False
    if {"stamp_s", "x_m", "y_m"} <= present:
        return True
    wanted = ("stamp_s", "x_m", "y_m") if {"x_m", "y_m"} & present else ("stamp_s", *measures)
    missing = next(name for name in wanted if name not in present)
    expected = "stamp_s,range_m,bearing_rad or stamp_s,x_m,y_m (in the sensor's frame)"
    if missing == "bearing_rad":
        expected += "; for ranges alone write sensor: {model: range, range_std_m: ...} in log.yaml"
    if missing == "range_m":
        expected += "; for bearings alone write sensor: {model: bearing, bearing_std_rad: ...} in log.yaml"
    message = f"column {missing} is missing: got {','.join(table.index_of)}, expected {expected}"
    raise DataError(message, table.path, table.header_line)


def _labels(table: CsvTable, name: str) -> tuple[Ints, tuple[str, ...]]:
    if name in table.index_of:
        return table.labels(name)
    return np.full(len(table.lines), -1, dtype=np.int64), ()


def _sensors(table: CsvTable, known: Collection[str]) -> tuple[Ints | None, tuple[str, ...]]:
    """Which sensor made each row, and their names; None without the column.

    Errors: DataError for a name that is none of `known`, where there are any, and for rows without one.
    """
    expected = ", ".join(known)
    if "sensor" not in table.index_of:
        if len(known) > 1:
            message = (
                f"column sensor is missing: log.yaml has the sensors {expected}, and each row must name one"
            )
            raise DataError(message, table.path, table.header_line)
        return None, ()
    index, names = table.labels("sensor")
    wrong = np.array([*(name not in known for name in names), len(known) > 1])[index]
    if known and wrong.any():
        row = int(np.argmax(wrong))
        got = names[index[row]] if index[row] >= 0 else "nothing"
        raise DataError(f"sensor: got {got}, expected one of {expected}", table.path, table.lines[row])
    return (index, names) if names else (None, ())


def _named(indices: Ints, names: tuple[str, ...]) -> tuple[Ints, tuple[str, ...]]:
    """Identities or classes without those words that say that nobody knows."""
    known = [not nobody_knows(name) for name in names]
    new_index = np.append(np.where(known, np.cumsum(known) - 1, -1), -1).astype(np.int64)
    return new_index[indices], tuple(name for name, is_known in zip(names, known, strict=True) if is_known)


def _given(table: CsvTable, *, measures: Sequence[str]) -> tuple[Floats, Floats]:
    nothing = np.full(len(table.lines), np.nan)
    range_m, bearing_rad = (table.numbers(column) if column in measures else nothing for column in BOTH)
    return range_m, bearing_rad


def _given_by_sensor(
    table: CsvTable, by_row: Bools, makers: Sequence[str], *, cartesian: bool
) -> tuple[Floats, Floats]:
    """Range and bearing of rows by sensors of which some measure one alone; their other cell is empty.

    Errors: DataError with the line of a row that lacks what its sensor measures, or has what it does not.
    """
    if cartesian:
        alone = makers[int(np.argmin(by_row.all(axis=1)))] if len(makers) else "some"
        message = f"sightings are x, y, but {alone} measures one number: expected range_m,bearing_rad"
        raise DataError(message, table.path, table.header_line)
    columns = []
    for place, column in enumerate(BOTH):
        values = table.numbers(column, empty=float("nan"))
        # An empty cell is told from one that says NaN, which is a reading that failed.
        is_empty = np.isnan(values) & np.isinf(table.numbers(column, empty=float("inf")))
        for wrong, got, expected in (
            (by_row[:, place] & is_empty, "nothing", "a number: sensor {} measures it"),
            (~by_row[:, place] & ~np.isnan(values), "{}", "an empty cell: sensor {} does not measure it"),
        ):
            if wrong.any():
                row = int(np.argmax(wrong))
                said = f"got {got.format(f'{values[row]:g}')}, expected {expected.format(makers[row])}"
                raise DataError(f"{column}: {said}", table.path, table.lines[row])
        columns.append(values)
    return columns[0], columns[1]


def _polar(table: CsvTable) -> tuple[Floats, Floats]:
    x, y = table.numbers("x_m"), table.numbers("y_m")
    return np.hypot(x, y), np.arctan2(y, x)


def _point_covariance(table: CsvTable) -> Floats | None:
    """Covariances of x and y, turned into those of range and bearing."""
    covariance = _covariance(table, POINT_COVARIANCE_COLUMNS)
    if covariance is None:
        return None
    return polar_covariance(table.numbers("x_m"), table.numbers("y_m"), covariance)


def _own_covariance(table: CsvTable, measures: Sequence[str], by_row: Bools | None) -> Floats | None:
    """Covariances of sightings; of a sensor that measures one column its variance is enough.

    Errors: DataError for a part of the columns, and for covariances that are none.
    """
    own = [COVARIANCE_COLUMNS[2 * BOTH.index(column)] for column in measures]
    if len(own) > 1 or [name for name in COVARIANCE_COLUMNS if name in table.index_of] != own:
        return _covariance(table, COVARIANCE_COLUMNS, by_row)
    variance = table.numbers(own[0], empty=float("nan"))
    wrong = ~np.isnan(variance) & ~(np.isfinite(variance) & (variance > 0.0))
    if wrong.any():
        row = int(np.argmax(wrong))
        message = f"{own[0]}: got {variance[row]}, expected a positive number or an empty cell"
        raise DataError(message, table.path, table.lines[row])
    values = np.where(np.isnan(variance)[:, None], np.nan, np.array([1.0, 0.0, 1.0]))
    values[:, COVARIANCE_COLUMNS.index(own[0])] = variance
    return values


def _complete_variances(values: Floats, by_row: Bools) -> None:
    """Makes covariances of the variances of sightings of one number; nobody reads what is not measured."""
    for alone, own in ((0, 0), (1, 2)):
        rows = by_row[:, alone] & ~by_row[:, 1 - alone] & ~np.isnan(values[:, own])
        values[rows, 1], values[rows, 2 - own] = 0.0, 1.0


def _covariance(table: CsvTable, names: tuple[str, ...], by_row: Bools | None = None) -> Floats | None:
    """Covariances (S, 3), NaN for the sensor's own; None without the columns. All or none must be there.

    `by_row` says which of range and bearing each row has; the variance of that is enough.
    """
    present = [name for name in names if name in table.index_of]
    if not present:
        return None
    if len(present) < len(names):
        missing = ", ".join(sorted(set(names) - set(present)))
        raise DataError(
            f"has {', '.join(present)} but not {missing}: expected all three or none",
            table.path,
            table.header_line,
        )
    values = np.column_stack([table.numbers(name, empty=float("nan")) for name in names])
    if by_row is not None:
        _complete_variances(values, by_row)
    given = ~np.isnan(values).all(axis=1)
    definite = (values[:, 0] > 0) & (values[:, 2] > 0) & (values[:, 0] * values[:, 2] > values[:, 1] ** 2)
    wrong = given & ~(definite & np.isfinite(values).all(axis=1))
    if wrong.any():
        row = int(np.argmax(wrong))
        message = (
            f"covariance: got {values[row].tolist()}, expected a positive definite one or three empty cells"
        )
        raise DataError(message, table.path, table.lines[row])
    return values

"""Reads the native log in space: `log.yaml` with `dimensions: 3`, `sightings.csv`, `odometry.csv` if any."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from .._yaml import YamlError, parse_yaml
from ..datasets.columns import Quantity, name_columns, split_unit
from ..datasets.csv_table import CsvTable, read_csv
from ..datasets.native_odometry import STAMP
from ..datasets.text import find_file, read_table, read_text
from ..errors import ConfigError, DataError
from ..log import Floats, Problem
from .config import SCHEMA
from .log import WITHOUT_ODOMETRY, SpaceLog, SpaceTruth

KEYS = ("format_version", "dimensions", "name", "motion", "sensor", "filter", "initial_pose")
VELOCITIES = (
    Quantity("vx_m_per_s", ("velocity_x", "linear_x"), "m_per_s"),
    Quantity("vy_m_per_s", ("velocity_y", "linear_y"), "m_per_s"),
    Quantity("vz_m_per_s", ("velocity_z", "linear_z"), "m_per_s"),
    Quantity("wx_rad_per_s", ("angular_x", "gyro_x"), "rad_per_s"),
    Quantity("wy_rad_per_s", ("angular_y", "gyro_y"), "rad_per_s"),
    Quantity("wz_rad_per_s", ("angular_z", "gyro_z"), "rad_per_s"),
)
PLANAR = (
    Quantity("speed_m_per_s", ("speed", "velocity", "v"), "m_per_s"),
    Quantity("yaw_rate_rad_per_s", ("yaw_rate", "turn_rate", "omega"), "rad_per_s"),
)
"""What a robot on the ground notes in place of six velocities."""
ON_THE_GROUND = {
    "position_std_m_per_sqrt_s": [0.05, 0.01, 0.001],
    "turn_std_rad_per_sqrt_s": [0.001, 0.001, 0.03],
}
"""Its motion, where `log.yaml` says nothing else: it slips a little, and neither rises nor tilts."""
COVARIANCES = tuple(f"covariance_{i}{j}" for i in range(3) for j in range(i, 3))
NAME = Quantity("landmark_id", ("id", "landmark", "tag", "tag_id", "marker", "marker_id"), is_text=True)
NUMBERS = {
    "point": (Quantity("x_m", (), "m"), Quantity("y_m", (), "m"), Quantity("z_m", (), "m")),
    "range_bearing_elevation": (
        Quantity("range_m", ("distance",), "m"),
        Quantity("bearing_rad", ("azimuth",), "rad"),
        Quantity("elevation_rad", (), "rad"),
    ),
    "stereo": (
        Quantity("column_px", ("u",)),
        Quantity("row_px", ("v",)),
        Quantity("disparity_px", ("disparity",)),
    ),
}
PLACE = (Quantity("id", ("name", "landmark_id"), is_text=True), *NUMBERS["point"])


def matches(path: Path) -> bool:
    """A folder whose `log.yaml` says `dimensions: 3`."""
    file = _folder(path) / "log.yaml"
    try:
        head = file.read_text(encoding="utf-8", errors="replace")[:100_000] if file.is_file() else ""
    except OSError:
        return False
    return any(
        line.partition("#")[0].replace(" ", "").strip() == "dimensions:3" for line in head.splitlines()
    )


def load(path: Path) -> SpaceLog:
    """Read a native log in space. Errors: DataError with file and line for what a person must repair."""
    path = _folder(path)
    settings = _settings(path / "log.yaml")
    model = settings.get("sensor", {}).get("model", "point")
    row_stamp_s, velocity, motion = _odometry(path)
    settings["motion"] = {**motion, **settings.get("motion", {})}
    if "kind" in motion:
        settings["filter"] = {**WITHOUT_ODOMETRY, **settings.get("filter", {})}
    seen, value, covariance = _sightings(path, NUMBERS[model])
    stamp_s = seen.stamps("stamp_s")
    seen.check_finite("stamp_s", stamp_s)
    identity, names = seen.labels("landmark_id")
    order = np.argsort(stamp_s, kind="stable")
    late = int(np.sum(np.diff(stamp_s) < 0))
    return SpaceLog(
        name=str(settings.get("name", path.resolve().name)),
        source=str(path),
        format="space",
        row_stamp_s=row_stamp_s,
        velocity=velocity,
        sighting_stamp_s=stamp_s[order],
        value=value[order],
        identity=identity[order],
        names=names,
        covariance=None if covariance is None else covariance[order],
        truth=_truth(path),
        config={
            key: settings[key] for key in ("motion", "sensor", "filter", "initial_pose") if settings.get(key)
        },
        problems=(Problem("sightings are not in the order of time: sorted", late),) if late else (),
    )


def _folder(path: Path) -> Path:
    return path.parent if path.name == "log.yaml" and path.is_file() else path


def _settings(path: Path) -> dict[str, Any]:
    try:
        settings, line_of_key = parse_yaml(read_text(path))
    except YamlError as error:
        raise DataError(f"is not valid YAML ({error.message})", path, error.line) from None
    for key in settings:
        if key not in KEYS:
            raise DataError(f"unknown key {key}; known: {', '.join(KEYS)}", path, line_of_key.get(key))
    if settings.get("format_version") != 1:
        raise DataError(f"format_version: got {settings.get('format_version')}, expected 1", path)
    config = {key: value for key, value in settings.items() if key in KEYS[3:]}
    for key, value in config.items():
        if not isinstance(value, dict):
            raise DataError(f"{key}: got {value}, expected a section", path, line_of_key.get(key))
    try:
        SCHEMA.resolve(config)
    except ConfigError as error:
        raise DataError(str(error), path, line_of_key.get(str(error).partition(":")[0])) from None
    return dict(settings)


def _odometry(path: Path) -> tuple[Floats, Floats, dict[str, Any]]:
    """Stamps, velocities (N, 6), and the settings of a motion that the table, or none, tells the kind of."""
    file = find_file(path, "odometry.csv")
    if file is None:
        return np.empty(0), np.empty((0, 6)), {"kind": "wandering"}
    given = {split_unit(name)[0] for name in read_csv(file, example=VELOCITIES[0].name).index_of}
    columns: tuple[Quantity, ...] = VELOCITIES
    axes, motion = list(range(6)), dict[str, Any]()
    if _holds(given, PLANAR[:1]):
        columns, axes, motion = PLANAR, [0, 5], dict(ON_THE_GROUND)
    elif _holds(given, VELOCITIES[3:]) and not _holds(given, VELOCITIES[:3]):
        columns, axes, motion = VELOCITIES[3:], [3, 4, 5], {"kind": "gyro"}
    table = _table(path, "odometry.csv", (STAMP, *columns))
    velocity = np.zeros((len(table.lines), 6))
    velocity[:, axes] = _columns(table, columns)
    return _growing(table), velocity, motion


def _growing(table: CsvTable) -> Floats:
    stamp_s = table.stamps("stamp_s")
    table.check_finite("stamp_s", stamp_s)
    early = np.diff(stamp_s) <= 0
    if early.any():
        row = int(np.argmax(early)) + 1
        raise DataError("the stamp is not later than the one before", table.path, table.lines[row])
    return stamp_s


def _holds(given: set[str], quantities: tuple[Quantity, ...]) -> bool:
    """Whether a table's columns, without their units, have one of these."""
    return any(not given.isdisjoint({split_unit(q.name)[0], *q.aliases}) for q in quantities)


def _table(
    path: Path, name: str, known: tuple[Quantity, ...], *, optional: tuple[Quantity, ...] = ()
) -> CsvTable:
    file = find_file(path, name)
    example = ",".join(quantity.name for quantity in known)
    if file is None:
        raise DataError(f"the file {name} is missing: write one with the header {example}", path)
    table = name_columns(
        read_csv(file, example=example, allow_empty=name == "sightings.csv"), (*known, *optional)
    )
    missing = [quantity.name for quantity in known if quantity.name not in table.index_of]
    if missing:
        got = ",".join(table.written_as.values())
        message = f"column {missing[0]} is missing: got {got}, expected {example}"
        raise DataError(message, file, table.header_line)
    return table


def _columns(table: CsvTable, quantities: tuple[Quantity, ...]) -> Floats:
    return np.column_stack([table.finite_numbers(quantity.name) for quantity in quantities])


def _sightings(path: Path, numbers: tuple[Quantity, ...]) -> tuple[CsvTable, Floats, Floats | None]:
    own = tuple(Quantity(name) for name in COVARIANCES)
    table = _table(path, "sightings.csv", (STAMP, NAME, *numbers), optional=own)
    value = np.column_stack([table.numbers(quantity.name) for quantity in numbers])
    given = [name for name in COVARIANCES if name in table.index_of]
    if not given:
        return table, value, None
    if len(given) < len(COVARIANCES):
        missing = next(name for name in COVARIANCES if name not in given)
        raise DataError(f"column {missing} is missing beside {given[0]}", table.path, table.header_line)
    empty = float("nan")
    return table, value, np.column_stack([table.numbers(name, empty=empty) for name in COVARIANCES])


def _truth(path: Path) -> SpaceTruth | None:
    trajectory, landmarks = find_file(path, "truth_trajectory.tum"), find_file(path, "truth_landmarks.csv")
    if trajectory is None and landmarks is None:
        return None
    stamp_s, poses = np.empty(0), np.empty((0, 7))
    if trajectory is not None:
        rows = read_table(trajectory, 8)
        lengths = np.linalg.norm(rows[:, 4:], axis=1)
        if (
            not np.isfinite(rows).all()
            or np.any(np.abs(lengths - 1.0) > 0.01)
            or np.any(np.diff(rows[:, 0]) <= 0)
        ):
            raise DataError("expected growing stamps, finite numbers and quaternions of length 1", trajectory)
        stamp_s, poses = rows[:, 0], rows[:, [1, 2, 3, 7, 4, 5, 6]]
        poses[:, 3:] /= lengths[:, None]
    names: tuple[str, ...] = ()
    places = np.empty((0, 3))
    if landmarks is not None:
        table = _table(path, "truth_landmarks.csv", PLACE)
        names, places = tuple(text.strip() for text in table.texts("id")), _columns(table, NUMBERS["point"])
    return SpaceTruth(stamp_s, poses, names, places)

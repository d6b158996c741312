"""Reads the native log, a folder of a YAML file and CSV files (`docs/native-log-format.md`)."""

from __future__ import annotations

import difflib
from pathlib import Path
from typing import Any

import numpy as np

from .._yaml import YamlError, parse_yaml
from ..errors import DataError
from ..log import (
    Controls,
    Floats,
    Log,
    PositionFixes,
    Problem,
    Sightings,
    TruthLandmarks,
    TruthTrajectory,
)
from .clean import clean_controls, clean_sightings, no_sightings
from .csv_table import CsvTable, check_columns, read_csv
from .options import LoadOptions
from .planar import increments_between
from .scans_file import NAME as SCANS
from .scans_file import read_scans
from .text import line_of_row, read_table, read_text

FILES = ("log.yaml", "odometry.csv", "sightings.csv")
FORMAT_VERSION = 1
CONFIG_KEYS = ("motion", "sensor", "association", "filter", "initial_pose")
KEYS = ("format_version", "name", *CONFIG_KEYS, "truth_landmarks_complete")
POSE_COLUMNS = ("stamp_s", "x_m", "y_m", "heading_rad")
INCREMENT_COLUMNS = ("stamp_s", "dx_m", "dy_m", "dheading_rad")
ODOMETRY_COLUMNS: dict[str, tuple[tuple[str, ...], ...]] = {
    "velocity": (("stamp_s", "speed_m_per_s", "yaw_rate_rad_per_s"),),
    "ackermann": (("stamp_s", "speed_m_per_s", "steering_rad"),),
    "odometry": (INCREMENT_COLUMNS, POSE_COLUMNS),
    "increments": (INCREMENT_COLUMNS, POSE_COLUMNS),
}
SIGHTING_COLUMNS = ("stamp_s", "range_m", "bearing_rad")
COVARIANCE_COLUMNS = ("range_variance_m2", "range_bearing_covariance_m_rad", "bearing_variance_rad2")
SIGHTING_OPTIONS = ("landmark_id", "class", "signature", *COVARIANCE_COLUMNS)


def matches(path: Path) -> bool:
    """A folder with any of the files of a native log, so that a missing one is reported by its name."""
    return any((_folder(path) / name).is_file() for name in FILES)


def load(path: Path, options: LoadOptions) -> Log:
    """Read a native log. Errors: DataError with file and line for what a person must repair."""
    path = _folder(path)
    scans, scan_problems = read_scans(path / SCANS)
    only_scans = scans is not None and not (path / "sightings.csv").is_file()
    for name in FILES:
        if not (path / name).is_file() and not (only_scans and name == "sightings.csv"):
            raise DataError(f"the file {name} of a native log is missing", path)
    settings = _read_settings(path / "log.yaml")
    controls, control_problems = _read_controls(path / "odometry.csv", settings["motion"]["model"])
    sightings, identity_names, class_names, problems = (
        (no_sightings(), (), (), ()) if only_scans else _read_sightings(path / "sightings.csv")
    )
    trajectory, truth_problems = _read_trajectory(path / "truth_trajectory.tum")
    return Log(
        name=str(settings.get("name", path.resolve().name)),
        source=str(path),
        format="native",
        controls=controls,
        sightings=sightings,
        identity_names=identity_names,
        class_names=class_names,
        truth_trajectory=trajectory,
        truth_landmarks=_read_landmarks(
            path / "truth_landmarks.csv", settings.get("truth_landmarks_complete", True)
        ),
        position_fixes=_read_fixes(path / "position_fixes.csv"),
        scans=scans,
        config={key: settings[key] for key in CONFIG_KEYS if key in settings},
        problems=control_problems
        + problems
        + scan_problems
        + _clock_problems(controls, sightings)
        + truth_problems,
    )


def _folder(path: Path) -> Path:
    """The log's folder, also where the path is that of its log.yaml."""
    return path.parent if path.name == "log.yaml" and path.is_file() else path


def _read_settings(path: Path) -> dict[str, Any]:
    try:
        settings, line_of_key = parse_yaml(read_text(path))
    except YamlError as error:
        raise DataError(f"is not valid YAML ({error.message})", path, error.line) from None
    if not isinstance(settings, dict):
        raise DataError(f"got no settings, expected the keys {', '.join(KEYS)}", path)
    for key in settings:
        if key not in KEYS:
            near = difflib.get_close_matches(str(key), KEYS, n=1)
            hint = f", did you mean {near[0]}?" if near else f"; known: {', '.join(KEYS)}"
            raise DataError(f"unknown key {key}{hint}", path, line_of_key.get(str(key)))
    version = settings.get("format_version")
    if version != FORMAT_VERSION:
        raise DataError(f"format_version: got {version}, expected {FORMAT_VERSION}", path)
    _check_model(settings, "motion", tuple(ODOMETRY_COLUMNS), path)
    _check_model(settings, "sensor", ("range_bearing",), path)
    if not isinstance(settings.get("truth_landmarks_complete", True), bool):
        raise DataError("truth_landmarks_complete: expected true or false", path)
    return settings


def _check_model(settings: dict[str, Any], key: str, known: tuple[str, ...], path: Path) -> None:
    section = settings.get(key)
    if not isinstance(section, dict):
        raise DataError(f"{key}: got {section}, expected a section with the key model", path)
    if section.get("model") not in known:
        raise DataError(f"{key}.model: got {section.get('model')}, expected {' or '.join(known)}", path)


def _read_controls(path: Path, model: str) -> tuple[Controls, tuple[Problem, ...]]:
    table = read_csv(path)
    columns = _odometry_columns(table, model)
    stamp_s = table.numbers("stamp_s")
    values = np.column_stack([table.numbers(name) for name in columns[1:]])
    controls, problems = clean_controls(stamp_s, values, path=path)
    if columns == POSE_COLUMNS:
        if len(controls.stamp_s) < 2:
            raise DataError("holds one pose, needs at least two to tell a motion", path)
        controls = Controls(controls.stamp_s[1:], increments_between(controls.values))
    return controls, table.problems + problems


def _odometry_columns(table: CsvTable, model: str) -> tuple[str, ...]:
    """The columns of the header, which must be one of those that the motion model can use."""
    allowed = ODOMETRY_COLUMNS[model]
    present = set(table.columns)
    for columns in allowed:
        if present == set(columns):
            return columns
    for other, variants in ODOMETRY_COLUMNS.items():
        if any(present == set(columns) for columns in variants):
            got, expected = ",".join(table.columns), " or ".join(",".join(columns) for columns in allowed)
            message = f"the header fits motion.model {other}, but log.yaml says {model}"
            raise DataError(f"{message}: got {got}, expected {expected}", table.path, 1)
    nearest = max(allowed, key=lambda columns: _likeness(present, columns))
    check_columns(table, required=nearest)
    return nearest


def _likeness(present: set[str], columns: tuple[str, ...]) -> int:
    return sum(bool(difflib.get_close_matches(name, present, n=1, cutoff=0.7)) for name in columns)


def _read_sightings(
    path: Path,
) -> tuple[Sightings, tuple[str, ...], tuple[str, ...], tuple[Problem, ...]]:
    """Sightings, identity names, class names, problems."""
    table = read_csv(path)
    check_columns(table, required=SIGHTING_COLUMNS, optional=SIGHTING_OPTIONS)
    nobody = np.full(len(table.lines), -1, dtype=np.int64)
    identity, identity_names = table.labels("landmark_id") if "landmark_id" in table.columns else (nobody, ())
    class_index, class_names = table.labels("class") if "class" in table.columns else (nobody, ())
    signature: Floats = np.full(len(table.lines), np.nan)
    if "signature" in table.columns:
        signature = table.numbers("signature", empty=float("nan"))
    raw = Sightings(
        stamp_s=table.numbers("stamp_s"),
        range_m=table.numbers("range_m"),
        bearing_rad=table.numbers("bearing_rad"),
        identity=identity,
        class_index=class_index,
        signature=signature,
        covariance=_covariance(table),
    )
    sightings, problems = clean_sightings(raw, path=path)
    return sightings, identity_names, class_names, table.problems + problems


def _covariance(table: CsvTable) -> Floats | None:
    """Covariances (S, 3), NaN for the sensor's own; None without the columns. All or none must be there."""
    present = [name for name in COVARIANCE_COLUMNS if name in table.columns]
    if not present:
        return None
    if len(present) < len(COVARIANCE_COLUMNS):
        missing = ", ".join(sorted(set(COVARIANCE_COLUMNS) - set(present)))
        raise DataError(
            f"has {', '.join(present)} but not {missing}: expected all three or none", table.path, 1
        )
    values = np.column_stack([table.numbers(name, empty=float("nan")) for name in COVARIANCE_COLUMNS])
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


def _clock_problems(controls: Controls, sightings: Sightings) -> tuple[Problem, ...]:
    """Says so where no sighting lies within the time of the odometry: usually two clocks or two units."""
    if len(sightings.stamp_s) == 0:
        return ()
    first_s, last_s = controls.stamp_s[0], controls.stamp_s[-1]
    if sightings.stamp_s[-1] >= first_s and sightings.stamp_s[0] <= last_s:
        return ()
    span = f"{sightings.stamp_s[0]:.3f} to {sightings.stamp_s[-1]:.3f} s"
    message = f"sightings ({span}) lie outside the odometry ({first_s:.3f} to {last_s:.3f} s): another clock?"
    return (Problem(message, len(sightings.stamp_s)),)


def _read_trajectory(path: Path) -> tuple[TruthTrajectory | None, tuple[Problem, ...]]:
    """Rows of `stamp x y z qx qy qz qw`; a quaternion of four zeros says that no heading is known."""
    if not path.is_file():
        return None, ()
    rows = read_table(path, 8)
    finite = np.isfinite(rows).all(axis=1)
    problems = (Problem("true poses with NaN or infinite values: dropped", int(np.sum(~finite))),)
    rows = rows[finite]
    if len(rows) == 0:
        raise DataError("holds no pose without NaN or infinite values", path)
    late = np.diff(rows[:, 0]) <= 0
    if late.any():
        row = int(np.flatnonzero(finite)[np.argmax(late) + 1])
        raise DataError("the stamp is not later than the one before", path, line_of_row(path, row))
    qx, qy, qz, qw = rows[:, 4:].T
    unknown = np.all(rows[:, 4:] == 0, axis=1)
    if unknown.any() and not unknown.all():
        raise DataError(f"{unknown.sum()} of {len(rows)} quaternions are zero: expected none or all", path)
    heading = np.arctan2(2 * (qw * qz + qx * qy), qw**2 + qx**2 - qy**2 - qz**2)
    heading = np.where(unknown, np.nan, heading)
    truth = TruthTrajectory(
        rows[:, 0], np.column_stack([rows[:, 1:3], heading]), heading_known=not unknown.any()
    )
    return truth, tuple(problem for problem in problems if problem.count)


def _read_landmarks(path: Path, complete: bool) -> TruthLandmarks | None:
    if not path.is_file():
        return None
    table = read_csv(path)
    check_columns(table, required=("id", "x_m", "y_m"))
    names = tuple(name.strip() for name in table.columns["id"])
    seen: set[str] = set()
    for name, line in zip(names, table.lines, strict=True):
        if not name or name in seen:
            raise DataError(f"id '{name}' is empty or appears twice", path, line)
        seen.add(name)
    return TruthLandmarks(names, _finite_positions(table), complete=complete)


def _read_fixes(path: Path) -> PositionFixes | None:
    if not path.is_file():
        return None
    table = read_csv(path)
    check_columns(table, required=("stamp_s", "x_m", "y_m"))
    return PositionFixes(_finite(table, "stamp_s"), _finite_positions(table))


def _finite_positions(table: CsvTable) -> Floats:
    return np.column_stack([_finite(table, "x_m"), _finite(table, "y_m")])


def _finite(table: CsvTable, name: str) -> Floats:
    values = table.numbers(name)
    bad = ~np.isfinite(values)
    if bad.any():
        row = int(np.argmax(bad))
        raise DataError(f"{name}: got {values[row]}, expected a finite number", table.path, table.lines[row])
    return values

"""Writes a `Log` as a native log folder, such that reading it gives the same arrays back."""

from __future__ import annotations

import csv
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TextIO

import numpy as np

from .._yaml import write_yaml
from ..csv_cells import guarded
from ..errors import DataError
from ..log import Floats, Log, TruthTrajectory
from .native_columns import HEADERS, Names, odometry_columns, sightings_columns
from .native_settings import CONFIG_KEYS, REAR_AXLE
from .scans_file import NAME as SCANS
from .scans_file import write_scans


def write_native(log: Log, folder: Path | str) -> Path:
    """Write a log as a native folder and return the folder.

    All numbers are written so that they read back bit for bit; only true headings pass through a quaternion
    and may differ in the last digits. Errors: DataError when the folder holds files already or cannot be
    written, the log has no motion or sensor settings, or a name could not be read back (empty, surrounding
    blanks, line breaks).
    """
    folder = Path(folder)
    try:
        _check(log, folder)
        _write(log, folder)
    except OSError as error:
        raise DataError(f"cannot write: {error.strerror or error}", error.filename or folder) from error
    return folder


def _write(log: Log, folder: Path) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    _write_odometry(log, folder / "odometry.csv")
    if log.scans is not None:
        write_scans(log.scans, folder / SCANS)
    if log.scans is None or len(log.sightings.stamp_s) > 0:
        _write_sightings(log, folder / "sightings.csv")
    if log.truth_trajectory is not None:
        _write_atomically(folder / "truth_trajectory.tum", tum_text(log.truth_trajectory))
    if log.truth_landmarks is not None:
        truth = zip(log.truth_landmarks.names, log.truth_landmarks.position_m.tolist(), strict=True)
        rows = [(guarded(name), *position) for name, position in truth]
        _write_csv(folder / "truth_landmarks.csv", ("id", "x_m", "y_m"), rows)
    if log.position_fixes is not None:
        fixes = np.column_stack([log.position_fixes.stamp_s, log.position_fixes.position_m])
        _write_csv(folder / "position_fixes.csv", ("stamp_s", "x_m", "y_m"), fixes.tolist())
    _write_atomically(folder / "log.yaml", write_yaml(_settings(log)))


def _check(log: Log, folder: Path) -> None:
    """Everything that may be refused, before the first file is written."""
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise DataError("exists and is not an empty folder: choose another", folder)
    if log.config.get("motion", {}).get("model") not in HEADERS or log.config.keys().isdisjoint(
        ("sensor", "sensors")
    ):
        raise DataError(f"log {log.name} has no motion model and sensor settings to write", folder)
    truth_names = () if log.truth_landmarks is None else log.truth_landmarks.names
    for name in (*log.identity_names, *log.class_names, *log.sensor_names, *truth_names):
        if not name or name != name.strip() or not name.isprintable():
            raise DataError(f"name {name!r} is empty, has blanks around it or cannot be printed", folder)


def _default_size() -> dict[str, Any]:
    """The size of a car that says nothing of it, as runs take it; a file that says nothing means another."""
    from ..config import Config

    motion = Config.resolve({"motion": {"model": "ackermann"}})["motion"]
    return {key: motion[key] for key in REAR_AXLE}


def _settings(log: Log) -> dict[str, Any]:
    settings: dict[str, Any] = {"format_version": 1, "name": log.name}
    for key in CONFIG_KEYS:
        if key in log.config:
            settings[key] = _plain(log.config[key])
    if settings["motion"]["model"] == "ackermann" and REAR_AXLE.keys().isdisjoint(settings["motion"]):
        settings["motion"] |= _default_size()
    if log.truth_landmarks is not None and not log.truth_landmarks.complete:
        settings["truth_landmarks_complete"] = False
    return settings


def _plain(value: Any) -> Any:
    """The same value without NumPy types, which YAML does not know."""
    if isinstance(value, dict):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]
    return value.item() if isinstance(value, np.generic) else value


def _write_odometry(log: Log, path: Path) -> None:
    _write_columns(path, odometry_columns(log))


def _write_sightings(log: Log, path: Path) -> None:
    _write_columns(path, sightings_columns(log))


def _write_columns(path: Path, columns: Mapping[str, Floats | Names]) -> None:
    """A table with empty cells for NaN and for names that are none."""
    cells = [_names(c) if isinstance(c, list) else _numbers(c) for c in columns.values()]
    _write_csv(path, list(columns), zip(*cells, strict=True))


def _numbers(values: Floats) -> list[object]:
    return ["" if value != value else value for value in values.tolist()]


def _names(names: Names) -> list[object]:
    cell_of = {name: "" if name is None else guarded(name) for name in dict.fromkeys(names)}
    return [cell_of[name] for name in names]


def tum_text(truth: TruthTrajectory) -> str:
    """The text of a TUM file; quaternions of zeros where no heading is known."""
    heading = truth.T_world_robot[:, 2]
    known = truth.heading_known
    qz = np.sin(heading / 2) if known else np.zeros(len(heading))
    qw = np.cos(heading / 2) if known else np.zeros(len(heading))
    rows: Floats = np.column_stack([truth.stamp_s, truth.T_world_robot[:, :2], qz, qw])
    lines = [f"{t!r} {x!r} {y!r} 0 0 0 {z!r} {w!r}" for t, x, y, z, w in rows.tolist()]
    return "\n".join(["# stamp_s x_m y_m z_m qx qy qz qw", *lines]) + "\n"


def _write_csv(path: Path, header: Sequence[str], rows: Iterable[Sequence[object]]) -> None:
    """Floats are written by `repr`, which reads back bit for bit."""
    with _in_place_of(path) as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(header)
        writer.writerows(rows)


def _write_atomically(path: Path, text: str) -> None:
    with _in_place_of(path) as file:
        file.write(text)


@contextmanager
def _in_place_of(path: Path) -> Iterator[TextIO]:
    """A file that takes the place of `path` when it was written whole, and is gone otherwise."""
    temporary = path.with_name(f".{path.name}.part")
    try:
        with temporary.open("w", encoding="utf-8", newline="") as file:
            yield file
        os.replace(temporary, path)
    except OSError as error:
        # Where the disk is full the error of closing the file does not name it.
        error.filename = str(path)
        raise
    finally:
        temporary.unlink(missing_ok=True)

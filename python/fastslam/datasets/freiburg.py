"""The robot mapping course's log: 9 landmarks, rotation-translation-rotation odometry, identities.

There are no time stamps: odometry row k has stamp k (seconds) and the readings after it share that stamp.
The noise is not documented; the figures here were measured against the true landmarks (range residual 0.10
m, bearing 0.05 rad over the first steps by dead reckoning, odometry scatter about 0.001 a step).
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from ..errors import DataError
from ..log import Floats, Log, Sightings, TruthLandmarks
from .clean import clean_controls, clean_sightings
from .options import LoadOptions
from .text import find_file, first_words, is_number, read_table, read_text, refuse_not_finite, whole_numbers

FILE = "sensor_data.dat"
WORLD = "world.dat"


def matches(path: Path) -> bool:
    """A folder with `sensor_data.dat`, or a text file whose first row is ODOMETRY with three numbers."""
    file = path if path.is_file() else find_file(path, FILE)
    words = [] if file is None else first_words(file)
    return len(words) == 4 and words[0] == "ODOMETRY"


def load(path: Path, options: LoadOptions) -> Log:
    """Read the log and, where `world.dat` lies beside it, the true landmarks. Errors: DataError."""
    file = path if path.is_file() else find_file(path, FILE)
    if file is None:
        raise DataError(f"the file {FILE} is missing", path)
    odometry, readings = _read_rows(file)
    identity_numbers, identity = np.unique(readings[:, 1].astype(np.int64), return_inverse=True)
    stamps = np.arange(1, len(odometry) + 1, dtype=np.float64)
    controls, control_problems = clean_controls(stamps, _increments(odometry), path=file)
    sightings, sighting_problems = clean_sightings(
        Sightings(
            stamp_s=readings[:, 0],
            range_m=readings[:, 2],
            bearing_rad=readings[:, 3],
            identity=identity.astype(np.int64),
            class_index=np.full(len(readings), -1, dtype=np.int64),
            signature=np.full(len(readings), np.nan),
        ),
        path=file,
    )
    return Log(
        name="freiburg",
        source=str(path),
        format="freiburg",
        controls=controls,
        sightings=sightings,
        identity_names=tuple(str(number) for number in identity_numbers),
        truth_landmarks=_world(file.parent),
        config=_config(),
        problems=control_problems + sighting_problems,
    )


def _read_rows(file: Path) -> tuple[Floats, Floats]:
    """Odometry rows (rot1, trans, rot2) and readings (stamp, identity, range, bearing)."""
    odometry: list[list[float]] = []
    readings: list[list[float]] = []
    for number, line in enumerate(read_text(file).splitlines(), start=1):
        fields = line.split()
        if not fields:
            continue
        if fields[0] not in ("ODOMETRY", "SENSOR"):
            raise DataError(f"got row '{fields[0]}', expected ODOMETRY or SENSOR", file, number)
        if len(fields) != 4:
            raise DataError(f"{fields[0]}: got {len(fields)} columns, expected 4", file, number)
        wrong = [value for value in fields[1:] if not is_number(value)]
        if wrong:
            raise DataError(f"{fields[0]}: got '{wrong[0]}', expected a number", file, number)
        values = [float(value) for value in fields[1:]]
        if fields[0] == "ODOMETRY":
            if not np.isfinite(values).all():
                raise DataError("ODOMETRY: got NaN or infinity, expected finite numbers", file, number)
            odometry.append(values)
        elif not values[0].is_integer():
            raise DataError(f"SENSOR: got landmark '{fields[1]}', expected a whole number", file, number)
        else:
            readings.append([float(len(odometry)), *values])
    if not odometry or not readings:
        raise DataError(f"holds {len(odometry)} ODOMETRY and {len(readings)} SENSOR rows, needs both", file)
    return np.array(odometry), np.array(readings)


def _increments(odometry: Floats) -> Floats:
    rotation1, translation, rotation2 = odometry.T
    return np.column_stack(
        [translation * np.cos(rotation1), translation * np.sin(rotation1), rotation1 + rotation2]
    )


def _world(folder: Path) -> TruthLandmarks | None:
    file = find_file(folder, WORLD)
    if file is None:
        return None
    rows = read_table(file, 3)
    refuse_not_finite(file, rows)
    return TruthLandmarks(tuple(str(number) for number in whole_numbers(file, rows[:, 0])), rows[:, 1:])


def _config() -> dict[str, Any]:
    return {
        "motion": {"model": "increments", "x_std_m": 0.002, "y_std_m": 0.002, "heading_std_rad": 0.002},
        "sensor": {"model": "range_bearing", "range_std_m": 0.1, "bearing_std_rad": 0.05},
    }

"""Labyrinth (TU Chemnitz): a small robot among four ultra-wideband modules: ranges, wheel speeds, true path.

Quirks handled: a row says where its module stands, which is kept as truth and not told to the filter; the
truth has no heading. The first column of speeds is that of the left wheel and the distance is that of a wheel
from the middle, whatever the readme says: so, and only so, the odometry goes where the robot went. The ranges
are 0.1 m too long in the mean, which is not told: a run on ranges alone learns it, knowing that such modules
are good to a decimetre or two.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from ..errors import DataError
from ..log import Floats, Log, Sightings, TruthLandmarks, TruthTrajectory
from .clean import clean_controls, clean_sightings
from .options import LoadOptions
from .text import first_words, is_number, read_text

COLUMNS = {"range2": 7, "odom2diff": 8, "point2": 7}
"""Numbers of each row, its stamp first."""
USUAL_STD = (0.01, 0.15)
"""By how much such modules are off: of one, and metres."""


def matches(path: Path) -> bool:
    """The file of what the sensors said, or a folder with one."""
    file = _file(path)
    return file is not None and next(iter(first_words(file)), "") in ("range2", "odom2diff")


def _file(path: Path) -> Path | None:
    if path.is_file():
        return path
    return next(iter(sorted(path.glob("*_UWB_Input.txt"))), None) if path.is_dir() else None


def load(path: Path, options: LoadOptions) -> Log:
    """Read the set, with the truth beside it where there is some. Errors: DataError."""
    file = _file(path)
    if file is None:
        raise DataError("holds no *_UWB_Input.txt", path)
    tables = _tables(file)
    wheels, ranges = tables["odom2diff"], tables["range2"]
    if len(wheels) == 0 or len(ranges) == 0:
        raise DataError("expected rows of range2 and of odom2diff", file)
    speed = 0.5 * (wheels[:, 1] + wheels[:, 2])
    turning = (wheels[:, 2] - wheels[:, 1]) / (2.0 * wheels[:, 4])
    controls, control_problems = clean_controls(wheels[:, 0], np.column_stack([speed, turning]), path=file)
    modules, first, identity = np.unique(ranges[:, 5], return_index=True, return_inverse=True)
    nothing = np.full(len(ranges), -1, dtype=np.int64)
    sightings, problems = clean_sightings(
        Sightings(
            stamp_s=ranges[:, 0],
            range_m=ranges[:, 1],
            bearing_rad=np.full(len(ranges), np.nan),
            identity=identity.astype(np.int64),
            class_index=nothing,
            signature=np.full(len(ranges), np.nan),
        ),
        path=file,
        measures=("range_m",),
    )
    names = tuple(f"{module:g}" for module in modules)
    return Log(
        name="labyrinth",
        source=str(path),
        format="labyrinth",
        controls=controls,
        sightings=sightings,
        identity_names=names,
        truth_trajectory=_truth(file),
        truth_landmarks=TruthLandmarks(names, ranges[first, 3:5]),
        config=_config(wheels, ranges),
        problems=control_problems + problems,
    )


def _tables(file: Path) -> dict[str, Floats]:
    rows: dict[str, list[list[float]]] = {kind: [] for kind in COLUMNS}
    for number, line in enumerate(read_text(file).splitlines(), start=1):
        words = line.split()
        if not words:
            continue
        width = COLUMNS.get(words[0])
        if width is None:
            raise DataError(f"{words[0]} is none of {', '.join(COLUMNS)}", file, number)
        if len(words) - 1 < width or not all(is_number(word) for word in words[1:]):
            raise DataError(f"{words[0]}: expected {width} numbers", file, number)
        rows[words[0]].append([float(word) for word in words[1 : width + 1]])
    return {kind: np.array(table).reshape(-1, COLUMNS[kind]) for kind, table in rows.items()}


def _truth(file: Path) -> TruthTrajectory | None:
    beside = file.with_name(file.name.replace("_Input", "_GT"))
    if beside == file or not beside.is_file():
        return None
    points = _tables(beside)["point2"]
    return TruthTrajectory(
        points[:, 0], np.column_stack([points[:, 1:3], np.zeros(len(points))]), heading_known=False
    )


def _config(wheels: Floats, ranges: Floats) -> dict[str, Any]:
    """Noise as the rows have it; that of a row's speed holds for the time to the next row."""
    half_m, left, right = (float(np.median(wheels[:, column])) for column in (4, 5, 6))
    return {
        "motion": {
            "model": "velocity",
            "speed_std_m_per_s": round(0.5 * float(np.sqrt(right + left)), 6),
            "yaw_rate_std_rad_per_s": round(float(np.sqrt(left + right)) / (2.0 * half_m), 6),
            "noise_period_s": round(float(np.median(np.diff(wheels[:, 0]))), 3),
        },
        "sensor": {
            "model": "range",
            "range_std_m": round(float(np.sqrt(np.median(ranges[:, 2]))), 6),
            "range_scale_std": USUAL_STD[0],
            "range_bias_std_m": USUAL_STD[1],
        },
    }

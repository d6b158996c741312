"""Victoria Park from raw scans: the 2003 ASCII edition, whose laser file is a single line.

All times are seconds on the clock of the extracted features (from the first GPS fix). Quirks handled: the
laser file has no line breaks; beam 0 points right; GPS rows have north before east; the steering is brought
to the calibration of the other edition; the state is the pose of the LASER. Where the folder of the extracted
features lies beside it, its 4466 position fixes are taken, not the 948 that the ASCII edition kept. There are
no sightings until a detector has made them from the scans.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from ..config import merge
from ..errors import DataError
from ..log import BeamGeometry, Log, PositionFixes, Scans
from . import victoria_park
from .clean import clean_controls, no_sightings
from .options import LoadOptions
from .text import find_file, read_table, read_text, require_file

FOLDER = "ascii_2003"
FILES = ("LASER.txt", "DRS.txt", "GPS.txt")
BEAMS = 361
NO_RETURN_M = 80.0
# From the steering of this edition to that of the other: exactly linear, and worth 0.1 m of GPS error.
STEERING_SCALE, STEERING_OFFSET_RAD = 0.94412, -0.002464
# Noise of this scanner on bark; the extra noise is that of trunks that lean and are no circles. What stands
# 4 m before anything else is a trunk even if one beam hits it; nearer to others are bushes and people.
DETECTOR: dict[str, Any] = {
    "kind": "trunks",
    "trunks": {
        "range_std_m": 0.06,
        "roughness_std_m": 0.05,
        "min_beams": 1,
        "min_clearance_m": 4.0,
        "max_diameter_m": 1.5,
        "max_range_m": 40.0,
        "extra_range_std_m": 0.5,
        "extra_bearing_std_rad": 0.022,
    },
}


def matches(path: Path) -> bool:
    """A folder that has the three raw files itself (its parent is taken for the extracted features)."""
    return all(find_file(path, name) for name in FILES)


def load(path: Path, options: LoadOptions) -> Log:
    """Read the set. Errors: DataError for a missing or faulty file."""
    folder = path / FOLDER if (path / FOLDER).is_dir() else path
    drive = require_file(folder, "DRS.txt")
    rows = read_table(drive, 3)
    steering_rad = STEERING_SCALE * rows[:, 2] + STEERING_OFFSET_RAD
    values = np.column_stack([rows[:, 1], steering_rad])
    controls, problems = clean_controls(rows[:, 0], values, path=drive)
    return Log(
        name="victoria_park_scans",
        source=str(path),
        format="victoria_scans",
        controls=controls,
        sightings=no_sightings(),
        position_fixes=_fixes(folder),
        scans=_scans(require_file(folder, "LASER.txt")),
        # Measured: with paths drawn anew the median distance to GPS is 1.16 m, without 1.01 m (3 seeds).
        config=merge(victoria_park.configuration(), {"filter": {"rejuvenation": {"every_steps": 0}}}),
        problems=problems,
    )


def _scans(path: Path) -> Scans:
    """Every 362 numbers are one scan: time, then 361 ranges."""
    try:
        numbers = np.array(read_text(path).split(), dtype=np.float64)
    except ValueError as error:
        raise DataError(f"holds something that is no number ({error})", path) from error
    width = BEAMS + 1
    if len(numbers) == 0 or len(numbers) % width:
        scans, rest = divmod(len(numbers), width)
        raise DataError(f"got {scans} scans of {width} numbers and {rest} more: cut off?", path)
    rows = numbers.reshape(-1, width)
    late = np.diff(rows[:, 0]) <= 0
    if late.any():
        raise DataError(f"scan {1 + int(np.argmax(late))} is not later than the one before", path)
    geometry = BeamGeometry(
        first_angle_rad=-np.pi / 2, angle_step_rad=np.pi / 360, min_range_m=1.0, max_range_m=NO_RETURN_M
    )
    return Scans(rows[:, 0].copy(), rows[:, 1:].astype(np.float32), geometry, detector=DETECTOR)


def _fixes(folder: Path) -> PositionFixes:
    better = find_file(folder.parent / victoria_park.FOLDER, "gps.dat")
    if better is not None:
        rows = read_table(better, 3)
        return PositionFixes(rows[:, 0], rows[:, 1:])
    rows = read_table(require_file(folder, "GPS.txt"), 3)
    return PositionFixes(rows[:, 0], rows[:, [2, 1]])

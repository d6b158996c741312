"""Victoria Park: a truck among trees; tree features that others extracted, speed and steering, GPS.

All times are seconds on the clock of the extracted features. Quirks handled: bearings count from the
vehicle's right, so a quarter turn is taken off; the diameter is the signature; the state is the pose of the
LASER, whose place on the vehicle is in the motion model, so the sensor mounting is zero. The position fixes
are all 4466 of `gps.dat` (the rotated and shifted frame of that file), outliers included: 74 are more than
10 m off, so score with a median or a trimmed mean. The 948 that the authors kept, `ascii_2003/GPS.txt` (north
first), are the edited fixes where that file is there. There are no identities and no true map.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from ..log import Log, PositionFixes, Sightings
from .clean import clean_controls, clean_sightings
from .options import LoadOptions
from .text import find_file, read_table, require_file

FOLDER = "features_rfs_slam"
EDITED_FOLDER = "ascii_2003"
FILES = ("measurements.dat", "inputs.dat", "gps.dat")
CONTROL_PERIOD_S = 0.025


def matches(path: Path) -> bool:
    """A folder that has the three feature files, or has them in `features_rfs_slam`."""
    return all(find_file(_folder(path), name) for name in FILES)


def load(path: Path, options: LoadOptions) -> Log:
    """Read the set. Errors: DataError for a missing or faulty file."""
    folder = _folder(path)
    measurements, inputs, gps = (require_file(folder, name) for name in FILES)
    stamp_s, range_m, bearing_from_right_rad, diameter_m = read_table(measurements, 4).T
    control_rows = read_table(inputs, 3)
    fixes = read_table(gps, 3)
    controls, control_problems = clean_controls(control_rows[:, 0], control_rows[:, 1:], path=inputs)
    nobody = np.full(len(stamp_s), -1, dtype=np.int64)
    sightings, sighting_problems = clean_sightings(
        Sightings(
            stamp_s=stamp_s,
            range_m=range_m,
            bearing_rad=bearing_from_right_rad - np.pi / 2,
            identity=nobody,
            class_index=nobody.copy(),
            signature=diameter_m,
        ),
        path=measurements,
    )
    return Log(
        name="victoria_park",
        source=str(path),
        format="victoria_park",
        controls=controls,
        sightings=sightings,
        position_fixes=PositionFixes(fixes[:, 0], fixes[:, 1:]),
        edited_fixes=_edited_fixes(folder),
        config=configuration(),
        problems=control_problems + sighting_problems,
    )


def _folder(path: Path) -> Path:
    inner = path / FOLDER
    return inner if inner.is_dir() else path


def _edited_fixes(folder: Path) -> PositionFixes | None:
    """The fixes of the edition of 2003, on the same clock, east first; None where they are not beside."""
    file = find_file(folder.parent / EDITED_FOLDER, "GPS.txt")
    if file is None:
        return None
    stamp_s, north_m, east_m = read_table(file, 3).T
    return PositionFixes(stamp_s, np.column_stack([east_m, north_m]))


def configuration() -> dict[str, Any]:
    """Geometry as the authors measured it; noise as in trials that reached the published accuracy."""
    return {
        "motion": {
            "model": "ackermann",
            "wheelbase_m": 2.83,
            "encoder_left_m": 0.76,
            "sensor_ahead_m": 3.78,
            "sensor_left_m": 0.5,
            "speed_std_m_per_s": 0.5,
            "steering_std_rad": 0.03,
            "noise_period_s": CONTROL_PERIOD_S,
        },
        "sensor": {
            "model": "range_bearing",
            "range_std_m": 0.5,
            "bearing_std_rad": float(np.deg2rad(1.5)),
            "min_range_m": 1.5,
            "max_range_m": 50.0,
            "field_of_view_rad": float(np.pi),
            "mounting": {"x_m": 0.0, "y_m": 0.0, "yaw_rad": 0.0},
        },
        # Trees are seen at almost 5 Hz, and the errors of the round-trunk model repeat from scan to scan.
        "filter": {
            "likelihood_exponent": 0.2,
            "rejuvenation": {"every_steps": 100, "growth": 0.03, "spread": 0.2},
        },
    }

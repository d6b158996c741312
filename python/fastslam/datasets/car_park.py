"""Sydney car park: a truck among reflective posts; laser with reflectivity, speed and steering, RTK truth.

Quirks handled: range and reflected intensity share 16 bits; speed and steering are raw counts; latitude is
positive to the south; the GPS antenna sits at the laser, whose pose is the state, so of the mounting there
is only the yaw. The true heading is not known. The posts were surveyed; other reflectors in view were not,
so the true map is not complete. There are no sightings until a detector has made them from the scans.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import DataError
from ..log import (
    BeamGeometry,
    Controls,
    Floats,
    Log,
    Problem,
    Scans,
    TruthLandmarks,
    TruthTrajectory,
)
from .clean import clean_controls, no_sightings
from .csv_table import read_csv
from .matlab import read_matrices
from .options import LoadOptions

DEFAULT_RUN = 3
POSTS = "derived_posts.csv"
NO_RETURN_M = 81.0
ENCODER_PERIOD_S = 0.025
EQUATOR_RADIUS_M = 6378137.0
DETECTOR: dict[str, Any] = {
    "kind": "reflectors",
    "reflectors": {"radius_m": 0.03, "range_std_m": 0.1, "bearing_std_rad": 0.01},
}
# Retro-reflectors read long on this scanner, and it is turned to the right by a degree: what
# `fastslam calibrate --reference odometry` finds in run 3, without a look at its truth.
RANGE_SCALE, RANGE_BIAS_M, LASER_YAW_RAD = 1.006, 0.0105, -0.016
FLATTENING = 0.003352810664747
ORIGIN_LATITUDE_DEG, ORIGIN_LONGITUDE_DEG = -33.8884, 151.1948


def matches(path: Path) -> bool:
    """A folder with a raw run of the car park."""
    return path.is_dir() and any(path.glob("juan[0-9]_lsr2.mat"))


def load(path: Path, options: LoadOptions) -> Log:
    """Read one run (3 unless `options.run` names one). Errors: DataError for a missing or faulty file."""
    run = DEFAULT_RUN if options.run is None else options.run
    controls, control_problems = _controls(path / f"juan{run}_etc.mat")
    scans = _scans(path / f"juan{run}_lsr2.mat")
    return Log(
        name=f"car_park_{run}",
        source=str(path),
        format="car_park",
        controls=controls,
        sightings=no_sightings(),
        truth_trajectory=_truth(path / f"juan{run}_gps.mat"),
        truth_landmarks=_posts(path / POSTS),
        scans=scans,
        config=_config(),
        problems=control_problems,
    )


def _controls(path: Path) -> tuple[Controls, tuple[Problem, ...]]:
    rows = _variable(path, "SENSORS", columns=6).astype(np.float64)
    steering_rad = 1.0127 * (rows[:, 3] - 2022.0) * 0.00040 + 0.0042
    speed_m_per_s = rows[:, 5] * 0.024970 * 0.79
    return clean_controls(1e-3 * rows[:, 0], np.column_stack([speed_m_per_s, steering_rad]), path=path)


def _scans(path: Path) -> Scans:
    """Range in centimetres in the low 13 bits, intensity (0 to 4) in the high 3; beam 0 points right."""
    packed = _variable(path, "LASER", columns=361)
    if packed.dtype != np.uint16:
        raise DataError(f"LASER: got type {packed.dtype}, expected uint16", path)
    stamp_s = 1e-3 * _variable(path, "TLsr", columns=1)[:, 0].astype(np.float64)
    if len(stamp_s) != len(packed):
        raise DataError(f"got {len(stamp_s)} stamps for {len(packed)} scans", path)
    if np.any(np.diff(stamp_s) <= 0):
        scan = 1 + int(np.argmax(np.diff(stamp_s) <= 0))
        raise DataError(f"scan {scan} is not later than the one before", path)
    geometry = BeamGeometry(
        first_angle_rad=-np.pi / 2, angle_step_rad=np.pi / 360, min_range_m=1.0, max_range_m=NO_RETURN_M
    )
    ranges_m = ((packed & 0x1FFF) / 100.0).astype(np.float32)
    intensities = (packed >> 13).astype(np.float32)
    mounting = (0.0, 0.0, LASER_YAW_RAD)
    return Scans(stamp_s, ranges_m, geometry, intensities=intensities, mounting=mounting, detector=DETECTOR)


def _truth(path: Path) -> TruthTrajectory:
    """RTK GPS as metres east and north of the benchmark's origin."""
    rows = _variable(path, "GPS", columns=13)
    north_east = local_metres(-rows[:, 2], rows[:, 3])
    unknown = np.full(len(rows), np.nan)
    poses = np.column_stack([north_east, unknown])
    finite = np.isfinite(poses[:, :2]).all(axis=1)
    return TruthTrajectory(1e-3 * rows[finite, 0], poses[finite], heading_known=False)


def local_metres(latitude_deg: Floats, longitude_deg: Floats) -> Floats:
    """East and north of the origin, by the radii of the ellipsoid there. Shapes: (T,) and (T,) to (T, 2)."""
    latitude_rad = np.radians(ORIGIN_LATITUDE_DEG)
    a, b = EQUATOR_RADIUS_M, EQUATOR_RADIUS_M * (1 - FLATTENING)
    cosine, sine = np.cos(latitude_rad), np.sin(latitude_rad)
    parallel_m = a**2 * cosine / np.sqrt((a * cosine) ** 2 + (b * sine) ** 2)
    meridian_m = (b / a) * np.sqrt(a**2 - parallel_m**2) / abs(sine)
    east_m = np.radians(longitude_deg - ORIGIN_LONGITUDE_DEG) * parallel_m
    north_m = np.radians(latitude_deg - ORIGIN_LATITUDE_DEG) * meridian_m
    return np.column_stack([east_m, north_m])


def _posts(path: Path) -> TruthLandmarks | None:
    if not path.is_file():
        return None
    table = read_csv(path, example="post,east_m,north_m")
    for name in ("post", "east_m", "north_m"):
        if name not in table.index_of:
            raise DataError(f"the column {name} is missing", path, 1)
    names = tuple(name.strip() for name in table.texts("post"))
    positions = np.column_stack([table.finite_numbers("east_m"), table.finite_numbers("north_m")])
    return TruthLandmarks(names, positions, complete=False)


def _variable(path: Path, name: str, *, columns: int) -> NDArray[Any]:
    """A matrix of a MATLAB file. Errors: DataError where file or matrix are missing or of another width."""
    if not path.is_file():
        raise DataError("the file is missing", path)
    content = read_matrices(path, [name])
    if name not in content:
        raise DataError(f"the matrix {name} is missing", path)
    matrix: NDArray[Any] = content[name]
    if matrix.ndim != 2 or matrix.shape[1] != columns or len(matrix) == 0:
        raise DataError(f"{name}: got shape {matrix.shape}, expected rows of {columns}", path)
    if matrix.dtype.kind not in "fiu":
        raise DataError(f"{name}: got type {matrix.dtype}, expected numbers", path)
    return matrix


def _config() -> dict[str, Any]:
    """Geometry as the authors measured it; noise of the motion from trials."""
    return {
        "motion": {
            "model": "ackermann",
            "wheelbase_m": 2.83,
            "encoder_left_m": 0.76,
            "sensor_ahead_m": 3.78,
            "sensor_left_m": 0.5,
            "speed_std_m_per_s": 0.3,
            "steering_std_rad": float(np.radians(8.0)),
            "noise_period_s": ENCODER_PERIOD_S,
        },
        "sensor": {
            "model": "range_bearing",
            "range_std_m": 0.15,
            "bearing_std_rad": float(np.radians(1.0)),
            "min_range_m": 1.0,
            "max_range_m": 60.0,
            "field_of_view_rad": float(np.pi),
            "range_scale": RANGE_SCALE,
            "range_bias_m": RANGE_BIAS_M,
            "mounting": {"x_m": 0.0, "y_m": 0.0, "yaw_rad": LASER_YAW_RAD},
        },
    }

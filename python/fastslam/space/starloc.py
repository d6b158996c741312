"""STAR-loc: tags in a room, seen by a stereo camera in a hand or on a robot; no odometry, sometimes a gyro.

Quirks handled: the quaternions of the cameras turn the world into the camera; the gyro sits on the camera
with other axes, and its clock is another one than that of the tags, by run; the first survey of the tags has
two of them exchanged, and labels of its own beside those of the tags; the motion capture jumps now and then
and does not say so. A sighting is made a point with its covariance: pixels are too far from linear for a pose
that nothing holds.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from ..datasets.csv_table import CsvTable, read_csv
from ..datasets.text import find_file, read_text, require_file
from ..errors import DataError
from ..log import Floats, Problem
from .log import WITHOUT_ODOMETRY, SpaceLog, SpaceTruth

TAGS, CALIBRATION, GYRO = "apriltag.csv", "calib.json", "imu.csv"
TRUE_POSES = "apriltag_cal_individual.csv"
PIXELS = ("left_u", "left_v", "right_u", "right_v")
SHIFT = ("cam_x", "cam_y", "cam_z")
TURN = ("cam_w", "cam_rot_x", "cam_rot_y", "cam_rot_z")
RATES = ("angular_velocity_x", "angular_velocity_y", "angular_velocity_z")
OPTICS = ("fu", "fv", "cu", "cv", "b")
PIXEL_STD = (2.0, 2.0, 1.0)
"""Of column, row and disparity: both cameras of a pair that shakes err together."""
LATE_S = {"loop-2d_s1": 1.55, "loop-2d-fast_s1": 1.55, "loop-3d_s5": 1.6}
"""By how much the clock of the gyro is ahead of that of the tags, where it is not as in the other runs."""
USUALLY_LATE_S = 0.15
EXCHANGED = {"v1": (35, 36)}
"""Tags of which the survey has one in the place of the other."""
FASTEST_M_PER_S = 10.0
"""A hand is slower: motion capture that says otherwise has jumped."""


def matches(path: Path) -> bool:
    """A folder of one run: sightings of tags with the optics of the cameras."""
    return (path / CALIBRATION).is_file() and find_file(path, TAGS) is not None


def load(path: Path) -> SpaceLog:
    """Read a run. Errors: DataError for files that are missing, or of another form."""
    table = read_csv(require_file(path, TAGS), example="time_s,apriltag_id,left_u,left_v,right_u,right_v")
    stamp_s, tag = _columns(table, ("time_s", "apriltag_id")).T
    order = np.argsort(stamp_s, kind="stable")
    left_u, left_v, right_u, right_v = _columns(table, PIXELS)[order].T
    pixels = np.column_stack([left_u, 0.5 * (left_v + right_v), left_u - right_u])
    value, covariance = _points(path, pixels)
    tags = np.unique(tag.astype(np.int64))
    row_stamp_s, rates = _gyro(path)
    true_stamp_s, true_poses, jumps = _true_poses(path)
    names, places = _survey(path)
    return SpaceLog(
        name=path.resolve().name,
        source=str(path),
        format="starloc",
        row_stamp_s=row_stamp_s,
        velocity=np.hstack([np.zeros_like(rates), rates]),
        sighting_stamp_s=stamp_s[order],
        value=value,
        covariance=covariance,
        identity=np.searchsorted(tags, tag[order]).astype(np.int64),
        names=tuple(str(number) for number in tags),
        truth=SpaceTruth(true_stamp_s, true_poses, names, places),
        config=_config(len(row_stamp_s) > 0, true_poses),
        problems=(Problem("true poses that lie off their neighbours: left out", jumps),) if jumps else (),
    )


def _columns(table: CsvTable, names: tuple[str, ...]) -> Floats:
    missing = [name for name in names if name not in table.index_of]
    if missing:
        raise DataError(f"column {missing[0]} is missing", table.path, table.header_line)
    return np.column_stack([table.finite_numbers(name) for name in names])


def _gyro(path: Path) -> tuple[Floats, Floats]:
    """Stamps by the clock of the tags, and velocities about the axes of the camera; none without a gyro."""
    file = find_file(path, GYRO)
    if file is None:
        return np.empty(0), np.empty((0, 3))
    rows = _columns(read_csv(file, example="time_s"), ("time_s", *RATES))
    rows = rows[np.unique(rows[:, 0], return_index=True)[1]]
    _, x, y, z = rows.T
    return rows[:, 0] - LATE_S.get(path.resolve().name, USUALLY_LATE_S), np.column_stack([-y, -z, x])


def _true_poses(path: Path) -> tuple[Floats, Floats, int]:
    """Stamps of frames, poses of the camera, and how many others were left out."""
    file = find_file(path, TRUE_POSES)
    if file is None:
        return np.empty(0), np.empty((0, 7)), 0
    rows = _columns(read_csv(file, example="time_s"), ("time_s", *SHIFT, *TURN))
    rows = rows[np.unique(rows[:, 0], return_index=True)[1]]
    rows[:, 5:] *= -1.0
    sound = [0]
    for row in range(1, len(rows)):
        gone, took_s = rows[row, 1:4] - rows[sound[-1], 1:4], rows[row, 0] - rows[sound[-1], 0]
        if np.linalg.norm(gone) <= FASTEST_M_PER_S * took_s:
            sound.append(row)
    rows[:, 4:] /= np.linalg.norm(rows[:, 4:], axis=1, keepdims=True)
    return rows[sound, 0], rows[sound, 1:], len(rows) - len(sound)


def _survey(path: Path) -> tuple[tuple[str, ...], Floats]:
    """Tags and where they are, from the survey that the data set has for the run."""
    root = path.resolve().parent.parent
    listed = root / "dataset_params.json"
    if not listed.is_file():
        return (), np.empty((0, 3))
    runs = {run["name"]: run["landmarks"] for run in _json(listed)}
    version = runs.get(path.resolve().name)
    file = find_file(root / "mocap", f"environment_{version}.csv")
    if file is None:
        return (), np.empty((0, 3))
    table = _columns(read_csv(file, example="id,x,y,z,april_id"), ("april_id", "x", "y", "z"))
    one, other = EXCHANGED.get(str(version), (0, 0))
    right = {one: other, other: one}
    numbers = [right.get(int(number), int(number)) for number in table[:, 0]]
    return tuple(map(str, numbers)), table[:, 1:]


def _points(path: Path, pixels: Floats) -> tuple[Floats, Floats]:
    """Points (S, 3) in the camera's frame (x right, y down, z ahead) and the triangles of their covariances.

    Errors: DataError for optics that are none, and tags that lie behind the cameras.
    """
    optics = _json(path / CALIBRATION)
    try:
        fu, fv, cu, cv, baseline_m = (float(optics[name]) for name in OPTICS)
    except (KeyError, TypeError, ValueError) as error:
        raise DataError(f"is malformed ({error})", path / CALIBRATION) from None
    column, row, disparity = pixels.T
    if np.any(disparity <= 0.0):
        raise DataError("a tag lies behind the cameras: expected left_u above right_u", path / TAGS)
    z = fu * baseline_m / disparity
    point = np.column_stack([(column - cu) * z / fu, (row - cv) * z / fv, z])
    by_pixel = np.zeros((len(point), 3, 3))
    by_pixel[:, 0, 0], by_pixel[:, 1, 1] = z / fu, z / fv
    by_pixel[:, :, 2] = -point / disparity[:, None]
    scaled = by_pixel * np.array(PIXEL_STD)
    covariance = scaled @ np.transpose(scaled, (0, 2, 1))
    first, second = np.triu_indices(3)
    return point, covariance[:, first, second]


def _config(has_gyro: bool, true_poses: Floats) -> dict[str, Any]:
    config: dict[str, Any] = {
        "motion": {"kind": "gyro" if has_gyro else "wandering"},
        "sensor": {"model": "point"},
        "filter": dict(WITHOUT_ODOMETRY),
    }
    if len(true_poses):
        keys = ("x_m", "y_m", "z_m", "qw", "qx", "qy", "qz")
        config["initial_pose"] = dict(zip(keys, map(float, true_poses[0]), strict=True))
    return config


def _json(path: Path) -> Any:
    try:
        return json.loads(read_text(path))
    except ValueError as error:
        raise DataError(f"is malformed ({error})", path) from None

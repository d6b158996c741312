"""Starry Night: a stereo camera with velocities and gyro, moved by hand over 20 marked points (MATLAB file).

Quirks handled: -1 pixel means not seen; both rows of a pair say the same, so that their weighted mean is the
row; orientations are rotation vectors that turn the world into the vehicle; the variances are the authors'
own, of velocities in rows of a median of 63 ms.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from ..datasets.matlab import files_with, read_matrices
from ..errors import DataError
from ..log import Floats, Problem
from .evaluation import quaternions
from .log import SpaceLog, SpaceTruth

POINTS = 20
_OPTICS = ("fu", "fv", "cu", "cv", "b")
_VECTORS = ("v_vk_vk_i", "w_vk_vk_i", "r_i_vk_i", "theta_vk_i")
VARIABLES = frozenset(
    ("t", "y_k_j", "rho_i_pj_i", "C_c_v", "rho_v_c_v", "v_var", "w_var", "y_var", *_OPTICS, *_VECTORS)
)


def matches(path: Path) -> bool:
    """A MATLAB file with this set's variables, or a folder with exactly one such file."""
    return len(files_with(path, VARIABLES)) == 1


def load(path: Path) -> SpaceLog:
    """Read the set. Errors: DataError for a file without the variables, or of other shapes."""
    candidates = files_with(path, VARIABLES)
    if len(candidates) != 1:
        raise DataError("is no MATLAB file with this set's variables, nor a folder of one", path)
    data = _read_mat(candidates[0])
    stamp_s = data["t"].ravel()
    row, point = np.nonzero(data["y_k_j"][0] != -1)
    pixels = np.moveaxis(data["y_k_j"], 0, -1)[row, point]
    names = tuple(str(number) for number in range(1, POINTS + 1))
    rotations = np.transpose(_rotations(data["theta_vk_i"].T), (0, 2, 1))
    truth = SpaceTruth(
        stamp_s, np.column_stack([data["r_i_vk_i"].T, quaternions(rotations)]), names, data["rho_i_pj_i"].T
    )
    unseen = int(len(stamp_s) - len(np.unique(row)))
    return SpaceLog(
        name="starry_night",
        source=str(path),
        format="starry_night",
        row_stamp_s=stamp_s,
        velocity=np.hstack([data["v_vk_vk_i"].T, data["w_vk_vk_i"].T]),
        sighting_stamp_s=stamp_s[row],
        value=_reading(pixels, data["y_var"].ravel()),
        identity=point.astype(np.int64),
        names=names,
        truth=truth,
        config=_config(data, truth.T_world_robot[0], float(np.median(np.diff(stamp_s)))),
        problems=(Problem("frames in which no point is seen", unseen),),
    )


def _read_mat(path: Path) -> dict[str, Any]:
    data = read_matrices(path, VARIABLES)
    missing = VARIABLES - set(data)
    if missing:
        raise DataError(f"holds no matrix {', '.join(sorted(missing))}", path)
    rows = data["t"].size
    shapes: dict[str, tuple[int, ...]] = {name: (3, rows) for name in _VECTORS}
    shapes |= {name: (1, 1) for name in _OPTICS}
    shapes |= {"t": (1, rows), "y_k_j": (4, rows, POINTS), "rho_i_pj_i": (3, POINTS), "C_c_v": (3, 3)}
    shapes |= {"rho_v_c_v": (3, 1), "v_var": (3, 1), "w_var": (3, 1), "y_var": (4, 1)}
    for name, shape in shapes.items():
        if data[name].shape != shape:
            raise DataError(f"variable {name}: got shape {data[name].shape}, expected {shape}", path)
        if not np.isfinite(data[name]).all():
            raise DataError(f"variable {name}: got NaN or infinite values", path)
    if rows < 2 or np.any(np.diff(data["t"].ravel()) <= 0):
        raise DataError("variable t: expected growing times", path)
    return {name: np.asarray(data[name], dtype=np.float64) for name in VARIABLES}


def _reading(pixels: Floats, variance: Floats) -> Floats:
    """Column, row and disparity: both rows of a pair say the same."""
    left_u, left_v, right_u, right_v = pixels.T
    left, right = 1.0 / variance[1], 1.0 / variance[3]
    return np.column_stack([left_u, (left * left_v + right * right_v) / (left + right), left_u - right_u])


def _rotations(vectors: Floats) -> Floats:
    """cos(a) I + (1 - cos(a)) u u^T - sin(a) u^x for vectors a u (N, 3)."""
    angle = np.linalg.norm(vectors, axis=1)
    axis = vectors / np.where(angle > 0, angle, 1.0)[:, None]
    x, y, z = axis.T
    zero = np.zeros(len(axis))
    cross = np.moveaxis(np.array([[zero, -z, y], [z, zero, -x], [-y, x, zero]]), -1, 0)
    cosine, sine = np.cos(angle)[:, None, None], np.sin(angle)[:, None, None]
    outer = axis[:, :, None] * axis[:, None, :]
    return np.asarray(cosine * np.eye(3) + (1.0 - cosine) * outer - sine * cross)


def _config(data: dict[str, Any], start: Floats, row_s: float) -> dict[str, Any]:
    def growing(name: str) -> list[float]:
        return [float(value) for value in np.sqrt(data[name].ravel() * row_s)]

    turn = quaternions(data["C_c_v"].T[None])[0]
    variance = data["y_var"].ravel()
    keys = ("x_m", "y_m", "z_m", "qw", "qx", "qy", "qz")
    mounting = np.concatenate([data["rho_v_c_v"].ravel(), turn])
    return {
        "motion": {
            "position_std_m_per_sqrt_s": growing("v_var"),
            "turn_std_rad_per_sqrt_s": growing("w_var"),
        },
        "sensor": {
            "model": "stereo",
            "column_std_px": float(np.sqrt(np.mean(variance[[0, 2]]))),
            "row_std_px": float(np.sqrt(np.mean(variance[[1, 3]]))),
            "camera": {
                "fu_px": float(data["fu"].item()),
                "fv_px": float(data["fv"].item()),
                "cu_px": float(data["cu"].item()),
                "cv_px": float(data["cv"].item()),
                "baseline_m": float(data["b"].item()),
            },
            "mounting": dict(zip(keys, map(float, mounting), strict=True)),
        },
        "initial_pose": dict(zip(keys, map(float, start), strict=True)),
    }

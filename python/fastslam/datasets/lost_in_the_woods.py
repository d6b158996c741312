"""Lost in the Woods: a robot, a laser, 17 tubes with identities, motion-capture truth (one MATLAB file).

Units are SI already. Quirks handled: range 0 means not seen; ranges stuck at the largest value (5.63531 m)
are saturated, hence the default range limit; the laser sits `d` ahead of the robot's centre; truth counts
only where `true_valid` is 1. The noise is the authors' own.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from ..errors import DataError
from ..log import Controls, Floats, Log, Problem, Sightings, TruthLandmarks, TruthTrajectory
from .clean import clean_controls, clean_sightings
from .matlab import files_with, read_matrices
from .options import LoadOptions

DEFAULT_MAX_RANGE_M = 5.6
FIELD_OF_VIEW_RAD = 4.2
"""All bearings lie within +-2.096 rad."""
_TRUTH = ("l", "x_true", "y_true", "th_true", "true_valid")
_VARIANCES = ("r_var", "b_var", "v_var", "om_var")
VARIABLES = frozenset(("t", "r", "b", "v", "om", "d", *_TRUTH, *_VARIANCES))


def matches(path: Path) -> bool:
    """A MATLAB file with this set's variables, or a folder with exactly one such file."""
    return len(files_with(path, VARIABLES)) == 1


def load(path: Path, options: LoadOptions) -> Log:
    """Read the set. Errors: DataError for a file without the variables or a limit that is not positive."""
    candidates = files_with(path, VARIABLES)
    if len(candidates) != 1:
        raise DataError("is no MATLAB file with this set's variables, nor a folder of one", path)
    max_range_m = DEFAULT_MAX_RANGE_M if options.max_range_m is None else options.max_range_m
    if not max_range_m > 0:
        raise DataError(f"max_range_m: got {max_range_m}, expected a positive number", path)
    data = _read_mat(candidates[0])
    sightings, too_far = _sightings(data, max_range_m)
    controls, control_problems = _controls(data, candidates[0])
    cleaned, sighting_problems = clean_sightings(sightings, path=candidates[0])
    names = tuple(str(number) for number in range(1, data["l"].shape[0] + 1))
    dropped = Problem(f"sightings beyond {max_range_m:g} m: dropped", too_far)
    truth = _truth_trajectory(data, candidates[0])
    return Log(
        name="lost_in_the_woods",
        source=str(path),
        format="lost_in_the_woods",
        controls=controls,
        sightings=cleaned,
        identity_names=names,
        truth_trajectory=truth,
        truth_landmarks=TruthLandmarks(names, data["l"].astype(np.float64)),
        config=_config(data, max_range_m, truth.T_world_robot[0]),
        problems=((dropped,) if too_far else ()) + control_problems + sighting_problems,
    )


def _read_mat(path: Path) -> dict[str, Any]:
    data = read_matrices(path, VARIABLES)
    missing = VARIABLES - set(data)
    if missing or data["r"].ndim != 2:
        raise DataError(f"holds no matrix {', '.join(sorted(missing)) or 'r'}", path)
    rows, tubes = data["r"].shape
    shapes = {name: (rows, 1) for name in ("t", "v", "om", *_TRUTH[1:])}
    shapes |= {name: (1, 1) for name in ("d", *_VARIANCES)}
    shapes |= {"b": (rows, tubes), "l": (tubes, 2)}
    for name, shape in shapes.items():
        if data[name].shape != shape:
            raise DataError(f"variable {name}: got shape {data[name].shape}, expected {shape}", path)
    if not np.isfinite(data["l"]).all():
        raise DataError("variable l: got NaN or infinite positions of tubes", path)
    return data


def _controls(data: dict[str, Any], path: Path) -> tuple[Controls, tuple[Problem, ...]]:
    values = np.column_stack([data["v"].ravel(), data["om"].ravel()]).astype(np.float64)
    return clean_controls(_stamps(data), values, path=path)


def _stamps(data: dict[str, Any]) -> Floats:
    stamp_s: Floats = data["t"].ravel().astype(np.float64)
    return stamp_s


def _sightings(data: dict[str, Any], max_range_m: float) -> tuple[Sightings, int]:
    range_m = data["r"].astype(np.float64)
    seen = range_m != 0
    near = seen & ~(range_m > max_range_m)
    row, tube = np.nonzero(near)
    sightings = Sightings(
        stamp_s=_stamps(data)[row],
        range_m=range_m[near],
        bearing_rad=data["b"].astype(np.float64)[near],
        identity=tube.astype(np.int64),
        class_index=np.full(len(row), -1, dtype=np.int64),
        signature=np.full(len(row), np.nan),
    )
    return sightings, int(seen.sum() - near.sum())


def _truth_trajectory(data: dict[str, Any], path: Path) -> TruthTrajectory:
    poses = np.column_stack([data[name].ravel() for name in ("x_true", "y_true", "th_true")])
    valid = (data["true_valid"].ravel() == 1) & np.isfinite(poses).all(axis=1)
    if not valid.any():
        raise DataError("no row of true_valid is 1", path)
    return TruthTrajectory(_stamps(data)[valid], poses[valid].astype(np.float64))


def _config(data: dict[str, Any], max_range_m: float, start: Floats) -> dict[str, Any]:
    def std(name: str) -> float:
        return float(np.sqrt(data[name].item()))

    return {
        "motion": {
            "model": "velocity",
            "speed_std_m_per_s": std("v_var"),
            "yaw_rate_std_rad_per_s": std("om_var"),
            "lateral_std_m_per_s": 0.05,
            "noise_period_s": 0.1,
        },
        "sensor": {
            "model": "range_bearing",
            "range_std_m": std("r_var"),
            "bearing_std_rad": std("b_var"),
            "tail_degrees_of_freedom": 4.0,
            "max_range_m": max_range_m,
            "field_of_view_rad": FIELD_OF_VIEW_RAD,
            "mounting": {"x_m": float(data["d"].item()), "y_m": 0.0, "yaw_rad": 0.0},
        },
        "filter": {"rejuvenation": {"every_steps": 500, "growth": 0.5, "spread": 0.5}},
        "initial_pose": {"x_m": float(start[0]), "y_m": float(start[1]), "heading_rad": float(start[2])},
    }

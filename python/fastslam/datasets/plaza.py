"""Plaza: a riding mower among four ranging radios; ranges alone, gyro and wheel odometry, RTK truth.

Quirks handled: a row of odometry leads from the true pose before to that at its own stamp; sightings have no
bearing, and their rows are not in time order. The ranges are about 7 % too long, which is not told: a run on
ranges alone learns the scale. The first true heading differs from the direction driven, so score after
alignment.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import DataError
from ..log import Log, Sightings, TruthLandmarks, TruthTrajectory
from .clean import clean_controls, clean_sightings
from .matlab import read_matrices
from .options import LoadOptions

COLUMNS = {"DR": 3, "TD": 4, "GT": 4, "TL": 3}
ROW_PERIOD_S = 0.2
NOISE_PER_ROOT_S = (0.05, 0.02, 0.01)
"""Noise of the odometry ahead, to the left (m) and in heading (rad), as others take it for this set."""


def matches(path: Path) -> bool:
    """A folder with the MATLAB file of one Plaza set."""
    return path.is_dir() and len(_files(path)) == 1


def _files(path: Path) -> list[Path]:
    return sorted(path.glob("Plaza[0-9]_.mat"))


def load(path: Path, options: LoadOptions) -> Log:
    """Read the set. Errors: DataError for a missing or faulty file."""
    file = _files(path)[0] if path.is_dir() and _files(path) else path
    tables = {name: _table(read_matrices(file, COLUMNS), name, file) for name in COLUMNS}
    driven, heard, truth, radios = (tables[name] for name in COLUMNS)
    increments = np.column_stack([driven[:, 1], np.zeros(len(driven)), driven[:, 2]])
    controls, control_problems = clean_controls(driven[:, 0], increments, path=file)
    heard = heard[np.argsort(heard[:, 0], kind="stable")]
    names, identity = np.unique(heard[:, 2].astype(np.int64), return_inverse=True)
    nothing = np.full(len(heard), -1, dtype=np.int64)
    sightings, problems = clean_sightings(
        Sightings(
            stamp_s=heard[:, 0],
            range_m=heard[:, 3],
            bearing_rad=np.full(len(heard), np.nan),
            identity=identity.astype(np.int64),
            class_index=nothing,
            signature=np.full(len(heard), np.nan),
        ),
        path=file,
        measures=("range_m",),
    )
    return Log(
        name=file.stem.rstrip("_").lower(),
        source=str(path),
        format="plaza",
        controls=controls,
        sightings=sightings,
        identity_names=tuple(str(name) for name in names),
        truth_trajectory=TruthTrajectory(truth[:, 0], truth[:, 1:]),
        truth_landmarks=TruthLandmarks(tuple(str(int(name)) for name in radios[:, 0]), radios[:, 1:]),
        config=_config(truth[0, 1:]),
        problems=control_problems + problems,
    )


def _table(matrices: dict[str, Any], name: str, path: Path) -> NDArray[np.float64]:
    """One matrix with the columns that it should have. Errors: DataError where it has not."""
    table = np.asarray(matrices.get(name, np.empty((0, 0))))
    if (
        table.ndim != 2
        or table.shape[0] == 0
        or table.shape[1] != COLUMNS[name]
        or table.dtype.kind not in "fiu"
    ):
        got = f"{table.shape} of {table.dtype}" if name in matrices else "nothing"
        raise DataError(f"{name}: got {got}, expected a matrix of {COLUMNS[name]} columns", path)
    numbers = table.astype(np.float64)
    if name in ("GT", "TL") and not np.isfinite(numbers).all():
        raise DataError(f"{name} holds what is no number", path)
    if name in ("TD", "TL"):
        column = 2 if name == "TD" else 0
        if not (np.isfinite(numbers[:, column]) & (np.abs(numbers[:, column]) < 1e9)).all():
            raise DataError(f"{name} names a radio that is no number", path)
    return numbers


def _config(start: NDArray[np.float64]) -> dict[str, Any]:
    x_std_m, y_std_m, heading_std_rad = (float(std * np.sqrt(ROW_PERIOD_S)) for std in NOISE_PER_ROOT_S)
    return {
        "motion": {
            "model": "increments",
            "x_std_m": x_std_m,
            "y_std_m": y_std_m,
            "heading_std_rad": heading_std_rad,
        },
        "sensor": {"model": "range", "range_std_m": 0.55},
        "initial_pose": {"x_m": float(start[0]), "y_m": float(start[1]), "heading_rad": float(start[2])},
    }

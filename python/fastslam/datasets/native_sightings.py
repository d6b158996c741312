"""Reads `sightings.csv` of a native log: which landmarks were seen, and where."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..errors import DataError
from ..log import Floats, Problem, Sightings
from .clean import clean_sightings
from .csv_table import CsvTable, check_columns, read_csv

SIGHTING_COLUMNS = ("stamp_s", "range_m", "bearing_rad")
COVARIANCE_COLUMNS = ("range_variance_m2", "range_bearing_covariance_m_rad", "bearing_variance_rad2")
SIGHTING_OPTIONS = ("landmark_id", "class", "signature", *COVARIANCE_COLUMNS)


def read_sightings(
    path: Path,
) -> tuple[Sightings, tuple[str, ...], tuple[str, ...], tuple[Problem, ...]]:
    """Sightings, identity names, class names, problems."""
    table = read_csv(path)
    check_columns(table, required=SIGHTING_COLUMNS, optional=SIGHTING_OPTIONS)
    nobody = np.full(len(table.lines), -1, dtype=np.int64)
    identity, identity_names = table.labels("landmark_id") if "landmark_id" in table.columns else (nobody, ())
    class_index, class_names = table.labels("class") if "class" in table.columns else (nobody, ())
    signature: Floats = np.full(len(table.lines), np.nan)
    if "signature" in table.columns:
        signature = table.numbers("signature", empty=float("nan"))
    raw = Sightings(
        stamp_s=table.numbers("stamp_s"),
        range_m=table.numbers("range_m"),
        bearing_rad=table.numbers("bearing_rad"),
        identity=identity,
        class_index=class_index,
        signature=signature,
        covariance=_covariance(table),
    )
    sightings, problems = clean_sightings(raw, path=path)
    return sightings, identity_names, class_names, table.problems + problems


def _covariance(table: CsvTable) -> Floats | None:
    """Covariances (S, 3), NaN for the sensor's own; None without the columns. All or none must be there."""
    present = [name for name in COVARIANCE_COLUMNS if name in table.columns]
    if not present:
        return None
    if len(present) < len(COVARIANCE_COLUMNS):
        missing = ", ".join(sorted(set(COVARIANCE_COLUMNS) - set(present)))
        raise DataError(
            f"has {', '.join(present)} but not {missing}: expected all three or none", table.path, 1
        )
    values = np.column_stack([table.numbers(name, empty=float("nan")) for name in COVARIANCE_COLUMNS])
    given = ~np.isnan(values).all(axis=1)
    definite = (values[:, 0] > 0) & (values[:, 2] > 0) & (values[:, 0] * values[:, 2] > values[:, 1] ** 2)
    wrong = given & ~(definite & np.isfinite(values).all(axis=1))
    if wrong.any():
        row = int(np.argmax(wrong))
        message = (
            f"covariance: got {values[row].tolist()}, expected a positive definite one or three empty cells"
        )
        raise DataError(message, table.path, table.lines[row])
    return values

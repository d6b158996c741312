"""Reads and writes `scans.npz`, the laser scans of a native log."""

from __future__ import annotations

import io
import json
import os
import zipfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import DataError
from ..log import BeamGeometry, Problem, Scans

NAME = "scans.npz"
NUMBERS = ("first_angle_rad", "angle_step_rad", "min_range_m", "max_range_m")
REQUIRED = ("stamp_s", "ranges_m", *NUMBERS)
OPTIONAL = ("intensities", "beam_period_s", "mounting", "detector_json")


def read_scans(path: Path) -> tuple[Scans | None, tuple[Problem, ...]]:
    """The scans in time order, or None where there is no such file.

    Errors: DataError that names the array for one that is missing, unknown, of another shape or not numeric,
    or for a geometry that makes no sense.
    """
    if not path.is_file():
        return None, ()
    arrays = _arrays(path)
    stamp_s = _numeric(arrays, "stamp_s", path).astype(np.float64)
    ranges_m = _ranges(arrays, "ranges_m", path)
    if stamp_s.ndim != 1 or ranges_m.ndim != 2 or len(ranges_m) != len(stamp_s):
        shapes = f"{ranges_m.shape} for stamp_s {stamp_s.shape}"
        raise DataError(f"got ranges_m {shapes}, expected (N, B) for (N,)", path)
    intensities = _ranges(arrays, "intensities", path) if "intensities" in arrays else None
    if intensities is not None and intensities.shape != ranges_m.shape:
        raise DataError(f"got intensities {intensities.shape}, expected {ranges_m.shape}", path)
    geometry = _geometry(arrays, ranges_m.shape[1], path)
    kept, problems = _time_order(stamp_s)
    mounting = _numeric(arrays, "mounting", path).ravel() if "mounting" in arrays else np.zeros(3)
    if len(mounting) != 3 or not np.isfinite(mounting).all():
        raise DataError(f"mounting: got {mounting.tolist()}, expected finite x_m, y_m, yaw_rad", path)
    x_m, y_m, yaw_rad = (float(value) for value in mounting)
    scans = Scans(
        stamp_s=stamp_s[kept],
        ranges_m=ranges_m[kept],
        geometry=geometry,
        intensities=None if intensities is None else intensities[kept],
        mounting=(x_m, y_m, yaw_rad),
        detector=_detector(arrays, path),
    )
    return scans, problems


def write_scans(scans: Scans, path: Path) -> None:
    """Write scans so that `read_scans` gives the same arrays back."""
    columns: dict[str, Any] = {name: getattr(scans.geometry, name) for name in NUMBERS}
    columns |= {"stamp_s": scans.stamp_s, "ranges_m": scans.ranges_m, "mounting": np.array(scans.mounting)}
    if scans.intensities is not None:
        columns["intensities"] = scans.intensities
    if scans.geometry.beam_period_s is not None:
        columns["beam_period_s"] = scans.geometry.beam_period_s
    if scans.detector:
        columns["detector_json"] = np.array(json.dumps(scans.detector))
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **columns)
    temporary = path.with_name(f".{path.name}.part")
    temporary.write_bytes(buffer.getvalue())
    os.replace(temporary, path)


def _arrays(path: Path) -> dict[str, NDArray[Any]]:
    try:
        with zipfile.ZipFile(path):
            pass  # NumPy loads other files too, but then not by name.
        with np.load(path, allow_pickle=False) as content:
            arrays = {name: content[name] for name in content.files}
    except (
        OSError,
        ValueError,
        EOFError,
        zipfile.BadZipFile,
        zlib.error,
        AttributeError,
        TypeError,
    ) as error:
        raise DataError(f"is no readable NPZ file ({error})", path) from error
    missing = [name for name in REQUIRED if name not in arrays]
    if missing:
        raise DataError(f"the array {missing[0]} is missing; needed are {', '.join(REQUIRED)}", path)
    unknown = [name for name in arrays if name not in REQUIRED + OPTIONAL]
    if unknown:
        raise DataError(f"unknown array {unknown[0]}; known: {', '.join(REQUIRED + OPTIONAL)}", path)
    return arrays


def _numeric(arrays: dict[str, NDArray[Any]], name: str, path: Path) -> NDArray[Any]:
    array = arrays[name]
    if array.dtype.kind not in "fiu":
        raise DataError(f"{name}: got type {array.dtype}, expected numbers", path)
    return array


def _ranges(arrays: dict[str, NDArray[Any]], name: str, path: Path) -> NDArray[Any]:
    array = _numeric(arrays, name, path)
    return array if array.dtype in (np.float32, np.float64) else array.astype(np.float64)


def _geometry(arrays: dict[str, NDArray[Any]], beams: int, path: Path) -> BeamGeometry:
    def number(name: str) -> float:
        array = _numeric(arrays, name, path)
        if array.size != 1 or not np.isfinite(array).all():
            raise DataError(f"{name}: expected one finite number", path)
        return float(array.ravel()[0])

    geometry = BeamGeometry(
        first_angle_rad=number("first_angle_rad"),
        angle_step_rad=number("angle_step_rad"),
        min_range_m=number("min_range_m"),
        max_range_m=number("max_range_m"),
        beam_period_s=number("beam_period_s") if "beam_period_s" in arrays else None,
    )
    turn_rad = (beams - 1.5) * abs(geometry.angle_step_rad)
    if geometry.angle_step_rad == 0 or turn_rad > 2 * np.pi:
        raise DataError(f"angle_step_rad: got {geometry.angle_step_rad}, expected at most one turn", path)
    if not 0 <= geometry.min_range_m < geometry.max_range_m:
        limits = f"{geometry.min_range_m} and {geometry.max_range_m}"
        raise DataError(f"min_range_m and max_range_m: got {limits}, expected 0 <= min < max", path)
    return geometry


def _detector(arrays: dict[str, NDArray[Any]], path: Path) -> dict[str, Any]:
    if "detector_json" not in arrays:
        return {}
    try:
        settings = json.loads(str(arrays["detector_json"]))
    except ValueError as error:
        raise DataError(f"detector_json: is not valid JSON ({error})", path) from error
    if not isinstance(settings, dict):
        raise DataError("detector_json: expected the settings of the detector", path)
    return settings


def _time_order(stamp_s: NDArray[np.float64]) -> tuple[NDArray[np.int64], tuple[Problem, ...]]:
    """Rows to keep, in time order: finite stamps, of equal ones the last."""
    finite = np.flatnonzero(np.isfinite(stamp_s))
    order = finite[np.argsort(stamp_s[finite], kind="stable")]
    last = np.append(np.diff(stamp_s[order]) > 0, True) if len(order) else np.zeros(0, dtype=bool)
    found = (
        ("scans with NaN or infinite stamp: dropped", len(stamp_s) - len(finite)),
        ("scans out of time order: sorted", int(np.sum(np.diff(stamp_s[finite]) < 0))),
        ("scans with a repeated stamp: the last of each stamp kept", int(np.sum(~last))),
    )
    return order[last], tuple(Problem(message, count) for message, count in found if count)

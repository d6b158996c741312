"""Everything that a run in space leaves in its folder."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from .._yaml import write_yaml
from ..resultfiles import (
    CONFIG_FILE,
    COVARIANCE_FILE,
    METRICS_FILE,
    RUN_FILE,
    RUNS_FILE,
    SMOOTHED_FILE,
    SPACE_MAP_FILE,
    STEPS_FILE,
    TRAJECTORY_FILE,
    csv_text,
    replace_results,
    to_json,
    write_atomically,
)
from .evaluation import Metrics, evaluate
from .log import SpaceLog
from .result import SpaceMap, SpacePath, SpaceResult

MAP_COLUMNS = (
    *("id", "x_m", "y_m", "z_m"),
    *(f"cov_{name}_m2" for name in ("xx", "xy", "xz", "yy", "yz", "zz")),
    "sightings",
)
_AXES = ("x", "y", "z", "rx", "ry", "rz")
_UPPER = np.triu_indices(6)


def write_outputs(
    result: SpaceResult,
    log: SpaceLog,
    folder: Path | str,
    *,
    report: bool = True,
    other_runs: Sequence[Metrics] = (),
) -> Metrics:
    """Writes the numbers and, with `report`, the picture of the map; returns the metrics.

    Errors: `DataError` where the folder cannot be written.
    """
    target = Path(folder)
    metrics = evaluate(result, log)
    contents = {
        TRAJECTORY_FILE: result.trajectory.to_tum(),
        SMOOTHED_FILE: result.smoothed.to_tum(),
        SPACE_MAP_FILE: map_text(result.landmarks),
        METRICS_FILE: to_json(metrics),
        CONFIG_FILE: f"# fastslam {result.version}, a run in space over {result.log_name}\n"
        + write_yaml(result.config),
        RUN_FILE: to_json(_facts(result)),
        STEPS_FILE: _steps(result),
        COVARIANCE_FILE: _covariances(result.trajectory),
    }
    if other_runs:
        contents[RUNS_FILE] = to_json({"runs": [metrics, *other_runs]})
    replace_results(target, contents)
    if report:
        from ..plots import house_style, render
        from .plots import map_figure

        with house_style():
            write_atomically(target / "map.png", render(map_figure(result, log), "png"))
    return metrics


def map_text(landmarks: SpaceMap) -> str:
    """The map as a table."""
    upper = np.triu_indices(3)
    places = zip(landmarks.ids, landmarks.mean_m, landmarks.covariance_m2, landmarks.sightings, strict=True)
    rows = (
        (name, *(f"{v:.9g}" for v in mean), *(f"{v:.9g}" for v in covariance[upper]), str(count))
        for name, mean, covariance, count in places
    )
    return csv_text(MAP_COLUMNS, rows)


def _facts(result: SpaceResult) -> dict[str, Any]:
    return {
        "version": result.version,
        "log": result.log_name,
        "dimensions": 3,
        "seed": result.config["seed"],
        "filter_seconds": result.filter_seconds,
        "interrupted": result.interrupted,
        "counts": result.counts,
        "warnings": list(result.warnings),
        "innovation_ratio": result.innovation_ratio,
        "log_evidence_nats": result.log_evidence,
    }


def _steps(result: SpaceResult) -> str:
    columns = {"stamp_s": result.trajectory.stamp_s, **result.steps}
    rows = zip(*(column.tolist() for column in columns.values()), strict=True)
    return csv_text(tuple(columns), (tuple(repr(value) for value in row) for row in rows))


def _covariances(path: SpacePath) -> str:
    """The upper triangle of a shift (m) and a turn (rad) in the robot's axes, a row per pose."""
    header = ("stamp_s", *(f"cov_{_AXES[i]}_{_AXES[j]}" for i, j in zip(*_UPPER, strict=True)))
    if path.covariance is None:
        return csv_text(header, ())
    rows = zip(path.stamp_s, path.covariance[:, _UPPER[0], _UPPER[1]], strict=True)
    return csv_text(header, ((repr(float(stamp)), *(f"{v:.9g}" for v in row)) for stamp, row in rows))

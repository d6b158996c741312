"""Short cards of logs, results and maps, as text and, for notebooks, as HTML with a picture of the map."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape
from typing import TYPE_CHECKING

import numpy as np

from .errors import FastSlamError

if TYPE_CHECKING:
    from .log import Floats, Log
    from .result import LandmarkMap, RunResult

MOST_DRAWN = 2000
"""Landmarks and corners of a path in the picture of a card; of more, evenly spread ones are drawn."""

_MARGIN = 0.04


def log_card(log: Log) -> str:
    """Name, format, duration and counts of a log, in a few lines."""
    stamps = np.concatenate([log.controls.stamp_s, log.sightings.stamp_s])
    duration_s = float(stamps.max() - stamps.min()) if len(stamps) else 0.0
    lines = [
        f"Log {log.name!r} (format {log.format}), {duration_s:,.1f} s",
        f"  {len(log.controls.stamp_s):,} controls, {len(log.sightings.stamp_s):,} sightings, "
        f"{np.count_nonzero(log.sightings.identity >= 0):,} of them with identity",
    ]
    if log.scans is not None:
        lines.append(f"  {len(log.scans.stamp_s):,} laser scans")
    known = [
        "" if log.truth_trajectory is None else f"{len(log.truth_trajectory.stamp_s):,} poses",
        "" if log.truth_landmarks is None else f"{len(log.truth_landmarks.names):,} landmarks",
        "" if log.position_fixes is None else f"{len(log.position_fixes.stamp_s):,} position fixes",
    ]
    lines.append(f"  truth: {', '.join(filter(None, known)) or 'none'}")
    if log.problems:
        lines.append(f"  {sum(problem.count for problem in log.problems):,} rows skipped or repaired")
    return "\n".join(lines)


def map_card(landmarks: LandmarkMap) -> str:
    """How many landmarks a map has, over what area, and how well they are known."""
    kept = _confirmed(landmarks)
    provisional = len(kept) - int(kept.sum())
    more = f" and {provisional:,} provisional" if provisional else ""
    line = f"LandmarkMap of {int(kept.sum()):,} landmarks{more}"
    if not kept.any():
        return line
    width_m, height_m = np.ptp(landmarks.mean_m[kept], axis=0)
    std_m = np.sqrt(np.maximum(np.linalg.eigvalsh(landmarks.covariance_m2[kept])[:, -1], 0.0))
    spread = (
        f"  over {width_m:,.1f} m by {height_m:,.1f} m, standard deviation {np.median(std_m):.3g} m (median)"
    )
    return f"{line}\n{spread}"


def result_card(result: RunResult) -> str:
    """What a run made of its log, in a few lines."""
    steps, particles = len(result.steps.stamp_s), result.config.get("filter", {}).get("particles")
    how = f"algorithm {result.config.get('algorithm', '?')}"
    if particles is not None:
        how += f", {particles:,} particles, seed {result.config.get('seed')}"
    lines = [
        f"RunResult over {result.log_name!r}: {steps:,} steps in {result.filter_seconds:.3g} s",
        f"  {how}",
        *(f"  {line.strip()}" for line in map_card(result.landmarks).splitlines()),
    ]
    if result.calibration:
        lines.append(f"  learned of the sensor: {calibration_text(result.calibration)}")
    if result.interrupted:
        lines.append("  stopped before the end of the log")
    lines.extend(f"  warning: {warning}" for warning in result.warnings)
    return "\n".join(lines)


def calibration_text(calibration: Mapping[str, float]) -> str:
    """What was learned of scale and bias, each with its standard deviation."""
    learned = (("range_scale", "range_scale_std"), ("range_bias_m", "range_bias_std_m"))
    return ", ".join(
        f"{name} {calibration[name]:.4g} ± {calibration[std]:.2g}"
        for name, std in learned
        if name in calibration
    )


def card_html(text: str, picture: str = "") -> str:
    """A card for a notebook: the text, and beside it the picture."""
    style = "display:flex;flex-wrap:wrap;gap:1em;align-items:flex-start"
    return f'<div style="{style}"><pre>{escape(text)}</pre>{picture}</div>'


def map_picture(landmarks: LandmarkMap, path_m: Floats | None = None) -> str:
    """Landmarks, with id and sightings under the pointer, and a path (T, 2), as SVG; empty for nothing."""
    rows = _spread(np.flatnonzero(_confirmed(landmarks)))
    labels = [f"{landmarks.ids[row]}, {int(landmarks.sightings[row]):,} sightings" for row in rows]
    return _picture(landmarks.mean_m[rows], labels, path_m)


def log_picture(log: Log) -> str:
    """What is known of a log's world before any filter, as SVG: true path and landmarks, else odometry."""
    path_m = None if log.truth_trajectory is None else log.truth_trajectory.T_world_robot[:, :2]
    if path_m is None:
        path_m = _odometry_path(log)
    if log.truth_landmarks is None or log.truth_trajectory is None:
        # Landmarks in the frame of a survey do not belong on a path that starts at the origin.
        return _picture(np.zeros((0, 2)), [], path_m)
    rows = _spread(np.arange(len(log.truth_landmarks.names)))
    labels = [log.truth_landmarks.names[row] for row in rows]
    return _picture(log.truth_landmarks.position_m[rows], labels, path_m)


def _odometry_path(log: Log) -> Floats | None:
    from .datasets.planar import chain_increments
    from .dead_reckoning import path_of_odometry

    try:
        return chain_increments(path_of_odometry(log).increments)[:, :2]
    except FastSlamError:
        # A card is no place for errors; a run of the log says what is wrong.
        return None


def _picture(mean_m: Floats, labels: Sequence[str], path_m: Floats | None) -> str:
    path = np.zeros((0, 2)) if path_m is None else path_m[_spread(np.arange(len(path_m)))]
    path = path[np.isfinite(path).all(axis=1)]
    points = np.vstack([mean_m, path])
    points = points[np.isfinite(points).all(axis=1)]
    if len(points) == 0:
        return ""
    low, size = points.min(axis=0), max(float(np.ptp(points, axis=0).max()), 1e-6)
    scale = (1.0 - 2.0 * _MARGIN) * 320.0 / size
    offset = _MARGIN * 320.0
    height = 2.0 * offset + scale * float(np.ptp(points[:, 1]))

    def place(at_m: Floats) -> Floats:
        # On the screen y points down.
        x, y = (at_m - low).T * scale
        return np.column_stack([offset + x, height - offset - y])

    line = " ".join(f"{x:.1f},{y:.1f}" for x, y in place(path))
    dots = "".join(
        f'<circle cx="{x:.1f}" cy="{y:.1f}" r="3"><title>{escape(label)}</title></circle>'
        for label, (x, y) in zip(labels, place(mean_m), strict=True)
    )
    drawn = f'<polyline points="{line}" fill="none" stroke="#0072b2"/><g fill="#d55e00">{dots}</g>'
    return f'<svg role="img" aria-label="map" width="320" height="{height:.0f}">{drawn}</svg>'


def _confirmed(landmarks: LandmarkMap) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    return np.full(len(landmarks.ids), True) if landmarks.confirmed is None else landmarks.confirmed


def _spread(rows: np.ndarray[tuple[int], np.dtype[np.intp]]) -> np.ndarray[tuple[int], np.dtype[np.intp]]:
    if len(rows) <= MOST_DRAWN:
        return rows
    return rows[np.linspace(0, len(rows) - 1, MOST_DRAWN).astype(np.intp)]

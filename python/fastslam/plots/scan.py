"""A laser scan with what was detected in it: one figure, or a page with a slider for a whole log."""

from __future__ import annotations

import base64
import json
from pathlib import Path
from string import Template

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ..detection import Detections, find
from ..errors import DataError
from ..log import Floats, Ints, Log, Scans
from ..resultfiles import write_atomically
from ..settings import Layer
from . import style
from .figures import render

PAGE = Path(__file__).with_name("scan_page.html")
JUMP_M, JUMP_PER_RANGE = 0.3, 0.005
"""Where segments are drawn apart: the detector's own defaults."""
MAX_PAGE_SCANS = 2000


def plot_scan(axis: Axes, scans: Scans, detections: Detections, *, scan: int, max_range_m: float) -> Axes:
    """Draw one scan: echoes in alternating colours by segment, detections with diameter and 2-sigma ellipse.

    Coordinates are in the sensor frame, ahead to the top. Errors: DataError where there is no such scan.
    """
    if not 0 <= scan < len(scans.stamp_s):
        raise DataError(f"scan {scan}: the log has scans 0 to {len(scans.stamp_s) - 1}")
    points_m, segment, bright = echoes(scans, scan, max_range_m)
    for parity, color in enumerate((style.LIVE, style.BAND)):
        chosen = segment % 2 == parity
        axis.plot(-points_m[chosen, 1], points_m[chosen, 0], ".", color=color, markersize=3)
    axis.plot(
        -points_m[bright, 1], points_m[bright, 0], "o", color=style.SMOOTHED, markersize=4, label="bright"
    )
    chosen_rows = np.flatnonzero((detections.scan_index == scan) & (detections.range_m <= max_range_m))
    for row in chosen_rows:
        _draw_detection(axis, detections, int(row))
    axis.plot(0, 0, "^", color=style.INK, markersize=8)
    axis.set_aspect("equal", adjustable="datalim")
    axis.set_xlabel("to the right [m]")
    axis.set_ylabel("ahead [m]")
    count = f"{len(chosen_rows)} detection" + ("" if len(chosen_rows) == 1 else "s")
    axis.set_title(
        f"Scan {scan} at {scans.stamp_s[scan]:.2f} s: {segment.max(initial=-1) + 1} segments, {count}"
    )
    return axis


def echoes(scans: Scans, scan: int, max_range_m: float) -> tuple[Floats, Ints, Ints]:
    """Points (E, 2) ahead and left of the sensor, the segment of each (E,), rows of the bright ones."""
    geometry = scans.geometry
    ranges_m = scans.ranges_m[scan].astype(np.float64)
    angle_rad = geometry.first_angle_rad + geometry.angle_step_rad * np.arange(len(ranges_m))
    limit_m = min(geometry.max_range_m, max_range_m)
    hit = np.flatnonzero((ranges_m >= max(geometry.min_range_m, 1e-9)) & (ranges_m < limit_m))
    range_m, heading_rad = ranges_m[hit], angle_rad[hit]
    jump = np.abs(np.diff(range_m)) > JUMP_M + JUMP_PER_RANGE * range_m[:-1]
    apart = jump | (np.diff(hit) > 2)
    segment = np.concatenate([[0], np.cumsum(apart)]) if len(hit) else np.zeros(0, dtype=np.int64)
    points_m = np.column_stack([range_m * np.cos(heading_rad), range_m * np.sin(heading_rad)])
    if scans.intensities is None:
        return points_m, segment, np.zeros(0, dtype=np.int64)
    return points_m, segment, np.flatnonzero(scans.intensities[scan][hit] > 0)


def write_scan_figure(log: Log, path: Path | str, *, scan: int, config: Layer | None = None) -> Path:
    """Detect landmarks in the scans of a log and write a figure of one as a PNG file.

    Errors: DataError, ConfigError.
    """
    scans = _scans(log)
    found = find(scans, {**scans.detector, **(config or {})})
    with style.house_style():
        figure: Figure = style.new_figure(8.0, 6.0)
        plot_scan(figure.add_subplot(), scans, found, scan=scan, max_range_m=_view_m(found))
    return write_atomically(Path(path), render(figure, "png"))


def write_scan_page(log: Log, path: Path | str, *, config: Layer | None = None) -> Path:
    """Detect landmarks in all scans and write one self-contained HTML page with a slider.

    Of a log with more than MAX_PAGE_SCANS scans every n-th is shown. Errors: DataError, ConfigError.
    """
    scans = _scans(log)
    found = find(scans, {**scans.detector, **(config or {})})
    every = -(-len(scans.stamp_s) // MAX_PAGE_SCANS)
    shown = np.arange(0, len(scans.stamp_s), every)
    raw: Floats = scans.ranges_m[shown].astype(np.float64)
    clean = np.nan_to_num(raw, nan=0.0, posinf=0.0, neginf=0.0)
    clean[(clean < scans.geometry.min_range_m) | (clean >= scans.geometry.max_range_m)] = 0.0
    centimetres = np.clip(np.round(100.0 * clean), 0, 65535).astype("<u2")
    rows = [np.flatnonzero(found.scan_index == scan) for scan in shown]
    content = {
        "first_angle_rad": scans.geometry.first_angle_rad,
        "angle_step_rad": scans.geometry.angle_step_rad,
        "beams": int(scans.ranges_m.shape[1]),
        "scan": shown.tolist(),
        "stamp_s": scans.stamp_s[shown].tolist(),
        "view_m": _view_m(found),
        "ranges_cm": base64.b64encode(centimetres.tobytes()).decode("ascii"),
        "detections": [[_page_row(found, int(row)) for row in chosen] for chosen in rows],
    }
    page = Template(PAGE.read_text(encoding="utf-8"))
    title = f"{log.name}: scans and detections".replace("&", "&amp;").replace("<", "&lt;")
    data = json.dumps(content).replace("</", "<\\/")
    return write_atomically(Path(path), page.substitute(title=title, data=data))


def _page_row(found: Detections, row: int) -> list[float | None]:
    """Range, bearing, diameter (None: unknown), range and bearing standard deviations."""
    diameter_m = float(found.signature[row])
    values = (found.range_m[row], found.bearing_rad[row])
    stds = np.sqrt(found.covariance[row, [0, 2]])
    return [
        *(round(float(value), 4) for value in values),
        None if np.isnan(diameter_m) else round(diameter_m, 3),
        *(round(float(std), 5) for std in stds),
    ]


def _draw_detection(axis: Axes, found: Detections, row: int) -> None:
    range_m, bearing_rad = found.range_m[row], found.bearing_rad[row]
    turn = np.linspace(0, 2 * np.pi, 60)
    variance = found.covariance[row]
    root = np.linalg.cholesky(np.array([[variance[0], variance[1]], [variance[1], variance[2]]]))
    ellipse = np.array([[range_m], [bearing_rad]]) + 2 * root @ np.array([np.cos(turn), np.sin(turn)])
    axis.plot(-ellipse[0] * np.sin(ellipse[1]), ellipse[0] * np.cos(ellipse[1]), color=style.LANDMARK, lw=0.9)
    ahead_m, right_m = range_m * np.cos(bearing_rad), -range_m * np.sin(bearing_rad)
    axis.plot(right_m, ahead_m, "+", color=style.LANDMARK, markersize=9)
    diameter_m = found.signature[row]
    if np.isfinite(diameter_m):
        radius_m = diameter_m / 2
        circle = right_m + radius_m * np.cos(turn), ahead_m + radius_m * np.sin(turn)
        axis.plot(*circle, color=style.GOOD, lw=0.9)
        text = f"{diameter_m:.2f} m"
    else:
        text = "part hidden"
    axis.annotate(text, (right_m, ahead_m), xytext=(7, 5), textcoords="offset points", fontsize=7)


def _scans(log: Log) -> Scans:
    if log.scans is None or len(log.scans.stamp_s) == 0:
        raise DataError("the log holds no laser scans to show", log.source)
    return log.scans


def _view_m(found: Detections) -> float:
    """A range that holds nearly all detections."""
    return float(np.percentile(found.range_m, 98)) * 1.1 if len(found.range_m) else 30.0

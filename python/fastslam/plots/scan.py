"""A laser scan with what was detected in it: one figure, or a page with a slider for a whole log."""

from __future__ import annotations

import base64
import json
from pathlib import Path
from string import Template

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ..detection import SCHEMA, VERDICTS, Detections, Pieces, explain
from ..errors import DataError
from ..log import Floats, Ints, Log, Scans
from ..resultfiles import write_atomically
from ..settings import Layer
from . import style
from .figures import render

PAGE = Path(__file__).with_name("scan_page.html")
MAX_PAGE_SCANS = 2000
MAX_LABELS = 10
"""So many rejected pieces are labelled in a figure, those of most beams."""
LEAST_BEAMS_TO_LABEL = 3
COLORS = {
    "detected": style.LIVE,
    "too few beams": "#afb8c1",
    "too far": style.MUTED,
    "too wide": style.EVENT,
    "too small": "#b8a800",
    "both ends hidden": style.SMOOTHED,
    "poor fit": style.LANDMARK,
    "centre uncertain": style.GOOD,
    "part of a wall": style.BAND,
    "no corner": "#7a5195",
}
"""Of the echoes, by what became of their piece."""
NO_PIECE = "not bright"
NO_PIECE_COLOR = style.GRID
"""Echoes that the detector of reflectors does not look at."""


def plot_scan(
    axis: Axes, scans: Scans, found: tuple[Detections, Pieces], *, scan: int, max_range_m: float
) -> Axes:
    """Draw one scan: echoes coloured by what became of them, detections with diameter and 2-sigma ellipse.

    The largest rejected pieces say why. Coordinates are in the sensor frame, ahead to the top. Errors:
    DataError where there is no such scan.
    """
    if not 0 <= scan < len(scans.stamp_s):
        raise DataError(f"scan {scan}: the log has scans 0 to {len(scans.stamp_s) - 1}")
    detections, pieces = found
    points_m, piece = echoes(scans, pieces, scan, max_range_m)
    verdict = np.where(piece >= 0, pieces.verdict[piece], -1) if len(pieces.verdict) else piece
    for number in sorted(set(verdict.tolist()), key=lambda v: (v != 0, v)):
        chosen = verdict == number
        name = VERDICTS[number] if number >= 0 else NO_PIECE
        color = COLORS[name] if number >= 0 else NO_PIECE_COLOR
        count = len(np.unique(piece[chosen])) if number >= 0 else int(chosen.sum())
        axis.plot(
            -points_m[chosen, 1],
            points_m[chosen, 0],
            ".",
            color=color,
            markersize=4,
            label=f"{name} ({count})",
        )
    _label_rejected(axis, points_m, piece, pieces)
    chosen_rows = np.flatnonzero((detections.scan_index == scan) & (detections.range_m <= max_range_m))
    for row in chosen_rows:
        _draw_detection(axis, detections, int(row))
    axis.plot(0, 0, "^", color=style.INK, markersize=8)
    axis.set_aspect("equal", adjustable="datalim")
    axis.set_xlabel("to the right [m]")
    axis.set_ylabel("ahead [m]")
    said = f"{len(chosen_rows)} detection" + ("" if len(chosen_rows) == 1 else "s")
    axis.set_title(f"Scan {scan} at {scans.stamp_s[scan]:.2f} s: {said}")
    style.legend_below(axis)
    return axis


def echoes(scans: Scans, pieces: Pieces, scan: int, max_range_m: float) -> tuple[Floats, Ints]:
    """Points (E, 2) ahead and left of the sensor, and the row of the piece of each (E,), -1 for none."""
    geometry = scans.geometry
    ranges_m = scans.ranges_m[scan].astype(np.float64)
    angle_rad = geometry.first_angle_rad + geometry.angle_step_rad * np.arange(len(ranges_m))
    limit_m = min(geometry.max_range_m, max_range_m)
    hit = np.flatnonzero((ranges_m >= max(geometry.min_range_m, 1e-9)) & (ranges_m < limit_m))
    range_m, heading_rad = ranges_m[hit], angle_rad[hit]
    of_beam = np.full(len(ranges_m), -1, dtype=np.int64)
    for row in np.flatnonzero(pieces.scan_index == scan):
        first, last = int(pieces.first_beam[row]), int(pieces.last_beam[row])
        beams = np.arange(first, last + 1 if last >= first else last + 1 + len(ranges_m)) % len(ranges_m)
        of_beam[beams] = row
    points_m = np.column_stack([range_m * np.cos(heading_rad), range_m * np.sin(heading_rad)])
    return points_m, of_beam[hit]


def _label_rejected(axis: Axes, points_m: Floats, piece: Ints, pieces: Pieces) -> None:
    rows, beams = np.unique(piece[piece >= 0], return_counts=True)
    wanted = (beams >= LEAST_BEAMS_TO_LABEL) & (pieces.verdict[rows] != 0)
    largest = rows[wanted][np.argsort(-beams[wanted], kind="stable")][:MAX_LABELS]
    for row in largest:
        middle = points_m[piece == row][int((piece == row).sum()) // 2]
        name = VERDICTS[pieces.verdict[row]]
        axis.annotate(
            name,
            (-middle[1], middle[0]),
            xytext=(8, -12),
            textcoords="offset points",
            fontsize=7,
            color=style.MUTED,
        )


def write_scan_figure(log: Log, path: Path | str, *, scan: int, config: Layer | None = None) -> Path:
    """Detect landmarks in the scans of a log and write a figure of one as a PNG file.

    Errors: DataError, ConfigError.
    """
    scans = _scans(log)
    found = explain(scans, SCHEMA.merge(scans.detector, config or {}))
    with style.house_style():
        figure: Figure = style.new_figure(8.0, 7.0)
        plot_scan(figure.add_subplot(), scans, found, scan=scan, max_range_m=_view_m(found[0]))
    return write_atomically(Path(path), render(figure, "png"))


def write_scan_page(log: Log, path: Path | str, *, config: Layer | None = None) -> Path:
    """Detect landmarks in all scans and write one self-contained HTML page with a slider.

    Of a log with more than MAX_PAGE_SCANS scans every n-th is shown. Errors: DataError, ConfigError.
    """
    scans = _scans(log)
    found, pieces = explain(scans, SCHEMA.merge(scans.detector, config or {}))
    every = -(-len(scans.stamp_s) // MAX_PAGE_SCANS)
    shown = list(range(0, len(scans.stamp_s), every))
    raw: Floats = scans.ranges_m[shown].astype(np.float64)
    clean = np.nan_to_num(raw, nan=0.0, posinf=0.0, neginf=0.0)
    clean[(clean < scans.geometry.min_range_m) | (clean >= scans.geometry.max_range_m)] = 0.0
    centimetres = np.clip(np.round(100.0 * clean), 0, 65535).astype("<u2")
    columns = np.column_stack([pieces.first_beam, pieces.last_beam, pieces.verdict])
    content = {
        "first_angle_rad": scans.geometry.first_angle_rad,
        "angle_step_rad": scans.geometry.angle_step_rad,
        "beams": int(scans.ranges_m.shape[1]),
        "scan": shown,
        "stamp_s": scans.stamp_s[shown].tolist(),
        "view_m": _view_m(found),
        "ranges_cm": base64.b64encode(centimetres.tobytes()).decode("ascii"),
        "detections": [
            [_page_row(found, row) for row in range(*_rows_of(found.scan_index, scan))] for scan in shown
        ],
        "pieces": [columns[slice(*_rows_of(pieces.scan_index, scan))].tolist() for scan in shown],
        "verdicts": [[name, COLORS[name]] for name in VERDICTS],
        "no_piece": [NO_PIECE, NO_PIECE_COLOR],
    }
    page = Template(PAGE.read_text(encoding="utf-8"))
    title = f"{log.name}: scans and detections".replace("&", "&amp;").replace("<", "&lt;")
    data = json.dumps(content).replace("</", "<\\/")
    return write_atomically(Path(path), page.substitute(title=title, data=data))


def _rows_of(scan_index: Ints, scan: int) -> tuple[int, int]:
    """First row of a scan, and the one after its last; rows are in the order of scans."""
    first, end = np.searchsorted(scan_index, [scan, scan + 1])
    return int(first), int(end)


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
    axis.plot(
        -ellipse[0] * np.sin(ellipse[1]), ellipse[0] * np.cos(ellipse[1]), color=style.INK, lw=0.7, ls=":"
    )
    ahead_m, right_m = range_m * np.cos(bearing_rad), -range_m * np.sin(bearing_rad)
    axis.plot(right_m, ahead_m, "+", color=style.INK, markersize=9)
    diameter_m = found.signature[row]
    if np.isfinite(diameter_m):
        radius_m = diameter_m / 2
        circle = right_m + radius_m * np.cos(turn), ahead_m + radius_m * np.sin(turn)
        axis.plot(*circle, color=style.INK, lw=0.9)
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

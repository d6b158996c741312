"""The landmarks of a run in its report: what the map says under the pointer, and the table."""

from __future__ import annotations

from html import escape
from typing import TYPE_CHECKING

import numpy as np

from .log import Floats
from .result import LandmarkMap

if TYPE_CHECKING:
    from .charts.layout import Place

MOST_LANDMARKS = 2000
"""More than this are in `landmarks.csv` only: a page that holds them all would be slow to open."""
_SHOWN_AT_ONCE = 40
"""Up to so many landmarks the table is unfolded, so that it is printed too."""
_HEAD = ("id", "class", "x [m]", "y [m]", "σ along [m]", "σ across [m]", "sightings", "")


def hover_layer(place: Place, landmarks: LandmarkMap) -> str:
    """SVG elements that lie over the drawn map and tell each landmark's figures under the pointer."""
    if not 0 < len(landmarks.ids) <= MOST_LANDMARKS:
        return ""
    xs, ys = place.x.at(landmarks.mean_m[:, 0]).tolist(), place.y.at(landmarks.mean_m[:, 1]).tolist()
    major, minor = deviations_m(landmarks)
    spots = []
    for row, (x, y) in enumerate(zip(xs, ys, strict=True)):
        name = " ".join(part for part in (landmarks.ids[row], landmarks.class_name(row)) if part)
        east_m, north_m = landmarks.mean_m[row]
        says = (
            f"{name}: ({east_m:.3f}, {north_m:.3f}) m, σ {major[row]:.3f} m along, {minor[row]:.3f} m "
            f"across, {landmarks.sightings[row]:,} sightings{_standing(landmarks, row)}"
        )
        spots.append(f'<circle cx="{x:.1f}" cy="{y:.1f}" r="5"><title>{escape(says)}</title></circle>')
    return f'<g class="landmarks">{"".join(spots)}</g>'


def landmark_table(landmarks: LandmarkMap) -> str:
    """A table of all landmarks that folds away; with very many, where else they are."""
    count = len(landmarks.ids)
    if count == 0:
        return "<p>The map is empty.</p>"
    if count > MOST_LANDMARKS:
        return f"<p>{count:,} landmarks: <code>landmarks.csv</code> beside this page has them all.</p>"
    major, minor = deviations_m(landmarks)
    rows = []
    for row in range(count):
        x_m, y_m = landmarks.mean_m[row]
        figures = (f"{x_m:.3f}", f"{y_m:.3f}", f"{major[row]:.3f}", f"{minor[row]:.3f}")
        numbers = "".join(f"<td>{cell}</td>" for cell in (*figures, f"{landmarks.sightings[row]:,}"))
        name, kind = escape(landmarks.ids[row]), escape(landmarks.class_name(row))
        standing = _standing(landmarks, row).lstrip(", ")
        rows.append(f"<tr><td>{name}</td><td>{kind}</td>{numbers}<td>{standing}</td></tr>")
    head = "".join(f"<th>{cell}</th>" for cell in _HEAD)
    table = f'<div class="scroll"><table class="map"><tr>{head}</tr>{"".join(rows)}</table></div>'
    shown = " open" if count <= _SHOWN_AT_ONCE else ""
    return f"<details{shown}><summary>All {count:,} landmarks</summary>{table}</details>"


def deviations_m(landmarks: LandmarkMap) -> tuple[Floats, Floats]:
    """Standard deviations along the major and the minor axis of each landmark's ellipse. Shapes: (K,)."""
    values = np.sqrt(np.maximum(np.linalg.eigvalsh(landmarks.covariance_m2), 0.0)).reshape(-1, 2)
    return values[:, 1], values[:, 0]


def _standing(landmarks: LandmarkMap, row: int) -> str:
    return "" if landmarks.confirmed is None or landmarks.confirmed[row] else ", provisional"

"""The landmarks of a run in its report: what the map says under the pointer, and the table."""

from __future__ import annotations

from collections.abc import Iterator
from html import escape
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from .log import Floats
from .result import LandmarkMap

if TYPE_CHECKING:
    from .charts.layout import Place

Corner: TypeAlias = "tuple[float, float]"

MOST_LANDMARKS = 2000
"""More than this are in `landmarks.csv` only: a page that holds them all would be slow to open."""
MOST_NAMED = 200
"""Names of more landmarks than this would hide the map: the pointer asks for them one by one."""
_LETTERS, _WIDTH_OF_LETTER = 7.0, 4.0
"""Height of a name's letters, and about how wide one is; `page_style.css` has the same height."""
_DOT = 4.0
"""Half of the room that a landmark's own mark takes."""
_SHOWN_AT_ONCE = 40
"""Up to so many landmarks the table is unfolded, so that it is printed too."""
_HEAD = ("id", "class", "x [m]", "y [m]", "σ along [m]", "σ across [m]", "sightings")
_SAYS = (
    "<p>Residuals are of the sightings along the best path, measured less expected, over the standard "
    "deviation that the noise says: root of the mean square, of which 1 is expected, and mean.</p>"
)


def names_layer(place: Place, landmarks: LandmarkMap) -> str:
    """SVG elements that lie over the drawn map: names where there is room, figures under the pointer.

    A name that has no room is shown while the pointer rests on its landmark, or after a tap on it.
    """
    if not 0 < len(landmarks.ids) <= MOST_LANDMARKS:
        return ""
    at = np.column_stack([place.x.at(landmarks.mean_m[:, 0]), place.y.at(landmarks.mean_m[:, 1])])
    major, minor = deviations_m(landmarks)
    spots = []
    for row, corner in enumerate(_name_corners(at, landmarks, place)):
        name = " ".join(part for part in (landmarks.ids[row], landmarks.class_name(row)) if part)
        east_m, north_m = landmarks.mean_m[row]
        says = (
            f"{name}: ({east_m:.3f}, {north_m:.3f}) m, σ {major[row]:.3f} m along, {minor[row]:.3f} m "
            f"across, {landmarks.sightings[row]:,} sightings{_off(landmarks, row)}{_standing(landmarks, row)}"
        )
        x, y = at[row]
        spot = f'<circle cx="{x:.1f}" cy="{y:.1f}" r="5"><title>{escape(says)}</title></circle>'
        look = ' class="more"' if corner is None else ""
        x, y = corner if corner is not None else _inside(at[row], landmarks.ids[row], place)
        spots.append(f'{spot}<text x="{x:.1f}" y="{y:.1f}"{look}>{escape(landmarks.ids[row])}</text>')
    return f'<g class="landmarks">{"".join(spots)}</g>'


def _name_corners(at: Floats, landmarks: LandmarkMap, place: Place) -> list[Corner | None]:
    """Where each name begins, left and at the foot of its letters; None where it would cover something.

    Shapes: `at` (K, 2), on paper. Landmarks that are not believed are named under the pointer alone.
    """
    corners: list[Corner | None] = [None] * len(at)
    believed = [row for row in range(len(at)) if not _standing(landmarks, row)]
    if len(believed) > MOST_NAMED:
        return corners
    # Left, top, right, bottom of what is taken: the dots, then the names too.
    taken = np.column_stack([at - _DOT, at + _DOT])
    for row in believed:
        width = _WIDTH_OF_LETTER * len(landmarks.ids[row])
        for x, y in _beside(at[row], width):
            box = np.array([x, y - _LETTERS, x + width, y])
            apart = (box[0] >= taken[:, 2]) | (box[2] <= taken[:, 0])
            apart |= (box[1] >= taken[:, 3]) | (box[3] <= taken[:, 1])
            if apart.all() and _is_inside(box, place):
                corners[row] = (x, y)
                taken = np.vstack([taken, box])
                break
    return corners


def _beside(at: Floats, width: float) -> Iterator[Corner]:
    """Where a name of this width may begin: right of its dot, left of it, above, below."""
    x, y = at.tolist()
    foot = y + 0.5 * _LETTERS - 1.0
    yield x + _DOT + 1.0, foot
    yield x - _DOT - 1.0 - width, foot
    yield x - 0.5 * width, y - _DOT - 1.0
    yield x - 0.5 * width, y + _DOT + _LETTERS


def _inside(at: Floats, name: str, place: Place) -> Corner:
    """Beside a dot, on the side on which a name ends within the axes."""
    width = _WIDTH_OF_LETTER * len(name)
    right, left, *_ = _beside(at, width)
    return right if right[0] + width <= max(place.x.ends) else left


def _is_inside(box: Floats, place: Place) -> bool:
    (left, right), (top, bottom) = sorted(place.x.ends), sorted(place.y.ends)
    return bool(box[0] >= left and box[1] >= top and box[2] <= right and box[3] <= bottom)


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
        off = (_cell(figure) for of in landmarks.residuals for figure in (of.rms[row], of.mean[row]))
        numbers = "".join(f"<td>{cell}</td>" for cell in (*figures, f"{landmarks.sightings[row]:,}", *off))
        name, kind = escape(landmarks.ids[row]), escape(landmarks.class_name(row))
        standing = _standing(landmarks, row).lstrip(", ")
        rows.append(f"<tr><td>{name}</td><td>{kind}</td>{numbers}<td>{standing}</td></tr>")
    more = (
        name for of in landmarks.residuals for name in (f"{of.kind} residual", f"mean {of.kind} residual")
    )
    head = "".join(f"<th>{cell}</th>" for cell in (*_HEAD, *more, ""))
    table = f'<div class="scroll"><table class="map"><tr>{head}</tr>{"".join(rows)}</table></div>'
    shown = " open" if count <= _SHOWN_AT_ONCE else ""
    says = _SAYS if landmarks.residuals else ""
    return f"<details{shown}><summary>All {count:,} landmarks</summary>{says}{table}</details>"


def deviations_m(landmarks: LandmarkMap) -> tuple[Floats, Floats]:
    """Standard deviations along the major and the minor axis of each landmark's ellipse. Shapes: (K,)."""
    values = np.sqrt(np.maximum(np.linalg.eigvalsh(landmarks.covariance_m2), 0.0)).reshape(-1, 2)
    return values[:, 1], values[:, 0]


def _off(landmarks: LandmarkMap, row: int) -> str:
    """The residuals of a landmark, in words."""
    found = [(of.kind, of.rms[row]) for of in landmarks.residuals if of.count[row]]
    return "".join(f", {kind} residual {rms:.2f}" for kind, rms in found)


def _cell(figure: float) -> str:
    return f"{figure:.2f}" if np.isfinite(figure) else ""


def _standing(landmarks: LandmarkMap, row: int) -> str:
    return "" if landmarks.confirmed is None or landmarks.confirmed[row] else ", provisional"

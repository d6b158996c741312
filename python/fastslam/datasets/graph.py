"""From the rows of a pose graph to a log: the path of odometry through it, and what was seen from its poses.

A filter takes odometry from each pose to the next. Other edges between poses (loops that somebody has closed)
say what it finds by itself: they are counted and left out. Graphs have no stamps: the number along the path
counts seconds, unless the file says more.
"""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..log import Controls, Floats, Log, Problem, Sightings
from ..measured import BOTH
from .clean import clean_sightings
from .graph_noise import Matrices, triangles, wrong_row
from .graph_rows import Kind, Row, unusable
from .planar import increments_between, polar_covariance, wrap_to_pi

DEFAULT_MAX_RANGE_M = 100.0
UPPER_2, UPPER_3 = np.triu_indices(2), np.triu_indices(3)


@dataclass(frozen=True)
class GraphFile:
    """Rows of one file, and how to turn their noise (upper triangles) into covariances."""

    path: Path
    format: str
    rows: Sequence[Row]
    covariances: Callable[[Floats], Matrices]
    notes: tuple[str, ...] = ()

    def of_kind(self, *kinds: Kind) -> list[Row]:
        """The rows of some kinds, in the order of the file."""
        return [row for row in self.rows if row.kind in kinds]


@dataclass(frozen=True)
class GraphPath:
    """Poses in the order in which they were passed, with the motion between them.

    Shapes: `names` (N), `stamp_s` (N,), `increments` (N - 1, 3), `covariance` (N - 1, 6) as upper triangles
    or None. `others` edges between poses are not part of it.
    """

    names: tuple[str, ...]
    stamp_s: Floats
    increments: Floats
    covariance: Floats | None
    others: int


def log_of_graph(file: GraphFile, *, name: str) -> Log:
    """The log that a graph holds. Errors: DataError that names the format and the page on converting."""
    path = path_of_graph(file)
    sightings, names, dropped = _sightings(file, path)
    measures = _measures(sightings)
    sightings, problems = clean_sightings(sightings, path=file.path, measures=measures)
    problems = (
        *_unused(path.others, "edges between poses that do not follow each other"),
        *dropped,
        *problems,
    )
    return Log(
        name=name,
        source=str(file.path),
        format=file.format,
        controls=Controls(path.stamp_s[1:], path.increments, covariance=path.covariance),
        sightings=sightings,
        identity_names=names,
        config=_config(file, path, sightings),
        problems=problems,
        notes=file.notes + _notes(file, path),
    )


def path_of_graph(file: GraphFile) -> GraphPath:
    """The chain of odometry: an edge from every pose to the next by number. Errors: DataError for a gap."""
    motions = file.of_kind(Kind.MOTION)
    if not motions:
        raise unusable(file.path, file.format, "holds no edge between poses")
    covariances = _motion_covariances(file, motions)
    names = sorted({name for row in motions for name in row.names}, key=_order)
    place = {name: index for index, name in enumerate(names)}
    chain: dict[int, int] = {}
    for index, row in enumerate(motions):
        first, second = (place[name] for name in row.names)
        if abs(second - first) == 1 and min(first, second) not in chain:
            chain[min(first, second)] = index
    missing = next((step for step in range(len(names) - 1) if step not in chain), None)
    if len(names) < 2 or missing is not None:
        gap = f"from pose {names[missing]} to pose {names[missing + 1]}" if missing is not None else "at all"
        raise unusable(file.path, file.format, f"holds no edge {gap}: the path is broken")
    chosen = [chain[step] for step in range(len(names) - 1)]
    backwards = np.array([place[motions[i].names[0]] > place[motions[i].names[1]] for i in chosen])
    values = np.array([motions[i].values for i in chosen])
    values[:, 2] = wrap_to_pi(values[:, 2])
    increments, turned = _forwards(values, covariances[chosen], backwards)
    known = not np.isnan(turned).all()
    triangle = turned[:, UPPER_3[0], UPPER_3[1]] if known else None
    others = len(motions) - len(chosen)
    return GraphPath(tuple(names), _stamps(file, names), increments, triangle, others)


def _order(name: str) -> tuple[str, int]:
    """Poses of one robot are in the order of their numbers."""
    match = re.fullmatch(r"(.*?)(\d*)", name)
    prefix, digits = match.groups() if match is not None else (name, "")
    return prefix, int(digits or 0)


def _forwards(values: Floats, covariances: Matrices, backwards: Any) -> tuple[Floats, Matrices]:
    """Edges that lead back, turned round, with their covariance to first order."""
    increments, turned = values.copy(), covariances.copy()
    origin = np.zeros(3)
    for index in np.flatnonzero(backwards):
        increments[index] = increments_between(np.vstack([values[index], origin]))[0]
        dx, dy, _ = increments[index]
        cosine, sine = np.cos(values[index, 2]), np.sin(values[index, 2])
        by_edge = np.array([[-cosine, -sine, dy], [sine, -cosine, -dx], [0.0, 0.0, -1.0]])
        turned[index] = by_edge @ covariances[index] @ by_edge.T
    return increments, turned


def _motion_covariances(file: GraphFile, motions: Sequence[Row]) -> Matrices:
    return _checked(file, motions, triangles([row.noise for row in motions], 3))


def _checked(file: GraphFile, rows: Sequence[Row], triangle: Floats) -> Matrices:
    matrices = file.covariances(triangle)
    wrong = wrong_row(matrices)
    if wrong is not None:
        row = rows[wrong]
        raise unusable(file.path, file.format, f"{row.tag}: the noise is not positive definite", row.line)
    return matrices


def _stamps(file: GraphFile, names: Sequence[str]) -> Floats:
    """Stamps of the poses where all have one and they increase; else the number along the path."""
    stamp_of = {row.names[0]: row.stamp_s for row in file.of_kind(Kind.POSE)}
    stamps = np.array([stamp_of.get(name, math.nan) for name in names])
    if np.isfinite(stamps).all() and (np.diff(stamps) > 0).all():
        return stamps
    return np.arange(len(names), dtype=np.float64)


def _sightings(file: GraphFile, path: GraphPath) -> tuple[Sightings, tuple[str, ...], tuple[Problem, ...]]:
    """What was seen from the poses of the path, names of the landmarks, and what could not be used."""
    place = {name: index for index, name in enumerate(path.names)}
    rows = [*file.of_kind(Kind.POINT, Kind.POLAR), *_paired(file)]
    seen = [row for row in rows if row.names[0] in place]
    lost = next((row for row in rows if row.names[0] not in place), None)
    if lost is not None:
        message = f"{lost.tag}: pose {lost.names[0]} is not on the path of odometry"
        raise unusable(file.path, file.format, message, lost.line)
    half = Counter(row.kind for row in file.of_kind(Kind.BEARING, Kind.RANGE))
    bearings, ranges = half[Kind.BEARING], half[Kind.RANGE]
    paired = len(rows) - len(file.of_kind(Kind.POINT, Kind.POLAR))
    if not seen:
        seen = _alone(file, place)
    paired = paired if rows else len(seen)
    seen.sort(key=lambda row: (place[row.names[0]], row.line))
    order: dict[str, int] = {}
    identity = np.array([order.setdefault(row.names[1], len(order)) for row in seen], dtype=np.int64)
    range_m, bearing_rad, covariance = _polar(file, seen)
    sightings = Sightings(
        stamp_s=path.stamp_s[[place[row.names[0]] for row in seen]],
        range_m=range_m,
        bearing_rad=bearing_rad,
        identity=identity,
        class_index=np.full(len(seen), -1, dtype=np.int64),
        signature=np.full(len(seen), np.nan),
        covariance=None if np.isnan(covariance).all() else covariance,
    )
    dropped = (
        *_unused(bearings - paired, "bearings without range"),
        *_unused(ranges - paired, "ranges without bearing"),
    )
    label_of = {row.names[0]: row.label for row in file.of_kind(Kind.LANDMARK) if row.label}
    return sightings, tuple(label_of.get(name, name) for name in order), dropped


def _measures(sightings: Sightings) -> tuple[str, ...]:
    """The columns that sightings have: both, or those of bearings or ranges alone."""
    return tuple(column for column in BOTH if np.isfinite(getattr(sightings, column)).any())


def _alone(file: GraphFile, place: dict[str, int]) -> list[Row]:
    """Bearings alone, or ranges alone where they are more, of what is no pose. Errors: DataError."""
    landmarks = {row.names[0] for row in file.of_kind(Kind.LANDMARK)}

    def of(kind: Kind) -> list[Row]:
        rows = [row for row in file.of_kind(kind) if row.names[0] in place]
        unnamed = not landmarks
        return [r for r in rows if r.names[1] in landmarks or (unnamed and r.names[1] not in place)]

    seen = max(of(Kind.BEARING), of(Kind.RANGE), key=len)
    if not seen:
        raise unusable(file.path, file.format, "holds no landmarks: needs sightings of them")
    return seen


def _paired(file: GraphFile) -> list[Row]:
    """Bearings and ranges of one landmark from one pose, each pair as one sighting."""
    ranges = {row.names: row for row in file.of_kind(Kind.RANGE)}
    pairs = [(row, ranges.pop(row.names, None)) for row in file.of_kind(Kind.BEARING)]
    return [
        Row(
            bearing.line,
            bearing.tag,
            Kind.POLAR,
            bearing.names,
            (bearing.values[0], distance.values[0]),
            _stds(file, bearing, distance),
            bearing.stamp_s,
        )
        for bearing, distance in pairs
        if distance is not None
    ]


def _stds(file: GraphFile, bearing: Row, distance: Row) -> tuple[float, ...]:
    """Standard deviations of bearing and range from the noise of two rows; none unless both have one."""
    if not any(bearing.noise) or not any(distance.noise):
        return ()
    variances = file.covariances(np.array([[bearing.noise[0]], [distance.noise[0]]])).ravel()
    if not (variances > 0).all():
        message = f"{bearing.tag}: the noise is not positive"
        raise unusable(file.path, file.format, message, bearing.line)
    return tuple(float(value) for value in np.sqrt(variances))


def _polar(file: GraphFile, rows: Sequence[Row]) -> tuple[Floats, Floats, Floats]:
    """Range, bearing and their covariance (S, 3), NaN where a row has none."""
    if rows[0].kind in (Kind.BEARING, Kind.RANGE):
        return _polar_alone(file, rows)
    values = np.array([row.values for row in rows])
    is_point = np.array([row.kind is Kind.POINT for row in rows])
    points = [row for row in rows if row.kind is Kind.POINT]
    covariance = np.full((len(rows), 3), np.nan)
    matrices = _checked(file, points, triangles([row.noise for row in points], 2))
    x, y = values.T
    by_point = polar_covariance(x[is_point], y[is_point], matrices[:, UPPER_2[0], UPPER_2[1]])
    covariance[is_point] = by_point
    for index in np.flatnonzero(~is_point).tolist():
        if rows[index].noise:
            bearing_std_rad, range_std_m = rows[index].noise
            covariance[index] = (range_std_m**2, 0.0, bearing_std_rad**2)
    range_m = np.where(is_point, np.hypot(x, y), y)
    bearing_rad = np.where(is_point, np.arctan2(y, x), wrap_to_pi(x))
    return range_m, bearing_rad, covariance


def _polar_alone(file: GraphFile, rows: Sequence[Row]) -> tuple[Floats, Floats, Floats]:
    """The same of bearings alone or ranges alone; the variance of what is not measured is 1 and not used."""
    variance = _checked(file, rows, triangles([row.noise for row in rows], 1))[:, 0, 0]
    value = np.array([row.values[0] for row in rows])
    nothing, one, zero = np.full_like(value, np.nan), np.ones_like(value), np.zeros_like(value)
    if rows[0].kind is Kind.BEARING:
        return nothing, wrap_to_pi(value), np.column_stack([one, zero, variance])
    return value, nothing, np.column_stack([variance, zero, one])


def _unused(count: int, what: str) -> tuple[Problem, ...]:
    return (Problem(f"{what}: not used", count),) if count > 0 else ()


def _notes(file: GraphFile, path: GraphPath) -> tuple[str, ...]:
    notes: list[str] = []
    if path.stamp_s[0] == 0 and (np.diff(path.stamp_s) == 1).all():
        notes.append("stamps are the numbers of the poses along the path")
    if path.covariance is None:
        notes.append("edges between poses have no noise: the default of motion.model increments holds")
    return tuple(notes)


def _config(file: GraphFile, path: GraphPath, sightings: Sightings) -> dict[str, Any]:
    """Models, and noise for whatever has none of its own: the medians of what is given."""
    motion: dict[str, Any] = {"model": "increments"}
    if path.covariance is not None:
        stds = np.nanmedian(np.sqrt(path.covariance[:, [0, 3, 5]]), axis=0)
        motion |= dict(zip(("x_std_m", "y_std_m", "heading_std_rad"), _rounded(stds), strict=True))
    sensor: dict[str, Any] = {"model": "range_bearing"}
    keys, columns = ["range_std_m", "bearing_std_rad"], [0, 2]
    measures = _measures(sightings)
    if len(measures) == 1:
        only = BOTH.index(measures[0])
        sensor["model"] = ("range", "bearing")[only]
        keys, columns = [keys[only]], [columns[only]]
    if sightings.covariance is not None:
        stds = np.nanmedian(np.sqrt(sightings.covariance[:, columns]), axis=0)
        sensor |= dict(zip(keys, _rounded(stds), strict=True))
    farthest_m = float(np.nanmax(sightings.range_m)) if "range_m" in measures else 0.0
    if farthest_m > DEFAULT_MAX_RANGE_M:
        sensor["max_range_m"] = math.ceil(1.1 * farthest_m)
    config = {"motion": motion, "sensor": sensor}
    start = next((row for row in file.of_kind(Kind.POSE) if row.names[0] == path.names[0]), None)
    if start is not None and any(start.values):
        config["initial_pose"] = dict(zip(("x_m", "y_m", "heading_rad"), start.values, strict=True))
    return config


def _rounded(values: Floats) -> list[float]:
    return [float(f"{value:.4g}") for value in values]

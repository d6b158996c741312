"""The sightings of a log laid on the map that a run came to, along its path."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from .evaluation.align import wrap_angle
from .log import Bools, Floats, Ints, Log
from .result import RunResult

MOST_IN_CELL = 16
"""So many of the landmarks in one cell are held against a sighting."""
WIDE = 0.9
"""The cells are as wide as sightings can be off at this quantile of their ranges."""
EXPLAINED_SQUARED = 25.0
"""A sighting within five deviations of a landmark is explained by it."""
LOOK_S = 1.0
"""Sightings within this time count once: they repeat each other."""
FRAME_S = 0.02
"""Sightings closer in time than this are of one frame."""


@dataclass(frozen=True)
class Laid:
    """Sightings in order of time against the landmarks that are believed.

    Shapes: `row` (S,) of each in the log, `stamp_s`, `squared` (squared distance to the landmark that fits
    best, in the noise configured, infinite where none is near), `landmark` (which one, or -1) and `frame`
    (S,), `mean_m` (K, 2), `origin` (S, 3) the sensor's pose at each, `range_m` and `bearing_rad` (S,) less
    what the settings correct.
    """

    row: Ints
    stamp_s: Floats
    squared: Floats
    landmark: Ints
    frame: Ints
    mean_m: Floats
    origin: Floats
    range_m: Floats
    bearing_rad: Floats

    @property
    def point_m(self) -> Floats:
        """Where the sightings (S, 2) put what they show."""
        direction = self.origin[:, 2] + self.bearing_rad
        ahead = np.column_stack([np.cos(direction), np.sin(direction)])
        return np.asarray(self.origin[:, :2] + self.range_m[:, None] * ahead)

    @property
    def look(self) -> Ints:
        """Number (S,) of the second in which each sighting was made, from the first on."""
        return np.asarray(np.floor((self.stamp_s - self.stamp_s[0]) / LOOK_S), dtype=np.int64)

    def by_landmark(self) -> list[Ints]:
        """The sightings that each landmark fits best, in order of time."""
        order = np.argsort(self.landmark, kind="stable")
        bounds = np.searchsorted(self.landmark[order], np.arange(len(self.mean_m) + 1))
        return [order[start:end] for start, end in pairwise(bounds.tolist())]

    @property
    def explained(self) -> Bools:
        """Which sightings (S,) some landmark explains."""
        return np.asarray(self.squared < EXPLAINED_SQUARED)


def believed(result: RunResult) -> Bools:
    """Which landmarks (K,) are confirmed, and stand at a place that can be computed with."""
    landmarks = result.landmarks
    chosen: Bools = np.asarray(np.isfinite(landmarks.mean_m).all(axis=1), dtype=np.bool_)
    if landmarks.confirmed is not None:
        chosen &= landmarks.confirmed
    return chosen


def laid_on_map(result: RunResult, log: Log) -> Laid | None:
    """Lays the sightings on the confirmed landmarks; None where there is no path or no landmark."""
    landmarks, path, sensor = result.landmarks, result.path, result.config["sensor"]
    chosen = believed(result)
    seen = log.sightings
    if len(path.stamp_s) < 2 or not chosen.any() or len(seen.stamp_s) == 0:
        return None
    stamp_s = seen.stamp_s - sensor["delay_s"]
    range_m = (seen.range_m - sensor["range_bias_m"]) / sensor["range_scale"]
    usable = np.isfinite(range_m) & np.isfinite(seen.bearing_rad)
    usable &= (range_m >= sensor["min_range_m"]) & (range_m <= sensor["max_range_m"])
    usable &= (stamp_s >= path.stamp_s[0]) & (stamp_s <= path.stamp_s[-1])
    rows = np.flatnonzero(usable)
    rows = rows[np.argsort(stamp_s[rows], kind="stable")]
    if len(rows) == 0:
        return None
    stamp_s, range_m = stamp_s[rows], range_m[rows]
    bearing = wrap_angle(seen.bearing_rad[rows] - sensor["bearing_bias_rad"])
    origin = sensor_poses(result, stamp_s, sensor["mounting"])
    mean_m = landmarks.mean_m[chosen]
    squared, landmark = _best(mean_m, origin, (range_m, bearing), sensor)
    if result.config["association"]["mode"] == "known":
        own = _by_name(landmarks.ids, chosen, log)[rows]
        named = np.flatnonzero(own >= 0)
        seen_there = range_m[named], bearing[named]
        squared[named] = squared_of(mean_m[own[named]], origin[named], seen_there, sensor)
        landmark[named] = own[named]
    frame = np.concatenate([[0], np.cumsum(np.diff(stamp_s) > FRAME_S)])
    return Laid(rows, stamp_s, squared, landmark, frame, mean_m, origin, range_m, bearing)


def explained_apart(laid: Laid, log: Log, sensor: Mapping[str, Any]) -> Bools:
    """Which sightings (S,) some landmark explains that explains no other one of their scan.

    As many as can be: what a scan shows twice is two things, however near. `sensor` holds the noise that was
    laid with.
    """
    scan = _scans(laid, log)
    own = laid.explained
    pair = scan * len(laid.mean_m) + laid.landmark
    _, number, taken = np.unique(pair[own], return_inverse=True, return_counts=True)
    rows = np.flatnonzero(own & np.isin(scan, scan[own][taken[number] > 1]))
    if len(rows):
        own[rows] = _matched(laid, rows, scan[rows], sensor)
    return own


def _scans(laid: Laid, log: Log) -> Ints:
    """Number (S,) of the scan that each sighting is of: those of a sensor with one stamp."""
    sensor = log.sightings.sensor_index
    of_sensor = np.zeros(len(laid.row), dtype=np.int64) if sensor is None else sensor[laid.row]
    return np.asarray(np.unique(np.column_stack([laid.stamp_s, of_sensor]), axis=0, return_inverse=True)[1])


def _matched(laid: Laid, rows: Ints, scan: Ints, sensor: Mapping[str, Any]) -> Bools:
    """Which of some sightings (n,) have a landmark for themselves, where as many have as can."""
    from scipy.sparse import csr_matrix
    from scipy.sparse.csgraph import maximum_bipartite_matching
    from scipy.spatial import cKDTree

    count = min(MOST_IN_CELL, len(laid.mean_m))
    nearest = cKDTree(laid.mean_m).query(laid.point_m[rows], k=count)[1].reshape(len(rows), count)
    held = np.repeat(rows, count)
    squared = squared_of(
        laid.mean_m[nearest.ravel()], laid.origin[held], (laid.range_m[held], laid.bearing_rad[held]), sensor
    )
    near = squared < EXPLAINED_SQUARED
    of_scan = np.repeat(scan, count)[near] * len(laid.mean_m) + nearest.ravel()[near]
    columns = np.unique(of_scan, return_inverse=True)[1]
    number = np.repeat(np.arange(len(rows)), count)[near]
    links = csr_matrix((np.ones(len(number)), (number, columns)), (len(rows), int(columns.max()) + 1))
    return np.asarray(maximum_bipartite_matching(links, perm_type="column") >= 0)


def laid_on_provisional(result: RunResult, laid: Laid) -> int:
    """How many of the sightings that no confirmed landmark explains a provisional one does."""
    mean_m = result.landmarks.mean_m[~believed(result)]
    mean_m = mean_m[np.isfinite(mean_m).all(axis=1)]
    rows = ~laid.explained
    if len(mean_m) == 0 or not rows.any():
        return 0
    measured = laid.range_m[rows], laid.bearing_rad[rows]
    squared, _ = _best(mean_m, laid.origin[rows], measured, result.config["sensor"])
    return int((squared < EXPLAINED_SQUARED).sum())


def wide_noise(log: Log, config: Mapping[str, Any]) -> Floats:
    """Generous standard deviations (2,) of range and bearing: of their class, or half the stated if more."""
    sensor, range_m = config["sensor"], log.sightings.range_m
    usual_m = float(np.median(range_m[np.isfinite(range_m)]))
    return np.array(
        [max(0.04 * usual_m, 0.5 * sensor["range_std_m"]), max(0.04, 0.5 * sensor["bearing_std_rad"])]
    )


def sensor_poses(result: RunResult, stamp_s: Floats, mounting: Mapping[str, float]) -> Floats:
    """Where a sensor that is mounted so was in the world (n, 3) at these stamps, along the best path."""
    path = result.path
    x, y, heading = path.T_world_robot[:, 0], path.T_world_robot[:, 1], np.unwrap(path.T_world_robot[:, 2])
    x, y, heading = (np.interp(stamp_s, path.stamp_s, column) for column in (x, y, heading))
    cosine, sine = np.cos(heading), np.sin(heading)
    ahead, left = mounting["x_m"], mounting["y_m"]
    return np.column_stack(
        [x + cosine * ahead - sine * left, y + sine * ahead + cosine * left, heading + mounting["yaw_rad"]]
    )


def _by_name(ids: tuple[str, ...], chosen: Bools, log: Log) -> Ints:
    """Row (S,) among the believed landmarks of the one that each sighting names; -1 where it names none."""
    rows = {ids[row]: number for number, row in enumerate(np.flatnonzero(chosen).tolist())}
    of_identity = np.array([*(rows.get(name, -1) for name in log.identity_names), -1], dtype=np.int64)
    return np.asarray(of_identity[log.sightings.identity])


def _best(
    mean_m: Floats, origin: Floats, measured: tuple[Floats, Floats], sensor: Mapping[str, Any]
) -> tuple[Floats, Ints]:
    """Squared distance (S,) to the landmark that fits best, and which; infinite and -1 where none is near.

    Landmarks lie in square cells as wide as a sighting can be off and be explained; a sighting is held
    against those of the nine cells around it.
    """
    range_m, bearing = measured
    direction = origin[:, 2] + bearing
    point_m = origin[:, :2] + range_m[:, None] * np.column_stack([np.cos(direction), np.sin(direction)])
    stds = np.hypot(sensor["range_std_m"], np.quantile(range_m, WIDE) * sensor["bearing_std_rad"])
    side_m = np.sqrt(EXPLAINED_SQUARED) * float(stds)
    corner = np.minimum(mean_m.min(axis=0), point_m.min(axis=0)) - side_m
    cells, cell = (np.floor((points - corner) / side_m).astype(np.int64) for points in (mean_m, point_m))
    wide = max(int(cells[:, 1].max()), int(cell[:, 1].max())) + 2
    order = np.argsort(cells[:, 0] * wide + cells[:, 1], kind="stable")
    keys = (cells[:, 0] * wide + cells[:, 1])[order]
    squared, landmark = np.full(len(range_m), np.inf), np.full(len(range_m), -1, dtype=np.int64)
    for ahead, aside in np.ndindex(3, 3):
        key = (cell[:, 0] + ahead - 1) * wide + cell[:, 1] + aside - 1
        start, end = np.searchsorted(keys, key, "left"), np.searchsorted(keys, key, "right")
        for place in range(min(int((end - start).max()), MOST_IN_CELL)):
            rows = np.flatnonzero(start + place < end)
            held = order[start[rows] + place]
            found = squared_of(mean_m[held], origin[rows], (range_m[rows], bearing[rows]), sensor)
            better = found < squared[rows]
            squared[rows[better]], landmark[rows[better]] = found[better], held[better]
    return squared, landmark


def squared_of(
    mean_m: Floats, origin: Floats, measured: tuple[Floats, Floats], sensor: Mapping[str, Any]
) -> Floats:
    """Squared distance (n,) of sightings from landmarks (n, 2), in the noise that was told."""
    apart = mean_m - origin[:, :2]
    by_range = (measured[0] - np.hypot(apart[:, 0], apart[:, 1])) / sensor["range_std_m"]
    turned = origin[:, 2] + measured[1] - np.arctan2(apart[:, 1], apart[:, 0])
    return np.asarray(by_range**2 + (wrap_angle(turned) / sensor["bearing_std_rad"]) ** 2)

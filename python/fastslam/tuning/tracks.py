"""Which sightings are of one thing: by names, by following them from scan to scan, or by the map of a run."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..log import Floats, Ints, Sightings

LONGEST_S = 1.5
"""A track ends when nothing was seen of it for this long (or three scans, where these are rarer)."""
GATE_STDS = 3.0
TURNING, GOING = 0.35, 0.25
"""Share of a turn and of a way by which the odometry may be wrong from scan to scan."""
NEAR_STDS = 4.0
"""A sighting further from every landmark of a map is of none."""
CLEAR = 2.0
"""The next best must be this much further away, or the sighting belongs to neither."""


@dataclass(frozen=True)
class Scene:
    """Sightings with the pose of the robot at each, by odometry, and where that puts what was seen.

    Shapes: `stamp_s`, `identity` (S,), `T_odometry_robot` (S, 3), `point_m` (S, 2), `std_m` (S,).
    """

    stamp_s: Floats
    identity: Ints
    T_odometry_robot: Floats
    point_m: Floats
    std_m: Floats


def scene(
    sightings: Sightings, sensor: Mapping[str, Any], poses: Floats, wide: Floats, *, named: bool
) -> Scene:
    """The scene under settings of the sensor; `wide` (2,) are generous deviations of range and bearing."""
    range_m = (sightings.range_m - sensor["range_bias_m"]) / sensor["range_scale"]
    mounting = sensor["mounting"]
    bearing = sightings.bearing_rad - sensor["bearing_bias_rad"]
    direction = poses[:, 2] + mounting["yaw_rad"] + bearing
    cosine, sine = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    x = poses[:, 0] + cosine * mounting["x_m"] - sine * mounting["y_m"] + range_m * np.cos(direction)
    y = poses[:, 1] + sine * mounting["x_m"] + cosine * mounting["y_m"] + range_m * np.sin(direction)
    identity = sightings.identity if named else np.full(len(range_m), -1, dtype=np.int64)
    std_m = np.hypot(wide[0], range_m * wide[1])
    return Scene(sightings.stamp_s, identity, poses, np.column_stack([x, y]), std_m)


def short_tracks(seen: Scene) -> Ints:
    """Number of the track of each sighting (S,), -1 for what was seen once or could be of two.

    A sighting belongs to a track when each is the other's nearest, within what odometry and sensor may be
    wrong by since the track was last seen, and no other comes near. Names, where they count, must agree.
    """
    track = np.full(len(seen.stamp_s), -1, dtype=np.int64)
    stamps, starts = np.unique(seen.stamp_s, return_index=True)
    bounds = np.append(starts, len(track))
    period_s = float(np.median(np.diff(stamps))) if len(stamps) > 1 else 0.0
    age_s = max(LONGEST_S, 3 * period_s) if period_s < 10.0 else 3 * period_s
    last, number = np.empty(0, dtype=np.int64), 0
    for stamp_s, start, end in zip(stamps, bounds[:-1], bounds[1:], strict=True):
        last = last[seen.stamp_s[last] >= stamp_s - age_s]
        now = np.arange(start, end)
        earlier, later, lost = _matches(seen, last, now)
        track[later] = track[last[earlier]]
        unmatched = np.ones(len(now), dtype=bool)
        unmatched[np.concatenate([later, lost]) - start] = False
        fresh = now[unmatched]
        track[fresh] = number + np.arange(len(fresh))
        number += len(fresh)
        kept = np.ones(len(last), dtype=bool)
        kept[earlier] = False
        last = np.concatenate([last[kept], later, fresh])
    return track


def _matches(seen: Scene, last: Ints, now: Ints) -> tuple[Ints, Ints, Ints]:
    """Positions in `last` and rows of `now` that belong together, and rows of `now` that could be of two."""
    if len(last) == 0:
        return last, now[:0], now[:0]
    distance = np.hypot(*(seen.point_m[last][:, None] - seen.point_m[now][None]).transpose(2, 0, 1))
    distance = distance / _reach_m(seen, last, now)
    names, other = seen.identity[last][:, None], seen.identity[now][None]
    distance = np.where((names >= 0) | (other >= 0), np.where(names == other, 0.5, np.inf), distance)
    nearest = np.argmin(distance, axis=0)
    column = np.arange(len(now))
    best = distance[nearest, column]
    rivals = distance.copy()
    rivals[nearest, column] = np.inf
    rival = np.minimum(rivals.min(axis=0), _others(distance, nearest, column))
    mutual = np.argmin(distance, axis=1)[nearest] == column
    inside = best < 1.0
    clear = mutual & inside & (rival > CLEAR * best)
    return nearest[clear], now[clear], now[inside & ~clear]


def _others(distance: Floats, nearest: Ints, column: Ints) -> Floats:
    """Distance (n,) from the nearest track of each sighting to the next sighting."""
    rows = distance[nearest].copy()
    rows[column, column] = np.inf
    least: Floats = rows.min(axis=1)
    return least


def _reach_m(seen: Scene, last: Ints, now: Ints) -> Floats:
    """How far a sighting may lie from where its track was seen last (n, m)."""
    before, after = seen.T_odometry_robot[last], seen.T_odometry_robot[now[0]]
    turned = np.abs(after[2] - before[:, 2])[:, None]
    gone_m = np.hypot(*(after[:2] - before[:, :2]).T)[:, None]
    range_m = np.hypot(*(seen.point_m[now] - after[:2]).T)[None]
    noise_m: Floats = GATE_STDS * np.hypot(seen.std_m[last][:, None], seen.std_m[now][None])
    reach: Floats = noise_m + TURNING * turned * range_m + GOING * gone_m
    return reach


def of_map(seen: Scene, mean_m: Floats, std_m: Floats) -> Ints:
    """Nearest landmark (S,) of a map, in deviations of both; -1 where it is far or another as near."""
    if len(mean_m) == 0:
        return np.full(len(seen.stamp_s), -1, dtype=np.int64)
    from scipy.spatial import cKDTree

    count = min(3, len(mean_m))
    distance, index = cKDTree(mean_m).query(seen.point_m, k=count)
    distance, index = distance.reshape(-1, count), index.reshape(-1, count)
    scaled = distance / np.hypot(seen.std_m[:, None], std_m[index])
    order = np.argsort(scaled, axis=1)
    first = np.take_along_axis(scaled, order[:, :1], axis=1)[:, 0]
    rival = (
        np.take_along_axis(scaled, order[:, 1:2], axis=1)[:, 0] if count > 1 else np.full(len(first), np.inf)
    )
    nearest = np.take_along_axis(index, order[:, :1], axis=1)[:, 0]
    good = (first < NEAR_STDS) & (rival > 1.5 * first)
    return np.where(good, nearest, -1).astype(np.int64)

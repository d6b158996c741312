"""Names that stand at two places, told from names that a robot saw while it was wrong about where it was.

The filter doubts a name whose sightings are far from its landmark. Either it stands at two places, or the
pose was off: then the other names of those scans are off with it, and laid on them this one stands where it
always stood.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import TypeAlias

import numpy as np

from .config import sensor_of
from .errors import DataError
from .evaluation.align import align_points, align_points_robustly, wrap_angle
from .log import Bools, Floats, Ints, Log
from .result import RunResult

TwoPlaces: TypeAlias = tuple[int, float, float, int, float, float, int]
"""An identity, then x, y and sightings of the place in the map, then those of the other place."""

LEAST_AT_A_PLACE = 3
MOST_AT_A_PLACE = 60
"""So many sightings, spread over all, are looked at for each place."""
APART = 4.0
"""Places are two when they are further apart than this many times the median distance of sightings from
them; the halves of one normal cloud come to 1.5."""
MOST_SCANS = 100
FAR = 5.0
"""A sighting further than this many standard deviations from the landmark of its name shows another one."""
AWAY_SCANS = 10
"""What was not seen in so many scans, and then again, was come back to."""
ALIKE = 0.5
"""Names moved together when their displacements differ by this part of one of them at most."""
LEAST_REAL = 0.25
"""Where a smaller part of the doubted names contradicts itself, none does."""
DRIFT = 0.1
"""A robot that did not come back is granted to be wrong by this share of its way, and by this angle for each
radian turned."""


def that_contradict_themselves(
    doubted: Iterable[TwoPlaces], result: RunResult, log: Log
) -> tuple[TwoPlaces, ...]:
    """Those of the names doubted by a filter that cannot be explained by a pose that was off.

    None where nearly all can: such a map is too wrong to accuse the rest by.
    """
    doubted, judge = tuple(doubted), _Judge(result, log)
    alone = [
        two
        for two in doubted
        if not any(other[0] != two[0] and _moved_alike(two, other) for other in doubted)
    ]
    real = tuple(two for two in alone if judge.cannot_be_the_pose(two))
    return real if len(real) >= LEAST_REAL * len(doubted) else ()


def share_misnamed(result: RunResult, log: Log) -> float:
    """Which part of the sightings that were left out does not fit the other names of its scan either.

    By a sample of the scans; 1 where nothing can be told.
    """
    return _Judge(result, log).share_misnamed()


@dataclass(frozen=True)
class _Judge:
    """A run and its log: rows are those of the sightings, points in the frame of the robot."""

    result: RunResult
    log: Log

    def cannot_be_the_pose(self, two: TwoPlaces) -> bool:
        rows = np.flatnonzero(self.log.sightings.identity == two[0])
        held, other = np.array(two[1:3]), np.array(two[4:6])
        seen_m = _in_world(self._pose_at(rows), self._point_m[rows])
        elsewhere = np.hypot(*(seen_m - other).T) < np.hypot(*(seen_m - held).T)
        witness_m = self._witnesses(two[0], rows[~elsewhere], rows[elsewhere])
        places = [self._laid_on_others(rows[where], witness_m) for where in (~elsewhere, elsewhere)]
        if min(map(len, places)) >= LEAST_AT_A_PLACE:
            return _are_apart(*places)
        return self._further_than_drift(rows, elsewhere, float(np.hypot(*(held - other))))

    def share_misnamed(self) -> float:
        """See the function of this name."""
        steps = self.result.steps
        delay_s = self.result.config["sensor"]["delay_s"]
        judged, misnamed = 0, 0
        for step in _spread(np.flatnonzero(steps.ignored), MOST_SCANS).tolist():
            at_s = steps.stamp_s[step] + delay_s
            rows = np.arange(*np.searchsorted(self.log.sightings.stamp_s, [at_s - 1e-6, at_s + 1e-6]))
            rows = rows[np.isfinite(self._map_m[self.log.sightings.identity[rows], 0])]
            if len(rows) < LEAST_AT_A_PLACE:
                continue
            judged += int(steps.ignored[step])
            misnamed += min(self._misfits(rows), int(steps.ignored[step]))
        return misnamed / judged if judged else 1.0

    def _misfits(self, rows: Ints) -> int:
        """How many sightings of a scan, laid on the map as most of them fit, are not where their name is."""
        noise_m = float(self._noise_m(rows).max())
        map_m = self._map_m[self.log.sightings.identity[rows]]
        try:
            return int(
                (
                    ~align_points_robustly(
                        self._point_m[rows], map_m, inlier_distance_m=FAR * noise_m
                    ).inliers
                ).sum()
            )
        except DataError:
            return 0

    def _further_than_drift(self, rows: Ints, elsewhere: Bools, far_m: float) -> bool:
        """Whether the sightings of the name went to the other place, or back, on too short a way."""
        poses = self.result.trajectory.T_world_robot
        way_m = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(poses[:, :2], axis=0).T))])
        turned = np.concatenate([[0.0], np.cumsum(np.abs(wrap_angle(np.diff(poses[:, 2]))))])
        at = self._step_of(rows)
        went_m, turn = np.diff(way_m[at]), np.diff(turned[at])
        reach_m = self.log.sightings.range_m[rows][1:] + went_m
        noise_m = self._noise_m(rows)
        drift_m = DRIFT * went_m + np.minimum(DRIFT * turn, 0.5) * reach_m
        allowed_m = 2.0 * drift_m + FAR * np.hypot(noise_m[1:], noise_m[:-1])
        return bool((far_m > allowed_m[np.diff(elsewhere)]).any())

    def _noise_m(self, rows: Ints) -> Floats:
        sensor, range_m = sensor_of(self.result.config), self.log.sightings.range_m[rows]
        return np.asarray(np.hypot(sensor["range_std_m"], sensor["bearing_std_rad"] * range_m))

    def _laid_on_others(self, rows: Ints, witness_m: Floats) -> Floats:
        """Where landmarks sighted are (N, 2) by the witnesses of their scans, of which there are enough."""
        places = [np.empty((0, 2))]
        for row in _spread(rows, MOST_AT_A_PLACE).tolist():
            scan = self._scan[row]
            others = np.arange(*np.searchsorted(self._scan, [scan, scan + 1]))
            others = others[np.isfinite(witness_m[self.log.sightings.identity[others], 0])]
            try:
                T_world_robot = align_points(
                    self._point_m[others], witness_m[self.log.sightings.identity[others]]
                )
            except DataError:
                continue
            places.append(T_world_robot.apply_points(self._point_m[row : row + 1]))
        return np.concatenate(places)

    def _witnesses(self, name: int, here: Ints, there: Ints) -> Floats:
        """The place of every name in the map (names + 1, 2); NaN for those that nothing ties to both places.

        That are those which were seen together with the name here and there, or to which the robot came back.
        """
        identity, scan = self.log.sightings.identity, self._scan
        beside = [identity[np.isin(scan, scan[rows])] for rows in (here, there)]
        at_both = np.intersect1d(beside[0], beside[1])
        tied = np.union1d(at_both, self._come_back_to)
        place_m: Floats = self._map_m.copy()
        place_m[np.setdiff1d(np.arange(len(place_m)), tied)] = np.nan
        # Nobody's name is -1, and a name is no witness of itself.
        place_m[[name, -1]] = np.nan
        return place_m

    @cached_property
    def _come_back_to(self) -> Ints:
        identity = self.log.sightings.identity
        order = np.lexsort((self._scan, identity))
        away = (np.diff(self._scan[order]) > AWAY_SCANS) & (np.diff(identity[order]) == 0)
        return np.unique(identity[order][1:][away])

    @cached_property
    def _map_m(self) -> Floats:
        """The place of every name in the map that came out (names + 1, 2), NaN where it has none."""
        landmarks = self.result.landmarks
        row_of = {name: row for row, name in enumerate(landmarks.ids)}
        rows = [row_of.get(name, -1) for name in (*self.log.identity_names, "")]
        return np.asarray(np.vstack([landmarks.mean_m, [[np.nan, np.nan]]])[rows])

    @cached_property
    def _scan(self) -> Ints:
        """Number of the scan of each sighting."""
        stamp_s = self.log.sightings.stamp_s
        return np.unique(stamp_s, return_inverse=True)[1].astype(np.int64)

    @cached_property
    def _point_m(self) -> Floats:
        """What each sighting shows, in the frame of the robot (S, 2)."""
        sightings, sensor = self.log.sightings, sensor_of(self.result.config)
        mounting = sensor["mounting"]
        range_m = (sightings.range_m - sensor["range_bias_m"]) / sensor["range_scale"]
        bearing = sightings.bearing_rad - sensor["bearing_bias_rad"]
        point_m = range_m[:, None] * np.column_stack([np.cos(bearing), np.sin(bearing)])
        T_robot_sensor = np.array([[mounting["x_m"], mounting["y_m"], mounting["yaw_rad"]]])
        return _in_world(T_robot_sensor, point_m)

    def _step_of(self, rows: Ints) -> Ints:
        """The step of the run that took in each sighting."""
        stamp_s = self.log.sightings.stamp_s[rows] - self.result.config["sensor"]["delay_s"]
        steps_s = self.result.trajectory.stamp_s
        step = np.searchsorted(steps_s, stamp_s - 1e-9)
        return np.asarray(np.minimum(step, len(steps_s) - 1), dtype=np.int64)

    def _pose_at(self, rows: Ints) -> Floats:
        return np.asarray(self.result.trajectory.T_world_robot[self._step_of(rows)])


def _in_world(T_world_frame: Floats, point_m: Floats) -> Floats:
    cosine, sine = np.cos(T_world_frame[:, 2]), np.sin(T_world_frame[:, 2])
    turned = [cosine * point_m[:, 0] - sine * point_m[:, 1], sine * point_m[:, 0] + cosine * point_m[:, 1]]
    return np.asarray(T_world_frame[:, :2] + np.column_stack(turned))


def _spread(rows: Ints, most: int) -> Ints:
    if len(rows) <= most:
        return rows
    return np.asarray(rows[np.linspace(0, len(rows) - 1, most).astype(np.int64)])


def _moved_alike(two: TwoPlaces, other: TwoPlaces) -> bool:
    by_m, by_other_m = ((place[4] - place[1], place[5] - place[2]) for place in (two, other))
    apart_m = np.hypot(by_m[0] - by_other_m[0], by_m[1] - by_other_m[1])
    return bool(apart_m <= ALIKE * np.hypot(*by_m))


def _are_apart(first_m: Floats, second_m: Floats) -> bool:
    centres = [np.median(places, axis=0) for places in (first_m, second_m)]
    distances = [
        np.hypot(*(places - centre).T) for places, centre in zip((first_m, second_m), centres, strict=True)
    ]
    spread_m = max(float(np.median(distance)) for distance in distances)
    return float(np.hypot(*(centres[0] - centres[1]))) > APART * spread_m

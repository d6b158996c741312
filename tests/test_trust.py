"""What speaks against a map: landmarks that are gone, moved or there twice, and nothing of a sound one."""

from __future__ import annotations

from dataclasses import replace

import fastslam
import numpy as np
import pytest
from fastslam.detection import with_sightings
from fastslam.evaluation import evaluate
from fastslam.health import HealthStatus
from fastslam.laid import Laid, explained_apart, laid_on_map
from fastslam.log import Floats, Log
from fastslam.result import RunResult
from fastslam.simulation import resolve_simulation, simulate
from fastslam.standing import Looks, standing, surplus
from fastslam.trust import against, doubts, lost_for_good

SETTINGS = {"filter": {"particles": 15}, "association": {"mode": "unknown"}}
RNG = np.random.default_rng(3)


def drive(seed: int = 5, preset: str = "demo", **settings: object) -> Log:
    return with_sightings(simulate(resolve_simulation({"seed": seed, **settings}, preset=preset)))


def ratios(result: RunResult, log: Log) -> dict[str, float]:
    return {doubt.rule: doubt.ratio for doubt in doubts(result, log)}


@pytest.mark.parametrize("preset", ["demo", "orchard", "rover"])
def test_nothing_speaks_against_a_sound_run(preset: str) -> None:
    log = drive(preset=preset)
    result = fastslam.run(log, SETTINGS)
    found = ratios(result, log)
    assert {"landmarks", "innovations", "unexplained", "lost"} <= set(found)
    assert max(found.values()) < 1.0, found
    assert against(doubts(result, log)) == ()


@pytest.mark.parametrize("seed", [3, 7, 5024])
def test_what_a_thin_log_could_not_confirm_does_not_speak_against_the_rest(seed: int) -> None:
    """Half of the landmarks stay provisional: what was sighted of these lies on none of the map."""
    scan = {"identities": "none", "period_s": 1.0, "clutter_per_scan": 0.5}
    sensor = {"max_range_m": 6.0, "field_of_view_rad": np.deg2rad(162.0), "tail_degrees_of_freedom": 4.0}
    log = drive(seed=seed, scan=scan, sensor=sensor)
    result = fastslam.run(log, auto=False)
    confirmed = result.landmarks.confirmed
    assert confirmed is not None and (~confirmed).sum() > confirmed.sum() > 3
    assert evaluate(result, log)["landmark_precision"] == 1.0
    assert not result.verdict and ratios(result, log)["unexplained"] < 1.0


@pytest.mark.parametrize("mode", ["known", "unknown"])
def test_a_world_that_changed_half_way_is_told(mode: str) -> None:
    log = drive(trajectory={"laps": 6})
    seen = log.sightings
    late = seen.stamp_s > np.median(seen.stamp_s)
    shifted = late & (seen.identity % 3 == 0) & (seen.range_m > 2.0)
    range_m = seen.range_m - 1.5 * shifted
    changed = replace(log, sightings=replace(seen, range_m=range_m))
    result = fastslam.run(changed, {**SETTINGS, "association": {"mode": mode}}, auto=False)
    found = ratios(result, changed)
    assert max(found["landmarks"], found["not found again"]) > 1.0
    assert any("the world has changed" in sentence for sentence in result.verdict)


def test_the_drift_of_a_live_path_does_not_speak_against_the_map() -> None:
    """Of EKF-SLAM there is no other path: it lies off the map where the loop was not closed yet."""
    log = drive(seed=3, preset="loop", trajectory={"laps": 3})
    result = fastslam.run(log, {"algorithm": "ekf", "association": {"mode": "unknown"}})
    assert np.array_equal(result.path.T_world_robot, result.trajectory.T_world_robot)
    assert evaluate(result, log)["landmark_precision"] == 1.0
    assert against(doubts(result, log)) == ()


def test_sightings_that_the_map_does_not_explain_are_told() -> None:
    log = drive()
    result = fastslam.run(log, SETTINGS)
    bent = result.smoothed.T_world_robot.copy()
    half = len(bent) // 2
    bent[half:, :2] += 3.0
    wrong = replace(result, smoothed=replace(result.smoothed, T_world_robot=bent))
    assert ratios(result, log)["unexplained"] < 0.5 < 1.0 < ratios(wrong, log)["unexplained"]


def test_a_time_in_which_the_filter_was_lost_counts_where_its_map_stands_apart() -> None:
    log = drive()
    result = fastslam.run(log, SETTINGS)
    health = result.steps.health.copy()
    third = len(health) // 3
    health[third : 2 * third] = HealthStatus.LOST
    lost = replace(result, steps=replace(result.steps, health=health))
    laid = laid_on_map(lost, log)
    assert laid is not None
    # What was seen meanwhile shows landmarks of the time before and after.
    assert not lost_for_good(lost, laid).any() and ratios(lost, log)["lost"] == 0.0
    first_s, last_s = result.steps.stamp_s[[third, 2 * third - 1]]
    meanwhile = (laid.stamp_s >= first_s) & (laid.stamp_s <= last_s) & (laid.landmark >= 0)
    landmark = laid.landmark + len(laid.mean_m) * meanwhile
    apart = replace(laid, landmark=landmark, mean_m=np.vstack([laid.mean_m, laid.mean_m + 50.0]))
    assert np.array_equal(lost_for_good(lost, apart), health == HealthStatus.LOST)
    unseen = replace(laid, squared=np.where(meanwhile, np.inf, laid.squared))
    assert np.array_equal(lost_for_good(lost, unseen), health == HealthStatus.LOST)


def scene(shown: Floats, mean_m: Floats, *, together: bool = True) -> Laid:
    """A sensor at rest, ten looks of ten frames a landmark and frame; `shown` (L, K) says what it sees."""
    rows = [(look, k) for look, row in enumerate(shown) for k in np.flatnonzero(row)]
    look, landmark = np.array(rows).T
    # Alone each sighting is of its own frame.
    stamp_s = look + (0.0 if together else 0.1) * landmark
    apart = mean_m[landmark] + 0.01 * RNG.normal(size=(len(landmark), 2))
    return Laid(
        row=np.arange(len(look)),
        stamp_s=stamp_s,
        squared=np.zeros(len(look)),
        landmark=landmark,
        frame=np.unique(stamp_s, return_inverse=True)[1],
        mean_m=mean_m,
        origin=np.zeros((len(look), 3)),
        range_m=np.hypot(*apart.T),
        bearing_rad=np.arctan2(apart[:, 1], apart[:, 0]),
    )


def test_what_one_scan_shows_beside_each_other_one_landmark_does_not_explain() -> None:
    log = simulate({"seed": 1, "max_duration_s": 2.0})
    sensor = {"range_std_m": 0.1, "bearing_std_rad": 0.04}
    mean_m = np.array([[4.0, 0.0], [4.0, 0.6], [4.0, -3.0]])

    def explained(
        side_m: list[float], stamp_s: list[float], sensor_index: list[int] | None = None
    ) -> list[bool]:
        point_m = np.column_stack([np.full(len(side_m), 4.0), side_m])
        log_of_them = replace(log, sightings=log.sightings[np.zeros(len(side_m), dtype=np.int64)])
        if sensor_index is not None:
            indices = np.array(sensor_index)
            log_of_them = replace(log_of_them, sightings=replace(log_of_them.sightings, sensor_index=indices))
        apart = np.abs(np.array(side_m)[:, None] - mean_m[:, 1])
        laid = Laid(
            row=np.arange(len(side_m)),
            stamp_s=np.array(stamp_s),
            squared=(apart.min(axis=1) / 0.16) ** 2,
            landmark=apart.argmin(axis=1),
            frame=np.zeros(len(side_m), dtype=np.int64),
            mean_m=mean_m,
            origin=np.zeros((len(side_m), 3)),
            range_m=np.hypot(*point_m.T),
            bearing_rad=np.arctan2(point_m[:, 1], point_m[:, 0]),
        )
        return [bool(one) for one in explained_apart(laid, log_of_them, sensor)]

    # Both are nearest to one landmark; another one is near enough for the second.
    assert explained([0.0, 0.2], [1.0, 1.0]) == [True, True]
    # None is.
    assert sum(explained([-3.0, -3.2], [1.0, 1.0])) == 1
    # The first must leave the landmark that is nearest to it, so that the second has one.
    assert explained([0.25, -0.2], [1.0, 1.0]) == [True, True]
    assert sum(explained([0.1, 0.2, 0.3], [1.0, 1.0, 1.0])) == 2
    # Of two scans, of two sensors.
    assert explained([-3.0, -3.2], [1.0, 1.1]) == [True, True]
    assert explained([-3.0, -3.2], [1.0, 1.0], [0, 1]) == [True, True]
    # What is far from all is explained by none.
    assert explained([-3.0, 9.0, -3.1], [1.0, 1.0, 1.1]) == [True, False, True]


WALL = np.array([[5.0, -3.0], [2.0, 0.0], [2.0, 0.4], [5.0, 3.0], [6.0, 3.0]])
"""The outer ones stand for the edge of the view, within which three quarters of the sightings lie."""


def test_two_that_take_turns_are_twins_and_two_seen_together_are_not() -> None:
    shown = np.ones((60, 5), dtype=bool)
    assert Looks(scene(shown, WALL)).twins() == []
    shown[::2, 1] = False
    shown[1::2, 2] = False
    assert Looks(scene(shown, WALL)).twins() == [(1, 2)]
    assert standing(scene(shown, WALL), named=False).twins == 1
    assert standing(scene(shown, WALL), named=True).twins == 0


def test_two_closer_than_the_noise_are_told_by_frames_that_show_both() -> None:
    close = WALL.copy()
    close[2] = [2.0, 0.02]
    shown = np.ones((60, 5), dtype=bool)
    assert Looks(scene(shown, close)).twins() == []
    assert Looks(scene(shown, close, together=False)).twins() == [(1, 2)]


def test_one_that_is_not_sighted_any_more_is_gone_unless_it_was_rarely_sighted() -> None:
    shown = np.ones((60, 5), dtype=bool)
    shown[30:, 1] = False
    assert list(Looks(scene(shown, WALL)).gone()) == [1]
    rarely = np.ones((60, 5), dtype=bool)
    rarely[:, 1] = np.arange(60) % 20 == 0
    assert list(Looks(scene(rarely, WALL)).gone()) == []


def test_one_that_moved_is_told_and_scatter_is_not() -> None:
    laid = scene(np.ones((60, 5), dtype=bool), WALL)
    assert list(Looks(laid).moved()) == []
    late = (laid.landmark == 1) & (laid.stamp_s >= 30)
    assert list(Looks(replace(laid, range_m=laid.range_m + 0.3 * late)).moved()) == [1]


def test_of_groups_all_but_one_are_left_over() -> None:
    assert surplus([(0, 1), (1, 2), (4, 5)]) == [1, 2, 5]
    assert surplus([(4, 3), (1, 2), (2, 4), (3, 1)]) == [2, 3, 4]
    assert surplus([]) == []


def test_sightings_lie_on_the_landmarks_that_they_name() -> None:
    log = drive()
    named = laid_on_map(fastslam.run(log, {"filter": {"particles": 15}}), log)
    unnamed = laid_on_map(fastslam.run(log, SETTINGS), log)
    assert named is not None and unnamed is not None
    for laid in (named, unnamed):
        assert len(laid.stamp_s) > 3000 and np.mean(laid.explained) > 0.99
        # The squared distance of two numbers has mean 2.
        assert 1.5 < float(np.mean(laid.squared[laid.explained])) < 2.5

"""A robot that is told rows as they come gives what a run over the log gives."""

from __future__ import annotations

import copy
import pickle
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pytest
from fastslam import FastSlam, Robot, Start, run
from fastslam.config import merge
from fastslam.errors import ConfigError, DataError
from fastslam.health import status_name
from fastslam.robot import Step, Window
from fastslam.so_far import SoFar
from small_log import LANDMARKS_M, events, make_small_log, tell

CONFIG = {"filter": {"particles": 20}, "seed": 3}


def test_late_rows_give_the_bits_of_a_run_also_across_a_file(tmp_path: Path) -> None:
    log = make_small_log()
    expected = run(log, CONFIG)
    # Sightings come 0.15 s late.
    rows = sorted(events(log), key=lambda row: row[0] + 0.15 * row[1])
    assert rows != sorted(rows)
    robot = Robot({**log.config, **CONFIG}, identities="all", window=Window(late_s=0.2))
    steps: list[Step] = []
    for number, row in enumerate(rows):
        steps += tell(robot, log, row)
        if number == 100:
            robot = Robot.load(robot.save(tmp_path / "robot.fastslam"))
        if number == 200:
            robot = pickle.loads(pickle.dumps(copy.deepcopy(robot)))
    steps += robot.end()
    assert robot.end() == () and robot.counts == dict.fromkeys(robot.counts, 0)
    np.testing.assert_array_equal([step.stamp_s for step in steps], expected.trajectory.stamp_s)
    np.testing.assert_array_equal([step.T_world_robot for step in steps], expected.trajectory.T_world_robot)
    np.testing.assert_array_equal(robot.path.T_world_robot, expected.smoothed.T_world_robot)
    assert set(robot.landmarks.ids) == set(expected.landmarks.ids) and len(robot.landmarks.ids) == 6
    assert steps[-1].info.health == status_name(int(expected.steps.health[-1]))
    stamp_s, mean, covariance = robot.pose
    assert stamp_s == log.controls.stamp_s[-1] and covariance.shape == (3, 3)
    punctual = Robot({**log.config, **CONFIG}, identities="all")
    for row in sorted(events(log)):
        tell(punctual, log, row)
    punctual.end()
    # After the draw at the end, which follows the last step of the run.
    np.testing.assert_array_equal(mean, punctual.pose[1])
    assert np.linalg.norm(mean[:2] - expected.smoothed.T_world_robot[-1, :2]) < 0.1


def test_bad_rows_change_nothing_and_refused_ones_are_counted() -> None:
    robot = Robot(CONFIG, window=Window(late_s=0.1))
    robot.odometry(1.0, [1.0, 0.0])
    before = pickle.dumps(robot)
    for bad in (
        lambda: robot.odometry(1.1, [1.0]),
        lambda: robot.odometry(1.1, [np.nan, 0.0]),
        lambda: robot.odometry(np.nan, [1.0, 0.0]),
        lambda: robot.odometry(1.7e12, [1.0, 0.0]),
        lambda: robot.odometry(1.1, [1.0, 0.0], covariance=[1.0]),
        lambda: robot.odometry(1.1, [1.0, 0.0], covariance=-np.eye(3)),
        lambda: robot.sightings(1.1, range_m=[1.0], bearing_rad=[90.0], identity=["new"]),
        lambda: robot.sightings(1.1, range_m=[1.0], bearing_rad=[0.1], class_name=["blue"]),
        lambda: robot.sightings(1.1, range_m=[1.0], bearing_rad=[0.1], class_name="b"),
    ):
        with pytest.raises(DataError):
            bad()
    assert pickle.dumps(robot) == before
    robot.odometry(0.5, [1.0, 0.0])
    robot.odometry(1.0, [2.0, 0.0])
    robot.odometry(9e9, [1.0, 0.0])
    assert {**robot.counts, "waiting": 0} == {
        **{"late": 1, "repeated": 1, "ahead": 1},
        **{"waiting": 0, "unexplained": 0},
    }
    with pytest.raises(DataError, match="late_s"):
        Robot(window=Window(late_s=-1.0))
    with pytest.raises(ConfigError, match="particle"):
        Robot({"filter": {"particle": 3}})


def test_classes_have_their_names_and_too_many_are_refused() -> None:
    robot = Robot({**CONFIG, "association": {"classes": {"number": 2}}}, classes=("blue", "yellow"))
    robot.odometry(0.0, [0.0, 0.0])
    robot.sightings(0.1, range_m=[2.0, 3.0], bearing_rad=[0.5, -0.5], class_name=["yellow", None])
    with pytest.raises(DataError, match="got 'red', expected one of blue, yellow"):
        robot.sightings(0.2, range_m=[2.0], bearing_rad=[0.5], class_name=["red"])
    robot.end()
    assert robot.landmarks.class_names == ("blue", "yellow")
    classes = robot.landmarks.class_index
    assert classes is not None and sorted(classes.tolist()) == [-1, 1]


@pytest.mark.parametrize("word", ["unknown", " None ", "", "nan", "NULL", "-1", -1, float("nan"), None])
def test_a_word_for_a_class_that_nobody_knows_is_no_class(word: str | float | None) -> None:
    settings = {**CONFIG, "association": {"classes": {"number": 2}}}
    seen: dict[str, Any] = {"range_m": [2.0, 3.0], "bearing_rad": [0.5, -0.5]}
    robot = Robot(settings, classes=("blue",))
    robot.odometry(0.0, [0.0, 0.0])
    robot.sightings(0.1, class_name=["blue", word], **seen)
    robot.end()
    assert robot.landmarks.class_names == ("blue",)
    single = FastSlam(settings)
    single.update(0.1, class_index=[0, word], **seen)
    for landmarks in (robot.landmarks, single.landmarks):
        assert landmarks.class_index is not None and sorted(landmarks.class_index.tolist()) == [-1, 0]


def test_the_map_of_a_robot_is_that_of_its_end_and_the_robot_goes_on() -> None:
    log = make_small_log()
    robot = Robot({**log.config, **CONFIG}, identities="all")
    robot.keep_result()
    for row in sorted(events(log)):
        tell(robot, log, row)
    before = pickle.dumps(robot)
    early = robot.map
    assert pickle.dumps(robot) == before and robot.counts["waiting"] > 0
    robot.end()
    kept = robot.result()[0].map
    assert early.landmarks.ids == kept.landmarks.ids and len(kept.landmarks.ids) == 6
    np.testing.assert_array_equal(early.landmarks.mean_m, kept.landmarks.mean_m)
    np.testing.assert_array_equal(robot.map.landmarks.mean_m, kept.landmarks.mean_m)
    assert early.made_from == kept.made_from and early.name == "live"


@pytest.mark.parametrize("late_draws", ["await", "put_off"])
def test_a_draw_that_is_late_is_waited_for_or_put_off(late_draws: Literal["await", "put_off"]) -> None:
    log = make_small_log(steps=600)
    often = {"particles": 100, "rejuvenation": {"every_steps": 20, "delay_scans": 1}}
    config = merge(log.config, {"filter": often, "seed": 3})
    robot = Robot(config, identities="all", window=Window(late_s=1000.0, gap_s=1000.0), late_draws=late_draws)
    for row in sorted(events(log)):
        tell(robot, log, row)
    assert robot.counts["waiting"] > 600
    robot = pickle.loads(pickle.dumps(robot))
    # All steps are computed in one call, and the next scan is there at once.
    steps = robot.end()
    assert len(steps) == 120
    assert (robot.waits > 0, robot.put_off > 0) == (late_draws == "await", late_draws == "put_off")
    assert len(robot.landmarks.ids) == len(LANDMARKS_M)


MISTAKES: dict[str, tuple[dict[str, Any], str]] = {
    "none": ({}, ""),
    "reach": ({"sensor": {"max_range_m": 4.0}}, "lie beyond sensor.max_range_m = 4"),
    "noise": ({"sensor": {"range_std_m": 0.01, "bearing_std_rad": 0.001}}, "innovations are larger than"),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_the_verdict_so_far_is_told_on_the_way_and_kept_in_a_file(mistake: str) -> None:
    log = make_small_log(steps=400)
    settings, expected = MISTAKES[mistake]
    robot = Robot(merge(log.config, CONFIG, {"association": {"mode": "unknown"}}, settings))
    told: list[tuple[str, ...]] = []
    for number, row in enumerate(sorted(events(log))):
        tell(robot, log, row)
        if number % 20 == 0:
            told.append(robot.verdict)
        if number == 150:
            robot = pickle.loads(pickle.dumps(robot))
    assert len(told) > 20 and told[0] == (), "the first sightings say nothing"
    if not expected:
        assert not any(told)
        return
    assert any(expected in sentence for sentence in told[-1])
    assert any(expected in " ".join(verdict) for verdict in told[:-5]), "before the end"
    robot.end()
    assert robot.verdict and any(expected in sentence for sentence in robot.verdict)


def test_who_asks_at_each_step_is_told_a_verdict_that_is_made_once_a_second(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    log = make_small_log(steps=400)
    made: list[tuple[str, ...]] = []
    ask = SoFar.verdict

    def counted(self: SoFar, *given: Any) -> tuple[str, ...]:
        made.append(ask(self, *given))
        return made[-1]

    monkeypatch.setattr(SoFar, "verdict", counted)
    robot = Robot(merge(log.config, CONFIG, {"sensor": {"max_range_m": 4.0}}), identities="all")
    asked = 0
    for row in sorted(events(log)):
        for step in tell(robot, log, row):
            assert robot.view(step).verdict == robot.recent_verdict == made[-1]
            asked += 1
    seconds = float(log.controls.stamp_s[-1] - log.controls.stamp_s[0])
    assert 1 < len(made) <= seconds + 1.0 < asked and made[0] == ()
    robot.end()
    assert robot.recent_verdict == robot.verdict != (), "what was told before the end does not stand"


def test_the_verdict_so_far_says_what_a_run_says_of_what_was_dropped() -> None:
    log = make_small_log()
    config = merge(log.config, CONFIG, {"sensor": {"max_range_m": 4.0}})
    robot = Robot(config, identities="all")
    for row in sorted(events(log)):
        tell(robot, log, row)
    robot.end()
    verdict = run(log, merge(CONFIG, {"sensor": {"max_range_m": 4.0}}), auto=False).verdict
    assert robot.verdict and robot.verdict[0] == verdict[0].replace(" (feet?)", "")


def test_every_pose_that_is_told_can_be_a_start() -> None:
    log = make_small_log()
    robot = Robot({**log.config, **CONFIG}, identities="all")
    told: list[tuple[np.ndarray, np.ndarray]] = []
    for row in sorted(events(log)):
        told += [(step.T_world_robot, step.covariance) for step in tell(robot, log, row)]
        told.append(robot.pose[1:])
    result = run(log, CONFIG)
    assert result.trajectory.covariance is not None
    told += zip(result.trajectory.T_world_robot, result.trajectory.covariance, strict=True)
    assert len(told) > 400
    for mean, covariance in told:
        np.testing.assert_array_equal(covariance, covariance.T)
        FastSlam(CONFIG, start=Start(*mean, covariance=covariance))


def test_threads_share_a_robot() -> None:
    log = make_small_log(steps=100)
    robot = Robot(CONFIG, window=Window(late_s=100.0))
    with ThreadPoolExecutor(4) as pool:
        list(pool.map(lambda row: tell(robot, log, row), events(log)))
    steps = robot.end()
    alone = Robot(CONFIG, window=Window(late_s=100.0))
    for row in events(log):
        tell(alone, log, row)
    # Names are numbered as they come, and so the steps are the same to rounding only.
    assert len(steps) == len(alone.end()) >= 20 and robot.counts["late"] == 0
    np.testing.assert_allclose(robot.pose[1], alone.pose[1], atol=1e-9)

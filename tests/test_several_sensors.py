"""Several sensors on one robot: logs, runs, live streams, and what refuses them."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cli_runner import fastslam as call
from fastslam import FastSlam, Robot, run
from fastslam.calibration import calibrate
from fastslam.datasets import load
from fastslam.datasets.native_write import write_native
from fastslam.errors import ConfigError, DataError
from fastslam.evaluation import evaluate
from fastslam.examination import examine
from fastslam.live import Session, tell
from fastslam.log import Log
from fastslam.result import RunResult
from fastslam.several import as_of_one, refuse_several
from fastslam.simulation import simulate
from fastslam.tuning import diagnose, tune
from fastslam.window import Window

FRONT = {"max_range_m": 10.0, "field_of_view_rad": 3.14, "mounting": {"x_m": 0.4, "y_m": 0.1}}
REAR = {
    "max_range_m": 9.0,
    "field_of_view_rad": 3.14,
    "range_std_m": 0.15,
    "mounting": {"x_m": -0.3, "yaw_rad": 3.1416},
}
WORLD: dict[str, Any] = {"seed": 3, "world": {"count": 30, "size_m": [30.0, 24.0]}, "max_duration_s": 40.0}
QUICK = {"filter": {"particles": 30}}


def _both(**more: Any) -> Log:
    return simulate({**WORLD, "sensors": {"front": FRONT, "rear": REAR | more}})


def _map_error_m(result: RunResult, log: Log) -> float:
    return float(evaluate(result, log)["landmark_rmse_m"])


def test_two_half_circles_map_as_well_as_a_whole_one_and_a_wrong_mounting_shows() -> None:
    around = simulate(WORLD)
    log = _both()
    assert log.sensor_names == ("front", "rear")
    result = run(log, QUICK)
    error_m, whole_m = _map_error_m(result, log), _map_error_m(run(around, QUICK), around)
    assert error_m < 1.5 * whole_m + 0.02, (error_m, whole_m)
    assert len(result.landmarks.ids) >= 25
    assert result.verdict == () and result.warnings == ()
    wrong = run(log, {**QUICK, "sensors": {"rear": {"mounting": {"yaw_rad": 3.25}}}})
    assert _map_error_m(wrong, log) > 1.5 * error_m
    assert wrong.warnings or wrong.verdict


def test_without_names_both_find_the_landmarks_once() -> None:
    log = _both()
    result = run(log, {**QUICK, "association": {"mode": "unknown"}})
    scores = evaluate(result, log)
    assert scores["landmark_recall"] > 0.9 and scores["landmark_precision"] > 0.9, scores
    assert scores["landmark_duplicates"] == 0, scores


def test_a_log_of_several_is_read_as_it_was_written(tmp_path: Path) -> None:
    log = _both(delay_s=0.05)
    again = load(write_native(log, tmp_path / "log"))
    for name in ("stamp_s", "range_m", "bearing_rad"):
        np.testing.assert_array_equal(getattr(again.sightings, name), getattr(log.sightings, name))
    names = [np.array(one.sensor_names)[one.sightings.sensor_index] for one in (log, again)]
    np.testing.assert_array_equal(*names)
    maps = [run(one, QUICK).landmarks for one in (log, again)]
    places = [dict(zip(each.ids, each.mean_m.tolist(), strict=True)) for each in maps]
    assert places[0] == places[1]
    shown = call("info", str(tmp_path / "log"))
    assert shown.exit_code == 0 and "sightings of sensor rear" in shown.stdout


LOG_YAML = """\
format_version: 1
motion: {model: velocity, speed_std_m_per_s: 0.05, yaw_rate_std_rad_per_s: 0.02}
"""


def _written(folder: Path, settings: str, sightings: str) -> Path:
    folder.mkdir()
    (folder / "log.yaml").write_text(LOG_YAML + settings)
    rows = "".join(f"{0.1 * k:.1f},1.0,0.1\n" for k in range(20))
    (folder / "odometry.csv").write_text("stamp_s,speed_m_per_s,yaw_rate_rad_per_s\n" + rows)
    (folder / "sightings.csv").write_text(sightings)
    return folder


SENSORS = "sensors:\n  front: {range_std_m: 0.1}\n  rear: {range_std_m: 0.2}\n"


@pytest.mark.parametrize(
    ("settings", "sightings", "message"),
    [
        (
            SENSORS,
            "stamp_s,range_m,bearing_rad,sensor\n0.1,2,0.1,front\n0.2,2,0.1,side\n",
            r"sightings.csv:3: sensor: got side, expected one of front, rear",
        ),
        (
            SENSORS,
            "stamp_s,range_m,bearing_rad,sensor\n0.1,2,0.1,front\n0.2,2,0.1,\n",
            r"sightings.csv:3: sensor: got nothing, expected one of front, rear",
        ),
        (
            SENSORS,
            "stamp_s,range_m,bearing_rad\n0.1,2,0.1\n",
            r"sightings.csv:1: column sensor is missing: log.yaml has the sensors front, rear",
        ),
        (
            SENSORS + "sensor: {model: range_bearing, range_std_m: 0.3}\n",
            "stamp_s,range_m,bearing_rad,sensor\n0.1,2,0.1,front\n",
            r"log.yaml:3: sensors: got `sensor` beside it, expected one of the two",
        ),
        (
            SENSORS.replace("rear: {", "rear: {model: own, "),
            "stamp_s,range_m,bearing_rad,sensor\n0.1,2,0.1,front\n",
            r"sensors.rear.model: got own, expected range_bearing, range or bearing",
        ),
        (
            SENSORS.replace("range_std_m: 0.2", "range_st: 0.2"),
            "stamp_s,range_m,bearing_rad,sensor\n0.1,2,0.1,front\n",
            r"sensors.*range_st",
        ),
        (
            "sensor: {model: range_bearing, range_std_m: 0.1}\n",
            "stamp_s,range_m,bearing_rad,sensor\n0.1,2,0.1,front\n0.1,2,0.1,rear\n",
            r"sightings are of front, rear: the configuration needs `sensors`",
        ),
    ],
)
def test_what_does_not_fit_is_one_line_with_its_place(
    settings: str, sightings: str, message: str, tmp_path: Path
) -> None:
    folder = _written(tmp_path / "log", settings, sightings)
    with pytest.raises((DataError, ConfigError), match=message) as refused:
        run(load(folder), QUICK)
    assert "\n" not in str(refused.value)


def test_one_sensor_with_a_name_needs_no_column(tmp_path: Path) -> None:
    sightings = "stamp_s,range_m,bearing_rad,landmark_id\n0.1,2,0.1,oak\n0.5,2,0.1,oak\n"
    named = _written(tmp_path / "named", "sensors: {laser: {range_std_m: 0.2}}\n", sightings)
    plain = _written(tmp_path / "plain", "sensor: {model: range_bearing, range_std_m: 0.2}\n", sightings)
    maps = [run(load(folder), QUICK).landmarks.mean_m.tobytes() for folder in (named, plain)]
    assert maps[0] == maps[1]


def test_a_robot_told_row_by_row_gives_the_bits_of_a_run() -> None:
    log = _both(delay_s=0.03)
    config = {**log.config, "filter": {"particles": 20}}
    robot = Robot(config, identities="all", window=Window(late_s=0.5))
    whole = run(log, {"filter": {"particles": 20, "rejuvenation": {"delay_scans": 10}}})
    session = Session(robot)
    seen, controls = log.sightings, log.controls
    assert seen.sensor_index is not None
    events: list[tuple[float, str]] = [
        (float(t), json.dumps({"t": float(t), "odom": row.tolist()}))
        for t, row in zip(controls.stamp_s, controls.values, strict=True)
    ]
    for t in np.unique(seen.stamp_s):
        for number, name in enumerate(log.sensor_names):
            rows = np.flatnonzero((seen.stamp_s == t) & (seen.sensor_index == number))
            if len(rows) > 0:
                see = [
                    [float(seen.range_m[k]), float(seen.bearing_rad[k]), log.identity_names[seen.identity[k]]]
                    for k in rows
                ]
                events.append((float(t), json.dumps({"t": float(t), "see": see, "sensor": name})))
    for _, line in sorted(events, key=lambda event: event[0]):
        session.take(line)
    session.end()
    assert session.faults.count == 0
    by_name = dict(zip(whole.landmarks.ids, whole.landmarks.mean_m.tolist(), strict=True))
    told = dict(zip(robot.landmarks.ids, robot.landmarks.mean_m.tolist(), strict=True))
    assert told.keys() == by_name.keys()
    # Names are numbered as they come, which changes no estimate.
    assert max(abs(np.array(told[name]) - by_name[name]).max() for name in told) < 1e-9


def test_scans_name_their_sensor_step_by_step(tmp_path: Path) -> None:
    robot = FastSlam({"sensors": {"front": {}, "rear": {"mounting": {"yaw_rad": 3.141592653589793}}}})
    robot.predict([1.0, 0.0], dt_s=1.0)
    robot.update(1.0, range_m=[2.0], bearing_rad=[0.0], identity=["ahead"], sensor="front")
    robot.update(1.0, range_m=[2.0], bearing_rad=[0.0], identity=["behind"], sensor="rear")
    loaded = FastSlam.load(robot.save(tmp_path / "robot.fastslam"))
    for one in (robot, loaded):
        place = dict(zip(one.landmarks.ids, one.landmarks.mean_m[:, 0], strict=True))
        assert place["ahead"] - place["behind"] == pytest.approx(4.0, abs=0.2)
    for sensor, message in [(None, "sensor: got none, expected one of front, rear"), ("side", "got 'side'")]:
        with pytest.raises(DataError, match=message):
            robot.update(1.5, range_m=[2.0], bearing_rad=[0.0], sensor=sensor)
    with pytest.raises(DataError, match="got none"):
        robot.step([1.0, 0.0], dt_s=0.1, range_m=[1.0], bearing_rad=[0.0])
    with pytest.raises(DataError, match="has no `sensors`: leave it out"):
        FastSlam().update(0.1, range_m=[2.0], bearing_rad=[0.0], sensor="front")
    with pytest.raises(DataError, match="sensor: got 3, expected a name"):
        tell(Robot({"sensors": {"a": {}, "b": {}}}), '{"t": 0.1, "see": [[1.0, 0.2]], "sensor": 3}')


@pytest.mark.parametrize("algorithm", ["fastslam2", "ekf"])
def test_a_step_names_its_sensor(algorithm: str) -> None:
    config = {"algorithm": algorithm, "sensors": {"front": {}, "rear": {"mounting": {"yaw_rad": 3.0}}}}
    by_step, by_hand = FastSlam(config), FastSlam(config)
    rng = np.random.default_rng(4)
    for number in range(1, 20):
        sensor = ("front", "rear")[number % 2]
        range_m, bearing_rad = rng.normal(4.0, 0.05, 2), np.array([0.3, -0.4]) + rng.normal(0.0, 0.01, 2)
        seen = {"range_m": range_m, "bearing_rad": bearing_rad, "identity": [f"{sensor}-a", f"{sensor}-b"]}
        info = by_step.step([0.1, 0.02], dt_s=0.1, sensor=sensor, **seen)
        by_hand.predict([0.1, 0.02], dt_s=0.1)
        assert info == by_hand.update(0.1 * number, sensor=sensor, **seen) and info.sightings == 2
    np.testing.assert_array_equal(by_step.landmarks.mean_m, by_hand.landmarks.mean_m)
    np.testing.assert_array_equal(by_step.pose[0], by_hand.pose[0])
    # What is refused moves nothing.
    before = by_step.pose[0]
    for wrong in ({"sensor": "side"}, {}, {"sensor": "rear", "identity": ["a"]}):
        with pytest.raises(DataError):
            by_step.step([1.0, 0.0], dt_s=0.1, range_m=[1.0, 2.0], bearing_rad=[0.0, 0.1], **wrong)
    np.testing.assert_array_equal(by_step.pose[0], before)
    by_step.step([0.1, 0.02], dt_s=0.1, sensor="front")


def test_what_knows_one_sensor_says_so() -> None:
    log = _both()
    for what in (calibrate, tune, diagnose):
        with pytest.raises(
            ConfigError, match=r"sensors: got front, rear, expected one sensor \(`sensor`\) for"
        ):
            what(log)
    with pytest.raises(ConfigError, match="for a kept map"):
        run(log, map="nowhere")
    refuse_several({"sensor": {}}, "anything")
    with pytest.raises(ConfigError, match=r"sensors: got several, expected none with a laser"):
        simulate({**WORLD, "sensors": {"a": FRONT, "b": REAR}, "scan": {"laser": {}}})


def test_what_judges_a_log_sees_it_in_the_frame_of_the_robot() -> None:
    log = _both()
    config = run(log, QUICK).config
    alike, one = as_of_one(log, config)
    assert one["sensor"]["mounting"] == {"x_m": 0.0, "y_m": 0.0, "yaw_rad": 0.0} and "sensors" not in one
    truth = log.truth_trajectory
    assert truth is not None and log.truth_landmarks is not None
    pose = np.array(
        [np.interp(alike.sightings.stamp_s, truth.stamp_s, truth.T_world_robot[:, k]) for k in (0, 1)]
    )
    heading = np.interp(alike.sightings.stamp_s, truth.stamp_s, np.unwrap(truth.T_world_robot[:, 2]))
    towards = heading + alike.sightings.bearing_rad
    shown = pose + alike.sightings.range_m * np.array([np.cos(towards), np.sin(towards)])
    there = log.truth_landmarks.position_m[alike.sightings.identity].T
    # Noise of 0.15 m and 0.02 rad at 10 m: none of some thousand is off by six standard deviations.
    assert np.hypot(*(shown - there)).max() < 6 * np.hypot(0.15, 0.2)
    assert [finding.code for finding in examine(log)] == []

"""Bearings alone: from files and arrays to a map, and what cannot be done with them."""

from __future__ import annotations

import pickle
from pathlib import Path

import numpy as np
import pytest
from fastslam import FastSlam, Log, run
from fastslam.datasets import load, write_native
from fastslam.datasets.info import describe
from fastslam.errors import ConfigError, DataError, FastSlamError
from fastslam.evaluation import evaluate
from fastslam.evaluation.runs import flatten
from fastslam.examination.registry import examine
from fastslam.log import Log as LogType
from fastslam.simulation import simulate
from fastslam.tuning.doctor import diagnose
from fastslam.tuning.session import tune

WORLD = {"count": 12}
SENSOR = {"model": "bearing", "bearing_std_rad": 0.02, "max_range_m": 20.0}
FEW = {"filter": {"particles": 20}}


@pytest.fixture(scope="module")
def posts() -> LogType:
    return simulate({"seed": 3, "world": WORLD, "sensor": SENSOR}, name="posts")


def test_a_native_log_without_ranges_is_written_read_and_mapped(posts: LogType, tmp_path: Path) -> None:
    write_native(posts, tmp_path / "log")
    header = (tmp_path / "log" / "sightings.csv").read_text().splitlines()[0]
    assert header == "stamp_s,bearing_rad,landmark_id"
    log = load(tmp_path / "log")
    assert np.isnan(log.sightings.range_m).all() and len(log.sightings.bearing_rad) > 500
    assert describe(log).range_m is None and describe(log).bearing_rad is not None
    result = run(log, FEW)
    metrics = flatten(evaluate(result, log))
    seen = len(np.unique(log.sightings.identity))
    assert metrics["landmark_matched"] == seen >= 10 and metrics["landmark_duplicates"] == 0
    for name, most in (("landmark_rmse_m", 0.3), ("smoothed_ate_rmse_m", 0.2)):
        value = metrics[name]
        assert value is not None and value < most, name
    assert result.verdict == ()
    again = run(posts, FEW)
    np.testing.assert_array_equal(again.trajectory.T_world_robot, result.trajectory.T_world_robot)


def test_the_map_is_not_much_worse_than_with_ranges(posts: LogType) -> None:
    # The bar for 60 landmarks is twice the error with ranges of 3 %, 0.3 m of 10; here one world of 12.
    both = {**SENSOR, "model": "range_bearing", "range_std_m": 0.3}
    with_ranges = simulate({"seed": 3, "world": WORLD, "sensor": both})
    errors = []
    for log in (posts, with_ranges):
        value = flatten(evaluate(run(log, {"filter": {"particles": 50}}), log))["landmark_rmse_m"]
        assert value is not None
        errors.append(value)
    assert errors[0] < 2.0 * errors[1], errors


def test_ranges_in_the_file_are_not_used_and_a_missing_model_is_named(tmp_path: Path) -> None:
    settings = (
        "format_version: 1\nmotion: {model: velocity}\nsensor: {model: bearing, bearing_std_rad: 0.02}\n"
    )
    (tmp_path / "log.yaml").write_text(settings)
    rows = "".join(f"{k},1.0,0.1\n" for k in range(10))
    (tmp_path / "odometry.csv").write_text("stamp_s,speed_m_per_s,yaw_rate_rad_per_s\n" + rows)
    header = "stamp_s,range_m,bearing_rad,landmark_id"
    (tmp_path / "sightings.csv").write_text(f"{header}\n1,5,0.1,a\n2,5,nan,a\n3,-1,0.2,a\n")
    log = load(tmp_path)
    assert np.isnan(log.sightings.range_m).all() and log.sightings.bearing_rad.tolist() == [0.1, 0.2]
    assert any("ranges are not used" in note for note in log.notes)
    (tmp_path / "sightings.csv").write_text("stamp_s,bearing_deg,landmark_id\n1,90,a\n")
    assert load(tmp_path).sightings.bearing_rad[0] == pytest.approx(np.pi / 2)
    (tmp_path / "log.yaml").write_text(settings.replace("model: bearing,", "model: range_bearing,"))
    with pytest.raises(DataError, match=r"range_m is missing.*model: bearing"):
        load(tmp_path)


def test_the_step_interface_takes_bearings_alone() -> None:
    robot = FastSlam({"sensor": {**SENSOR, "bearing_bias_rad": 0.3}, **FEW}, identities="all")
    for k in range(60):
        robot.predict([1.0, 0.1], dt_s=1.0)
        heading = 0.1 * (k + 1)
        x, y = np.sin(heading) / 0.1, (1.0 - np.cos(heading)) / 0.1
        towards = np.arctan2(5.0 - y, 20.0 - x) - heading + 0.3
        robot.update(k + 1.0, bearing_rad=[np.arctan2(np.sin(towards), np.cos(towards))], identity=["mast"])
        if k == 0:
            assert not robot.landmarks.confirmed[0]
    assert robot.landmarks.confirmed[0] and np.hypot(*(robot.landmarks.mean_m[0] - [20.0, 5.0])) < 1.0
    with pytest.raises(DataError, match=r"bearing_rad: got none, but sensor\.model is bearing"):
        robot.update(70.0, range_m=[2.0], identity=["mast"])
    with pytest.raises(DataError, match=r"range_m: got none, but sensor\.model is range_bearing"):
        FastSlam(identities="all").update(1.0, bearing_rad=[2.0], identity=["mast"])


def test_arrays_need_no_ranges() -> None:
    controls = ([0.0, 1.0, 2.0], [[1.0, 0.0]] * 3)
    config = {"sensor": SENSOR}
    log = Log.from_arrays(controls, ([1.0, 2.0], [0.4, 0.5]), identities=["a", "a"], config=config)
    assert np.isnan(log.sightings.range_m).all()
    assert len(run(log, {"filter": {"particles": 5}}).landmarks.ids) == 1


@pytest.mark.slow
def test_bearings_without_names_make_the_same_map(posts: LogType) -> None:
    unknown = {**FEW, "association": {"mode": "unknown"}}
    result = run(posts, unknown)
    metrics = flatten(evaluate(result, posts))
    assert all(metrics[name] == 1.0 for name in ("landmark_recall", "landmark_precision")), metrics
    assert metrics["landmark_duplicates"] == 0
    error_m = metrics["landmark_rmse_m"]
    assert error_m is not None and error_m < 0.3
    assert result.verdict == () and result.steps.matched.sum() > 0.8 * len(posts.sightings.stamp_s)
    again = run(posts, unknown)
    np.testing.assert_array_equal(again.path.T_world_robot, result.path.T_world_robot)


def test_a_filter_without_names_goes_on_from_what_was_saved() -> None:
    def turned(robot: FastSlam, steps: range) -> None:
        for k in steps:
            robot.predict([1.0, 0.1], dt_s=1.0)
            heading = 0.1 * (k + 1)
            x, y = np.sin(heading) / 0.1, (1.0 - np.cos(heading)) / 0.1
            towards = [np.arctan2(b - y, a - x) - heading for a, b in ((12.0, 5.0), (-3.0, 18.0))]
            robot.update(k + 1.0, bearing_rad=np.arctan2(np.sin(towards), np.cos(towards)))

    robot = FastSlam({"sensor": SENSOR, **FEW}, identities="none")
    turned(robot, range(25))
    copy = pickle.loads(pickle.dumps(robot))
    turned(robot, range(25, 50))
    turned(copy, range(25, 50))
    np.testing.assert_array_equal(robot.landmarks.mean_m, copy.landmarks.mean_m)
    assert robot.landmarks.confirmed is not None and robot.landmarks.confirmed.sum() == 2


def test_what_it_cannot_do_is_said_in_one_line(posts: LogType) -> None:
    for layer, message in (
        ({"algorithm": "ekf"}, "algorithm: got ekf"),
        ({"sensor": {"min_range_m": 50.0}}, r"sensor\.min_range_m: got 50, expected at most"),
    ):
        with pytest.raises(FastSlamError, match=message) as caught:
            run(posts, layer)
        assert "\n" not in str(caught.value)
    with pytest.raises(ConfigError, match="got bearing, expected range_bearing"):
        tune(posts)
    assert examine(posts) == () and diagnose(posts).verdicts == ()
    with pytest.raises(ConfigError, match=r"sensor\.model"):
        simulate({"sensor": SENSOR, "scan": {"laser": {}}})

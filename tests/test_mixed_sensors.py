"""Sensors of different kinds on one robot: range and bearing, bearings alone, ranges alone."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cli_runner import fastslam as call
from fastslam import FastSlam, Robot, run
from fastslam.config import Config
from fastslam.datasets import load
from fastslam.datasets.info import describe
from fastslam.datasets.native_write import write_native
from fastslam.errors import ConfigError, DataError
from fastslam.evaluation import evaluate
from fastslam.events import event_lines
from fastslam.examination import examine
from fastslam.live import tell
from fastslam.log import Log
from fastslam.simulation import simulate
from fastslam.window import Window

LASER = {"max_range_m": 5.0, "mounting": {"x_m": 0.2}}
CAMERA = {
    "model": "bearing",
    "bearing_std_rad": 0.01,
    "max_range_m": 15.0,
    "mounting": {"x_m": 0.3, "yaw_rad": 0.1},
}
RADIO = {"model": "range", "range_std_m": 0.1, "max_range_m": 12.0}
WORLD: dict[str, Any] = {"world": {"count": 30, "size_m": [30.0, 24.0]}, "max_duration_s": 60.0}
QUICK = {"filter": {"particles": 30}}


def _log(seed: int = 3, **sensors: Any) -> Log:
    return simulate({**WORLD, "seed": seed, "sensors": {"laser": LASER, **sensors}})


@pytest.fixture(scope="module")
def mixed() -> Log:
    return _log(camera=CAMERA, radio=RADIO)


def _of(log: Log, name: str) -> np.ndarray[Any, Any]:
    assert log.sightings.sensor_index is not None
    return np.array(log.sensor_names)[log.sightings.sensor_index] == name


def test_sightings_have_what_their_sensor_measures_and_nothing_else(mixed: Log, tmp_path: Path) -> None:
    seen = mixed.sightings
    for name, has in (("laser", (True, True)), ("camera", (False, True)), ("radio", (True, False))):
        rows = _of(mixed, name)
        assert rows.sum() > 50
        assert (np.isfinite(seen.range_m[rows]) == has[0]).all()
        assert (np.isfinite(seen.bearing_rad[rows]) == has[1]).all()
    again = load(write_native(mixed, tmp_path / "log"))
    assert again.problems == ()
    for column in ("stamp_s", "range_m", "bearing_rad"):
        np.testing.assert_array_equal(getattr(again.sightings, column), getattr(seen, column))
    np.testing.assert_array_equal(_of(again, "radio"), _of(mixed, "radio"))
    info = describe(again)
    assert info.range_m is not None and np.isfinite([info.range_m.minimum, info.range_m.maximum]).all()
    shown = call("info", str(tmp_path / "log"))
    assert shown.exit_code == 0 and "sightings of sensor camera" in shown.stdout, shown.output
    assert examine(again) == ()


@pytest.mark.parametrize(
    ("mode", "others"),
    [("known", {"camera": CAMERA, "radio": RADIO}), ("unknown", {"camera": CAMERA})],
)
def test_with_a_far_camera_map_and_path_are_better(mode: str, others: dict[str, Any]) -> None:
    scores: dict[str, list[dict[str, float]]] = {"alone": [], "mixed": []}
    for seed in (1, 2, 3, 4):
        for name, sensors in (("alone", {}), ("mixed", others)):
            log = _log(seed, **sensors)
            result = run(log, {**QUICK, "association": {"mode": mode}})
            scores[name].append({k: v for k, v in evaluate(result, log).items() if isinstance(v, float)})
    for metric in ("smoothed_ate_rmse_m", "landmark_rmse_m"):
        alone, mixed = (float(np.mean([one[metric] for one in scores[name]])) for name in scores)
        assert mixed < 0.7 * alone, (mode, metric, alone, mixed)


def test_what_no_landmark_explains_is_left_out_and_counted(mixed: Log) -> None:
    result = run(mixed, QUICK)
    assert result.counts["sightings_left_out"] == result.steps.ignored.sum() > 0
    assert all(count == 0 for reason, count in result.counts.items() if reason != "sightings_left_out")
    # All are sightings of landmarks that the laser has not come near to yet.
    assert len(result.landmarks.ids) <= 30
    assert evaluate(result, mixed)["landmark_precision"] == 1.0
    assert result.verdict == () and result.warnings == ()


LOG_YAML = """\
format_version: 1
motion: {model: velocity, speed_std_m_per_s: 0.05, yaw_rate_std_rad_per_s: 0.02}
sensors:
  laser: {range_std_m: 0.1, bearing_std_rad: 0.02}
  camera: {model: bearing, bearing_std_rad: 0.01}
  radio: {model: range, range_std_m: 0.2}
"""
HEADER = "stamp_s,sensor,range_m,bearing_rad,landmark_id\n0.1,laser,2,0.1,oak\n"


def _written(folder: Path, sightings: str, settings: str = LOG_YAML) -> Path:
    folder.mkdir()
    (folder / "log.yaml").write_text(settings)
    rows = "".join(f"{0.1 * k:.1f},1.0,0.1\n" for k in range(20))
    (folder / "odometry.csv").write_text("stamp_s,speed_m_per_s,yaw_rate_rad_per_s\n" + rows)
    (folder / "sightings.csv").write_text(sightings)
    return folder


@pytest.mark.parametrize(
    ("row", "message"),
    [
        (
            "0.2,radio,2.5,0.3,oak",
            r"sightings.csv:3: bearing_rad: got 0.3, expected an empty cell: sensor radio",
        ),
        (
            "0.2,camera,2.5,0.3,oak",
            r"sightings.csv:3: range_m: got 2.5, expected an empty cell: sensor camera",
        ),
        ("0.2,radio,,,oak", r"sightings.csv:3: range_m: got nothing, expected a number: sensor radio"),
        ("0.2,camera,,,oak", r"sightings.csv:3: bearing_rad: got nothing, expected a number: sensor camera"),
        ("0.2,laser,2.5,,oak", r"sightings.csv:3: bearing_rad: got nothing, expected a number: sensor laser"),
        ("0.2,camera,,near,oak", r"sightings.csv:3: bearing_rad"),
        ("0.2,,2.5,0.1,oak", r"sightings.csv:3: sensor: got nothing, expected one of camera, laser, radio"),
    ],
)
def test_rows_that_do_not_fit_their_sensor_are_one_line_with_their_place(
    row: str, message: str, tmp_path: Path
) -> None:
    folder = _written(tmp_path / "log", HEADER + row + "\n")
    with pytest.raises(DataError, match=message) as refused:
        load(folder)
    assert "\n" not in str(refused.value)


def test_a_reading_that_failed_is_dropped_and_counted_as_in_any_log(tmp_path: Path) -> None:
    rows = "0.2,camera,,nan,oak\n0.2,radio,nan,,oak\n0.3,camera,nan,0.2,oak\n0.3,radio,2.0,,oak\n"
    log = load(_written(tmp_path / "log", HEADER + rows))
    assert len(log.sightings.stamp_s) == 3
    (problem,) = log.problems
    assert problem.count == 2 and "dropped" in problem.message


def test_variances_of_their_own_are_those_of_what_is_measured(tmp_path: Path) -> None:
    names = "range_variance_m2,range_bearing_covariance_m_rad,bearing_variance_rad2"
    rows = (
        f"stamp_s,sensor,range_m,bearing_rad,landmark_id,{names}\n0.1,laser,2,0.1,oak,,,\n"
        "0.2,camera,,0.1,oak,,,1e-4\n0.3,radio,2.1,,oak,0.04,,\n"
    )
    log = load(_written(tmp_path / "log", rows))
    covariance = log.sightings.covariance
    assert covariance is not None and np.isnan(covariance[0]).all()
    np.testing.assert_array_equal(covariance[1:], [[1.0, 0.0, 1e-4], [0.04, 0.0, 1.0]])
    assert run(log, QUICK).counts["sightings_bad_covariance"] == 0
    wrong = rows.replace("1e-4", "-1e-4")
    with pytest.raises(DataError, match=r"sightings.csv:3: covariance"):
        load(_written(tmp_path / "wrong", wrong))


def test_sensors_that_cannot_be_used_together_are_refused_in_one_line() -> None:
    for sensors, message in (
        (
            {"camera": CAMERA, "radio": RADIO},
            r"sensors: got bearing, range, expected one of range_bearing among them",
        ),
        ({"laser": LASER, "mine": {"model": "own"}}, r"sensors.mine.model: got own, expected range_bearing"),
    ):
        with pytest.raises(ConfigError, match=message) as refused:
            FastSlam({"sensors": sensors})
        assert "\n" not in str(refused.value)


CONFIG: dict[str, Any] = {
    "sensors": {"laser": {}, "camera": {"model": "bearing"}, "radio": {"model": "range"}}
}


def test_a_filter_takes_what_each_sensor_measures() -> None:
    filter = FastSlam(CONFIG, identities="all")
    seen: dict[str, Any] = {"identity": ["oak"]}
    filter.update(0.0, range_m=[5.0], bearing_rad=[0.4], sensor="laser", **seen)
    before = np.trace(filter.landmarks.covariance_m2[0])
    for k in range(1, 6):
        info = filter.update(0.1 * k, bearing_rad=[0.4], sensor="camera", **seen)
        assert (info.sightings, info.matched, info.ignored) == (1, 1, 0)
        filter.update(0.1 * k, range_m=[5.0], sensor="radio", **seen)
    assert np.trace(filter.landmarks.covariance_m2[0]) < 0.3 * before
    info = filter.update(1.0, bearing_rad=[1.0], identity=["elm"], sensor="camera")
    assert (info.ignored, len(filter.landmarks.ids)) == (1, 1)
    # What a sensor does not measure counts for nothing.
    twins = [FastSlam(CONFIG, identities="all") for _ in range(2)]
    for twin, extra in zip(twins, ({}, {"range_m": [77.0]}), strict=True):
        twin.update(0.0, range_m=[5.0], bearing_rad=[0.4], sensor="laser", **seen)
        twin.update(0.1, bearing_rad=[0.41], sensor="camera", **seen, **extra)
    assert twins[0].landmarks.mean_m.tolist() == twins[1].landmarks.mean_m.tolist()
    with pytest.raises(DataError, match=r"bearing_rad: got none, but sensors.camera.model is bearing"):
        filter.update(2.0, range_m=[3.0], identity=["oak"], sensor="camera")
    with pytest.raises(DataError, match=r"bearing_rad: got none, but sensors.laser.model is range_bearing"):
        filter.update(2.0, range_m=[3.0], identity=["oak"], sensor="laser")


def test_a_robot_and_live_events_give_the_numbers_of_a_run(mixed: Log) -> None:
    quick = {"filter": {"particles": 30, "rejuvenation": {"delay_scans": 10}}}
    config = Config.resolve(mixed.config, quick)
    expected = run(mixed, quick)
    robot = Robot(config, identities="all", window=Window(late_s=0.5, wait_s=10.0, gap_s=60.0))
    robot.keep_result()
    lines = list(event_lines(mixed, config))
    assert any("null" in line for line in lines) and not any("NaN" in line for line in lines)
    for line in lines:
        tell(robot, line)
    robot.end()
    result, log = robot.result()
    assert len(log.sightings.stamp_s) == len(mixed.sightings.stamp_s)
    np.testing.assert_array_equal(np.isnan(log.sightings.range_m), np.isnan(mixed.sightings.range_m))
    places = [
        dict(zip(one.landmarks.ids, one.landmarks.mean_m.tolist(), strict=True)) for one in (result, expected)
    ]
    assert places[0].keys() == places[1].keys()
    # Names are numbered as they come, which changes no estimate.
    assert max(abs(np.array(places[0][name]) - places[1][name]).max() for name in places[0]) < 1e-9
    for wrong in ("[null, null]", "[null]", "[null, 0.1, 3, 4]"):
        with pytest.raises(DataError, match="see: got"):
            tell(Robot(config), f'{{"t": 0.0, "see": [{wrong}], "sensor": "camera"}}')


def test_a_log_of_arrays_says_nothing_of_what_is_not_measured() -> None:
    controls = ([0.0, 1.0, 2.0], [[1.0, 0.0]] * 3)
    seen = ([0.1, 0.2, 0.3], [4.0, None, 4.1], [0.3, 0.31, float("nan")])
    config = {"motion": {"model": "velocity"}, **CONFIG}
    log = Log.from_arrays(
        controls, seen, identities=["oak"] * 3, sensors=["laser", "camera", "radio"], config=config
    )
    assert np.isnan(log.sightings.range_m).tolist() == [False, True, False]
    assert len(run(log, QUICK).landmarks.ids) == 1
    seen = ([0.1, 0.2, 0.3], [4.0, 4.2, 4.1], [0.3, 0.31, float("nan")])
    with pytest.raises(DataError, match=r"bearing_rad: row 1 \(radio\) is 0.31, expected NaN"):
        Log.from_arrays(controls, seen, sensors=["laser", "radio", "radio"], config=config)

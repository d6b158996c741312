"""Ranges alone: from files and arrays to a map, and what cannot be done with them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from fastslam import FastSlam, Log, run
from fastslam.calibration import calibrate
from fastslam.datasets import load, write_native
from fastslam.datasets.info import describe
from fastslam.errors import ConfigError, DataError
from fastslam.evaluation import evaluate
from fastslam.evaluation.runs import flatten
from fastslam.examination.registry import examine
from fastslam.log import Log as LogType
from fastslam.simulation import simulate
from fastslam.tuning.doctor import diagnose
from fastslam.tuning.session import tune

WORLD = {"count": 6}
SENSOR = {"model": "range", "range_std_m": 0.2, "max_range_m": 100.0}


SETTINGS = "format_version: 1\nmotion: {model: velocity}\nsensor: {model: range, range_std_m: 0.2}\n"


def begin_log(folder: Path) -> None:
    """A log of ten seconds that lacks its sightings."""
    (folder / "log.yaml").write_text(SETTINGS)
    rows = "".join(f"{k},1.0,0.1\n" for k in range(10))
    (folder / "odometry.csv").write_text("stamp_s,speed_m_per_s,yaw_rate_rad_per_s\n" + rows)


@pytest.fixture(scope="module")
def beacons() -> LogType:
    return simulate({"seed": 3, "world": WORLD, "sensor": SENSOR, "scan": {"period_s": 1.0}}, name="beacons")


def test_a_native_log_without_bearings_is_written_read_and_mapped(beacons: LogType, tmp_path: Path) -> None:
    write_native(beacons, tmp_path / "log")
    header = (tmp_path / "log" / "sightings.csv").read_text().splitlines()[0]
    assert header == "stamp_s,range_m,landmark_id"
    log = load(tmp_path / "log")
    assert np.isnan(log.sightings.bearing_rad).all() and len(log.sightings.range_m) > 200
    assert describe(log).bearing_rad is None and describe(log).range_m is not None
    result = run(log, {"filter": {"particles": 30}})
    metrics = flatten(evaluate(result, log))
    assert metrics["landmark_matched"] == 6 and metrics["landmark_duplicates"] == 0
    for name, most in (("landmark_rmse_m", 0.5), ("smoothed_ate_rmse_m", 0.3)):
        value = metrics[name]
        assert value is not None and value < most, name
    assert result.verdict == ()
    again = run(beacons, {"filter": {"particles": 30}})
    np.testing.assert_array_equal(again.trajectory.T_world_robot, result.trajectory.T_world_robot)


def test_the_variance_of_ranges_alone_is_enough(tmp_path: Path) -> None:
    begin_log(tmp_path)
    header = "stamp_s,range_m,landmark_id,range_variance_m2"
    (tmp_path / "sightings.csv").write_text(f"{header}\n1,5,a,0.5\n2,5,a,\n3,5,a,0.001\n")
    log = load(tmp_path)
    assert log.sightings.covariance is not None
    np.testing.assert_array_equal(log.sightings.covariance[:, 0], [0.5, np.nan, 0.001])
    # The same numbers with all three columns are the same sightings to a run.
    wide = f"{header},range_bearing_covariance_m_rad,bearing_variance_rad2"
    (tmp_path / "sightings.csv").write_text(f"{wide}\n1,5,a,0.5,0,0.01\n2,5,a,,,\n3,5,a,0.001,0,0.01\n")
    few = {"filter": {"particles": 20}}
    one, three = run(log, few), run(load(tmp_path), few)
    np.testing.assert_array_equal(one.landmarks.covariance_m2, three.landmarks.covariance_m2)
    again = load(write_native(log, tmp_path / "again")).sightings.covariance
    np.testing.assert_array_equal(again, log.sightings.covariance)
    for cell in ("-1", "0", "inf"):
        (tmp_path / "sightings.csv").write_text(f"{header}\n1,5,a,0.5\n2,5,a,{cell}\n")
        with pytest.raises(
            DataError, match=r"sightings\.csv:3: range_variance_m2: got .*, expected a positive"
        ):
            load(tmp_path)


def test_a_ruined_run_and_one_that_places_nothing_get_a_verdict(beacons: LogType) -> None:
    settings = {"filter": {"particles": 30}, "sensor": {"range_std_m": 0.02, "range_scale_std": 0.0}}
    ruined = replace(beacons.sightings, range_m=beacons.sightings.range_m**1.3)
    result = run(replace(beacons, sightings=ruined), settings)
    assert any("innovations" in sentence or "lost" in sentence for sentence in result.verdict), result.verdict
    still = replace(beacons, controls=replace(beacons.controls, values=0.0 * beacons.controls.values))
    near = replace(beacons.sightings, range_m=0.0 * beacons.sightings.range_m + 9.0)
    nowhere = run(replace(still, sightings=near), {"filter": {"particles": 30}})
    assert nowhere.steps.matched.sum() == 0
    assert [sentence[:21] for sentence in nowhere.verdict] == ["no landmark was placed"[:21]]


def test_bearings_in_the_file_are_not_used_and_a_missing_model_is_named(tmp_path: Path) -> None:
    begin_log(tmp_path)
    header = "stamp_s,range_m,bearing_rad,landmark_id"
    (tmp_path / "sightings.csv").write_text(f"{header}\n1,5,0.1,a\n2,nan,0.1,a\n")
    log = load(tmp_path)
    assert np.isnan(log.sightings.bearing_rad).all() and len(log.sightings.range_m) == 1
    assert any("bearings are not used" in note for note in log.notes)
    (tmp_path / "sightings.csv").write_text("stamp_s,range_m,landmark_id\n1,5,a\n")
    assert len(load(tmp_path).sightings.range_m) == 1
    (tmp_path / "log.yaml").write_text(SETTINGS.replace("model: range,", "model: range_bearing,"))
    (tmp_path / "sightings.csv").write_text(f"{header}\n1,5,nan,a\n")
    with pytest.raises(DataError, match="no usable sighting"):
        load(tmp_path)
    (tmp_path / "sightings.csv").write_text("stamp_s,range_m,landmark_id\n1,5,a\n")
    with pytest.raises(DataError, match=r"bearing_rad is missing.*model: range"):
        load(tmp_path)


def test_the_step_interface_takes_ranges_alone() -> None:
    robot = FastSlam({"sensor": SENSOR, "filter": {"particles": 20}}, identities="all")
    for k in range(60):
        robot.predict([1.0, 0.1], dt_s=1.0)
        x, y = np.sin(0.1 * (k + 1)) / 0.1, (1.0 - np.cos(0.1 * (k + 1))) / 0.1
        robot.update(k + 1.0, range_m=[np.hypot(20.0 - x, 5.0 - y)], identity=["mast"])
    assert np.hypot(*(robot.landmarks.mean_m[0] - [20.0, 5.0])) < 1.0
    with pytest.raises(DataError, match="bearing_rad: got none"):
        FastSlam(identities="all").update(1.0, range_m=[2.0], identity=["mast"])


def test_arrays_need_no_bearings() -> None:
    controls = ([0.0, 1.0, 2.0], [[1.0, 0.0]] * 3)
    config = {"sensor": SENSOR}
    log = Log.from_arrays(controls, ([1.0, 2.0], [4.0, 3.5]), identities=["a", "a"], config=config)
    assert np.isnan(log.sightings.bearing_rad).all()
    assert len(run(log, {"filter": {"particles": 5}}).landmarks.ids) == 1
    with pytest.raises(DataError, match="bearing_rad"):
        Log.from_arrays(controls, ([1.0, 2.0], [4.0, 3.5]))


def test_what_needs_bearings_or_names_says_so_in_one_line(beacons: LogType) -> None:
    for layer, message in (
        ({"association": {"mode": "unknown"}}, "association.mode: got unknown"),
        ({"algorithm": "ekf"}, "algorithm: got ekf"),
        ({"filter": {"adaptive": {"number": "kld"}}}, "filter.adaptive.number: got kld"),
    ):
        with pytest.raises((ConfigError, DataError), match=message) as caught:
            run(beacons, layer)
        assert "\n" not in str(caught.value)
    for what in (calibrate, tune):
        with pytest.raises(ConfigError, match="needs bearings"):
            what(beacons)
    assert examine(beacons) == () and diagnose(beacons).verdicts == ()
    with pytest.raises(ConfigError, match=r"sensor\.model"):
        simulate({"sensor": SENSOR, "scan": {"laser": {}}})


def test_plaza_is_read_as_documented(data_dir: Path) -> None:
    log = load(data_dir / "plaza1")
    assert log.format == "plaza" and log.identity_names == ("0", "1", "5", "6")
    assert len(log.controls.stamp_s) == 9657 and len(log.sightings.stamp_s) == 3529
    assert (np.diff(log.sightings.stamp_s) >= 0).all() and np.isnan(log.sightings.bearing_rad).all()
    assert log.truth_landmarks is not None and set(log.truth_landmarks.names) == set(log.identity_names)
    assert log.truth_trajectory is not None and len(log.truth_trajectory.stamp_s) == 9658

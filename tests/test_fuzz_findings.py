"""What fuzzing found, one by one: each was a crash, a traceback or a number that is none."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.io
from fastslam import FastSlam
from fastslam.config import Config, parse_assignments
from fastslam.datasets import load
from fastslam.datasets.matlab import read_matrices
from fastslam.datasets.text import whole_numbers
from fastslam.errors import ConfigError, DataError, NumericalError
from fastslam.log import Log
from fastslam.simulation import simulate
from test_csv_dialects import YAML, folder_with
from test_datasets_formats import car_park, freiburg, lost_in_the_woods, utias

CONTROLS = ([0.0, 0.1], [[1.0, 0.0], [1.0, 0.0]])
ARRAYS: dict[str, tuple[Any, Any, Any, str]] = {
    "no rows": (([], []), ([], [], []), None, "controls: values: got an array of shape"),
    "no columns": (([0.0], [[]]), ([], [], []), None, "got 0 columns, expected 2 or 3"),
    "a table too many": (
        CONTROLS,
        ([], [], [], []),
        None,
        "got 4 arrays, expected stamp_s, range_m, bearing",
    ),
    "a table too few": (([0.0],), ([], [], []), None, "got 1 arrays, expected stamp_s, values"),
    "no tuple": (3.0, ([], [], []), None, "got 3.0, expected"),
    "no floats": (([10**400], [[1, 0]]), ([], [], []), None, "controls: stamp_s: expected numbers"),
    "complex": (([0.0], np.array([[1j, 0]])), ([], [], []), None, "controls: values: expected numbers"),
    "dates": ((np.array(["2026-11-28"], "M8[s]"), [[1, 0]]), ([], [], []), None, "stamp_s: expected numbers"),
    "names that are none": (
        CONTROLS,
        ([0.1], [1.0], [0.0]),
        True,
        "identities: got True, expected a sequence",
    ),
    "stamps in nanoseconds": (([1.7e18], [[1, 0]]), ([], [], []), None, "row 0: the stamp .* nanoseconds"),
    "bearings in degrees": (CONTROLS, ([0.1], [1.0], [45.0]), None, "are these degrees"),
}


@pytest.mark.parametrize("case", ARRAYS)
def test_arrays_that_make_no_log(case: str) -> None:
    controls, sightings, identities, says = ARRAYS[case]
    with pytest.raises(DataError, match=says) as raised:
        Log.from_arrays(controls, sightings, identities=identities)
    assert "\n" not in str(raised.value)


def test_words_for_nobody_are_no_names_in_arrays() -> None:
    seen = ([0.1] * 4, [1.0] * 4, [0.0, 0.1, 0.2, 0.3])
    log = Log.from_arrays(CONTROLS, seen, identities=[-1, "None", float("nan"), 7])
    assert log.identity_names == ("7",) and log.sightings.identity.tolist() == [-1, -1, -1, 0]


@pytest.mark.parametrize(
    "value", [np.array([1 + 1j]), np.array(["2026-11-28"], "M8[s]"), [10**400], [[1.0], 2.0]]
)
def test_live_numbers_that_are_none(value: Any) -> None:
    robot = FastSlam()
    with pytest.raises(DataError, match=r"range_m: expected numbers, got|got shape"):
        robot.update(0.1, range_m=value, bearing_rad=[0.1])
    with pytest.raises(DataError, match=r"control: expected numbers"):
        robot.predict(value, dt_s=0.1)


def test_a_scan_that_fails_leaves_the_filter_as_it_was() -> None:
    """Once the map held landmarks of the scan that failed, and their names were lost."""
    settings = {"association": {"signatures": {}}, "filter": {"particles": 7}}
    robot = FastSlam(settings)
    robot.step([0.5, 0.1], dt_s=0.1, range_m=[5.0], bearing_rad=[0.1], identity=["oak"])
    before = robot.pose, robot.landmarks
    with pytest.raises(NumericalError):
        robot.update(
            5.0, range_m=[4.0, 4.0], bearing_rad=[0.1, 0.1], identity=["fir", "fir"], signature=[1.0, 1e154]
        )
    for old, new in zip(before[0], robot.pose, strict=True):
        np.testing.assert_array_equal(old, new)
    np.testing.assert_array_equal(before[1].covariance_m2, robot.landmarks.covariance_m2)
    assert robot.landmarks.ids == ("oak",)
    # Time has not passed either.
    robot.update(0.2, range_m=[4.0], bearing_rad=[0.1], identity=["fir"])
    robot.step([0.5, 0.1], dt_s=0.1, range_m=[4.0], bearing_rad=[0.4], identity=["ash"])
    assert set(robot.landmarks.ids) == {"oak", "fir", "ash"} and np.isfinite(robot.pose[0]).all()


@pytest.mark.parametrize(
    ("key", "value"),
    [("sensor.mounting.x_m", 1.8e19), ("sensor.max_range_m", 2e7), ("sensor.range_std_m", 1e-13)],
)
def test_lengths_that_no_sensor_has(key: str, value: float) -> None:
    """They gave landmarks that were no numbers, or seconds of computing, without a word."""
    with pytest.raises(ConfigError, match=rf"^{key}: got .*, expected a finite number"):
        FastSlam(parse_assignments([f"{key}={value!r}"]))


@pytest.mark.parametrize("model", ["velocity", "ackermann"])
@pytest.mark.parametrize("algorithm", ["fastslam1", "fastslam2", "ekf"])
def test_a_control_of_no_time_at_all(model: str, algorithm: str) -> None:
    """White noise over 1e-310 s had a standard deviation whose square is infinite."""
    robot = FastSlam({"algorithm": algorithm, "motion": {"model": model}, "filter": {"particles": 5}})
    for dt_s in (1e-310, 5e-324, 1e-200, 0.0):
        robot.step([0.5, 0.4], dt_s=dt_s, range_m=[4.0], bearing_rad=[0.4])
    pose, covariance = robot.pose
    np.testing.assert_allclose(pose, 0.0, atol=1e-3)
    assert np.isfinite(covariance).all()


def test_settings_that_are_no_settings() -> None:
    for value in (range(3), np.zeros((2, 2)), {1, 2}, b"x"):
        with pytest.raises(
            ConfigError, match=r"filter\.particles: expected a number, text or list"
        ) as raised:
            Config.resolve({"filter": {"particles": value}})
        assert "\n" not in str(raised.value)
    with pytest.raises(ConfigError) as raised:
        parse_assignments(["\r\n"])
    assert "\n" not in str(raised.value) and "expected key=value" in str(raised.value)
    with pytest.raises(ConfigError, match=r"scan\.laser\.angle_step_rad: got .*, expected 0.00001 to π"):
        simulate({"scan": {"laser": {"angle_step_rad": 2.0**31}}})


@pytest.mark.parametrize(
    ("yaml", "says"),
    [
        (YAML + "association: 3\n", r"log\.yaml:4: association: got 3, expected a section"),
        (
            YAML.replace("range_std_m: 0.1", "0.5: 1"),
            r"log\.yaml.*: sensor: got the key 0.5, expected a name",
        ),
    ],
)
def test_sections_of_a_log_that_are_none(tmp_path: Path, yaml: str, says: str) -> None:
    with pytest.raises(DataError, match=says):
        load(folder_with(tmp_path / "log", yaml=yaml))


@pytest.mark.parametrize(
    ("radius", "says"),
    [
        ("1.7e+308", r"log\.yaml:4: wheels\.radius_m: got 1\.7e\+308, expected a positive number \("),
        ("1000", r"odometry\.csv: the row at [01] s makes a motion too large to compute with"),
    ],
)
@pytest.mark.filterwarnings("error")
def test_wheels_that_no_robot_has(tmp_path: Path, radius: str, says: str) -> None:
    wheels = f"wheels: {{track_width_m: 1.0e-12, radius_m: {radius}, ticks_per_turn: 1.0e-5}}\n"
    folder = folder_with(tmp_path / "log", yaml=YAML + wheels)
    ticks = "stamp_s,left_ticks,right_ticks\n0,0,0\n1,1e300,0\n2,0,1e300\n3,1e300,0\n"
    (folder / "odometry.csv").write_text(ticks)
    with pytest.raises(DataError, match=says):
        load(folder)


def test_any_tag_of_a_matlab_file(tmp_path: Path) -> None:
    """SciPy takes types of elements at their word and reads beyond its tables: the process ended."""
    path = tmp_path / "one.mat"
    scipy.io.savemat(path, {"A": np.arange(6.0).reshape(2, 3)})
    whole = path.read_bytes()
    read = refused = 0
    for at in range(128, len(whole), 4):
        for word in (0, 3, 20, 200, 2**16 + 60, 2**31, 2**32 - 1):
            path.write_bytes(whole[:at] + struct.pack("<I", word) + whole[at + 4 :])
            try:
                read += "A" in read_matrices(path, ["A"])
            except DataError as error:
                assert "damaged or cut off" in str(error)
                refused += 1
    assert read > 20 and refused > 20
    for packed in (True, False):
        scipy.io.savemat(path, {"A": np.arange(6.0).reshape(2, 3), "B": "text"}, do_compression=packed)
        assert read_matrices(path, ["A"])["A"].tolist() == [[0, 1, 2], [3, 4, 5]]
        with pytest.raises(DataError, match="expected numbers"):
            read_matrices(path, ["B"])


def test_true_landmarks_are_finite(tmp_path: Path) -> None:
    folder = car_park(tmp_path)
    (folder / "derived_posts.csv").write_text("post,east_m,north_m\n1,2.5,-3.5\n2,inf,0\n")
    with pytest.raises(DataError, match=r"derived_posts\.csv:3: east_m: got inf, expected a finite number"):
        load(folder)
    barcodes = utias(tmp_path) / "Landmark_Groundtruth.dat"
    barcodes.write_text("11 1.0 2.0 0.1 0.1\n17 nan 4.0 0.1 0.1\n")
    with pytest.raises(DataError, match=r"Landmark_Groundtruth\.dat:2: got NaN or infinite values"):
        load(barcodes.parent, robot=2)
    file = lost_in_the_woods(tmp_path / "woods") / "dataset2.mat"
    data = {name: value for name, value in scipy.io.loadmat(file).items() if not name.startswith("__")}
    scipy.io.savemat(file, {**data, "l": np.array([[1.0, np.inf], [3.0, 4.0]])}, do_compression=True)
    with pytest.raises(DataError, match="variable l: got NaN or infinite positions"):
        load(file.parent)


def test_numbers_of_a_graph_whose_squares_are_none(tmp_path: Path) -> None:
    path = tmp_path / "small.g2o"
    path.write_text("EDGE_SE2 0 1 1 0 0 100 0 0 100 0 400\nEDGE_SE2_XY 1 7 3 4e300 100 0 100\n")
    with pytest.raises(DataError, match=r"small\.g2o:2: EDGE_SE2_XY: got '4e300', expected at most 1e\+30"):
        load(path)


def test_true_landmarks_of_the_freiburg_course_are_finite(tmp_path: Path) -> None:
    folder = freiburg(tmp_path)
    (folder / "world.dat").write_text("4 1.5 nan\n")
    with pytest.raises(DataError, match=r"world\.dat:1: got NaN or infinite values"):
        load(folder)


def test_messages_have_an_end() -> None:
    with pytest.raises(ConfigError) as raised:
        Config.resolve({"filter": {"adaptive": {"delta": "9" * 10_000}}})
    assert len(str(raised.value)) == 1000 and str(raised.value).endswith("...")


def test_a_whole_number_that_no_float_holds(tmp_path: Path) -> None:
    path = tmp_path / "table.txt"
    path.write_text("1\n1e300\n")
    with pytest.raises(DataError, match=r"table\.txt:2: got '1e\+300', expected a whole number"):
        whole_numbers(path, np.array([1.0, 1e300]))


def test_an_array_without_dimensions_is_no_sequence() -> None:
    with pytest.raises(DataError, match="expected a sequence"):
        Log.from_arrays(np.array(1.0), ([0.0], [1.0], [0.1]))

"""The native log: what is written reads back, and every fault is reported with its place."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from fastslam.datasets import load, write_native
from fastslam.datasets.native_settings import REAR_AXLE
from fastslam.datasets.native_sightings import COVARIANCE_COLUMNS
from fastslam.errors import DataError
from small_log import make_small_log

YAML = """\
format_version: 1
name: yard
motion: {model: velocity, speed_std_m_per_s: 0.1, yaw_rate_std_rad_per_s: 5e-2}
sensor: {model: range_bearing, range_std_m: 1e-1, bearing_std_rad: 0.02}
"""
ODOMETRY = "stamp_s,speed_m_per_s,yaw_rate_rad_per_s\n0.0,1.0,0.1\n0.5,1.0,-0.1\n1.0,0.0,0.0\n"
SIGHTINGS = "stamp_s,range_m,bearing_rad,landmark_id,class\n0.25,2.0,0.5,007,cone\n0.25,3.0,-0.5,,\n"
DOCS = Path(__file__).resolve().parents[1] / "docs" / "native-log-format.md"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A small native log without a fault."""
    path = tmp_path / "yard"
    path.mkdir()
    (path / "log.yaml").write_text(YAML)
    (path / "odometry.csv").write_text(ODOMETRY)
    (path / "sightings.csv").write_text(SIGHTINGS)
    return path


def problem_counts(folder: Path) -> dict[str, int]:
    return {problem.message: problem.count for problem in load(folder).problems}


def test_small_log_is_read_as_written(folder: Path) -> None:
    log = load(folder)
    assert (log.name, log.format) == ("yard", "native")
    np.testing.assert_array_equal(log.controls.stamp_s, [0.0, 0.5, 1.0])
    np.testing.assert_array_equal(log.controls.values, [[1.0, 0.1], [1.0, -0.1], [0.0, 0.0]])
    assert log.identity_names == ("007",)
    assert log.class_names == ("cone",)
    np.testing.assert_array_equal(log.sightings.identity, [0, -1])
    np.testing.assert_array_equal(log.sightings.class_index, [0, -1])
    assert np.isnan(log.sightings.signature).all()
    assert log.config["motion"]["yaw_rate_std_rad_per_s"] == 0.05
    assert log.problems == ()


def test_path_of_the_yaml_file_means_its_folder(folder: Path) -> None:
    np.testing.assert_array_equal(load(folder / "log.yaml").sightings.range_m, [2.0, 3.0])


def test_byte_order_mark_carriage_returns_and_column_order_do_not_matter(folder: Path) -> None:
    text = "\ufeffbearing_rad, stamp_s ,range_m\r\n0.5,0.25,2.0\r\n\r\n"
    (folder / "sightings.csv").write_bytes(text.encode())
    log = load(folder)
    np.testing.assert_array_equal(log.sightings.bearing_rad, [0.5])
    np.testing.assert_array_equal(log.sightings.range_m, [2.0])
    assert log.problems == ()


FAULTS = [
    # file, content (None: the file is missing), pattern of the message
    ("log.yaml", None, r"yard: the file log\.yaml of a native log is missing"),
    ("odometry.csv", None, r"the file odometry\.csv of a native log is missing"),
    ("sightings.csv", None, r"the file sightings\.csv of a native log is missing"),
    ("log.yaml", "", r"log\.yaml: got no settings"),
    ("log.yaml", "a: 1\nb: c: 2\n", r"log\.yaml:2: is not valid YAML"),
    ("log.yaml", YAML + "sensro: 1\n", r"unknown key sensro, did you mean sensor\?"),
    ("log.yaml", YAML.replace("version: 1", "version: 2"), r"format_version: got 2, expected 1"),
    ("log.yaml", YAML.replace("velocity", "velocty"), r"motion\.model: got velocty, expected velocity or"),
    ("log.yaml", YAML.replace("range_bearing", "sonar"), r"sensor\.model: got sonar, expected range_bearing"),
    (
        "log.yaml",
        YAML.replace("motion: {", "motion: [{").replace("e-2}", "e-2}]"),
        r"motion: got .*, expected a section",
    ),
    ("log.yaml", "format_version: 1\n", r"log\.yaml: sensor is missing: add sensor: \{model: range_bearing,"),
    ("log.yaml", YAML + "truth_landmarks_complete: 3\n", r"expected true or false"),
    (
        "log.yaml",
        YAML.replace("velocity", "ackermann"),
        r"fits motion\.model velocity, but .* says ackermann",
    ),
    ("log.yaml", YAML.replace("velocity", "odometry"), r"odometry\.csv:1: .*expected stamp_s,dx_m,dy_m,"),
    ("odometry.csv", "", r"odometry\.csv:1: is empty, expected a header line"),
    ("odometry.csv", ODOMETRY.split("\n")[0] + "\n", r"odometry\.csv:1: holds a header and no rows"),
    (
        "odometry.csv",
        ODOMETRY.replace(",1.0,0.1", ",fast,0.1"),
        r"odometry\.csv:2: speed_m_per_s: got 'fast'",
    ),
    ("odometry.csv", ODOMETRY.replace(",1.0,0.1", ",1_0,0.1"), r"odometry\.csv:2: speed_m_per_s: got '1_0'"),
    ("odometry.csv", ODOMETRY.replace(",1.0,0.1", ",,0.1"), r"odometry\.csv:2: speed_m_per_s: got ''"),
    ("odometry.csv", ODOMETRY.replace(",1.0,0.1", ",1.0"), r"odometry\.csv:2: got 2 columns, expected 3$"),
    ("odometry.csv", ODOMETRY[:-5], r"odometry\.csv:4: got 2 columns, expected 3 \(the last line .* cut off"),
    ("odometry.csv", ODOMETRY.replace("speed_m_per_s", "stamp_s"), r"column stamp_s appears more than once"),
    (
        "odometry.csv",
        ODOMETRY.replace("0.0,1.0,0.1", 'a"b",1,"2'),
        r"odometry\.csv:\d: is not well-formed CSV",
    ),
    (
        "odometry.csv",
        "stamp_s,speed_m_per_s,yaw_rate_rad_per_s\n0,nan,0\n",
        r"no usable odometry row is left",
    ),
    ("sightings.csv", SIGHTINGS.replace("landmark_id", "landmarkid"), r"did you mean landmark_id\?"),
    (
        "sightings.csv",
        "stamp_s,range_m\n0,1\n",
        r"column bearing_rad is missing: got stamp_s,range_m, expected",
    ),
    ("sightings.csv", "stamp_s,range_m,bearing_rad\n0,-1,0\n", r"no usable sighting is left of 1"),
    ("sightings.csv", "stamp_s,range_m,bearing_rad\n0,1,45\n", r"expected radians, are these degrees\?"),
    (
        "sightings.csv",
        SIGHTINGS.replace("0.25,3.0", "0.25,x"),
        r"sightings\.csv:3: range_m: got 'x', expected a number",
    ),
    (
        "truth_landmarks.csv",
        "id,x_m,y_m\na,1,2\na,1,2\n",
        r"truth_landmarks\.csv:3: id 'a' is empty or appears twice",
    ),
    ("truth_landmarks.csv", "id,x_m,y_m\na,1,nan\n", r"truth_landmarks\.csv:2: y_m: got nan"),
    ("truth_landmarks.csv", "id,x_rad,y_m\na,1,2\n", r"column x_rad: got the unit rad, expected m"),
    ("truth_trajectory.tum", "0 1 2 0 0 0 0\n", r"truth_trajectory\.tum:1: got 7 columns, expected 8"),
    ("truth_trajectory.tum", "0 1 2 0 0 0 0 one\n", r"truth_trajectory\.tum:1: column 8: got 'one'"),
    ("truth_trajectory.tum", "#\n1 0 0 0 0 0 0 1\n\n1 0 0 0 0 0 0 1\n", r"tum:4: the stamp is not later"),
    ("truth_trajectory.tum", "0 0 0 0 0 0 0 1\n1 0 0 0 0 0 0 0\n", r"1 of 2 quaternions are zero"),
    ("truth_trajectory.tum", "# nothing\n", r"truth_trajectory\.tum: holds no rows of data"),
    ("truth_trajectory.tum", "0 nan 0 0 0 0 0 1\n", r"holds no pose without NaN"),
    ("position_fixes.csv", "stamp_s,x_m,y_m\n0,inf,0\n", r"position_fixes\.csv:2: x_m: got inf"),
]


@pytest.mark.parametrize(("name", "content", "pattern"), FAULTS)
def test_fault_is_reported_with_its_place(folder: Path, name: str, content: str | None, pattern: str) -> None:
    if content is None:
        (folder / name).unlink()
    else:
        (folder / name).write_text(content)
    with pytest.raises(DataError) as caught:
        load(folder)
    message = str(caught.value)
    assert re.search(pattern, message), message
    assert "\n" not in message
    assert message.startswith(str(folder))


def test_a_car_that_says_nothing_of_its_size_is_measured_on_its_rear_axle(folder: Path) -> None:
    (folder / "odometry.csv").write_text(ODOMETRY.replace("yaw_rate_rad_per_s", "steering_rad"))
    car = YAML.replace("velocity", "ackermann").replace("yaw_rate_std", "steering_std")
    (folder / "log.yaml").write_text(car)
    log = load(folder)
    assert REAR_AXLE.items() <= log.config["motion"].items() and len(REAR_AXLE) == 3
    assert any("rear axle; motion.wheelbase_m is the default's" in note for note in log.notes)
    (folder / "log.yaml").write_text(car.replace("ackermann", "ackermann, sensor_ahead_m: 1.2", 1))
    log = load(folder)
    assert "encoder_left_m" not in log.config["motion"] and not any("axle" in note for note in log.notes)


def test_text_that_is_not_utf8_is_read_as_spreadsheets_write_it(folder: Path) -> None:
    (folder / "sightings.csv").write_bytes(SIGHTINGS.encode() + "0.3,1.0,0.0,Öl 20 °,\n".encode("cp1252"))
    log = load(folder)
    assert "Öl 20 °" in log.identity_names
    assert [note for note in log.notes if "1252" in note] == [
        "sightings.csv: is not UTF-8, taken as Windows-1252"
    ]


@pytest.mark.parametrize("strange", [b"\x81", b"\xbf", b"\xfe\x00", b"\xe9\x01"])
def test_what_is_no_text_is_reported_with_its_line(folder: Path, strange: bytes) -> None:
    (folder / "sightings.csv").write_bytes(SIGHTINGS.encode() + b"0.3,1.0,0.0," + strange + b",\n")
    with pytest.raises(DataError, match=r"sightings\.csv:4: is not UTF-8 text: save it as UTF-8"):
        load(folder)


def test_not_a_number_is_dropped_and_counted(folder: Path) -> None:
    (folder / "sightings.csv").write_text(
        "stamp_s,range_m,bearing_rad\n0,nan,0\n0,1,inf\n0,0,0\n0,-2,0\n0,1.5,0.1\n"
    )
    (folder / "odometry.csv").write_text(ODOMETRY + "2.0,nan,0\n")
    log = load(folder)
    np.testing.assert_array_equal(log.sightings.range_m, [1.5])
    assert len(log.controls.stamp_s) == 3
    assert problem_counts(folder) == {
        "odometry rows with NaN or infinite values: dropped": 1,
        "sightings with NaN or infinite stamp, range or bearing: dropped": 2,
        "sightings with zero or negative range: dropped": 2,
    }


def test_disorder_is_sorted_stably_and_counted(folder: Path) -> None:
    (folder / "sightings.csv").write_text(
        "stamp_s,range_m,bearing_rad\n0.2,1,0\n0.1,2,0\n0.2,3,0\n0.1,4,0\n0.3,5,0\n"
    )
    np.testing.assert_array_equal(load(folder).sightings.range_m, [2, 4, 1, 3, 5])
    assert problem_counts(folder) == {"sightings out of time order by up to 0.1 s: sorted": 2}


def test_last_control_of_a_stamp_is_kept(folder: Path) -> None:
    (folder / "odometry.csv").write_text(
        "stamp_s,speed_m_per_s,yaw_rate_rad_per_s\n0,1,0\n1,2,0\n1,3,0\n0.5,4,0\n"
    )
    log = load(folder)
    np.testing.assert_array_equal(log.controls.stamp_s, [0, 0.5, 1])
    np.testing.assert_array_equal(log.controls.values[:, 0], [1, 4, 3])
    assert problem_counts(folder) == {
        "odometry rows out of time order by up to 0.5 s: sorted": 1,
        "odometry rows with a repeated stamp: the last row of each stamp kept": 1,
    }


def test_bearings_beyond_half_a_turn_are_wrapped(folder: Path) -> None:
    (folder / "sightings.csv").write_text("stamp_s,range_m,bearing_rad\n0,1,6.0\n0,1,-3.0\n")
    # 6 rad is 2 pi - 6 = 0.283... to the right; -3 rad lies within half a turn and keeps its bits.
    np.testing.assert_allclose(load(folder).sightings.bearing_rad, [6 - 2 * np.pi, -3.0], rtol=0, atol=1e-15)
    assert problem_counts(folder) == {"sightings with a bearing beyond +-pi: wrapped": 1}


def test_words_for_a_class_that_nobody_knows_are_no_class(folder: Path) -> None:
    words = ("blue", "unknown", "None", "", "nan", "null", "-1", "yellow")
    rows = [f"{0.1 * k:.1f},{k + 1}.0,0.1,{word}" for k, word in enumerate(words)]
    (folder / "sightings.csv").write_text("stamp_s,range_m,bearing_rad,class\n" + "\n".join(rows) + "\n")
    log = load(folder)
    assert log.class_names == ("blue", "yellow")
    assert log.sightings.class_index.tolist() == [0, *[-1] * 6, 1]


def test_other_clock_is_reported(folder: Path) -> None:
    (folder / "sightings.csv").write_text("stamp_s,range_m,bearing_rad\n1000,1,0\n")
    (problem,) = load(folder).problems
    assert "outside the odometry (0.000 to 1.000 s): another clock?" in problem.message


def test_missing_line_end_is_reported_and_kept(folder: Path) -> None:
    (folder / "odometry.csv").write_text(ODOMETRY[:-1])
    assert len(load(folder).controls.stamp_s) == 3
    assert problem_counts(folder) == {
        "odometry.csv: the last line has no line end and may be cut off: kept": 1
    }


def test_accumulated_poses_become_increments(folder: Path) -> None:
    (folder / "log.yaml").write_text(YAML.replace("model: velocity", "model: increments"))
    (folder / "odometry.csv").write_text(
        "stamp_s,x_m,y_m,heading_rad\n0,5,5,1.5707963267948966\n1,5,7,3.0\n2,4,7,-3.0\n"
    )
    log = load(folder)
    np.testing.assert_array_equal(log.controls.stamp_s, [1, 2])
    # Facing north, 2 m north is 2 m ahead; then facing 3 rad, 1 m west is (cos 3, sin 3) . (-1, 0) ahead.
    expected = [[2, 0, 3 - np.pi / 2], [-np.cos(3), np.sin(3), 2 * np.pi - 6]]
    np.testing.assert_allclose(log.controls.values, expected, rtol=0, atol=1e-14)


def test_one_accumulated_pose_is_no_motion(folder: Path) -> None:
    (folder / "log.yaml").write_text(YAML.replace("model: velocity", "model: odometry"))
    (folder / "odometry.csv").write_text("stamp_s,x_m,y_m,heading_rad\n0,5,5,1.5\n")
    with pytest.raises(DataError, match="holds one row, needs at least two"):
        load(folder)


def test_truth_and_fixes_are_read(folder: Path) -> None:
    # A quaternion about z by 2.0 rad: (0, 0, sin 1, cos 1).
    (folder / "truth_trajectory.tum").write_text(
        f"# comment\n0 1 2 9 0 0 {float(np.sin(1))!r} {float(np.cos(1))!r}\n"
    )
    (folder / "truth_landmarks.csv").write_text("id,x_m,y_m\n007,1.5,-2\n")
    (folder / "position_fixes.csv").write_text("stamp_s,x_m,y_m\n0.5,3,4\n")
    (folder / "log.yaml").write_text(YAML + "truth_landmarks_complete: false\n")
    log = load(folder)
    assert log.truth_trajectory is not None
    np.testing.assert_allclose(log.truth_trajectory.T_world_robot, [[1, 2, 2.0]], rtol=0, atol=1e-15)
    assert log.truth_landmarks is not None
    assert log.truth_landmarks.names == ("007",)
    assert not log.truth_landmarks.complete
    assert log.position_fixes is not None
    np.testing.assert_array_equal(log.position_fixes.position_m, [[3, 4]])


def test_example_in_the_documentation_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    blocks = re.findall(r"```python\n(.*?)```", DOCS.read_text(), flags=re.DOTALL)
    assert len(blocks) == 1
    monkeypatch.chdir(tmp_path)
    exec(compile(blocks[0], str(DOCS), "exec"), {})
    log = load(tmp_path / "my_log")
    assert (len(log.controls.stamp_s), len(log.sightings.stamp_s)) == (100, 10)
    assert log.identity_names == ("tree",)
    assert log.problems == ()


def test_covariances_of_sightings_are_kept(tmp_path: Path) -> None:
    log = make_small_log()
    covariance = np.tile([0.04, -0.001, 0.0004], (len(log.sightings.stamp_s), 1))
    covariance[7] = np.nan
    written = replace(log, sightings=replace(log.sightings, covariance=covariance))
    back = load(write_native(written, tmp_path / "log")).sightings.covariance
    assert back is not None
    np.testing.assert_array_equal(back, covariance)


@pytest.mark.parametrize(
    ("header", "cells", "message"),
    [
        ("range_variance_m2", "0.1", r":1: has range_variance_m2 but not bearing_variance_rad2"),
        (",".join(COVARIANCE_COLUMNS), "0.1,1.0,0.1", r":2: covariance: got .*positive definite"),
        (",".join(COVARIANCE_COLUMNS), "0.1,,0.1", r":2: covariance: got"),
    ],
)
def test_faulty_covariances_name_the_line(tmp_path: Path, header: str, cells: str, message: str) -> None:
    folder = write_native(make_small_log(), tmp_path / "log")
    (folder / "sightings.csv").write_text(f"stamp_s,range_m,bearing_rad,{header}\n1.0,2.0,0.1,{cells}\n")
    with pytest.raises(DataError, match=rf"sightings\.csv{message}"):
        load(folder)

"""Tables as programs and spreadsheets write them: each reads to the same log, or says what to change."""

from __future__ import annotations

import gzip
import itertools
import re
from pathlib import Path

import numpy as np
import pytest
from fastslam.datasets import load
from fastslam.errors import DataError
from fastslam.log import Log

YAML = """format_version: 1
motion: {model: velocity, speed_std_m_per_s: 0.1}
sensor: {model: range_bearing, range_std_m: 0.1}
"""
ODOMETRY = "stamp_s,speed_m_per_s,yaw_rate_rad_per_s\n0,1.0,0.1\n1,1.0,-0.1\n2,1.0,0.0\n3,1.0,0.0\n"
# Two sightings of one stamp; no number needs rounding in any unit below.
ROWS = [("0.5", "2.25", "0.5", "007"), ("0.5", "3.5", "-0.25", "a b"), ("1.5", "1e1", "-3.0", "12")]
HEADERS = {
    "plain": ("stamp_s", "range_m", "bearing_rad", "landmark_id"),
    "without units": ("timestamp", "range", "bearing", "id"),
    "brackets": ("Time [s]", "Range [m]", "Bearing [rad]", "Landmark id"),
    "parentheses": ("t (s)", "Distance (m)", "Angle (rad)", "Tag"),
}
SEPARATORS = {"commas": ",", "semicolons": ";", "tabs": "\t", "bars": "|", "blanks": "   "}
MARKS = {"points": ".", "commas": ","}
ENCODINGS = ("utf-8", "utf-8-sig", "utf-16", "utf-16-le", "gzip")


def folder_with(
    base: Path, *, odometry: str = ODOMETRY, sightings: str | None = None, yaml: str = YAML
) -> Path:
    base.mkdir(exist_ok=True)
    (base / "log.yaml").write_text(yaml)
    (base / "odometry.csv").write_text(odometry)
    (base / "sightings.csv").write_text(sightings or "stamp_s,range_m,bearing_rad\n0.5,2.25,0.5\n")
    return base


def names(log: Log) -> list[str]:
    return [log.identity_names[index] for index in log.sightings.identity]


def table_of(separator: str, mark: str, header: tuple[str, ...]) -> str:
    """The table in a dialect; blanks cannot stand within a field where they separate."""
    blank = not separator.strip() and "\t" not in separator
    rows = [[value.replace(".", mark) for value in row[:3]] + [row[3]] for row in ROWS]
    if blank:
        header = tuple(name if "[" in name or "(" in name else name.replace(" ", "_") for name in header)
        rows = [[value.replace(" ", "_") for value in row] for row in rows]
    return "".join(separator.join(row) + "\n" for row in (header, *rows))


def test_every_dialect_reads_to_the_same_log(tmp_path: Path) -> None:
    folder = folder_with(tmp_path / "log")
    (folder / "sightings.csv").unlink()
    read = refused = 0
    for separator, mark, header, encoding in itertools.product(SEPARATORS, MARKS, HEADERS, ENCODINGS):
        text = table_of(SEPARATORS[separator], MARKS[mark], HEADERS[header])
        packed = encoding == "gzip"
        data = gzip.compress(text.encode()) if packed else text.encode(encoding)
        file = folder / ("sightings.csv.gz" if packed else "sightings.csv")
        file.write_bytes(data)
        where = f"{separator}, decimal {mark}, header {header}, {encoding}"
        if separator == mark == "commas":
            with pytest.raises(
                DataError, match=r"sightings\.csv.*:2: got 7 columns, expected 4 \(decimal commas\?"
            ):
                load(folder)
            refused += 1
        else:
            log = load(folder)
            np.testing.assert_array_equal(log.sightings.stamp_s, [0.5, 0.5, 1.5], err_msg=where)
            np.testing.assert_array_equal(log.sightings.range_m, [2.25, 3.5, 10.0], err_msg=where)
            np.testing.assert_array_equal(log.sightings.bearing_rad, [0.5, -0.25, -3.0], err_msg=where)
            assert names(log) == ["007", "a_b" if separator == "blanks" else "a b", "12"], where
            assert log.problems == () and len(log.notes) == (3 if header == "without units" else 0), where
            read += 1
        file.unlink()
    assert (read, refused) == (180, 20)


UNIT_NAMES = [
    # header, a value, the quantity in SI
    ("range_mm", "2500", 2.5),
    ("range_cm", "250", 2.5),
    ("Range [km]", "0.0025", 2.5),
    ("distance_ft", "10", 3.048),
    ("bearing_deg", "45", np.pi / 4),
    ("Bearing [°]", "-90", -np.pi / 2),
    ("azimuth(degrees)", "90", np.pi / 2),
    ("bearing_mrad", "500", 0.5),
    ("stamp_ms", "1500", 1.5),
    ("t_us", "1500000", 1.5),
    ("time_ns", "1500000000", 1.5),
]


@pytest.mark.parametrize(("header", "value", "expected"), UNIT_NAMES)
def test_unit_in_a_name_is_converted(tmp_path: Path, header: str, value: str, expected: float) -> None:
    columns = {"stamp_s": "1", "range_m": "1", "bearing_rad": "1"}
    stem = header.lower()
    replaced = (
        "range_m"
        if stem.startswith(("range", "distance"))
        else "bearing_rad"
        if stem.startswith(("bearing", "azimuth"))
        else "stamp_s"
    )
    columns = {
        header if name == replaced else name: value if name == replaced else one
        for name, one in columns.items()
    }
    text = ",".join(columns) + "\n" + ",".join(columns.values()) + "\n"
    log = load(folder_with(tmp_path / "log", sightings=text))
    assert getattr(log.sightings, replaced)[0] == pytest.approx(expected, rel=1e-15)
    assert log.notes == ()


def test_control_columns_in_other_units(tmp_path: Path) -> None:
    odometry = "t_ms,velocity [km/h],yaw rate [deg/s]\n0,36,180\n1000,18,0\n"
    log = load(folder_with(tmp_path / "log", odometry=odometry))
    np.testing.assert_allclose(log.controls.values, [[10.0, np.pi], [5.0, 0.0]], rtol=1e-15)
    np.testing.assert_array_equal(log.controls.stamp_s, [0.0, 1.0])


def test_index_columns_are_left_out_and_other_nameless_ones_refused(tmp_path: Path) -> None:
    for header in (",stamp_s,range_m,bearing_rad", "Unnamed: 0,stamp_s,range_m,bearing_rad"):
        log = load(folder_with(tmp_path / "log", sightings=f"{header}\n0,0.5,2,0\n1,0.5,3,0\n"))
        np.testing.assert_array_equal(log.sightings.range_m, [2.0, 3.0])
    log = load(folder_with(tmp_path / "log", sightings="stamp_s,range_m,bearing_rad,\n0.5,2,0,\n0.5,3,0,\n"))
    np.testing.assert_array_equal(log.sightings.range_m, [2.0, 3.0])
    with pytest.raises(DataError, match=r"sightings\.csv:1: a column has no name: name it, or remove it"):
        load(folder_with(tmp_path / "log", sightings=",stamp_s,range_m,bearing_rad\n7,0.5,2,0\n1,0.5,3,0\n"))


def test_comments_stand_before_the_header_or_hold_it(tmp_path: Path) -> None:
    plain = (
        "# made by hand\n\n# t: seconds\nstamp_s,range_m,bearing_rad\n0.5,2.0,0.1\n# a break\n0.7,2.0,0.1\n"
    )
    log = load(folder_with(tmp_path / "log", sightings=plain))
    np.testing.assert_array_equal(log.sightings.stamp_s, [0.5, 0.7])
    in_comment = "# by numpy.savetxt\n# stamp_s range_m bearing_rad\n0.5 2.0 0.1\n"
    np.testing.assert_array_equal(
        load(folder_with(tmp_path / "log", sightings=in_comment)).sightings.range_m, [2.0]
    )


def test_line_numbers_count_comments_and_blank_lines(tmp_path: Path) -> None:
    text = "# one\n\nstamp_s,range_m,bearing_rad\n\n0.5,2.0,0.1\n\n0.6,far,0.1\n"
    with pytest.raises(DataError, match=r"sightings\.csv:7: range_m: got 'far', expected a number"):
        load(folder_with(tmp_path / "log", sightings=text))


def test_dates_become_seconds(tmp_path: Path) -> None:
    """1714557600 s is 2024-05-01T10:00:00Z (19,844 days and ten hours after the start of 1970)."""
    assert 19844 * 86400 + 36000 == 1714557600
    stamps = ("2024-05-01T10:00:00.25Z", "2024-05-01 12:00:00,5+02:00", "2024-05-01T10:00:01")
    sightings = "stamp_s;range_m;bearing_rad\n" + "".join(f"{stamp};2;0\n" for stamp in stamps)
    odometry = "stamp_s,v,w\n1714557600,1,0\n1714557602,1,0\n"
    log = load(folder_with(tmp_path / "log", sightings=sightings, odometry=odometry))
    np.testing.assert_array_equal(log.sightings.stamp_s - 1714557600, [0.25, 0.5, 1.0])
    with pytest.raises(DataError, match=r"sightings\.csv has dates and odometry\.csv other seconds"):
        load(folder_with(tmp_path / "log", sightings=sightings))
    wrong = sightings.replace("12:00:00,5+02:00", "noon")
    with pytest.raises(DataError, match=r"sightings\.csv:3: stamp_s: got 2024-05-01 noon, expected a date"):
        load(folder_with(tmp_path / "log", sightings=wrong, odometry=odometry))


def test_stamps_that_are_no_seconds_are_refused(tmp_path: Path) -> None:
    odometry = "stamp_s,v,w\n1764313200000,1,0\n1764313200100,1,0\n"
    with pytest.raises(
        DataError, match=r"odometry\.csv:2: stamp_s: got 1764313200000\.0, .*name the column stamp_ms"
    ):
        load(folder_with(tmp_path / "log", odometry=odometry))


def test_cartesian_sightings_become_polar_with_their_covariance(tmp_path: Path) -> None:
    """At (3, 4), 5 m away: 0.04 m² in every direction is 0.04 m² along and 0.04/25 rad² across."""
    header = "stamp_s,x_m,y_m,x_variance_m2,xy_covariance_m2,y_variance_m2"
    log = load(folder_with(tmp_path / "log", sightings=f"{header}\n0.5,3,4,0.04,0,0.04\n0.5,0,-2,,,\n"))
    np.testing.assert_allclose(log.sightings.range_m, [5.0, 2.0])
    np.testing.assert_allclose(log.sightings.bearing_rad, [np.arctan2(4, 3), -np.pi / 2])
    assert log.sightings.covariance is not None
    np.testing.assert_allclose(log.sightings.covariance[0], [0.04, 0.0, 0.0016], atol=1e-17)
    assert np.isnan(log.sightings.covariance[1]).all()


WHEELS = "wheels: {track_width_m: 0.5, radius_m: 0.1, ticks_per_turn: 100, counter_bits: 16}\n"
# Ways of 10 ticks are 0.1 turns of 0.2 pi m.
TICK_M = 2 * np.pi * 0.1 / 100


def test_wheel_speeds_become_speed_and_yaw_rate(tmp_path: Path) -> None:
    for header, left, right in (
        ("left_m_per_s,right_m_per_s", 1.0, 1.5),
        ("left [rad/s],right [rad/s]", 10.0, 15.0),
        ("left_wheel_rpm,right_wheel_rpm", 10.0 * 30 / np.pi, 15.0 * 30 / np.pi),
        ("vl,vr", 1.0, 1.5),
    ):
        odometry = f"stamp_s,{header}\n0,{left!r},{right!r}\n1,0,0\n"
        log = load(folder_with(tmp_path / "log", odometry=odometry, yaml=YAML + WHEELS))
        np.testing.assert_allclose(log.controls.values, [[1.25, 1.0], [0.0, 0.0]], rtol=1e-14)


def test_ticks_wrap_around_and_become_controls(tmp_path: Path) -> None:
    odometry = "stamp_s,left_ticks,right_ticks\n0,65530,5\n0.5,4,25\n1.5,65532,17\n"
    log = load(folder_with(tmp_path / "log", odometry=odometry, yaml=YAML + WHEELS))
    # Steps of 10 and 20 ticks in half a second, then of -8 and -8 in one second; the last is held on.
    expected = [[15 * TICK_M / 0.5, 10 * TICK_M / 0.5 / 0.5], [-8 * TICK_M, 0.0], [-8 * TICK_M, 0.0]]
    np.testing.assert_allclose(log.controls.values, expected, rtol=1e-12)
    np.testing.assert_array_equal(log.controls.stamp_s, [0.0, 0.5, 1.5])


def test_ticks_become_increments_along_their_arc(tmp_path: Path) -> None:
    """A quarter turn about the left wheel: the middle goes half a track width ahead and to the left."""
    quarter = np.pi / 2 * 0.5 / TICK_M
    yaml = YAML.replace("velocity, speed_std_m_per_s", "increments, x_std_m") + WHEELS
    odometry = f"stamp_s,left_ticks,right_ticks\n0,0,0\n1,0,{quarter!r}\n"
    log = load(folder_with(tmp_path / "log", odometry=odometry, yaml=yaml))
    np.testing.assert_allclose(log.controls.values, [[0.25, 0.25, np.pi / 2]], rtol=1e-14)


def test_counters_that_seem_to_wrap_are_refused(tmp_path: Path) -> None:
    rows = "".join(f"{k},{(65000 + 10 * k) % 65536},{10 * k}\n" for k in range(100))
    yaml = YAML + WHEELS.replace(", counter_bits: 16", "")
    with pytest.raises(DataError, match=r"odometry\.csv:56: a counter jumps by -65526: .*counter_bits: 16"):
        load(folder_with(tmp_path / "log", odometry="stamp_s,left_ticks,right_ticks\n" + rows, yaml=yaml))


def test_pose_with_a_quaternion_becomes_increments(tmp_path: Path) -> None:
    yaml = YAML.replace("velocity, speed_std_m_per_s", "increments, x_std_m")
    half = float(np.sqrt(0.5))
    for header in (
        "stamp_s,x_m,y_m,z_m,qx,qy,qz,qw",
        "t,pose.pose.position.x,pose.pose.position.y,z,"
        + ",".join(f"pose.pose.orientation.{axis}" for axis in "xyzw"),
    ):
        odometry = f"{header}\n0,1,1,0,0,0,{half!r},{half!r}\n1,1,3,0,0,0,0,2\n"
        log = load(folder_with(tmp_path / "log", odometry=odometry, yaml=yaml))
        np.testing.assert_allclose(log.controls.values, [[2.0, 0.0, -np.pi / 2]], atol=1e-15)
    zero = odometry.replace(",0,2\n", ",0,0\n")
    with pytest.raises(DataError, match=r"odometry\.csv:3: the quaternion is zero"):
        load(folder_with(tmp_path / "log", odometry=zero, yaml=yaml))


def test_settings_in_other_units(tmp_path: Path) -> None:
    yaml = YAML.replace(
        "range_std_m: 0.1", "range_std_cm: 10, bearing_std_deg: 1.8, mounting: {yaw_deg: 180}"
    )
    log = load(folder_with(tmp_path / "log", yaml=yaml))
    sensor = log.config["sensor"]
    assert sensor["range_std_m"] == pytest.approx(0.1, rel=1e-15)
    assert sensor["bearing_std_rad"] == pytest.approx(np.pi / 100, rel=1e-15)
    assert sensor["mounting"] == {"yaw_rad": np.pi}
    both = YAML.replace("range_std_m", "range_std_cm: 10, range_std_m")
    with pytest.raises(DataError, match=r"log\.yaml:3: sensor\.range_std_cm: range_std_m is given too"):
        load(folder_with(tmp_path / "log", yaml=both))


POSES = "stamp_s,x_m,y_m,heading_rad\n0,0,0,0\n1,1,0,0\n"
REFUSED = [
    # file, content, pattern
    (
        "sightings.csv",
        'stamp_s,range_m,bearing_rad\n0,"a\nb",0\n',
        r":3: range_m: got 'a b', expected a number",
    ),
    (
        "sightings.csv",
        "0.5,2,0.1\n",
        r"sightings\.csv:1: got numbers, expected a header .*put stamp_s,range_m",
    ),
    ("sightings.csv", "stamp_s,range_m\n0,1\n", r":1: column bearing_rad is missing: .* or stamp_s,x_m,y_m"),
    (
        "sightings.csv",
        "stamp_s,range_s,bearing_rad\n0,1,0\n",
        r":1: column range_s: got the unit s, expected m",
    ),
    ("sightings.csv", "stamp_s,range,r,bearing\n0,1,1,0\n", r":1: columns range and r both give range_m"),
    ("sightings.csv", "stamp_s,range_m,bearing_rad,landmrk_id\n0,1,0,1\n", r"did you mean landmark_id\?"),
    ("sightings.csv", "stamp_s,range_m,bearing_rad,weather\n0,1,0,1\n", r"got weather, .*, or remove it"),
    (
        "sightings.csv",
        "stamp_s;range_m;bearing_rad\n0;1,5;0\n0;1.5;0\n",
        r":3: range_m: got '1\.5'|:2: range_m: got '1,5'",
    ),
    (
        "odometry.csv",
        POSES,
        r":1: the header fits motion\.model odometry or increments, but log\.yaml says velocity",
    ),
    (
        "odometry.csv",
        "stamp_s,left_m_per_s,right_m_per_s\n0,1,1\n",
        r":1: .*add it to log\.yaml, as wheels: \{track",
    ),
    ("odometry.csv", "stamp_s,left_ticks,right_ticks\n0,1,1\n1,2,2\n", r"ticks need wheels\.m_per_tick"),
    (
        "log.yaml",
        YAML + "wheels: {width: 1}\n",
        r"log\.yaml:4: unknown key wheels\.width; known: track_width_m",
    ),
    (
        "log.yaml",
        YAML + "wheels: {radius_m: 0}\n",
        r"log\.yaml:4: wheels\.radius_m: got 0, expected a positive",
    ),
    ("log.yaml", YAML + "wheels: {counter_bits: 1.5}\n", r"wheels\.counter_bits: got 1\.5, expected a whole"),
    ("log.yaml", YAML + "wheels: 3\n", r"wheels: got 3, expected a section of track_width_m"),
    (
        "log.yaml",
        YAML.replace("range_std_m: 0.1", "range_std_cm: ten"),
        r"range_std_cm: got ten, expected a number",
    ),
]


@pytest.mark.parametrize(("name", "content", "pattern"), REFUSED)
def test_refusal_says_what_to_change(tmp_path: Path, name: str, content: str, pattern: str) -> None:
    folder = folder_with(tmp_path / "log")
    (folder / name).write_text(content)
    with pytest.raises(DataError) as caught:
        load(folder)
    assert re.search(pattern, str(caught.value)), str(caught.value)
    assert "\n" not in str(caught.value)


def test_model_comes_from_the_columns_where_they_settle_it(tmp_path: Path) -> None:
    yaml = "format_version: 1\nsensor: {model: range_bearing}\n"
    log = load(folder_with(tmp_path / "log", yaml=yaml))
    assert log.config["motion"] == {"model": "velocity"}
    assert len(log.notes) == 2
    with pytest.raises(
        DataError, match=r"odometry\.csv:1: .*add motion: \{model: odometry\} \(or increments\)"
    ):
        load(folder_with(tmp_path / "log", yaml=yaml, odometry=POSES))
    ackermann = "stamp_s,speed_m_per_s,steering_rad\n0,1,0\n"
    with pytest.raises(DataError, match=r"odometry\.csv:1: .*add motion: \{model: ackermann\}"):
        load(folder_with(tmp_path / "log", yaml=yaml, odometry=ackermann))


def test_every_file_of_a_log_may_be_compressed(tmp_path: Path) -> None:
    folder = folder_with(tmp_path / "log")
    (folder / "truth_trajectory.tum").write_text("0 0 0 0 0 0 0 1\n")
    (folder / "truth_landmarks.csv").write_text("id,x_m,y_m\na,1,2\n")
    (folder / "position_fixes.csv").write_text("stamp_s,x_m,y_m\n0,1,2\n")
    plain = load(folder)
    files = [file for file in folder.iterdir()]
    for file in files:
        (folder / f"{file.name}.gz").write_bytes(gzip.compress(file.read_bytes()))
        file.unlink()
    packed = load(folder)
    assert len(files) == 6
    np.testing.assert_array_equal(packed.sightings.range_m, plain.sightings.range_m)
    assert packed.truth_trajectory is not None and packed.truth_landmarks is not None
    assert packed.position_fixes is not None

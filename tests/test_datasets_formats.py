"""Guessing the format, and the faults of the public formats, on small made-up files."""

from __future__ import annotations

import gzip
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import scipy.io
from fastslam.datasets import FORMATS, load
from fastslam.datasets.registry import TABLES_PAGE
from fastslam.errors import DataError


def write(folder: Path, files: dict[str, str]) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    for name, content in files.items():
        (folder / name).write_text(content)
    return folder


def native(base: Path) -> Path:
    yaml = "format_version: 1\nmotion: {model: velocity}\nsensor: {model: range_bearing}\n"
    return write(
        base / "native",
        {
            "log.yaml": yaml,
            "odometry.csv": "stamp_s,speed_m_per_s,yaw_rate_rad_per_s\n0,1,0\n1,1,0\n",
            "sightings.csv": "stamp_s,range_m,bearing_rad\n0,1,0\n",
        },
    )


def utias(base: Path) -> Path:
    """Robot 2 only; barcodes 18 and 61 belong to landmarks 11 and 17, 5 to robot 1, 99 to nobody."""
    return write(
        base / "MRCLAM_Dataset3",
        {
            "Barcodes.dat": "# Subject Barcode\n  1 \t 5 \n 11  18\n 17  61 \n",
            "Landmark_Groundtruth.dat": "11 1.0 2.0 0.1 0.1\n17 3.0 4.0 0.1 0.1\n",
            "Robot2_Odometry.dat": "# t v w\n10.0 0.1 0.2 \n10.1 0.1 0.2 \n10.1 0.3 0.2\n",
            "Robot2_Measurement.dat": "10 18 1.5 0.1\n10 61 2.5 -0.1\n10 5 3 0\n10 99 3 0\n10 nan 3 0\n",
        },
    )


def lost_in_the_woods(base: Path) -> Path:
    base.mkdir(parents=True, exist_ok=True)
    column = np.zeros((3, 1))
    names = ("v", "om", "x_true", "y_true", "th_true")
    variables = {name: column for name in names} | {"t": np.array([[0.0], [0.1], [0.2]])}
    variables |= {name: np.array([[0.01]]) for name in ("r_var", "b_var", "v_var", "om_var", "d")}
    variables |= {
        "r": np.array([[1.0, 0.0], [np.nan, 5.0], [5.7, 0.0]]),
        "b": np.zeros((3, 2)),
        "l": np.array([[1.0, 2.0], [3.0, 4.0]]),
        "true_valid": np.array([[1], [0], [1]], dtype=np.uint8),
    }
    # Compressed as the real file is: SciPy notices damage there, where it may crash on plain arrays.
    scipy.io.savemat(base / "dataset2.mat", variables, do_compression=True)
    return base


def victoria_park(base: Path) -> Path:
    write(
        base / "victoria" / "features_rfs_slam",
        {
            "measurements.dat": "0.1 10 1.5707963267948966 0.4\n",
            "inputs.dat": "0 1 0\n0.1 1 0\n",
            "gps.dat": "0 1 2\n",
        },
    )
    return base / "victoria"


EDGE = "EDGE2 0 1 1 0 1.5708 50 0 0 50 0 100\n"
LANDMARK = "LANDMARK 1 7 3 4 10 0 10\n"


def city_trees(base: Path) -> Path:
    files = {"cityTrees10000.txt": EDGE + LANDMARK, "cityTrees10000_groundtruth.txt": EDGE + LANDMARK}
    return write(base / "city", files)


def freiburg(base: Path) -> Path:
    files = {
        "sensor_data.dat": "ODOMETRY 0.1 1.0 0.2\nSENSOR 4 2.0 0.5\nODOMETRY 0 1 0\nSENSOR 4 1.0 0.5\n",
        "world.dat": "4 1.5 2.5\n",
    }
    return write(base / "freiburg", files)


def victoria_scans(base: Path) -> Path:
    """Two scans in one line: nothing hit but a trunk ahead, at half a turn of the beams."""
    scan = ["81.91"] * 361
    scan[178:183] = ["10.05", "10.01", "10.00", "10.01", "10.05"]
    files = {
        "LASER.txt": " ".join(["0.5", *scan, "0.7", *scan]),
        "DRS.txt": "0.4 1.0 0.1\n0.6 1.0 0.1\n0.8 1.0 0.1\n",
        "GPS.txt": "0.0 1.0 2.0\n",
    }
    return write(base / "ascii_2003", files)


def car_park(base: Path, *, run: int = 3) -> Path:
    """Two scans with a post at 9.00 m 45 degrees to the right, and one surveyed post."""
    folder = write(base / "car_park", {"derived_posts.csv": "post,east_m,north_m\n1,2.5,-3.5\n"})
    laser = np.full((2, 361), 8191, dtype=np.uint16)
    laser[:, 90] = (3 << 13) | 900
    rows = [[1000, 0, 0, 2022, 0, 100], [1025, 0, 0, 2022, 0, 100]]
    gps = np.zeros((2, 13))
    gps[:, 0], gps[:, 2], gps[:, 3] = (1000, 1200), 33.8884, 151.1948
    scipy.io.savemat(folder / f"juan{run}_etc.mat", {"SENSORS": np.array(rows, dtype=np.int32)})
    stamps = np.array([[1000], [1213]], dtype=np.uint32)
    scipy.io.savemat(folder / f"juan{run}_lsr2.mat", {"LASER": laser, "TLsr": stamps})
    scipy.io.savemat(folder / f"juan{run}_gps.mat", {"GPS": gps})
    return folder


def g2o(base: Path) -> Path:
    base.mkdir(parents=True, exist_ok=True)
    (base / "small.g2o").write_text("EDGE_SE2 0 1 1 0 0 100 0 0 100 0 400\nEDGE_SE2_XY 1 7 3 4 100 0 100\n")
    return base / "small.g2o"


def toro(base: Path) -> Path:
    base.mkdir(parents=True, exist_ok=True)
    (base / "small.txt").write_text(EDGE + LANDMARK)
    return base / "small.txt"


def pyfg(base: Path) -> Path:
    base.mkdir(parents=True, exist_ok=True)
    rows = "VERTEX_SE2 0 A0 0 0 0\nEDGE_SE2 1 A0 A1 1 0 0 1 0 0 1 0 1\nEDGE_SE2_XY 1 A1 L0 3 4 1 0 1\n"
    (base / "small.pyfg").write_text(rows)
    return base / "small.pyfg"


def bag(base: Path) -> Path:
    pytest.importorskip("rosbags", reason="the extra `bags` is not installed")
    from test_bags import detections, mrpt, twists, write

    base.mkdir(parents=True, exist_ok=True)
    return write(base / "small", [*twists(), *detections(mrpt)])


def plaza(folder: Path) -> Path:
    """Three rows of odometry, two ranges of two radios."""
    import scipy.io

    folder.mkdir()
    stamps = np.arange(4.0)
    tables = {
        "DR": np.column_stack([stamps[1:], np.full(3, 0.5), np.zeros(3)]),
        "TD": np.array([[2.0, 2, 5, 7.5], [1.0, 2, 1, 4.0]]),
        "GT": np.column_stack([stamps, 0.5 * stamps, np.zeros(4), np.zeros(4)]),
        "TL": np.array([[1.0, 4.0, 1.0], [5.0, 0.0, 8.0]]),
    }
    scipy.io.savemat(folder / "Plaza9_.mat", tables)
    return folder


def labyrinth(folder: Path) -> Path:
    folder.mkdir()
    rows = "".join(
        f"range2 {k} {3 + k} 0.01 5 1 105 0\nodom2diff {k} 0.1 0.2 0 0.25 0.0001 0.0001 0.0001\n"
        for k in range(3)
    )
    (folder / "Small_UWB_Input.txt").write_text(rows)
    (folder / "Small_UWB_GT.txt").write_text("point2 0 1 2 0 0 0 0\npoint2 1 1.15 2 0 0 0 0\n")
    return folder


def test_a_folder_of_tables_is_told_what_to_call_them(tmp_path: Path) -> None:
    (tmp_path / "wheels.csv").write_text("t;v;w\n0;1;0\n")
    (tmp_path / "marks.csv").write_text("t;post;range;bearing\n0;P1;1;0\n")
    wanted = r"\(marks\.csv, wheels\.csv\): name that of the motion odometry\.csv .* sightings\.csv"
    with pytest.raises(DataError, match=wanted):
        load(tmp_path)
    assert (Path(__file__).parents[1] / TABLES_PAGE).exists()
    (tmp_path / "notes.txt").write_text("")
    with pytest.raises(DataError, match="no log of a known format"):
        load(tmp_path)


def test_labyrinth_is_read_as_documented(tmp_path: Path) -> None:
    log = load(labyrinth(tmp_path / "log"))
    assert log.controls.values[0].tolist() == pytest.approx([0.15, 0.2])
    assert log.sightings.range_m.tolist() == [3.0, 4.0, 5.0] and log.identity_names == ("105",)
    assert log.truth_landmarks is not None and log.truth_landmarks.position_m.tolist() == [[5.0, 1.0]]
    assert log.truth_trajectory is not None and not log.truth_trajectory.heading_known
    assert log.config["sensor"]["model"] == "range" and log.config["sensor"]["range_std_m"] == 0.1
    path = tmp_path / "log" / "Small_UWB_Input.txt"
    path.write_text("range2 0 3 0.01 5 1\n")
    with pytest.raises(DataError, match=r"range2: expected 7 numbers"):
        load(path)


MAKERS: dict[str, Callable[[Path], Path]] = {
    "native": native,
    "utias": utias,
    "lost_in_the_woods": lost_in_the_woods,
    "victoria_park": victoria_park,
    "city_trees10000": city_trees,
    "freiburg": freiburg,
    "victoria_scans": victoria_scans,
    "car_park": car_park,
    "g2o": g2o,
    "toro": toro,
    "pyfg": pyfg,
    "bag": bag,
    "plaza": plaza,
    "labyrinth": labyrinth,
}


def test_every_format_has_a_small_example() -> None:
    assert set(MAKERS) == set(FORMATS)


@pytest.mark.parametrize("name", sorted(MAKERS))
def test_format_is_guessed_and_can_be_named(tmp_path: Path, name: str) -> None:
    path = MAKERS[name](tmp_path / "logs")
    robot = 2 if name == "utias" else None
    assert load(path, robot=robot).format == name
    assert load(path, format=name.replace("_", "-"), robot=robot).format == name
    assert [entry.name for entry in FORMATS.values() if entry.matches(path)] == [name]


def test_path_that_does_not_exist(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="nowhere: does not exist"):
        load(tmp_path / "nowhere")


def test_unknown_format_suggests_the_nearest(tmp_path: Path) -> None:
    with pytest.raises(DataError, match=r"unknown format utia; did you mean utias\?; known: native, utias,"):
        load(tmp_path, format="utia")


def test_path_of_no_format_lists_all(tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("nothing\n")
    for path in (tmp_path, tmp_path / "notes.txt"):
        with pytest.raises(DataError) as caught:
            load(path)
        assert f"read are {', '.join(FORMATS)}; docs/formats.md says how" in str(caught.value)


def test_folder_of_two_formats_asks_for_one(tmp_path: Path) -> None:
    folder = native(tmp_path)
    write(folder, {"cityTrees10000.txt": EDGE + LANDMARK})
    with pytest.raises(DataError, match=r"fits several formats \(native, city_trees10000\): name one"):
        load(folder)
    assert load(folder, format="native").format == "native"


def test_option_that_the_format_does_not_know(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="logs of format native know no option robot"):
        load(native(tmp_path), robot=1)
    with pytest.raises(DataError, match="logs of format utias know no option run"):
        load(utias(tmp_path), run=3)


def test_utias_maps_barcodes_and_counts_what_it_drops(tmp_path: Path) -> None:
    log = load(utias(tmp_path), robot=2)
    assert [log.identity_names[index] for index in log.sightings.identity] == ["11", "17"]
    np.testing.assert_array_equal(log.controls.values, [[0.1, 0.2], [0.3, 0.2]])
    assert {problem.message: problem.count for problem in log.problems} == {
        "odometry rows with a repeated stamp: the last row of each stamp kept": 1,
        "sightings of other robots: dropped": 1,
        "sightings of unknown barcodes: dropped": 2,
    }


@pytest.mark.parametrize(
    ("barcodes", "expected"), [("11 18\n17 61\n", ["17", "11"]), ("11 61\n17 18\n", ["17", "11"])]
)
def test_utias_set_1_has_two_barcodes_swapped(tmp_path: Path, barcodes: str, expected: list[str]) -> None:
    """The table of set 1 is put right whether it is as published or corrected already."""
    folder = utias(tmp_path).rename(tmp_path / "MRCLAM_Dataset1")
    (folder / "Barcodes.dat").write_text("1 5\n" + barcodes)
    log = load(folder, robot=2)
    assert [log.identity_names[index] for index in log.sightings.identity] == expected


def test_utias_robot_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="has no robot 1; robots there: 2"):
        load(utias(tmp_path))


def test_utias_reads_compressed_files_and_reports_damaged_ones(tmp_path: Path) -> None:
    folder = utias(tmp_path)
    plain = folder / "Robot2_Odometry.dat"
    packed = gzip.compress(plain.read_bytes())
    plain.unlink()
    (folder / "Robot2_Odometry.dat.gz").write_bytes(packed)
    assert len(load(folder, robot=2).controls.stamp_s) == 2
    (folder / "Robot2_Odometry.dat.gz").write_bytes(packed[:-12])
    with pytest.raises(DataError, match=r"Odometry\.dat\.gz: the gzip file is damaged or cut off"):
        load(folder, robot=2)


def test_lost_in_the_woods_drops_far_and_broken_ranges(tmp_path: Path) -> None:
    log = load(lost_in_the_woods(tmp_path / "woods"))
    np.testing.assert_array_equal(log.sightings.range_m, [1.0, 5.0])
    np.testing.assert_array_equal(log.sightings.identity, [0, 1])
    assert sorted(problem.count for problem in log.problems) == [1, 1]
    assert log.truth_trajectory is not None
    np.testing.assert_array_equal(log.truth_trajectory.stamp_s, [0.0, 0.2])


@pytest.mark.parametrize("limit_m", [0.0, -1.0, float("nan")])
def test_lost_in_the_woods_range_limit_must_be_positive(tmp_path: Path, limit_m: float) -> None:
    with pytest.raises(DataError, match=r"max_range_m: got .*, expected a positive number"):
        load(lost_in_the_woods(tmp_path), max_range_m=limit_m)


def test_lost_in_the_woods_file_that_is_cut_off(tmp_path: Path) -> None:
    file = lost_in_the_woods(tmp_path) / "dataset2.mat"
    file.write_bytes(file.read_bytes()[:-20])
    with pytest.raises(DataError, match=r"dataset2\.mat|damaged|is no"):
        load(file, format="lost_in_the_woods")


def test_city_trees_are_made_polar_and_the_truth_exact(tmp_path: Path) -> None:
    log = load(city_trees(tmp_path))
    np.testing.assert_array_equal(log.sightings.stamp_s, [1.0])
    assert log.sightings.range_m[0] == pytest.approx(5.0, rel=1e-15)
    assert log.sightings.bearing_rad[0] == pytest.approx(np.arctan2(4, 3), rel=1e-15)
    assert log.identity_names == ("7",)
    assert log.truth_landmarks is not None
    # At (1, 0) facing north exactly, (3, 4) ahead and left is (1 - 4, 3).
    np.testing.assert_allclose(log.truth_landmarks.position_m, [[-3, 3]], rtol=0, atol=1e-15)


def test_freiburg_rotations_become_increments(tmp_path: Path) -> None:
    log = load(freiburg(tmp_path))
    np.testing.assert_array_equal(log.controls.stamp_s, [1, 2])
    np.testing.assert_allclose(log.controls.values[0], [np.cos(0.1), np.sin(0.1), 0.3], rtol=1e-15)
    np.testing.assert_array_equal(log.sightings.stamp_s, [1, 2])
    assert log.truth_landmarks is not None and log.truth_landmarks.names == log.identity_names == ("4",)


FAULTS = [
    # maker, file below the log's folder, content (None: missing), pattern
    (utias, "Robot2_Measurement.dat", None, r"Robot2_Measurement\.dat \(or .*\.gz\) is missing"),
    (utias, "Robot2_Measurement.dat", "# only\n", r"Measurement\.dat: holds no rows of data"),
    (utias, "Robot2_Measurement.dat", "# a\n1 2 3 4\n1 2 3\n", r"dat:3: got 3 columns, expected 4$"),
    (utias, "Robot2_Measurement.dat", "1 2 3 4\n1 2 3", r"dat:2: got 3 columns, expected 4 \(.*cut off\)"),
    (utias, "Robot2_Odometry.dat", "1 2 3\n\n1 2 x3\n", r"dat:3: column 3: got 'x3', expected a number"),
    (utias, "Robot2_Odometry.dat", "1 2 3 4\n1 2 3 4\n", r"dat:1: got 4 columns, expected 3"),
    (utias, "Barcodes.dat", "# t\n1 5\n11 nan\n", r"Barcodes\.dat:3: got 'nan', expected a whole number"),
    (utias, "Landmark_Groundtruth.dat", "1.5 0 0 0 0\n", r"Groundtruth\.dat:1: got '1\.5', expected a whole"),
    (victoria_park, "features_rfs_slam/gps.dat", "0 1\n", r"gps\.dat:1: got 2 columns, expected 3"),
    (victoria_park, "features_rfs_slam/inputs.dat", "0 1 fast\n", r"inputs\.dat:1: column 3: got 'fast'"),
    (victoria_park, "features_rfs_slam/measurements.dat", "0 -1 0 0\n", r"no usable sighting is left of 1"),
    (city_trees, "cityTrees10000.txt", EDGE + "VERTEX 1\n", r"txt:2: got row 'VERTEX', expected EDGE2 or"),
    (
        city_trees,
        "cityTrees10000.txt",
        EDGE + "LANDMARK 1 7 3\n",
        r"txt:2: LANDMARK: got 4 columns, expected 8",
    ),
    (
        city_trees,
        "cityTrees10000.txt",
        EDGE + LANDMARK.replace("3", "x"),
        r"txt:2: LANDMARK: got 'x', expected",
    ),
    (city_trees, "cityTrees10000.txt", LANDMARK + EDGE, r"txt:1: LANDMARK: pose 1 is not known yet"),
    (city_trees, "cityTrees10000.txt", EDGE + EDGE, r"txt:2: EDGE2: got poses 0 1, expected consecutive"),
    (city_trees, "cityTrees10000.txt", EDGE, r"holds 1 EDGE2 and 0 LANDMARK rows, needs both"),
    (
        freiburg,
        "sensor_data.dat",
        "ODOMETRY 0 1 0\nLASER 1\n",
        r"dat:2: got row 'LASER', expected ODOMETRY or",
    ),
    (
        freiburg,
        "sensor_data.dat",
        "ODOMETRY 0 1 0\nSENSOR 1 2\n",
        r"dat:2: SENSOR: got 3 columns, expected 4",
    ),
    (freiburg, "sensor_data.dat", "ODOMETRY 0 1 0\nSENSOR 1.5 2 0\n", r"dat:2: SENSOR: got landmark '1\.5'"),
    (freiburg, "sensor_data.dat", "ODOMETRY 0 1 0\nSENSOR 1 two 0\n", r"dat:2: SENSOR: got 'two', expected"),
    (freiburg, "world.dat", "1 2\n", r"world\.dat:1: got 2 columns, expected 3"),
]


@pytest.mark.parametrize(("maker", "name", "content", "pattern"), FAULTS)
def test_fault_is_reported_with_its_place(
    tmp_path: Path, maker: Callable[[Path], Path], name: str, content: str | None, pattern: str
) -> None:
    folder = maker(tmp_path)
    if content is None:
        (folder / name).unlink()
    else:
        (folder / name).write_text(content)
    with pytest.raises(DataError) as caught:
        load(folder, robot=2 if maker is utias else None)
    message = str(caught.value)
    assert re.search(pattern, message), message
    assert "\n" not in message


TOKENS = [
    "nan",
    "inf",
    "-1",
    "1e999",
    "",
    " ",
    "\n",
    ",",
    ";",
    '"',
    "#",
    "EDGE2",
    "x",
    "\x00",
    "é",
    "0",
    "{",
    "- a\n",
]


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.slow] if name == "bag" else []) for name in sorted(MAKERS)]
)
def test_damage_gives_a_log_or_a_one_line_error(tmp_path: Path, name: str) -> None:
    """Cuts, swaps and insertions anywhere in any file never end in another exception."""
    rng = np.random.default_rng(7)
    folder = MAKERS[name](tmp_path / "logs")
    files = [folder] if folder.is_file() else sorted(path for path in folder.rglob("*") if path.is_file())
    originals = {file: file.read_bytes() for file in files}
    outcomes = {"log": 0, "error": 0}
    for _ in range(200):
        file = files[rng.integers(len(files))]
        content = originals[file]
        start, stop = sorted(rng.integers(0, len(content) + 1, size=2))
        token = TOKENS[rng.integers(len(TOKENS))].encode()
        stop = min(stop, start + int(rng.choice([0, 0, 1, 4, len(content)])))
        file.write_bytes(content[:start] + token + content[stop:])
        try:
            log = load(folder, format=name, robot=2 if name == "utias" else None)
            assert np.isfinite(log.controls.values).all()
            outcomes["log"] += 1
        except DataError as error:
            assert "\n" not in str(error)
            outcomes["error"] += 1
        file.write_bytes(content)
    assert min(outcomes.values()) > 0, outcomes


def test_victoria_scans_are_cut_from_one_line(tmp_path: Path) -> None:
    folder = victoria_scans(tmp_path)
    log = load(folder)
    assert log.scans is not None and log.scans.ranges_m.shape == (2, 361)
    assert log.scans.stamp_s.tolist() == [0.5, 0.7]
    assert log.position_fixes is not None and log.position_fixes.position_m.tolist() == [[2.0, 1.0]]
    text = (folder / "LASER.txt").read_text(encoding="utf-8")
    for broken, message in (
        (text[:-9], "1 scans of 362 numbers and"),
        (text.replace("10.00", "ten"), "no number"),
        (text.replace("0.7", "0.3"), "scan 1 is not later"),
    ):
        (folder / "LASER.txt").write_text(broken, encoding="utf-8")
        with pytest.raises(DataError, match=rf"LASER\.txt: .*{message}"):
            load(folder)


def test_car_park_is_converted_to_metres_and_radians(tmp_path: Path) -> None:
    log = load(car_park(tmp_path))
    assert log.scans is not None and log.scans.intensities is not None
    assert log.scans.ranges_m[0, 90] == np.float32(9.0) and log.scans.intensities[0, 90] == 3.0
    assert log.scans.ranges_m[0, 0] >= log.scans.geometry.max_range_m
    np.testing.assert_allclose(log.controls.values[0], [100 * 0.024970 * 0.79, 0.0042])
    assert log.truth_trajectory is not None and not log.truth_trajectory.heading_known
    np.testing.assert_allclose(log.truth_trajectory.T_world_robot[:, :2], 0.0, atol=1e-6)
    assert log.truth_landmarks is not None and not log.truth_landmarks.complete


def test_car_park_faults_name_the_file(tmp_path: Path) -> None:
    folder = car_park(tmp_path)
    with pytest.raises(DataError, match=r"juan1_etc\.mat: the file is missing"):
        load(folder, run=1)
    scipy.io.savemat(
        folder / "juan3_lsr2.mat", {"LASER": np.zeros((2, 7), np.uint16), "TLsr": np.zeros((2, 1))}
    )
    with pytest.raises(DataError, match=r"juan3_lsr2\.mat: LASER: got shape \(2, 7\), expected rows of 361"):
        load(folder)
    (folder / "juan3_etc.mat").write_bytes(b"no MATLAB file")
    with pytest.raises(DataError, match=r"juan3_etc\.mat: is no readable MATLAB file"):
        load(folder)

"""Where logs lie: layouts of MR.CLAM, folders of folders, and what is refused by name."""

from __future__ import annotations

import gzip
from pathlib import Path

import numpy as np
import pytest
from fastslam.datasets import FORMATS, load
from fastslam.datasets.utias import FIRST_SET_BARCODES, FIRST_SET_SPAN_S
from fastslam.errors import DataError
from fastslam.log import Log

LANDMARKS = "11 1.0 2.0 0.1 0.1\n17 3.0 4.0 0.1 0.1\n"
SHARED = {"Barcodes": "1 5\n11 18\n17 61\n", "Landmark_Groundtruth": LANDMARKS}
OWN = {
    "Odometry": "10.0 0.1 0.2\n10.1 0.1 0.2\n",
    "Measurement": "10 18 1.5 0.1\n10 61 2.5 -0.1\n",
    "Groundtruth": "10 0 0 0.5\n10.1 0 0 0.5\n",
}


def write(folder: Path, files: dict[str, str]) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    for name, content in files.items():
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_text(content)
    return folder


def names(log: Log) -> list[str]:
    return [log.identity_names[index] for index in log.sightings.identity]


def layout(form: str, *, own: dict[str, str] = OWN, shared: dict[str, str] = SHARED) -> dict[str, str]:
    """The files of one robot as a layout names them; `form` has {} for the kind of the robot's own files."""
    prefix = form.partition("Robot")[0] if "/" not in form else ""
    together = {f"{prefix.removesuffix('{}.dat')}{kind}.dat": content for kind, content in shared.items()}
    return together | {form.format(kind): content for kind, content in own.items()}


LAYOUTS = {
    "as published": ("Robot3_{}.dat", 3),
    "with a prefix": ("ds1_{}.dat", None),
    "prefix and robot": ("ds1_Robot3_{}.dat", 3),
    "bare": ("{}.dat", None),
    "a folder for each robot": ("Robot3/{}.dat", 3),
    "names within a folder for each": ("Robot3/Robot3_{}.dat", 3),
}


@pytest.mark.parametrize("name", LAYOUTS)
def test_layouts_of_mrclam_read_the_same(tmp_path: Path, name: str) -> None:
    form, robot = LAYOUTS[name]
    folder = write(tmp_path / "course", layout(form))
    log = load(folder, robot=robot)
    assert log.format == "utias" and names(log) == ["11", "17"]
    assert log.name == ("course" if robot is None else "course_robot3")
    np.testing.assert_array_equal(log.controls.values, [[0.1, 0.2], [0.1, 0.2]])
    assert log.truth_trajectory is not None and log.config["initial_pose"]["heading_rad"] == 0.5
    for file in list(folder.rglob("*.dat")):
        file.with_name(f"{file.name}.gz").write_bytes(gzip.compress(file.read_bytes()))
        file.unlink()
    assert names(load(folder, robot=robot)) == ["11", "17"]


def test_one_robot_in_a_folder_takes_the_table_from_above(tmp_path: Path) -> None:
    folder = write(tmp_path / "set", layout("Robot2/{}.dat"))
    assert names(load(folder / "Robot2")) == ["11", "17"]


def test_control_is_another_word_for_odometry(tmp_path: Path) -> None:
    files = layout("ds0_{}.dat")
    files["ds0_Control.dat"] = files.pop("ds0_Odometry.dat")
    assert names(load(write(tmp_path / "ds0", files))) == ["11", "17"]


def test_two_data_sets_in_one_folder_are_told_apart_by_the_odometry_file(tmp_path: Path) -> None:
    second = {**OWN, "Measurement": "10 61 4.5 0.1\n"}
    folder = write(tmp_path / "both", layout("ds0_{}.dat") | layout("ds1_{}.dat", own=second))
    with pytest.raises(
        DataError, match=r"several data sets: name the .* \(ds0_Odometry\.dat, ds1_Odometry\.dat\)"
    ):
        load(folder)
    log = load(folder / "ds1_Odometry.dat")
    assert (log.name, names(log)) == ("ds1_Odometry", ["17"])


@pytest.mark.parametrize("missing", ["Barcodes", "Landmark_Groundtruth", "Measurement"])
def test_missing_file_is_named_with_all_that_are_wanted(tmp_path: Path, missing: str) -> None:
    files = {name: content for name, content in layout("ds1_{}.dat").items() if missing not in name}
    wanted = r"wanted: Barcodes\.dat, Landmark_Groundtruth\.dat, Odometry\.dat, Measurement\.dat"
    with pytest.raises(
        DataError, match=rf"the file {missing}\.dat \(or {missing}\.dat\.gz\) is missing; {wanted}"
    ):
        load(write(tmp_path / "course", files))


def test_swap_of_data_set_1_is_known_by_table_or_time(tmp_path: Path) -> None:
    """Neither folder is called so; a table that only has the two barcodes, at another time, is left alone."""
    table = "".join(f"{subject} {barcode}\n" for subject, barcode in FIRST_SET_BARCODES.items())
    by_table = write(tmp_path / "a", layout("ds1_{}.dat", shared={**SHARED, "Barcodes": table}))
    early_s = FIRST_SET_SPAN_S[0] + 100
    own = {"Odometry": f"{early_s!r} 0.1 0.2\n", "Measurement": OWN["Measurement"]}
    by_time = write(tmp_path / "b", layout("ds1_{}.dat", own=own))
    other = write(tmp_path / "c", layout("ds1_{}.dat"))
    assert (names(load(by_table)), names(load(other))) == (["17", "11"], ["11", "17"])
    assert names(load(by_time)) == ["17", "11"]
    assert load(by_table).problems[0].message.startswith("barcodes of subjects 11 and 17, swapped")


def test_true_poses_that_are_no_numbers_are_left_out(tmp_path: Path) -> None:
    own = {**OWN, "Groundtruth": "9 0 0 nan\n9.5 0 0 1e999\n10 1 2 0.5\n"}
    log = load(write(tmp_path / "course", layout("ds1_{}.dat", own=own)))
    assert log.truth_trajectory is not None and log.truth_trajectory.stamp_s.tolist() == [10.0]
    own = {**OWN, "Groundtruth": "9 0 0 nan\n"}
    with pytest.raises(DataError, match=r"ds1_Groundtruth\.dat: holds no pose without NaN"):
        load(write(tmp_path / "broken", layout("ds1_{}.dat", own=own)))


def test_only_log_below_a_folder_stands_for_it(tmp_path: Path) -> None:
    write(tmp_path / "unpacked" / "MRCLAM" / "MRCLAM_Dataset3", layout("Robot1_{}.dat"))
    write(tmp_path / "unpacked" / "__MACOSX" / "MRCLAM_Dataset3", layout("Robot1_{}.dat"))
    log = load(tmp_path / "unpacked")
    assert log.name == "MRCLAM_Dataset3_robot1" and log.source.endswith("MRCLAM_Dataset3")
    # Nobody has to guess which one it was.
    assert log.notes[0] == f"read {log.source}, the only log in {tmp_path / 'unpacked'}"
    assert not any(note.startswith("read ") for note in load(log.source).notes)


def test_folder_of_several_logs_lists_them(tmp_path: Path) -> None:
    for number in range(12):
        write(tmp_path / "all" / f"set{number:02}", layout("Robot1_{}.dat"))
    (tmp_path / "all" / "z.g2o").write_text("EDGE_SE2 0 1 1 0 0\n")
    with pytest.raises(DataError, match=r"holds 13 logs, name one: set00, set01, .*set09 and 3 more$"):
        load(tmp_path / "all")
    with pytest.raises(DataError, match=r"has no robot 1; robots there: none"):
        load(tmp_path / "all", format="utias")


def test_foreign_files_are_named_with_the_way_out(tmp_path: Path) -> None:
    for name, what in (
        ("a.rawlog", "an MRPT rawlog"),
        ("a.pcap", "a packet capture"),
    ):
        (tmp_path / name).write_bytes(b"\x00\x01")
        with pytest.raises(DataError) as caught:
            load(tmp_path / name)
        message = str(caught.value).removeprefix(f"{tmp_path / name}: ")
        expected = (
            f"is {what}, which is not read; read are {', '.join(FORMATS)}; docs/formats.md says how to "
        )
        assert message == expected + "convert others"
        assert len(message) < 240

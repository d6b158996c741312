"""The native log: what is written reads back, and every fault is reported with its place."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from fastslam.datasets import load, write_native
from fastslam.errors import DataError

VELOCITY_YAML = """\
format_version: 1
name: yard
motion: {model: velocity, speed_std_m_per_s: 0.1, yaw_rate_std_rad_per_s: 5e-2}
sensor: {model: range_bearing, range_std_m: 1e-1, bearing_std_rad: 0.02}
"""
VELOCITY_CSV = "stamp_s,speed_m_per_s,yaw_rate_rad_per_s\n0.0,1.0,0.1\n0.5,1.0,-0.1\n1.0,0.0,0.0\n"
SIGHTINGS_CSV = "stamp_s,range_m,bearing_rad,landmark_id,class\n0.25,2.0,0.5,007,cone\n0.25,3.0,-0.5,,\n"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A small, faultless native log."""
    path = tmp_path / "yard"
    path.mkdir()
    (path / "log.yaml").write_text(VELOCITY_YAML)
    (path / "odometry.csv").write_text(VELOCITY_CSV)
    (path / "sightings.csv").write_text(SIGHTINGS_CSV)
    return path


def test_small_log_is_read_as_written(folder: Path) -> None:
    log = load(folder)
    assert log.name == "yard"
    assert log.format == "native"
    np.testing.assert_array_equal(log.controls.values, [[1.0, 0.1], [1.0, -0.1], [0.0, 0.0]])
    assert log.identity_names == ("007",)
    assert log.class_names == ("cone",)
    np.testing.assert_array_equal(log.sightings.identity, [0, -1])
    np.testing.assert_array_equal(log.sightings.class_index, [0, -1])
    assert log.config["motion"]["yaw_rate_std_rad_per_s"] == 0.05
    assert log.problems == ()


def test_wrong_unit_says_got_and_expected(folder: Path) -> None:
    (folder / "sightings.csv").write_text("stamp_s,range_cm,bearing_rad\n0.0,1.0,0.0\n")
    with pytest.raises(DataError, match=r"sightings.csv:1: .*got range_cm, expected range_m"):
        load(folder)


def test_written_log_is_not_overwritten(folder: Path) -> None:
    with pytest.raises(DataError, match="not an empty folder"):
        write_native(load(folder), folder)

"""A stamp that is wrong is an error that names its row, never an allocation or a loop of its size."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from fastslam import load, run
from fastslam.datasets.clean import clean_controls
from fastslam.errors import ConfigError, DataError
from fastslam.log import Controls
from small_log import make_small_log, write_small_log

SINCE_1970 = {
    1.7643132005e12: "milliseconds?",
    1.7643132005e15: "microseconds?",
    1.7643132005e18: "nanoseconds?",
}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return write_small_log(tmp_path / "log", steps=60)


@pytest.mark.parametrize("name", ["odometry.csv", "sightings.csv"])
@pytest.mark.parametrize("stamp", [1764313200.5, -4e9, *SINCE_1970, 1e300])
def test_one_wrong_stamp_is_named_with_its_line(folder: Path, name: str, stamp: float) -> None:
    path = folder / name
    lines = path.read_text().splitlines()
    for position in (1, len(lines) // 2, len(lines) - 1):
        cells = lines[position].split(",")
        changed = [*lines[:position], ",".join([repr(stamp), *cells[1:]]), *lines[position + 1 :]]
        path.write_text("\n".join(changed) + "\n")
        with pytest.raises(DataError) as raised:
            load(folder)
        message = str(raised.value)
        assert message.startswith(f"{path}:{position + 1}: "), message
        says = "are no seconds" if stamp > 1e11 else f"the stamp {stamp:.15g} lies"
        assert says in message, message


@pytest.mark.parametrize("stamp", SINCE_1970)
def test_every_reader_refuses_stamps_that_are_no_seconds(stamp: float) -> None:
    for place in (0, 2):
        stamps = np.array([1.0, 2.0, 3.0])
        stamps[place] = stamp
        with pytest.raises(DataError) as raised:
            clean_controls(stamps, np.zeros((3, 2)), path=Path("some.txt"))
        message = str(raised.value)
        assert message.startswith(f"some.txt: row {place + 1}: the stamp {stamp:.15g} is beyond"), message
        assert SINCE_1970[stamp] in message


def test_a_whole_file_in_another_unit_is_told_by_its_first_row(folder: Path) -> None:
    path = folder / "sightings.csv"
    header, *rows = path.read_text().splitlines()
    scaled = [f"{1e9 * (1.7e9 + float(row.split(',')[0]))!r},{row.split(',', 1)[1]}" for row in rows]
    path.write_text("\n".join([header, *scaled]) + "\n")
    with pytest.raises(DataError, match=r"sightings\.csv:2: .* no seconds"):
        load(folder)


def test_the_smaller_part_is_the_wrong_one(folder: Path) -> None:
    path = folder / "odometry.csv"
    header, *rows = path.read_text().splitlines()
    moved = [f"{float(row.split(',')[0]) + 1e8!r},{row.split(',', 1)[1]}" for row in rows[:5]]
    path.write_text("\n".join([header, *moved, *rows[5:]]) + "\n")
    says = r"odometry\.csv:2: the stamp 100000000 lies 1e\+08 s from the 56 other rows"
    with pytest.raises(DataError, match=says):
        load(folder)


@pytest.mark.parametrize("stamp", [1e9, 1.7e18, 1e300])
def test_arrays_with_a_wrong_stamp_are_refused_by_the_core(stamp: float) -> None:
    log = make_small_log(steps=60)
    wrong = log.controls.stamp_s.copy()
    wrong[-1] = stamp
    says = r"the gap from (control 59|sighting 71), at (5\.9|6)\S* s to control 60, at .*seconds\?"
    with pytest.raises(DataError, match=says):
        run(replace(log, controls=Controls(wrong, log.controls.values)))


@pytest.mark.parametrize("period", [1e-300, 1e-12, 1e-7])
def test_a_period_far_too_short_is_an_error_at_once(period: float) -> None:
    started = time.monotonic()
    with pytest.raises((DataError, ConfigError), match="path_period_s"):
        run(make_small_log(steps=60), {"filter": {"path_period_s": period, "particles": 5}})
    assert time.monotonic() - started < 2.0


def test_stamps_since_1970_are_sound() -> None:
    log = make_small_log(steps=60)
    shift_s = 1764313200.5
    late = replace(
        log,
        controls=Controls(log.controls.stamp_s + shift_s, log.controls.values),
        sightings=replace(log.sightings, stamp_s=log.sightings.stamp_s + shift_s),
    )
    result = run(late, {"filter": {"particles": 10}})
    assert len(result.steps.stamp_s) >= 12 and np.isfinite(result.trajectory.T_world_robot).all()

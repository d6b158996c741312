"""Each bad input that a user can hand over ends in one line, an exit code, and no traceback."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from cli_runner import fastslam
from fastslam.resultfiles import read_result
from small_log import write_small_log


@pytest.fixture
def log(tmp_path: Path) -> Path:
    return write_small_log(tmp_path / "log", steps=60)


def replace(path: Path, old: str, new: str) -> None:
    text = path.read_text()
    assert old in text, (path, old)
    path.write_text(text.replace(old, new, 1))


def append(path: Path, text: str) -> None:
    with path.open("a") as file:
        file.write(text)


def cut_last_line(path: Path) -> None:
    path.write_text(path.read_text().rstrip("\n").rpartition(",")[0])


FATAL: dict[str, tuple[Callable[[Path], object], int, str]] = {
    "missing file": (lambda log: (log / "odometry.csv").unlink(), 1, "odometry.csv"),
    "empty file": (lambda log: (log / "sightings.csv").write_text(""), 1, "sightings.csv:1"),
    "empty log": (
        lambda log: (log / "odometry.csv").write_text("stamp_s,speed_m_per_s,yaw_rate_rad_per_s\n"),
        1,
        "odometry.csv",
    ),
    "unit in the header": (
        lambda log: replace(log / "sightings.csv", "bearing_rad", "bearing_m"),
        1,
        "sightings.csv:1: column bearing_m: got the unit m, expected rad",
    ),
    "unknown column in the header": (
        lambda log: replace(log / "odometry.csv", "speed_m_per_s", "weather"),
        1,
        "odometry.csv:1",
    ),
    "truncated file": (lambda log: cut_last_line(log / "sightings.csv"), 1, "sightings.csv:"),
    "text where a number belongs": (
        lambda log: append(log / "odometry.csv", "99.0,fast,0.0\n"),
        1,
        "got 'fast', expected a number",
    ),
    "unknown key in the log": (
        lambda log: replace(log / "log.yaml", "motion:", "moton: 3\nmotion:"),
        1,
        "did you mean motion?",
    ),
    "unknown setting in the log": (
        lambda log: replace(log / "log.yaml", "range_std_m:", "rnge_std_m:"),
        2,
        "sensor.rnge_std_m: unknown key; did you mean sensor.range_std_m?",
    ),
    "zero noise in the log": (
        lambda log: replace(log / "log.yaml", "range_std_m: 0.05", "range_std_m: 0.0"),
        2,
        "sensor.range_std_m",
    ),
    "no sensor": (lambda log: (log / "log.yaml").write_text("format_version: 1\n"), 1, "log.yaml"),
    "broken YAML": (lambda log: append(log / "log.yaml", "name: [\n"), 1, "log.yaml:"),
    "binary file": (lambda log: (log / "odometry.csv").write_bytes(b"\xff\xfe\x00"), 1, "odometry.csv"),
}


@pytest.mark.parametrize("case", FATAL)
def test_unusable_log_is_refused_with_its_place(log: Path, tmp_path: Path, case: str) -> None:
    spoil, exit_code, contains = FATAL[case]
    spoil(log)
    out = tmp_path / "out"
    outcome = fastslam("run", log, "--out", out)
    outcome.assert_one_line_error(exit_code=exit_code, contains=contains)
    assert str(log) in outcome.stderr
    assert not out.exists(), "a refused log leaves no results folder"


REPAIRED: dict[str, tuple[Callable[[Path], object], str]] = {
    "NaN": (lambda log: append(log / "sightings.csv", "6.0,nan,0.1,post0\n"), "NaN"),
    "NaN in the odometry": (lambda log: append(log / "odometry.csv", "6.05,nan,0.1\n"), "NaN"),
    "unsorted stamps": (lambda log: append(log / "sightings.csv", "5.5,4.0,0.1,\n"), "time order"),
    "duplicate stamps": (lambda log: append(log / "odometry.csv", "6.0,1.0,0.25\n"), "repeated stamp"),
    "landmark at the sensor": (lambda log: append(log / "sightings.csv", "6.0,0.0,0.1,post0\n"), "zero"),
}


@pytest.mark.parametrize("case", REPAIRED)
def test_blemish_is_counted_and_the_run_goes_on(log: Path, tmp_path: Path, case: str) -> None:
    spoil, note = REPAIRED[case]
    spoil(log)
    out = tmp_path / "out"
    outcome = fastslam("run", log, "--out", out, "--no-report", "--particles", "10")
    assert outcome.exit_code == 0, outcome.stderr
    notes = [line for line in outcome.stderr.splitlines() if line.startswith("note: ")]
    assert len(notes) == 1 and note in notes[0] and "(1)" in notes[0], outcome.stderr
    result = read_result(out)
    assert np.isfinite(result.trajectory.T_world_robot).all()
    assert np.isfinite(result.landmarks.mean_m).all()


def test_landmark_a_hair_from_the_sensor_poisons_nothing(log: Path, tmp_path: Path) -> None:
    append(log / "sightings.csv", "6.0,1e-12,0.1,post0\n")
    out = tmp_path / "out"
    outcome = fastslam("run", log, "--out", out, "--no-report", "--particles", "10")
    assert outcome.exit_code == 0, outcome.stderr
    assert np.isfinite(read_result(out).landmarks.covariance_m2).all()


@pytest.mark.parametrize(
    ("arguments", "exit_code", "contains"),
    [
        (("--set", "sensor.range_std_m=0"), 2, "sensor.range_std_m"),
        (("--set", "sensor.range_std_m=.nan"), 2, "sensor.range_std_m: must be a finite number, got nan"),
        (("--set", "sensor.rnge_std_m=1"), 2, "did you mean sensor.range_std_m?"),
        (("--set", "seed"), 2, "seed: expected key=value"),
        (("--particles", "0"), 2, "filter.particles"),
        (("--store", "cupboard"), 2, "filter.store"),
        (("--algorithm", "fastslam9"), 2, "algorithm"),
        (("--association", "guessed"), 2, "association.mode"),
        (("--seed", "-1"), 2, "seed"),
        (("--format", "utias"), 1, "robots there: none"),
        (("--format", "victoria_prak"), 1, "did you mean victoria_park?"),
        (("--robot", "3"), 1, "robot"),
        (("--config", "nosuch.yaml"), 2, "nosuch.yaml: does not exist"),
    ],
)
def test_bad_argument_is_one_line(
    log: Path, tmp_path: Path, arguments: tuple[str, ...], exit_code: int, contains: str
) -> None:
    outcome = fastslam("run", log, "--out", tmp_path / "out", *arguments)
    outcome.assert_one_line_error(exit_code=exit_code, contains=contains)
    assert not (tmp_path / "out").exists()


def test_missing_log_and_unwritable_folder(log: Path, tmp_path: Path) -> None:
    fastslam("run", tmp_path / "nosuch").assert_one_line_error(exit_code=1, contains="nosuch: does not exist")
    blocked = tmp_path / "file"
    blocked.write_text("")
    fastslam("run", log, "--out", blocked / "out").assert_one_line_error(exit_code=1, contains="file/out")


def test_robot_that_is_not_there(tmp_path: Path, data_dir: Path) -> None:
    log = data_dir / "utias_mrclam" / "MRCLAM_Dataset1"
    fastslam("run", log, "--robot", "9", "--out", tmp_path / "out").assert_one_line_error(
        exit_code=1, contains="no robot 9; robots there: 1, 2, 3, 4, 5"
    )


@pytest.mark.parametrize("content", [None, {}, {"run.json": "{"}])
def test_eval_of_what_is_no_result(tmp_path: Path, content: dict[str, str] | None) -> None:
    folder = tmp_path / "result"
    if content is not None:
        folder.mkdir()
        for name, text in content.items():
            (folder / name).write_text(text)
    fastslam("eval", folder).assert_one_line_error(exit_code=1, contains=str(folder))

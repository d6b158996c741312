"""`fastslam detect`, and logs with scans on the command line."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import yaml
from cli_runner import fastslam
from fastslam import run
from fastslam.datasets import write_native
from fastslam.detection import detect
from fastslam.errors import ConfigError
from small_log import write_small_log
from test_detection import log_of_posts


@pytest.fixture
def posts(tmp_path: Path) -> Path:
    return write_native(log_of_posts(), tmp_path / "posts")


def test_detect_draws_a_scan(posts: Path, tmp_path: Path) -> None:
    out = tmp_path / "one.png"
    outcome = fastslam("detect", posts, "--scan", 2, "--out", out)
    assert outcome.exit_code == 0, outcome.stderr
    assert outcome.stdout.splitlines() == ["8 detections in 4 scans", str(out)]
    assert out.read_bytes()[:4] == b"\x89PNG"


def test_detect_writes_a_page_of_all_scans_with_its_settings(posts: Path, tmp_path: Path) -> None:
    page = tmp_path / "scans.html"
    outcome = fastslam("detect", posts, "--html", page, "--set", "trunks.max_range_m=7")
    assert outcome.stdout.splitlines() == ["4 detections in 4 scans", str(page)]
    assert "<html" in page.read_text() and not (tmp_path / "scan.png").exists()


def test_wrong_uses_of_detect_are_one_line(posts: Path, tmp_path: Path) -> None:
    out = tmp_path / "scan.png"
    fastslam("detect", posts, "--scan", 4, "--out", out).assert_one_line_error(
        exit_code=1, contains="scans 0 to 3"
    )
    fastslam("detect", posts, "--set", "trunk.x=1").assert_one_line_error(exit_code=2, contains="trunk")
    fastslam("detect", write_small_log(tmp_path / "log")).assert_one_line_error(
        exit_code=1, contains="no laser scans"
    )
    assert not out.exists()


def test_a_run_takes_settings_of_the_detector(posts: Path, tmp_path: Path) -> None:
    config = tmp_path / "robot.yaml"
    config.write_text("filter: {particles: 5}\ndetector: {trunks: {max_range_m: 7}}\n")
    outcome = fastslam("detect", posts, "--config", config, "--out", tmp_path / "one.png")
    assert outcome.stdout.startswith("4 detections"), "the same file as for a run"
    common = ("--no-report", "--no-auto", "--unexamined", "--out")
    counts = {}
    for name, given in {
        "plain": ("--particles", "5"),
        "file": ("--config", config),
        "flag": ("--particles", "5", "--set", "detector.trunks.max_range_m=7"),
    }.items():
        out = tmp_path / name
        outcome = fastslam("run", posts, *given, *common, out)
        assert outcome.exit_code == 0, outcome.stderr
        counts[name] = json.loads((out / "metrics.json").read_text())["sightings"]
        kept = yaml.safe_load((out / "config.yaml").read_text())
        assert ("detector" in kept) == (name != "plain")
        reach_m = kept["sensor"]["max_range_m"]
        assert reach_m < 8.5 if name != "plain" else reach_m > 8.5
    assert counts == {"plain": 8, "file": 4, "flag": 4}
    # What a run leaves makes the same run again, and so does the package.
    outcome = fastslam(
        "run", posts, "--config", tmp_path / "file" / "config.yaml", *common, tmp_path / "again"
    )
    assert outcome.exit_code == 0, outcome.stderr
    for name in ("landmarks.csv", "config.yaml"):
        assert (tmp_path / "again" / name).read_bytes() == (tmp_path / "file" / name).read_bytes()
    result = run(posts, config, auto=False)
    assert result.config["detector"] == {"trunks": {"max_range_m": 7}} and result.steps.sightings.sum() == 4


@pytest.mark.parametrize("command", ["run", "tune", "calibrate", "localize", "doctor"])
def test_settings_of_a_detector_where_there_is_nothing_to_detect_are_one_line(
    command: str, tmp_path: Path
) -> None:
    log, chart = write_small_log(tmp_path / "log"), tmp_path / "map.csv"
    chart.write_text("id,x_m,y_m\npost0,4,1\n")
    options = ("--map", chart) if command == "localize" else ()
    outcome = fastslam(command, log, *options, "--set", "detector.kind=corners")
    outcome.assert_one_line_error(exit_code=2, contains="detector: the log has no laser scans in which")


def test_a_log_with_scans_and_sightings_detects_nothing() -> None:
    both = detect(log_of_posts())
    assert both.scans is not None
    with pytest.raises(ConfigError, match="detector: the log has sightings already"):
        run(both, {"detector": {"trunks": {"max_range_m": 7.0}}})
    # What the sightings were made with is no contradiction.
    made = detect(log_of_posts(), {"trunks": {"max_range_m": 7.0}})
    assert made.scans is not None and made.scans.detector["trunks"]["max_range_m"] == 7.0
    assert run(made, {"detector": {"trunks": {"max_range_m": 7.0}}}, auto=False).steps.sightings.sum() == 4


def test_info_tells_of_scans(posts: Path) -> None:
    outcome = fastslam("info", posts)
    assert "laser scans" in outcome.stdout and "beams per scan" in outcome.stdout
    assert "361" in outcome.stdout


def test_a_run_number_where_there_are_no_runs_is_an_error(posts: Path) -> None:
    fastslam("info", posts, "--run", 3).assert_one_line_error(exit_code=1, contains="know no option run")


def test_the_run_of_a_log_is_remembered(data_dir: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    car_park = data_dir / "car_park"
    ran = fastslam("run", car_park, "--run", 3, "--particles", 10, "--no-report", "--out", out)
    assert ran.exit_code == 0, ran.stderr
    assert fastslam("eval", out).exit_code == 0
    fastslam("run", car_park, "--run", 8, "--out", out).assert_one_line_error(exit_code=1, contains="juan8")

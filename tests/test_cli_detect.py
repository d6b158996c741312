"""`fastslam detect`, and logs with scans on the command line."""

from __future__ import annotations

from pathlib import Path

import pytest
from cli_runner import fastslam
from fastslam.datasets import write_native
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

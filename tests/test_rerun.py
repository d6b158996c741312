"""A folder holds the files of one run; cells are no formulas; disks may be full."""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from cli_runner import fastslam
from fabricate import make_log, make_map, make_run
from fastslam import load
from fastslam.csv_cells import guarded, unguarded
from fastslam.datasets import write_native
from fastslam.errors import DataError
from fastslam.log import TruthLandmarks
from fastslam.plots import make_figures
from fastslam.resultfiles import FIGURES, OWN_FILES, read_result, write_result
from hypothesis import given
from hypothesis import strategies as st
from small_log import make_small_log, write_small_log

QUICK = ("--particles", "10")


@pytest.fixture
def log(tmp_path: Path) -> Path:
    return write_small_log(tmp_path / "log", steps=60)


def test_a_second_run_leaves_no_file_of_the_first(log: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    assert fastslam("run", log, "--out", out, "--runs", "2", "--figures", *QUICK).exit_code == 0
    first = {path.name for path in out.iterdir()}
    assert {"runs.json", "report.html", "map.png", "log.json"} <= first <= set(OWN_FILES)
    (out / "notes.txt").write_text("mine")
    (out / "frames").mkdir()
    (out / "map.svg").write_text("mine too")
    assert fastslam("run", log, "--out", out, "--no-report", "--seed", "5", *QUICK).exit_code == 0
    left = {path.name for path in out.iterdir()}
    assert left == (first - {"runs.json", "report.html", *(f"{name}.png" for name in FIGURES)}) | {
        *("notes.txt", "frames", "map.svg")
    }
    assert read_result(out).config["seed"] == 5
    assert (out / "notes.txt").read_text() == "mine"


def test_a_run_that_fails_leaves_the_older_one_whole(log: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    assert fastslam("run", log, "--out", out, "--no-report", *QUICK).exit_code == 0
    before = {path.name: path.read_bytes() for path in out.iterdir()}
    assert len(before) >= 9
    broken = tmp_path / "broken"
    other = replace(make_small_log(steps=60), name="other")
    write_native(other, broken)
    (broken / "odometry.csv").write_text(
        "stamp_s,speed_m_per_s,yaw_rate_rad_per_s\n0.0,1.0,0.0\n4e6,1.0,0.0\n"
    )
    outcome = fastslam("run", broken, "--out", out, "--no-report", "--set", "filter.path_period_s=0.01")
    outcome.assert_one_line_error(exit_code=1, contains="to control 1, at 4000000")
    assert {path.name: path.read_bytes() for path in out.iterdir()} == before


def test_the_list_of_own_files_is_complete() -> None:
    assert tuple(make_figures(make_run(), make_log())) == FIGURES


def test_a_disk_that_fills_up_leaves_the_older_run_whole(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_result(make_run(), make_log(), tmp_path)
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    real, written = Path.write_bytes, []

    def fills_up(self: Path, data: bytes) -> int:
        written.append(self)
        if len(written) == 4:
            raise OSError(28, "No space left on device")
        return real(self, data)

    monkeypatch.setattr(Path, "write_bytes", fills_up)
    with pytest.raises(DataError, match="cannot write: No space left on device"):
        write_result(make_run(), make_log(), tmp_path)
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before and len(before) == 8


def limited(*arguments: object, size: int) -> subprocess.CompletedProcess[str]:
    """Runs the command line where no file may grow beyond a size, as on a full disk."""
    code = (
        "import resource, signal, sys\n"
        "signal.signal(signal.SIGXFSZ, signal.SIG_IGN)\n"
        f"resource.setrlimit(resource.RLIMIT_FSIZE, ({size}, {size}))\n"
        "from fastslam._entry import main\n"
        "sys.argv[0] = 'fastslam'\n"
        "main()\n"
    )
    environment = {**os.environ, "PYTHONDONTWRITEBYTECODE": "1"}
    command = [sys.executable, "-c", code, *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, env=environment, check=False)


@pytest.mark.skipif(sys.platform == "win32", reason="there are no such limits")
def test_simulate_to_a_full_disk_says_so_in_a_line(tmp_path: Path) -> None:
    outcome = limited("simulate", tmp_path / "log", "--landmarks", "20", size=2000)
    assert outcome.returncode == 1 and outcome.stdout == ""
    assert len(outcome.stderr.splitlines()) == 1, outcome.stderr
    assert "odometry.csv: cannot write: File too large" in outcome.stderr.replace("\n", "")
    assert [path.name for path in (tmp_path / "log").iterdir()] == []


def test_simulate_to_where_nothing_can_be_written(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    outcome = fastslam("simulate", tmp_path / "file" / "log", "--landmarks", "20")
    outcome.assert_one_line_error(exit_code=1, contains="cannot write: Not a directory")
    if Path("/proc/version").exists():
        outcome = fastslam("simulate", "/proc/no-such-log", "--landmarks", "20")
        outcome.assert_one_line_error(exit_code=1, contains="/proc/no-such-log: cannot write: ")


FORMULAS = ("=1+1", "+cmd", "-2+3", "@SUM(A1)", "'=x", "''=x", "=", '=HYPERLINK("a","b")')
HARMLESS = ("oak", "-1", "+5", "-1e3", "'oak", "a=b", "7")


def test_names_that_look_like_formulas_are_guarded_and_come_back(tmp_path: Path) -> None:
    assert all(guarded(name) == f"'{name}" for name in FORMULAS)
    assert all(guarded(name) == name for name in HARMLESS)
    names = (*FORMULAS, *HARMLESS)
    points = np.column_stack([np.arange(len(names), dtype=float), np.zeros(len(names))])
    write_result(make_run(landmarks=make_map(names, points)), make_log(truth=False), tmp_path / "out")
    lines = (tmp_path / "out" / "landmarks.csv").read_text().splitlines()[1:]
    assert len(lines) == len(names)
    assert not [line for line in lines if line.lstrip('"')[:1] in ("=", "@", "\t")]
    assert read_result(tmp_path / "out").landmarks.ids == names
    log = replace(
        make_small_log(steps=30),
        identity_names=names[:6],
        truth_landmarks=TruthLandmarks(names, points),
    )
    back = load(write_native(log, tmp_path / "native"))
    assert set(back.identity_names) == set(names[:6])
    assert back.truth_landmarks is not None and back.truth_landmarks.names == names


@given(st.text())
def test_guarding_is_undone_for_any_text(text: str) -> None:
    assert unguarded(guarded(text)) == text or text.startswith("'")
    if not text.startswith("'"):
        assert not guarded(text).startswith(("=", "@", "\t"))


@given(st.text(alphabet="'=+-@a1", max_size=6))
def test_guarding_is_undone_where_apostrophes_come_first(text: str) -> None:
    assert unguarded(guarded(text)) == text

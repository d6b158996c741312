"""The experiments behind the published figures run, and print what they promise."""

from __future__ import annotations

import runpy
from pathlib import Path

import pytest
from doc_pages import ROOT

SCRIPT = ROOT / "experiments" / "real_logs" / "run.py"


def table(output: str) -> list[list[str]]:
    return [[cell.strip() for cell in line.strip("| ").split("|")] for line in output.splitlines()]


def test_table_of_the_real_logs(
    data_dir: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("FASTSLAM_DATA", str(data_dir))
    runpy.run_path(str(SCRIPT))["main"](["--seeds", "1", "--only", "UTIAS 2, robot 1"])
    header, _, *rows = table(capsys.readouterr().out)
    assert [row[1] for row in rows] == ["known", "unknown"]
    known = dict(zip(header, rows[0], strict=True))
    # Every landmark found, within the error that a plain EKF makes on the worst of these logs.
    assert known["matched"] == known["in map"] == "15"
    assert 0.0 < float(known["map [m]"]) < 0.16


def test_an_absent_log_is_listed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("FASTSLAM_DATA", str(tmp_path))
    runpy.run_path(str(SCRIPT))["main"]([])
    _, _, *rows = table(capsys.readouterr().out)
    assert len(rows) == 18 and all(row[1].startswith("absent") for row in rows)

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
    runpy.run_path(str(SCRIPT))["main"](["--seeds", "1", "--only", "Lost in the Woods"])
    header, _, *rows = table(capsys.readouterr().out)
    assert [row[1] for row in rows] == ["known", "unknown"]
    column = header.index("map [m]")
    assert all(0.0 < float(row[column]) < 0.1 for row in rows)


def test_an_absent_log_is_listed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("FASTSLAM_DATA", str(tmp_path))
    runpy.run_path(str(SCRIPT))["main"]([])
    _, _, *rows = table(capsys.readouterr().out)
    assert len(rows) == 18 and all(row[1].startswith("absent") for row in rows)

"""The experiments behind the published figures run, and print what they promise."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from doc_pages import ROOT

SCRIPT = ROOT / "experiments" / "accuracy" / "run.py"


def run_script(*arguments: str, data: Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, str(SCRIPT), *arguments]
    environment = {**os.environ, "FASTSLAM_DATA": str(data)}
    return subprocess.run(command, capture_output=True, text=True, env=environment, check=False)


@pytest.mark.slow
def test_accuracy_table(data_dir: Path) -> None:
    done = run_script("--seeds", "1", "--only", "UTIAS 2 robot 1", data=data_dir)
    assert done.returncode == 0, done.stderr
    lines = [line for line in done.stdout.splitlines() if line.startswith("|")]
    header, _, *rows = [[cell.strip() for cell in line.split("|")[1:-1]] for line in lines]
    assert [row[1] for row in rows] == ["known", "unknown"]
    known = dict(zip(header, rows[0], strict=True))
    # Every landmark found, within the error that is asked of this log.
    assert known["found"] == "15 (15) of 15"
    assert 0.0 < float(known["map [m]"].split()[0]) < 0.16
    # Nearly all without identities, by the log's own settings; 1.3 times the batch figure of sets 1 and 2.
    unknown = dict(zip(header, rows[1], strict=True))
    assert int(unknown["found"].split()[0]) >= 14
    assert 0.0 < float(unknown["map [m]"].split()[0]) < 1.3 * 0.079


def test_accuracy_without_the_logs_says_so(tmp_path: Path) -> None:
    done = run_script(data=tmp_path / "nowhere")
    assert done.returncode == 2
    assert "nowhere is no folder" in done.stderr and "Traceback" not in done.stderr

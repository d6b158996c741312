"""Exit codes of every command, and Ctrl-C at any moment."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import fastslam as package
import pytest
from cli_runner import fastslam
from fastslam.cli import app
from small_log import write_small_log
from typer.main import get_command

COMMAND = (sys.executable, "-m", "fastslam")
NOWHERE = "nosuch"
DONE: dict[str, tuple[str, ...]] = {
    "demo": ("--no-report", "--out", "{out}"),
    "run": ("{log}", "--no-report", "--out", "{out}", "--particles", "10"),
    "simulate": ("{out}", "--landmarks", "20"),
    "info": ("{log}",),
    "eval": ("{result}",),
    "compare": ("{result}", "--out", "{out}"),
    "config": ("dump",),
    "datasets": ("list",),
    "convert": ("{log}", "{out}"),
}
FAILED: dict[str, tuple[str, ...]] = {
    "demo": ("--no-report", "--out", "{file}/out"),
    "run": (NOWHERE, "--out", "{out}"),
    "simulate": ("{log}",),
    "info": (NOWHERE,),
    "eval": (NOWHERE,),
    "compare": (NOWHERE, "--out", "{out}"),
    "calibrate": (NOWHERE,),
    "detect": (NOWHERE,),
    "convert": (NOWHERE, "{out}"),
    "map": ("info", NOWHERE),
    "tune": (NOWHERE,),
    "doctor": (NOWHERE,),
    "localize": ("{log}", "--map", NOWHERE),
}
USAGE: dict[str, tuple[str, ...]] = {
    **{name: ("--no-such-option",) for name in (*DONE, "detect", "calibrate", "sweep", "reproduce")},
    "run": ("{log}", "--set", "filter.particles=0", "--out", "{out}"),
    "simulate": ("{out}", "--set", "no.such=1"),
    "localize": ("{log}", "--map", NOWHERE, "--start", "1,2"),
    "live": ("--in", "udp:9000"),
}


@pytest.fixture(scope="module")
def places(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    root = tmp_path_factory.mktemp("codes")
    log = write_small_log(root / "log", steps=60)
    (root / "file").write_text("")
    result = root / "result"
    assert fastslam("run", log, "--out", result, "--no-report", "--particles", "10").exit_code == 0
    return {"log": str(log), "result": str(result), "file": str(root / "file")}


def call(command: str, arguments: tuple[str, ...], places: dict[str, str], out: Path) -> tuple[int, str]:
    outcome = fastslam(command, *(text.format(**places, out=out) for text in arguments))
    return outcome.exit_code, outcome.stdout + outcome.stderr


@pytest.mark.parametrize("command", DONE)
def test_0_when_done(command: str, places: dict[str, str], tmp_path: Path) -> None:
    code, text = call(command, DONE[command], places, tmp_path / "out")
    assert code == 0, text


@pytest.mark.parametrize("command", FAILED)
def test_1_when_it_failed(command: str, places: dict[str, str], tmp_path: Path) -> None:
    code, text = call(command, FAILED[command], places, tmp_path / "out")
    assert code == 1 and text.startswith("error: ") and len(text.splitlines()) == 1, text


@pytest.mark.parametrize("command", USAGE)
def test_2_when_it_was_asked_wrongly(command: str, places: dict[str, str], tmp_path: Path) -> None:
    code, text = call(command, USAGE[command], places, tmp_path / "out")
    assert code == 2 and text.startswith("error: ") and len(text.splitlines()) == 1, text


def test_every_command_is_tried() -> None:
    commands = set(get_command(app).commands)  # type: ignore[attr-defined]
    assert commands == {*DONE, *FAILED, *USAGE}, commands


@pytest.mark.skipif(sys.platform == "win32", reason="no such signals")
def test_ctrl_c_while_the_program_loads_is_one_line() -> None:
    """From where the program's own code runs to its end: no traceback, and 130 unless it was done."""
    ended = set()
    for number in range(12):
        process = subprocess.Popen(
            [*COMMAND, "-h"], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True
        )
        time.sleep(0.1 + 0.1 * number)
        process.send_signal(signal.SIGINT)
        _, stderr = process.communicate(timeout=60)
        # Before it has read a line of ours, the interpreter itself ends in its own way.
        if process.returncode == -signal.SIGINT and not stderr:
            continue
        if "Traceback" in stderr and str(Path(package.__file__).parent) not in stderr:
            continue
        assert "Traceback" not in stderr, (number, stderr)
        assert (process.returncode, stderr) in ((0, ""), (130, "error: interrupted\n")), (number, stderr)
        ended.add(process.returncode)
    assert 130 in ended, ended


@pytest.mark.skipif(sys.platform == "win32", reason="no such files")
def test_a_reader_that_has_seen_enough_and_a_full_terminal() -> None:
    with open(os.devnull) as nothing:
        for shell in ("{} config dump | head -1", "{} config explain | head -1"):
            line = shell.format(" ".join(COMMAND))
            done = subprocess.run(
                line, shell=True, capture_output=True, text=True, stdin=nothing, check=False
            )
            assert "Traceback" not in done.stderr and "Exception" not in done.stderr, done.stderr
        if Path("/dev/full").exists():
            line = " ".join(COMMAND) + " datasets list > /dev/full"
            done = subprocess.run(
                line, shell=True, capture_output=True, text=True, stdin=nothing, check=False
            )
            assert "Traceback" not in done.stderr and "No space left" in done.stderr, done.stderr


def test_the_package_offers_its_names_without_loading_them_first() -> None:
    assert set(package.__all__) <= set(dir(package))
    for name in package.__all__:
        assert getattr(package, name) is not None
    assert package.datasets.load is package.load  # type: ignore[attr-defined]
    with pytest.raises(AttributeError, match="no attribute 'nonsense'"):
        _ = package.nonsense
    code = "import sys, fastslam; print('numpy' in sys.modules)"
    assert subprocess.check_output([sys.executable, "-c", code], text=True).strip() == "False"

"""Exit codes of every command, and Ctrl-C at any moment."""

from __future__ import annotations

import itertools
import os
import subprocess
import sys
from pathlib import Path

import fastslam as package
import pytest
from cli_runner import fastslam
from fastslam.cli import application
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
    "export": ("{result}", "{out}.tum"),
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
    "export": (NOWHERE, "{out}.mcap"),
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
    "export": ("{result}", "{out}.bag"),
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
    commands = set(get_command(application()).commands)  # type: ignore[attr-defined]
    assert commands == {*DONE, *FAILED, *USAGE}, commands


LOADING = """
import _signal, os, sys

class Interrupter:
    number = int(sys.argv.pop(1))
    looked_for = []

    def find_spec(self, name, path=None, target=None):
        by_default = _signal.getsignal(_signal.SIGINT) is _signal.default_int_handler
        self.looked_for.append("unprepared " * by_default + name)
        if len(self.looked_for) == self.number:
            os.kill(os.getpid(), _signal.SIGINT)

# A shell's background jobs begin with this signal ignored.
_signal.signal(_signal.SIGINT, _signal.default_int_handler)
sys.meta_path.insert(0, Interrupter())
from fastslam._entry import main
try:
    main()
finally:
    os.kill(os.getpid(), _signal.SIGINT)
    print(*Interrupter.looked_for, sep="\\n")
"""


def interrupted_at(number: int) -> subprocess.CompletedProcess[str]:
    """The program with a Ctrl-C where it looks for the module of a number, and with one when it is done."""
    command = [sys.executable, "-c", LOADING, str(number), "-h"]
    return subprocess.run(command, capture_output=True, text=True, check=False)


@pytest.mark.skipif(sys.platform == "win32", reason="no such signals")
def test_ctrl_c_while_the_program_loads_is_one_line() -> None:
    """From where the program's own code runs to its end: no traceback, and 130 unless it was done."""
    done = interrupted_at(0)
    assert (done.returncode, done.stderr) == (0, ""), done
    modules = done.stdout[done.stdout.index("unprepared fastslam") :].splitlines()
    early = list(itertools.takewhile(lambda line: line.startswith("unprepared "), modules))
    # Nothing that takes time comes before: the package's front door, and what `signal` loads.
    bare = [sys.executable, "-S", "-c", "import signal, sys, __future__; print(*sys.modules)"]
    allowed = {*subprocess.check_output(bare, text=True).split()}
    allowed |= {"fastslam", "fastslam._lazy", "fastslam._entry"}
    assert {line.removeprefix("unprepared ") for line in early} <= allowed, early
    assert len(modules) > 100 and "typer" in modules, modules
    for number in (*range(len(early) + 1, len(modules), len(modules) // 5), len(modules)):
        outcome = interrupted_at(number)
        ending = (outcome.returncode, outcome.stderr)
        assert ending == (130, "error: interrupted\n"), (modules[number - 1], outcome)


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

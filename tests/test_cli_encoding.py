"""Consoles that cannot write every sign, narrow ones, and output for other programs."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import fastslam as package
import pytest
from cli_runner import fastslam as in_process
from fastslam.cli.encoding import to_ascii
from fastslam.config import Config, load_config
from small_log import write_small_log


def run(*arguments: object, **env: str) -> subprocess.CompletedProcess[bytes]:
    """`python -m fastslam ARGUMENTS` in a process of its own, without a terminal, wherever the tests run."""
    command = [sys.executable, "-m", "fastslam", *(str(argument) for argument in arguments)]
    outer = {**os.environ, "TERM": "xterm"}
    done = subprocess.run(command, capture_output=True, env={**outer, **env}, check=False)
    assert done.returncode == 0, done.stderr
    assert b"Traceback" not in done.stderr
    return done


@pytest.mark.parametrize("encoding", ["cp1252", "ascii", "cp437", "utf-8"])
def test_a_dumped_configuration_can_be_read_whatever_the_code_page(encoding: str, tmp_path: Path) -> None:
    file = tmp_path / "settings.yaml"
    file.write_bytes(run("config", "dump", "--set", "filter.particles=7", PYTHONIOENCODING=encoding).stdout)
    settings = load_config(file)
    assert settings["filter"]["particles"] == 7
    assert dict(Config.resolve(settings)) == dict(Config.resolve({"filter": {"particles": 7}}))


@pytest.mark.parametrize("encoding", ["cp1252", "ascii"])
def test_tables_fall_back_to_ascii(encoding: str) -> None:
    text = run("config", "explain", PYTHONIOENCODING=encoding).stdout.decode(encoding)
    assert "filter.particles: 100\n" in text and "[M*weight]" in to_ascii(text)
    assert "?" not in text.replace("?)", "")
    table = run("datasets", "list", PYTHONIOENCODING=encoding).stdout.decode(encoding)
    assert "victoria_park" in table and "|" in table


def test_a_folder_whose_name_no_code_page_knows(tmp_path: Path) -> None:
    log = write_small_log(tmp_path / "log", steps=60)
    out = tmp_path / "out_λ→ü"
    text = run("run", log, "--out", out, "--no-report", PYTHONIOENCODING="cp1252").stdout.decode("cp1252")
    assert "out_?->ü" in text and (out / "metrics.json").exists()


def test_signs_in_ascii() -> None:
    assert to_ascii("σ ≤ 3 m² ± é, ⌊x⌋") == "sigma <= 3 m2 +- e, [x]"
    assert to_ascii("漢") == "?"
    assert to_ascii("plain") == "plain"


@pytest.mark.parametrize("columns", [60, 90])
def test_tables_follow_the_width_that_is_asked_for(columns: int) -> None:
    done = run("config", "explain", "filter", COLUMNS=str(columns), PYTHONIOENCODING="utf-8")
    widths = [len(line) for line in done.stdout.decode().splitlines()]
    assert len(widths) > 20 and columns - 15 < max(widths) <= columns


def test_no_color_and_the_module_name() -> None:
    assert run("--version").stdout.decode() == f"fastslam {package.__version__}\n"
    done = run("config", "explain", "seed", NO_COLOR="1", FORCE_COLOR="1", PYTHONIOENCODING="utf-8")
    assert b"seed" in done.stdout and b"\x1b[3" not in done.stdout


@pytest.mark.slow(but="arguments0")
@pytest.mark.parametrize("arguments", [("info", "LOG"), ("datasets", "list"), ("run", "LOG", "--no-report")])
def test_no_color_wins_over_force_color(arguments: tuple[str, ...], tmp_path: Path) -> None:
    log = write_small_log(tmp_path / "log", steps=60)
    words = [str(log) if word == "LOG" else word for word in arguments]
    if "run" in words:
        words += ["--out", str(tmp_path / "out"), "--particles", "5"]
    forced = run(*words, FORCE_COLOR="1", NO_COLOR="")
    assert b"\x1b[" in forced.stdout
    plain = run(*words, FORCE_COLOR="1", NO_COLOR="1")
    assert b"\x1b" not in plain.stdout + plain.stderr


def test_an_error_without_color() -> None:
    command = [sys.executable, "-m", "fastslam", "run", "nowhere"]
    both = {**os.environ, "FORCE_COLOR": "1", "NO_COLOR": "1"}
    done = subprocess.run(command, capture_output=True, env=both, check=False)
    assert done.returncode == 1 and done.stderr == b"error: nowhere: does not exist\n"


_OF_BASH = {"_TYPER_COMPLETE_TEST_DISABLE_SHELL_DETECTION": "1"}


def test_completion_is_shown_for_the_program() -> None:
    shown = run("--show-completion", "bash", **_OF_BASH).stdout
    assert b"complete -o" in shown and b"_FASTSLAM_COMPLETE=complete_bash" in shown
    assert shown.rstrip().endswith(b" fastslam")


def test_completion_is_installed_for_the_program(tmp_path: Path) -> None:
    (tmp_path / ".bashrc").write_text("# mine\n", encoding="utf-8")
    run("--install-completion", "bash", HOME=str(tmp_path), **_OF_BASH)
    script = tmp_path / ".bash_completions" / "fastslam.sh"
    assert "_FASTSLAM_COMPLETE" in script.read_text(encoding="utf-8")
    bashrc = (tmp_path / ".bashrc").read_text(encoding="utf-8")
    assert bashrc.startswith("# mine\n") and str(script) in bashrc
    asked = f"source {script}; COMP_WORDS=(fastslam conf) COMP_CWORD=1; _fastslam_completion fastslam; "
    place = tmp_path / "bin"
    place.mkdir()
    (place / "fastslam").write_text(
        f'#!/bin/sh\nexec "{sys.executable}" -m fastslam "$@"\n', encoding="utf-8"
    )
    (place / "fastslam").chmod(0o755)
    done = subprocess.run(
        ["bash", "-c", asked + 'echo "${COMPREPLY[@]}"'],
        capture_output=True,
        env={**os.environ, "PATH": f"{place}:{os.environ['PATH']}"},
        check=False,
    )
    assert done.stdout.split() == [b"config"], done.stderr


def test_json_loses_no_sign_whatever_the_code_page(tmp_path: Path) -> None:
    log = write_small_log(tmp_path / "log", steps=60)
    for file in ("sightings.csv", "truth_landmarks.csv"):
        text = (log / file).read_text(encoding="utf-8").replace("post0", "λ→𝄞")
        (log / file).write_text(text, encoding="utf-8")
    escaped = run("info", log, "--json", PYTHONIOENCODING="cp1252").stdout
    found = json.loads(escaped.decode("ascii"))
    assert found == json.loads(in_process("info", log, "--json").stdout)
    assert "λ→𝄞" in found["sightings_per_landmark"]


def test_eval_and_calibrate_print_one_object(tmp_path: Path) -> None:
    log, outs = write_small_log(tmp_path / "log", steps=120), [tmp_path / "one", tmp_path / "two"]
    for seed, out in enumerate(outs):
        in_process("run", log, "--out", out, "--no-report", "--particles", "10", "--seed", seed)
    one = json.loads(in_process("eval", outs[0], "--json").stdout)
    both = json.loads(in_process("eval", *outs, "--json").stdout)
    assert isinstance(one, dict) and set(both) == {"runs", "summary"}
    assert [entry["results"] for entry in both["runs"]] == [str(out) for out in outs]
    assert both["runs"][0]["metrics"] == one and both["summary"]["steps"]["runs"] == 2
    file = tmp_path / "found.yaml"
    few = ("--set", "filter.particles=10")
    told = json.loads(in_process("calibrate", log, "--out", file, *few, "--json").stdout)
    assert told["file"] == str(file) and load_config(file) == told["settings"]
    assert {"sightings", "landmarks", "parameters", "warnings"} <= set(told) and len(told["parameters"]) > 3


def test_run_prints_one_object(tmp_path: Path) -> None:
    log = write_small_log(tmp_path / "log", steps=120)
    done = run("run", log, "--out", tmp_path / "out", "--no-report", "--runs", "2", "--json")
    found = json.loads(done.stdout)
    assert found["results"] == str(tmp_path / "out") and found["report"] is None
    assert found["interrupted"] is False and isinstance(found["warnings"], list)
    assert found["metrics"] == json.loads((tmp_path / "out" / "metrics.json").read_text(encoding="utf-8"))
    assert len(found["runs"]) == 2 and found["runs"][0] == found["metrics"]

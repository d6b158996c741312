"""`fastslam info`, `config`, `datasets` and the top level."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import fastslam as package
import pytest
import typer
import yaml
from cli_runner import fastslam
from fastslam.cli import application
from fastslam.config import Config
from fastslam.datasets import FORMATS
from small_log import LANDMARKS_M, write_small_log


def test_version_and_help() -> None:
    assert fastslam("--version").stdout == f"fastslam {package.__version__}\n"
    commands = ("demo", "run", "simulate", "eval", "detect", "calibrate", "info", "config", "datasets")
    overview = fastslam().stdout
    assert all(re.search(rf"\b{command}\b", overview) for command in commands)


@pytest.mark.parametrize(
    "command", ["run", "simulate", "eval", "detect", "calibrate", "info", "config dump", "datasets download"]
)
def test_help_has_worked_examples(command: str) -> None:
    outcome = fastslam(*command.split(), "--help")
    assert outcome.exit_code == 0
    assert f"fastslam {command} " in outcome.stdout


def test_every_option_is_spelled_in_small_letters() -> None:
    # Some versions of typer take a metavar that equals the option's name in capitals for its name.
    group: Any = typer.main.get_command(application())
    commands = [
        command
        for entry in group.commands.values()
        for command in getattr(entry, "commands", {"": entry}).values()
    ]
    options = {
        option
        for command in commands
        for parameter in command.params
        for option in parameter.opts
        if option.startswith("-")
    }
    assert len(commands) > 10 and {"--out", "--format"} < options
    assert {option for option in options if option != option.lower()} == set()


def test_info_counts_what_is_in_the_log(tmp_path: Path) -> None:
    outcome = fastslam("info", write_small_log(tmp_path / "log", steps=300))
    assert outcome.exit_code == 0

    def row(name: str) -> str:
        found = re.search(rf"│ {name} +│ +(\S+) │ (\S*) *│", outcome.stdout)
        assert found is not None, outcome.stdout
        return f"{found[1]} {found[2]}".strip()

    assert row("duration").endswith(" s")
    assert row("controls") == "301"
    assert row("sightings") == str(60 * len(LANDMARKS_M))
    assert row("controls: rate").endswith(" Hz")
    assert row("true landmarks") == str(len(LANDMARKS_M))
    assert "post0: 60" in outcome.stdout
    assert "no problems found" in outcome.stdout


def test_info_lists_what_was_repaired(tmp_path: Path) -> None:
    log = write_small_log(tmp_path / "log")
    with (log / "sightings.csv").open("a") as file:
        file.write("30.0,nan,0.1,post0\n30.0,inf,0.1,post0\n")
    outcome = fastslam("info", log)
    assert "problem: sightings with NaN or infinite" in outcome.stdout
    assert "(2)" in outcome.stdout


def test_config_dump_is_the_default_configuration(tmp_path: Path) -> None:
    outcome = fastslam("config", "dump")
    assert yaml.safe_load(outcome.stdout) == dict(Config.resolve())


def test_config_layers_of_dump(tmp_path: Path) -> None:
    log = write_small_log(tmp_path / "log")
    settings = tmp_path / "settings.yaml"
    settings.write_text("filter:\n  particles: 7\nsensor:\n  bearing_std_rad: 0.5\n")
    outcome = fastslam("config", "dump", "--log", log, "--config", settings, "--set", "filter.particles=9")
    shown = yaml.safe_load(outcome.stdout)
    assert shown["sensor"]["range_std_m"] == 0.05, "from the log"
    assert shown["sensor"]["bearing_std_rad"] == 0.5, "the file wins over the log"
    assert shown["filter"]["particles"] == 9, "the command line wins over the file"


def test_config_validate(tmp_path: Path) -> None:
    settings = tmp_path / "settings.yaml"
    settings.write_text("seed: 3\n")
    assert fastslam("config", "validate", settings).stdout == f"{settings}: ok\n"
    settings.write_text("seed: 3\nfilter:\n  particels: 4\n")
    fastslam("config", "validate", settings).assert_one_line_error(
        exit_code=2, contains=f"{settings}:3: filter.particels: unknown key; did you mean filter.particles?"
    )


def test_config_explain() -> None:
    outcome = fastslam("config", "explain", "filter.particles")
    assert "filter.particles" in outcome.stdout and "integer" in outcome.stdout
    fastslam("config", "explain", "filter.particels").assert_one_line_error(
        exit_code=2, contains="did you mean filter.particles?"
    )


def test_datasets_list_names_every_format() -> None:
    outcome = fastslam("datasets", "list")
    assert len(FORMATS) >= 6
    for name in FORMATS:
        assert name in outcome.stdout


def test_datasets_download_of_an_unknown_log() -> None:
    fastslam("datasets", "download", "victoria_prak").assert_one_line_error(
        exit_code=1, contains="did you mean victoria_park?"
    )


@pytest.mark.parametrize(
    ("arguments", "contains"),
    [
        (("nosuch",), "nosuch"),
        (("--bogus",), "--bogus"),
        (("run",), "PATH"),
        (("config",), "command"),
        (("info", "somewhere", "--robot", "x"), "--robot"),
        (("run", "somewhere", "--runs", "0"), "--runs"),
    ],
)
def test_usage_errors_are_one_line(arguments: tuple[str, ...], contains: str) -> None:
    fastslam(*arguments).assert_one_line_error(exit_code=2, contains=contains)

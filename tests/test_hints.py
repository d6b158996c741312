"""What the program says of slips that people make: what was meant, in one line, without names of types."""

from __future__ import annotations

from pathlib import Path

import fastslam
import pytest
from cli_runner import fastslam as command
from fastslam._hints import does_not_exist, in_plain_words, like_named, meant, of_our_own
from fastslam.errors import ConfigError, DataError
from fastslam.maps import Map
from fastslam.simulation import simulate
from small_log import write_small_log


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder to work in, with a log, its results and a map of it."""
    monkeypatch.chdir(tmp_path)
    write_small_log(tmp_path / "yard", steps=60)
    few = ("--no-report", "--particles", "5", "--out", "found", "--map-out", "yard.map")
    assert command("run", "yard", *few).exit_code == 0
    return tmp_path


@pytest.mark.parametrize(
    ("arguments", "code", "says"),
    [
        ("run yrad", 1, "yrad: does not exist; did you mean yard?"),
        ("run nowhere/log", 1, "does not exist, nor does the folder"),
        ("run yard/odometry.csv", 1, "is one file of a log: name its folder, yard"),
        ("info found", 1, "found: is a folder of results (it holds run.json); expected a log"),
        ("run yard.map", 1, "yard.map: is a kept map (it holds map.yaml); expected a log"),
        ("eval yard", 1, "yard: is a log (it holds log.yaml); expected a folder of results"),
        ("compare found yard.map", 1, "yard.map: is a kept map"),
        ("map info found", 1, "found: is a folder of results (it holds run.json); expected a map"),
        ("localize yard --map yard", 1, "yard: is a log (it holds log.yaml); expected a map"),
        ("run yard --out yard", 1, "yard: is a log (it holds log.yaml): name another folder for the results"),
        ("run yard --out yard.map", 1, "yard.map: is a kept map"),
        ("run yard --out yard/log.yaml", 1, "yard/log.yaml: is a file; results need a folder"),
        ("run yard --config yrad.yaml", 2, "yrad.yaml: does not exist"),
        ("sweep yard", 2, "yard: is a log (it holds log.yaml); expected a YAML file of a sweep"),
        ("simulate new --preset orchrd", 2, "did you mean orchard?"),
        ("run yard --particles many", 2, "'many' is not a whole number (see fastslam run --help)"),
        ("run yard --seed -1", 2, "seed: got -1, expected a whole number from 0 on"),
        ("run yard --association unknwon", 2, "association.mode: got unknwon, expected known or unknown"),
        ("run yard --set sensor.range_std_m=wide", 2, 'sensor.range_std_m: got "wide", expected a number'),
        ("run yard --set association=unknown", 2, "`fastslam config explain association` lists them"),
    ],
)
def test_a_slip_on_the_command_line(folder: Path, arguments: str, code: int, says: str) -> None:
    before = {file: file.read_bytes() for file in folder.rglob("*") if file.is_file()}
    command(*arguments.split()).assert_one_line_error(exit_code=code, contains=says)
    assert {file: file.read_bytes() for file in folder.rglob("*") if file.is_file()} == before


def test_a_spreadsheet_and_other_things_that_are_no_log(tmp_path: Path) -> None:
    for name in ("survey.xlsx", "survey.csv"):
        (tmp_path / name).write_text("a,b\n")
    (tmp_path / "empty").mkdir()
    for name, says in {
        "survey.xlsx": "is a spreadsheet: save its sheets as CSV",
        "survey.csv": "is one table: a log is a folder",
        "empty": "is an empty folder; expected a log",
    }.items():
        with pytest.raises(DataError, match=says):
            fastslam.load(tmp_path / name)


@pytest.mark.parametrize("beginning", [b"PK\x03\x04", b"\xd0\xcf\x11\xe0"])
def test_a_spreadsheet_by_another_name(tmp_path: Path, beginning: bytes) -> None:
    log = write_small_log(tmp_path / "log", steps=5)
    (log / "odometry.csv").write_bytes(beginning + b"\0\1\2")
    with pytest.raises(DataError, match=r"odometry\.csv: is a spreadsheet by another name"):
        fastslam.load(log)


def test_a_file_that_is_nearly_named_right(tmp_path: Path) -> None:
    log = write_small_log(tmp_path / "log", steps=5)
    (log / "odometry.csv").rename(log / "Odometry.CSV.txt")
    with pytest.raises(DataError, match=r"rename Odometry\.CSV\.txt to odometry\.csv, if that is it"):
        fastslam.load(log)
    assert like_named(log, "map.yaml") == "" and like_named(log / "none", "log.yaml") == ""


def test_settings_that_are_no_mapping_or_not_nested() -> None:
    for settings in ("filter.particles=5", ["filter.particles=5"]):
        with pytest.raises(ConfigError, match="expected keys and values such as"):
            simulate(settings)  # type: ignore[arg-type]
    with pytest.raises(ConfigError, match=r"^world\.count: keys are nested: write world: \{count: \.\.\.\}$"):
        simulate({"world.count": 5})


def test_a_map_that_is_something_else(tmp_path: Path) -> None:
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "notes.txt").write_text("nothing\n")
    with pytest.raises(DataError, match=r"holds no map\.yaml; expected a map"):
        Map.load(tmp_path / "other")


@pytest.mark.parametrize(
    ("theirs", "ours"),
    [
        ("a.b: invalid type: string \"x\", expected f64", 'a.b: got "x", expected a number'),
        ("a.b: invalid value: integer `-3`, expected u64", "a.b: got -3, expected a whole number from 0 on"),
        ("a: invalid type: null, expected a boolean", "a: got nothing, expected true or false"),
        ("a: invalid type: map, expected a string", "a: got keys and values, expected text"),
        ("a: invalid type: sequence, expected f64", "a: got a list, expected a number"),
        ("a: invalid length: 2, expected an array of length 3", "a: got 2, expected a list of 3"),
        ("a: unknown variant `own`, expected `one`", "a: got own, expected one; did you mean one?"),
        ("a: unknown variant `x`, expected one of `p`, `q`, `r`", "a: got x, expected one of p, q, r"),
        ("a: got 3, expected 4", "a: got 3, expected 4"),
    ],
)  # fmt: skip
def test_complaints_of_the_core_in_plain_words(theirs: str, ours: str) -> None:
    assert in_plain_words(theirs) == ours


def test_only_what_is_near_is_meant(tmp_path: Path) -> None:
    assert meant("Cone", ("cones", "orchard")) == "; did you mean cones?"
    assert meant("moon", ("cones", "orchard")) == ""
    assert does_not_exist(tmp_path / "anything") == "does not exist"
    assert of_our_own(tmp_path / "anything") is None

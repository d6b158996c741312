"""The examination of a log names what is wrong with it, and says nothing about a sound one."""

from __future__ import annotations

import json
import re
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cli_runner import fastslam
from fastslam.config import Config
from fastslam.datasets import load, write_native
from fastslam.datasets.planar import increments_between
from fastslam.errors import DataError
from fastslam.examination import CHECKS, examine
from fastslam.examination.registry import SETTINGS
from fastslam.log import Controls, Log, Sightings
from fastslam.simulation import presets, simulate
from log_faults import FAULTS
from small_log import make_small_log, write_small_log

ROOT = Path(__file__).resolve().parents[1]


def without_names(log: Log) -> Log:
    nobody = np.full(len(log.sightings.stamp_s), -1)
    return replace(log, sightings=replace(log.sightings, identity=nobody), identity_names=())


def codes(log: Log) -> list[str]:
    return [finding.code for finding in examine(log)]


def noisier(settings: dict[str, Any], factor: float) -> dict[str, Any]:
    """The settings with all standard deviations of motion and sensor times `factor`."""
    scaled = dict(settings)
    for section in ("motion", "sensor"):
        scaled[section] = {
            key: factor * value if "_std_" in key else value for key, value in settings[section].items()
        }
    return scaled


# `headline` has half a million sightings; `loop` and `lawn-mower` are of its kind.
PRESETS = [name for name in presets() if name != "headline"]


@pytest.mark.parametrize("preset", PRESETS)
@pytest.mark.parametrize(("seed", "noise"), [(11, 1.0), (12, 2.0)])
def test_simulated_logs_are_sound(preset: str, seed: int, noise: float) -> None:
    log = simulate(noisier({**presets()[preset], "seed": seed, "max_duration_s": 300.0}, noise))
    assert codes(log) == []
    assert codes(without_names(log)) == []


def test_there_are_presets() -> None:
    assert len(PRESETS) >= 7


@pytest.mark.parametrize("degrees", [90, 162, 360])
@pytest.mark.parametrize("noise", [1.0, 2.0])
def test_narrow_and_wide_sensors_are_sound(degrees: int, noise: float) -> None:
    settings = noisier({**presets()["demo"], "seed": degrees}, noise)
    settings["sensor"]["field_of_view_rad"] = float(np.radians(degrees))
    log = simulate(settings)
    assert codes(log) == [] == codes(without_names(log))


def real_logs(data: Path) -> Iterator[tuple[str, Log]]:
    for number in (1, 2, 6):
        for robot in range(1, 6):
            yield (
                f"MRCLAM {number} {robot}",
                load(data / "utias_mrclam" / f"MRCLAM_Dataset{number}", robot=robot),
            )
    names = ("lost_in_the_woods", "victoria_park", "victoria_park/ascii_2003", "car_park")
    for name in (*names, "city_trees10000", "freiburg_slam_course"):
        yield name, load(data / name)


@pytest.mark.slow
def test_real_logs_are_sound(data_dir: Path) -> None:
    seen = 0
    for name, log in real_logs(data_dir):
        assert examine(log) == (), name
        seen += 1
    assert seen == 21


SAMPLES = {
    "velocity": ("demo", 21),
    "ackermann": ("victoria-like", 22),
    "increments": ("lawn-mower", 23),
}
DELAYS = ("sightings late by 0.5 s", "sightings late by 1.5 s")
# What stays undecided: the lawn-mower turns at the ends of its lanes only, the truck sees things 34 m away.
UNDECIDED = {
    *(("ackermann", f"bearings from the {side}") for side in ("left", "right")),
    ("ackermann", "sensor turned by 45 degrees"),
    ("increments", "sensor turned by 45 degrees"),
    ("increments", "odometer heading in degrees"),
    ("increments", "odometer heading clockwise"),
}


@pytest.fixture(scope="module")
def samples() -> dict[str, Log]:
    made = {}
    for model, (preset, seed) in SAMPLES.items():
        # The lawn-mower needs time for a few turns, which are all that tells left from right.
        duration_s = 600.0 if model == "increments" else 200.0
        log = simulate({**presets()[preset], "seed": seed, "max_duration_s": duration_s})
        assert log.config["motion"]["model"] == model
        made[model] = log
    return made


@pytest.mark.parametrize("model", SAMPLES)
@pytest.mark.parametrize("name", FAULTS)
def test_faults_are_named(samples: dict[str, Log], model: str, name: str) -> None:
    fault = FAULTS[name]
    if model not in fault.models or (model, name) in UNDECIDED:
        pytest.skip("the fault does not exist for this kind of odometry, or stays undecided on this log")
    if name in DELAYS and model != "velocity":
        pytest.skip("speed and turn change too seldom in this log for a delay to show")
    if name == "stamps rounded to seconds" and model == "increments":
        pytest.skip("rows of whole seconds")
    found = codes(fault.put(samples[model]))
    assert set(found) & set(fault.codes), found
    assert len(found) <= 2, "one fault, and at most what follows from it"


def test_every_code_but_four_is_told_by_a_fault() -> None:
    told = {code for fault in FAULTS.values() for code in fault.codes}
    others = {"bearing-unit", "name-two-places", "speed-unsigned", "view-limit"}
    assert {check.code for check in CHECKS} == told | others


def on_an_s(*, heading_gain: float) -> Log:
    """Poses of an odometer along bends of 90 degrees each way, its heading times `heading_gain`."""
    heading = np.pi / 2 * np.sin(np.linspace(0.0, 4.0 * np.pi, 2000))
    place = 0.05 * np.cumsum(np.column_stack([np.cos(heading), np.sin(heading)]), axis=0)
    poses = np.column_stack([place, heading_gain * heading])
    controls = Controls(0.1 * np.arange(1999), increments_between(poses))
    return replace(make_small_log(), controls=controls, config={"motion": {"model": "increments"}})


@pytest.mark.parametrize(
    ("gain", "expected"),
    [(1.0, None), (180.0 / np.pi, "heading-unit"), (-1.0, "heading-clockwise")],
)
def test_displacements_are_held_against_the_heading(gain: float, expected: str | None) -> None:
    found = codes(on_an_s(heading_gain=gain))
    assert [code for code in found if code.startswith("heading")] == ([expected] if expected else [])


def test_a_narrow_camera_in_degrees_is_told_by_the_motion() -> None:
    # A post straight ahead of every lane: 3 degrees to either side pass for the radians of a wide sensor.
    settings = {**presets()["demo"], "seed": 3}
    settings["world"] = {**settings["world"], "count": 400, "min_spacing_m": 0.5}
    settings["sensor"] = {**settings["sensor"], "field_of_view_rad": 0.1, "max_range_m": 30.0}
    log = simulate(settings)
    wide = {**log.config, "sensor": {**log.config["sensor"], "field_of_view_rad": 2 * np.pi}}
    sound = replace(log, config=wide)
    assert codes(sound) == []
    bearing = np.clip(np.degrees(log.sightings.bearing_rad), -3.1, 3.1)
    wrong = replace(sound, sightings=replace(log.sightings, bearing_rad=bearing))
    assert [(f.code, f.severity) for f in examine(wrong)] == [("bearing-unit", "error")]


def test_speeds_without_a_sign() -> None:
    log = make_small_log(steps=600)
    back = (log.controls.stamp_s // 10) % 3 == 1
    signed = log.controls.values * np.where(back, -1.0, 1.0)[:, None]
    made = _seen_while_driving(log, signed)
    assert codes(made) == []
    unsigned = signed.copy()
    unsigned[:, 0] = np.abs(unsigned[:, 0])
    assert codes(replace(made, controls=Controls(made.controls.stamp_s, unsigned))) == ["speed-unsigned"]


def _seen_while_driving(log: Log, values: np.ndarray) -> Log:
    """What the robot of the small log would see if it drove with these speeds and yaw rates."""
    rng = np.random.default_rng(5)
    truth = log.truth_landmarks
    assert truth is not None
    stamp_s = log.controls.stamp_s
    turn, dt_s = values[:, 1], np.diff(stamp_s, append=stamp_s[-1] + 0.1)
    heading = np.concatenate([[0.0], np.cumsum(turn * dt_s)[:-1]])
    middle = heading + 0.5 * turn * dt_s
    step = values[:, :1] * dt_s[:, None] * np.column_stack([np.cos(middle), np.sin(middle)])
    place = np.vstack([np.zeros((1, 2)), np.cumsum(step, axis=0)[:-1]])
    at = np.arange(0, len(stamp_s), 2)
    offset = truth.position_m[None] - place[at][:, None]
    bearing = np.arctan2(offset[..., 1], offset[..., 0]) - heading[at][:, None]
    count, many = len(at), len(truth.names)
    return replace(
        log,
        controls=Controls(stamp_s, values),
        sightings=Sightings(
            stamp_s=np.repeat(stamp_s[at], many),
            range_m=np.hypot(*np.moveaxis(offset, 2, 0)).ravel() + rng.normal(0.0, 0.02, count * many),
            bearing_rad=np.angle(np.exp(1j * (bearing.ravel() + rng.normal(0.0, 0.01, count * many)))),
            identity=np.tile(np.arange(many), count),
            class_index=np.full(count * many, -1),
            signature=np.full(count * many, np.nan),
        ),
    )


def test_bearings_outside_the_view() -> None:
    log = make_small_log()
    narrow = {**log.config, "sensor": {**log.config["sensor"], "field_of_view_rad": 1.0}}
    findings = examine(replace(log, config=narrow))
    assert [finding.code for finding in findings] == ["view-limit"]
    assert "sensor.field_of_view_rad" in findings[0].remedy


def test_what_the_configuration_puts_right_is_no_finding() -> None:
    log = FAULTS["sensor looks backwards"].put(make_small_log())
    assert codes(log) == ["sensor-turned"]
    assert "sensor.mounting.yaw_rad=3.1416" in examine(log)[0].remedy
    assert examine(log, {"sensor": {"mounting": {"yaw_rad": np.pi}}}) == ()


def test_settings_at_fault_name_file_and_line(tmp_path: Path) -> None:
    folder = write_small_log(tmp_path / "log")
    text = (folder / "log.yaml").read_text()
    assert "  range_std_m: 0.05\n" in text
    (folder / "log.yaml").write_text(text.replace("  range_std_m: 0.05\n", "  range_std_m: -1\n"))
    line = text[: text.index("  range_std_m")].count("\n") + 1
    findings = examine(load(folder))
    assert [(finding.code, finding.severity) for finding in findings] == [(SETTINGS, "error")]
    where = f"{folder / 'log.yaml'}:{line}: sensor.range_std_m"
    assert where in findings[0].message
    fastslam("run", folder, "--out", tmp_path / "out").assert_one_line_error(exit_code=2, contains=where)


@pytest.mark.parametrize("rows", [0, 1, 2, 3])
@pytest.mark.parametrize("seen", [0, 1, 2])
def test_tiny_logs_are_examined_without_complaint(rows: int, seen: int) -> None:
    log, sightings = make_small_log(), make_small_log().sightings
    columns = ("stamp_s", "range_m", "bearing_rad", "identity", "class_index", "signature")
    few = replace(sightings, **{name: getattr(sightings, name)[:seen] for name in columns})
    controls = Controls(log.controls.stamp_s[:rows], log.controls.values[:rows])
    assert all(finding.line for finding in examine(replace(log, controls=controls, sightings=few)))


@pytest.mark.parametrize("model", ["velocity", "ackermann", "increments", "odometry"])
@pytest.mark.parametrize("size", [0.0, 1e-300, 1.0, 1e9, 1e300])
def test_odd_numbers_raise_nothing(model: str, size: float) -> None:
    rng = np.random.default_rng(3)
    log = make_small_log()
    width = 2 if model in ("velocity", "ackermann") else 3
    values = size * rng.normal(size=(len(log.controls.stamp_s), width))
    odd = replace(
        log,
        controls=Controls(log.controls.stamp_s, values),
        sightings=replace(log.sightings, range_m=np.abs(size * log.sightings.range_m) + 1e-300),
        config={"motion": {"model": model}},
    )
    with np.errstate(all="ignore"):
        assert all(finding.line for finding in examine(odd))


@pytest.mark.slow
def test_a_large_log_takes_seconds() -> None:
    rng = np.random.default_rng(1)
    count = 300_000
    stamp_s = 0.01 * np.arange(count)
    seen = np.full(count, -1)
    log = replace(
        make_small_log(),
        controls=Controls(stamp_s, np.column_stack([np.ones(count), 0.1 * np.sin(stamp_s)])),
        sightings=Sightings(
            stamp_s=np.repeat(stamp_s[::10], 10),
            range_m=rng.uniform(1.0, 9.0, count),
            bearing_rad=rng.uniform(-3.0, 3.0, count),
            identity=seen,
            class_index=seen,
            signature=np.full(count, np.nan),
        ),
        identity_names=(),
    )
    start_s = time.process_time()
    examine(log)
    assert time.process_time() - start_s < 30.0, "a few seconds on an idle machine"


def test_a_clock_set_back_is_refused_and_jitter_is_sorted(tmp_path: Path) -> None:
    folder = write_native(make_small_log(), tmp_path / "log")
    header, *rows = (folder / "odometry.csv").read_text().splitlines()

    def write(changed: list[str]) -> None:
        (folder / "odometry.csv").write_text("\n".join([header, *changed]) + "\n")

    def shifted(by_s: float) -> list[str]:
        later = [row.split(",", 1) for row in rows[150:]]
        return rows[:150] + [f"{float(stamp) - by_s!r},{rest}" for stamp, rest in later]

    for by_s in (3600.0, 2.0, 0.75):
        write(shifted(by_s))
        with pytest.raises(DataError, match=r"clock set back: odometry row 151 has stamp"):
            load(folder)
    swapped = rows.copy()
    swapped[100], swapped[104] = swapped[104], swapped[100]
    write(swapped)
    assert any("out of time order" in problem.message for problem in load(folder).problems)


def test_rows_written_twice_are_dropped_and_counted(tmp_path: Path) -> None:
    folder = write_small_log(tmp_path / "log")
    header, *rows = (folder / "sightings.csv").read_text().splitlines()
    once = load(folder)
    (folder / "sightings.csv").write_text(
        "\n".join([header, *(row for row in rows for _ in range(2))]) + "\n"
    )
    twice = load(folder)
    np.testing.assert_array_equal(twice.sightings.range_m, once.sightings.range_m)
    assert {problem.count for problem in twice.problems} == {len(rows)}
    assert examine(twice) == ()


def test_run_says_problems_first_and_keeps_them(tmp_path: Path) -> None:
    folder = write_native(FAULTS["bearings clockwise"].put(make_small_log()), tmp_path / "log")
    outcome = fastslam("run", folder, "--no-report", "--out", tmp_path / "out")
    assert outcome.exit_code == 0
    problems = [line for line in outcome.stderr.splitlines() if line.startswith("problem: ")]
    assert len(problems) == 1 and "[bearing-mirrored]" in problems[0]
    kept = json.loads((tmp_path / "out" / "run.json").read_text())["findings"]
    assert [finding["code"] for finding in kept] == ["bearing-mirrored"]
    told = json.loads(fastslam("info", folder, "--json").stdout)
    assert told["findings"] == kept
    assert told["controls"]["rows"] == 301


def test_run_refuses_what_means_nothing_unless_told_to(tmp_path: Path) -> None:
    folder = write_native(FAULTS["sightings in ms"].put(make_small_log()), tmp_path / "log")
    arguments = ("run", folder, "--no-report", "--out", tmp_path / "out", "--set", "filter.particles=5")
    fastslam(*arguments).assert_one_line_error(
        exit_code=1, contains="stamps of the sightings in milliseconds?"
    )
    assert not (tmp_path / "out").exists()


def test_the_documentation_lists_every_check() -> None:
    page = (ROOT / "docs" / "examination.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| `([a-z-]+)` \| (.+?) \| (.*?) \|$", page, re.MULTILINE)
    assert rows == [(check.code, check.at, check.cannot) for check in CHECKS]
    assert f"`{SETTINGS}`" in page
    assert all(name in page for name in FAULTS)
    assert Config.resolve()["sensor"]["mounting"]["yaw_rad"] == 0.0

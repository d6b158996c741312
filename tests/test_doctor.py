"""The doctor names the fault that was put into a log, with the line that puts it right."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from cli_runner import fastslam
from fastslam.config import parse_assignments
from fastslam.datasets import write_native
from fastslam.log import Log
from fastslam.simulation import resolve_simulation, simulate
from fastslam.tuning import diagnose, tune


@pytest.fixture(scope="module")
def sound() -> Log:
    return simulate(resolve_simulation({"seed": 8, "max_duration_s": 30.0}, preset="demo"))


def faulty(log: Log, fault: str) -> Log:
    """The log with one of the faults of FAULTS."""
    sightings, values = log.sightings, log.controls.values
    if fault == "late":
        sightings = replace(sightings, stamp_s=sightings.stamp_s + 0.4)
    elif fault == "mirrored":
        sightings = replace(sightings, bearing_rad=-sightings.bearing_rad)
    elif fault == "turn-gain":
        values = values / np.array([1.0, 0.65])
    else:
        values = values * np.array([1.0, 180 / np.pi])
    return replace(log, sightings=sightings, controls=replace(log.controls, values=values))


FAULTS = {
    "late": ("late", "--set sensor.delay_s="),
    "mirrored": ("mirrored", "negate bearing_rad"),
    "turn-gain": ("turns 0.", "--set motion.correction.turn_gain=0.6"),
    "degrees": ("turns in degrees", "--set motion.correction.turn_gain=0.0174533"),
}


def test_under_a_problem_of_its_own_it_does_not_call_the_numbers_best(sound: Log, tmp_path: Path) -> None:
    slow = replace(
        sound,
        controls=replace(sound.controls, stamp_s=1000.0 * sound.controls.stamp_s),
        sightings=replace(sound.sightings, stamp_s=1000.0 * sound.sightings.stamp_s),
    )
    outcome = fastslam("doctor", write_native(slow, tmp_path / "log"))
    assert outcome.exit_code == 0 and "milliseconds" in outcome.stdout
    assert "fit best as they stand" not in outcome.stdout


@pytest.mark.parametrize("fault", FAULTS)
def test_the_likeliest_reading_is_the_fault(sound: Log, fault: str) -> None:
    name, remedy = FAULTS[fault]
    log = faulty(sound, fault)
    first = diagnose(log).suspected[0]
    assert name in first.name and first.remedy.startswith(remedy) and first.log_odds > 100
    if remedy.startswith("--set"):
        # What is pasted puts it right: nothing of that size is suspected any more.
        cured = diagnose(log, parse_assignments([first.remedy.removeprefix("--set ")]))
        assert all(verdict.log_odds < 0.05 * first.log_odds for verdict in cured.suspected)


def test_a_lasers_bearings_are_not_asked_for_their_unit(sound: Log) -> None:
    log = simulate(resolve_simulation({"seed": 7, "max_duration_s": 8.0}, preset="rover"))
    assert log.scans is not None and len(log.sightings.stamp_s) == 0
    names = {verdict.name for verdict in diagnose(log).verdicts}
    assert len(names) >= 10 and "bearings in degrees" not in names
    assert "bearings in degrees" in {verdict.name for verdict in diagnose(sound).verdicts}


def test_a_sound_log_is_told_to_be_sound(sound: Log) -> None:
    found = diagnose(sound)
    assert len(found.verdicts) >= 10 and found.questions > 100
    assert not found.suspected and not found.findings
    odds = [verdict.log_odds for verdict in found.verdicts]
    assert odds == sorted(odds, reverse=True)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("preset", "seed"), [(None, 4), (None, 5), ("demo", 1), ("orchard", 1), ("orchard", 2)]
)
def test_what_a_few_turns_or_sightings_gain_is_no_proof(preset: str | None, seed: int) -> None:
    """In each of these sound worlds some reading gains ten nats or more, in a few parts of the log."""
    found = diagnose(simulate(resolve_simulation({"seed": seed, "max_duration_s": 60.0}, preset=preset)))
    assert found.verdicts[0].log_odds > 10 and not found.suspected


def test_a_log_with_too_little_in_it_is_not_judged(sound: Log) -> None:
    few = np.arange(3)
    names = ("stamp_s", "range_m", "bearing_rad", "identity", "class_index", "signature")
    columns = {name: getattr(sound.sightings, name)[few] for name in names}
    found = diagnose(replace(sound, sightings=replace(sound.sightings, **columns)))
    assert found.verdicts == () and found.questions < 60


def test_the_command_prints_the_line_to_paste_and_json(sound: Log, tmp_path: Path) -> None:
    write_native(faulty(sound, "late"), tmp_path / "log")
    printed = fastslam("doctor", str(tmp_path / "log"))
    assert printed.exit_code == 0, printed.stderr
    assert "suspected: sightings 0." in printed.stdout and "--set sensor.delay_s=0." in printed.stdout
    facts = json.loads(fastslam("doctor", str(tmp_path / "log"), "--json").stdout)
    assert facts["suspected"][0]["remedy"].startswith("--set sensor.delay_s=0.")
    assert facts["suspected"][0]["log_odds"] == pytest.approx(facts["readings"][0]["log_odds"])


@pytest.mark.slow
def test_a_small_delay_is_suspected_where_learning_takes_it_and_kept_where_it_is_stated(
    tmp_path: Path,
) -> None:
    """A car among cones, sightings stamped 0.06 s late: the doctor and `tune` go by the same evidence."""
    log = simulate(resolve_simulation({"seed": 8102}, preset="cones"))
    late = replace(log, sightings=replace(log.sightings, stamp_s=log.sightings.stamp_s + 0.06))
    few = {"filter": {"particles": 30}, "association": {"mode": "unknown"}}
    # That the log itself says 0 is no statement.
    for layer, is_stated in (({**few, "sensor": {"delay_s": 0.0}}, True), (few, False)):
        found, tuned = diagnose(late, layer), tune(late, layer)
        (delay,) = (value for value in found.learned or () if value.key == "sensor.delay_s")
        assert delay.interval95[0] < 0.06 < delay.interval95[1] and delay.interval95[0] > 0.0
        told = [verdict.remedy for verdict in found.suspected]
        assert [value.key for value in found.kept] == (["sensor.delay_s"] if is_stated else [])
        assert told == ([] if is_stated else [f"--set sensor.delay_s={delay.value:.3g}"])
        assert ("delay_s" in tuned.settings.get("sensor", {})) is not is_stated
    printed = fastslam("doctor", write_native(late, tmp_path / "log"), "--set", "sensor.delay_s=0")
    assert "kept: sensor.delay_s = 0 is stated" in printed.stdout
    assert "nothing fits surely better" in printed.stdout and "suspected" not in printed.stdout

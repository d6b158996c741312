"""Small logs with faults (FASTSLAM_CASES): what the examination, or reading, says about each."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from fastslam.datasets import load
from fastslam.errors import DataError
from fastslam.examination import examine

NAMED = [
    # case, code, severity, words of the message
    ("02b-rear-sensor", "sensor-turned", "problem", "looks? the other way, backwards"),
    ("04-ranges-in-mm", "range-unit", "problem", "all 2,300 sightings .*max_range_m = 10 .*millimetres"),
    ("06-bearing-mirrored", "bearing-mirrored", "problem", "bearings seem mirrored"),
    ("07-yaw-rate-degrees", "turn-unit", "problem", "yaw_rate_rad_per_s seems to be in degrees"),
    ("08-sightings-ms-odometry-s", "clock-coverage", "error", "99.7% .* milliseconds"),
    ("09-time-offset", "clock-offset", "note", "sightings fit best 0.3 to 0.4 s earlier"),
    ("13-odometer-heading-degrees", "heading-unit", "error", "heading_rad seems to be in degrees"),
    ("13c-latlon-as-xy", "odometry-still", "problem", "moves 0.0034 m|moves 0.00338 m"),
    ("15-tag-number-twice", "name-two-places", "problem", "landmark 15 contradicts itself"),
    ("20b-log-gap-20s", "clock-gap", "problem", "gap: nothing was recorded for 20.1 s"),
    ("35-clock-50s-of-60", "clock-coverage", "problem", "75.8% .* 50 s off"),
]
SOUND = (
    "01-mrpt-kf-slam-demo",
    "02-mrpt909-behind",
    "10-baseline-fov162-doubles",
    "92-exact-rows-increments",
    "93-exact-rows-velocity",
)
REFUSED = [
    ("18-clock-jumps-back", "clock set back: sighting row 2525"),
    ("18b-clock-jumps-back-2s", "clock set back: sighting row 2525"),
    ("25-bearing-degrees-narrow", "expected radians, are these degrees?"),
    ("25c-bearing-degrees-narrow-8", "expected radians, are these degrees?"),
]


@pytest.mark.parametrize(("case", "code", "severity", "words"), NAMED)
def test_the_fault_is_named(cases: Path, case: str, code: str, severity: str, words: str) -> None:
    findings = examine(load(cases / case))
    assert [(finding.code, finding.severity) for finding in findings] == [(code, severity)]
    assert re.search(words, findings[0].message), findings[0].message


@pytest.mark.parametrize(("case", "words"), REFUSED)
def test_the_log_is_refused(cases: Path, case: str, words: str) -> None:
    with pytest.raises(DataError, match=re.escape(words)):
        load(cases / case)


@pytest.mark.parametrize("case", SOUND)
def test_nothing_is_said_about_a_sound_log(cases: Path, case: str) -> None:
    assert examine(load(cases / case)) == ()


def test_with_its_mounting_the_rear_sensor_is_sound(cases: Path) -> None:
    mounting = {"x_m": -0.5, "yaw_rad": 3.141592653589793}
    assert examine(load(cases / "02b-rear-sensor"), {"sensor": {"mounting": mounting}}) == ()


def test_rows_written_twice_are_dropped_and_counted(cases: Path) -> None:
    log = load(cases / "30-rows-twice-small")
    assert len(log.sightings.stamp_s) == 1488
    counts = {problem.message: problem.count for problem in log.problems}
    assert counts == {"sightings that repeat another row in every number: dropped": 1488}
    assert examine(log) == ()

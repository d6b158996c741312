"""The logs that people have: each is read, or refused with one line that says what to change."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from cli_runner import fastslam
from fastslam import run
from fastslam.datasets import load
from fastslam.errors import DataError
from fastslam.evaluation import evaluate

# What a folder of 37-csv-dialects must lead to: a pattern of the refusal, or None where it is read.
DIALECTS: dict[str, str | None] = {
    "bom": None,
    "cartesian": None,
    "color-column": None,
    "comments-top": None,
    "crlf": None,
    "decimal-comma": None,
    "extra-column": None,
    "header-deg": None,
    "header-names": None,
    "header-stamp-ms": None,
    "header-time": None,
    "header-units-brackets": None,
    "header-upper": None,
    "id-minus-one": None,
    "index-column": None,
    "no-header": r"sightings\.csv:1: .*put stamp_s,range_m,bearing_rad,landmark_id above them",
    "no-sightings-file": r"the file sightings\.csv .* is missing: write one, with the header",
    "odo-quaternion": r"odometry\.csv:1: .*fits motion\.model odometry or increments, but log\.yaml says",
    "odo-ticks": r"odometry\.csv:2: ticks need wheels\.m_per_tick, or .*: add to log\.yaml",
    "odo-twist": None,
    "odo-twist2": None,
    "odo-wheels": r"odometry\.csv:1: .*need wheels\.track_width_m: add it to log\.yaml",
    "semicolon": None,
    "space": None,
    "stamp-iso": r"sightings\.csv has dates and odometry\.csv other seconds: give the stamps of both",
    "tab": None,
    "utf16": None,
    "yaml-missing-motion": None,
    "yaml-no-noise": None,
    "yaml-units": None,
}
SIGHTINGS = 439
FACTORS = {"header-deg": ("bearing_rad", np.pi / 180), "header-stamp-ms": ("stamp_s", 1e-3)}


def test_every_dialect_is_read_or_refused(cases: Path) -> None:
    """All tables say the same; two claim another unit in their header, which is then believed."""
    folder = cases / "37-csv-dialects"
    assert sorted(path.name for path in folder.iterdir()) == sorted(DIALECTS)
    plain = load(folder / "crlf")
    assert len(plain.sightings.stamp_s) == SIGHTINGS
    for name, pattern in DIALECTS.items():
        if pattern is not None:
            with pytest.raises(DataError) as caught:
                load(folder / name)
            assert re.search(pattern, str(caught.value)), (name, str(caught.value))
            fastslam("info", folder / name).assert_one_line_error(exit_code=1, contains=str(caught.value))
            continue
        log = load(folder / name)
        quantity, factor = FACTORS.get(name, ("range_m", 1.0))
        expected = getattr(plain.sightings, quantity) * factor
        np.testing.assert_allclose(getattr(log.sightings, quantity), expected, rtol=1e-12, err_msg=name)
        np.testing.assert_array_equal(log.controls.values, plain.controls.values, err_msg=name)
        assert log.problems == (), (name, log.problems)


def test_dialects_that_carry_more_or_other_columns(cases: Path) -> None:
    folder = cases / "37-csv-dialects"
    assert load(folder / "color-column").class_names == ("blue",)
    assert load(folder / "extra-column").notes == ("sightings.csv: column confidence is not used",)
    assert load(folder / "yaml-missing-motion").config["motion"] == {"model": "velocity"}
    assert load(folder / "yaml-units").config["sensor"]["bearing_std_rad"] == pytest.approx(np.pi / 180)


def test_a_log_without_sightings_is_dead_reckoning_and_says_so(cases: Path) -> None:
    log = load(cases / "14-no-sightings")
    assert [problem.message for problem in log.problems] == [
        "sightings.csv holds no sighting: only the odometry is left"
    ]
    result = run(log, {"filter": {"particles": 5}})
    assert len(result.landmarks.ids) == 0
    assert result.trajectory.stamp_s[-1] == pytest.approx(log.controls.stamp_s[-1])


def test_a_sound_log_gives_its_map(cases: Path) -> None:
    log = load(cases / "01-mrpt-kf-slam-demo")
    assert log.problems == () and log.notes == ()
    result = run(log, {"association": {"mode": "unknown"}})
    assert len(result.landmarks.ids) == 70
    assert evaluate(result, log)["landmark_rmse_m"] < 0.01


@pytest.mark.slow
def test_a_loop_of_a_sound_log_is_closed_whatever_the_draws(cases: Path) -> None:
    # The plain filter maps all twice for two seeds in five.
    log = load(cases / "02-mrpt909-behind")
    assert log.problems == () and log.notes == ()
    counts = []
    for seed in range(5):
        result = run(log, {"seed": seed, "association": {"mode": "unknown"}})
        counts.append(len(result.landmarks.ids))
        # Measured over ten seeds: 0.017 m at most, one of them with a landmark too many.
        assert evaluate(result, log)["landmark_rmse_m"] < 0.05
    assert sorted(counts)[2] == 47 and max(counts) <= 48 and min(counts) >= 47, counts


FOREIGN = {
    # file: (format, sightings, landmarks), or a pattern of the refusal
    "example.graph": ("toro", 422, 24),
    "victoria_park_isam_first400.txt": ("toro", 163, 24),
    "toyExample.g2o": r":1: VERTEX_SE3:QUAT is of a graph in space, .*\(g2o file; see docs/formats\.md\)$",
    "vp_tung.g2o": r":1: VERTEX_XY: got 5 columns, expected 4 \(g2o file; see docs/formats\.md\)$",
    "kf-slam_demo.rawlog": r"is an MRPT rawlog, which is not read; .*docs/formats\.md says how to convert",
}


def test_files_of_other_programs_are_read_or_refused_in_a_line(cases: Path) -> None:
    folder = cases / "00-foreign-files"
    assert sorted(path.name for path in folder.iterdir()) == sorted(FOREIGN)
    for name, expected in FOREIGN.items():
        if isinstance(expected, tuple):
            log = load(folder / name)
            assert (log.format, len(log.sightings.stamp_s), len(log.identity_names)) == expected
            assert log.controls.covariance is not None and log.sightings.covariance is not None
            continue
        with pytest.raises(DataError) as caught:
            load(folder / name)
        assert re.search(expected, str(caught.value)), str(caught.value)
        fastslam("info", folder / name).assert_one_line_error(exit_code=1, contains=str(caught.value))


def test_mrclam_as_courses_hand_it_out(cases: Path) -> None:
    """The swap of data set 1 is put right though no folder is called so."""
    log = load(cases / "38-mrclam-ds1-prefix")
    assert (log.format, len(log.controls.stamp_s), len(log.sightings.stamp_s)) == ("utias", 2996, 574)
    assert any(problem.message.startswith("barcodes of subjects 11 and 17") for problem in log.problems)

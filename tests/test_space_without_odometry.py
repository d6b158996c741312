"""Poses in space without odometry: logs, runs, verdicts, and what STAR-loc has of its own."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from cli_runner import fastslam
from fastslam.errors import ConfigError
from fastslam.space import SpaceLog, evaluate, load, run
from fastslam.space.learning import learn
from fastslam.space.log import WITHOUT_ODOMETRY
from fastslam.space.native_write import write_native
from fastslam.space.simulation import MOTIONS, simulate
from fastslam.space.verdict import is_unsound

TAGS = "time_s,apriltag_id,left_u,left_v,right_u,right_v"


def begin(log: SpaceLog, seconds: float) -> SpaceLog:
    """What was noted and seen at first."""
    rows, seen = log.row_stamp_s < seconds, log.sighting_stamp_s < seconds
    return replace(
        log,
        row_stamp_s=log.row_stamp_s[rows],
        velocity=log.velocity[rows],
        sighting_stamp_s=log.sighting_stamp_s[seen],
        value=log.value[seen],
        identity=log.identity[seen],
    )


@pytest.mark.parametrize("motion", MOTIONS[1:])
def test_a_log_without_odometry_is_written_and_comes_back(motion: str, tmp_path: Path) -> None:
    made = begin(simulate(motion=motion, landmarks=15, seed=4), 5.0)
    path = write_native(made, tmp_path / "log")
    file = path / "odometry.csv"
    assert file.is_file() is (motion == "gyro")
    if motion == "gyro":
        assert file.read_text().splitlines()[0] == "stamp_s,wx_rad_per_s,wy_rad_per_s,wz_rad_per_s"
    log = load(path)
    assert log.motion == motion and log.config["filter"] == WITHOUT_ODOMETRY
    assert np.array_equal(log.velocity, made.velocity) and np.array_equal(log.value, made.value)
    assert log.velocity.shape[1] == 6 and not log.velocity[:, :3].any()


def test_a_camera_in_a_hand_finds_its_way(tmp_path: Path) -> None:
    found = {}
    for motion in MOTIONS[1:]:
        log = begin(simulate(motion=motion, seed=4), 10.0)
        result = run(log, {"filter": {"particles": 50}})
        assert result.warnings == () and result.hold is not None and result.ratios is not None
        metrics = evaluate(result, log)
        found[motion] = metrics
        # Ten looks at once of 6 cm each: a pose is known to less, the way between two scans to more.
        assert metrics["path.live.position_rmse_m"] < 0.3, motion
        assert metrics["path.smoothed.position_rmse_m"] < 0.12, motion
        assert metrics["map.aligned.rmse_m"] < 0.06, motion
        assert 0.3 < result.hold.misfit < 1.5 and result.hold.shape_std_m < 0.06, motion
        assert np.all(np.diff(result.smoothed.stamp_s) < 0.21)
    # A gyro knows the turns that sightings alone tell to a degree or two.
    turn = "path.live.rotation_rmse_rad"
    assert found["gyro"][turn] < found["wandering"][turn]


def test_what_wanders_more_than_the_settings_say_is_learned() -> None:
    log = begin(simulate(motion="wandering", seed=2, landmarks=25), 20.0)
    wrong = {"motion": {"velocity_std_m_per_s": [0.05] * 3, "rate_std_rad_per_s": [3.0] * 3}}
    learned = learn(log, wrong)["motion"]
    # It is carried at 0.8 m/s, turns by 0.2 rad/s, and sways by 0.3 m/s and 0.4 rad/s.
    assert all(0.15 < std < 1.5 for std in learned["velocity_std_m_per_s"]), learned
    assert all(0.15 < std < 1.5 for std in learned["rate_std_rad_per_s"]), learned
    assert set(learned) == {"velocity_std_m_per_s", "rate_std_rad_per_s"}


def test_landmarks_that_sightings_do_not_hold_together_are_lost() -> None:
    """Two that are seen, then, blind seconds later, two others: nothing says how these lie to those."""
    log = begin(simulate(motion="wandering", seed=1), 8.0)
    first, last = log.sighting_stamp_s < 2.0, log.sighting_stamp_s > 6.0
    early = np.unique(log.identity[first])[:2]
    late = np.setdiff1d(np.unique(log.identity[last]), log.identity[first])[:2]
    kept = (first & np.isin(log.identity, early)) | (last & np.isin(log.identity, late))
    assert len(early) == len(late) == 2
    parts = {"value": log.value[kept], "identity": log.identity[kept]}
    result = run(replace(log, sighting_stamp_s=log.sighting_stamp_s[kept], **parts))
    assert is_unsound(result)
    assert any(text.startswith("lost: sightings alone hold the landmarks to") for text in result.warnings)


def test_the_command_simulates_and_runs_one(tmp_path: Path) -> None:
    path = tmp_path / "carried"
    made = fastslam("simulate", str(path), "--sensor", "point3d", "--motion", "wandering", "--landmarks", "8")
    assert made.exit_code == 0 and not (path / "odometry.csv").exists()
    shown = fastslam("info", str(path))
    assert shown.exit_code == 0 and "wandering" in shown.stdout
    flat = fastslam("simulate", str(tmp_path / "flat"), "--motion", "gyro")
    flat.assert_one_line_error(exit_code=2, contains="--motion: for a sensor in space")
    with pytest.raises(ConfigError, match=r"motion: got wheels, expected odometry or gyro or wandering"):
        simulate(motion="wheels")
    for key, value in (("velocity_std_m_per_s", "[0, 1, 1]"), ("velocity_time_s", "0")):
        refused = fastslam("run", str(path), "--out", str(tmp_path / "out"), "--set", f"motion.{key}={value}")
        refused.assert_one_line_error(exit_code=2, contains=f"motion.{key}")

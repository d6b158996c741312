"""The summary of a log counts what is there."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from fastslam.datasets import describe, load
from fastslam.datasets.info import Extent
from fastslam.log import Controls, Log, PositionFixes, Problem, Sightings, TruthLandmarks, TruthTrajectory


def small_log() -> Log:
    return Log(
        name="small",
        source="memory",
        format="test",
        controls=Controls(np.array([0.0, 1.0, 2.0, 5.0]), np.zeros((4, 2))),
        sightings=Sightings(
            stamp_s=np.array([1.0, 1.0, 2.0, 6.0]),
            range_m=np.array([2.0, 3.0, 4.0, 9.0]),
            bearing_rad=np.array([-0.5, 0.0, 0.25, 1.0]),
            identity=np.array([0, -1, 0, 1]),
            class_index=np.array([-1, 0, 0, -1]),
            signature=np.array([np.nan, 0.3, np.nan, np.nan]),
        ),
        identity_names=("a", "b", "unseen"),
        class_names=("cone",),
        truth_trajectory=TruthTrajectory(np.array([0.0, 1.0]), np.zeros((2, 3)), heading_known=False),
        truth_landmarks=TruthLandmarks(("a",), np.zeros((1, 2))),
        position_fixes=PositionFixes(np.zeros(3), np.zeros((3, 2))),
        config={"motion": {"model": "velocity"}},
        problems=(Problem("rows lost", 7),),
    )


def test_small_log_by_hand() -> None:
    info = describe(small_log())
    assert (info.name, info.format, info.motion_model) == ("small", "test", "velocity")
    assert info.duration_s == 6.0
    assert (info.controls.rows, info.controls.stamps) == (4, 4)
    assert info.controls.rate_hz == pytest.approx(3 / 5)
    assert info.controls.longest_gap_s == 3.0
    assert info.sightings is not None
    assert (info.sightings.rows, info.sightings.stamps) == (4, 3)
    assert info.sightings.period_s == Extent(1.0, 2.5, 4.0)
    assert info.sightings_per_stamp == Extent(1.0, 1.0, 2.0)
    assert info.range_m == Extent(2.0, 3.5, 9.0)
    assert info.bearing_rad == Extent(-0.5, 0.125, 1.0)
    assert info.identified == 3
    assert info.sightings_per_landmark == {"a": 2, "b": 1, "unseen": 0}
    assert info.classes == {"cone": 2}
    assert info.with_signature == 1
    assert (info.truth_poses, info.truth_heading_known, info.truth_landmarks) == (2, False, 1)
    assert info.position_fixes == 3
    assert info.problems == (Problem("rows lost", 7),)


def test_log_without_sightings_and_with_one_control() -> None:
    empty = np.empty(0)
    log = Log(
        name="empty",
        source="memory",
        format="test",
        controls=Controls(np.zeros(1), np.zeros((1, 2))),
        sightings=Sightings(empty, empty, empty, empty.astype(int), empty.astype(int), empty),
    )
    info = describe(log)
    assert info.sightings is None
    assert info.range_m is None
    assert info.motion_model == "not given"
    assert (info.controls.rate_hz, info.controls.longest_gap_s) == (0.0, 0.0)


def test_lost_in_the_woods_matches_its_documentation(data_dir: Path) -> None:
    info = describe(load(data_dir / "lost_in_the_woods", max_range_m=10.0))
    assert info.duration_s == pytest.approx(1260.8)
    assert info.controls.rate_hz == pytest.approx(10.0)
    assert info.sightings is not None
    assert (info.sightings.rows, info.sightings.stamps) == (61086, 12533)
    assert info.sightings_per_stamp is not None and info.sightings_per_stamp.maximum == 11
    per_tube = sorted(info.sightings_per_landmark.values())
    assert (len(per_tube), per_tube[0], per_tube[-1]) == (17, 1684, 5102)

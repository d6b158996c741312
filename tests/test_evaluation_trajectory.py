"""Absolute and relative path errors, with values derived by hand."""

from __future__ import annotations

import numpy as np
import pytest
from fastslam.errors import DataError
from fastslam.evaluation import RigidTransform, nees_bounds, pose_nees, relative_errors, trajectory_errors
from fastslam.log import TruthTrajectory
from fastslam.result import Trajectory

# Orthogonal to a shift and to a turn of five evenly spaced points on a line, so no alignment absorbs it.
BEND = np.array([2.0, -1.0, -2.0, -1.0, 2.0])
LINE = np.column_stack([np.arange(5.0), np.zeros(5), np.zeros(5)])
STAMPS = np.arange(5.0)
TURNED = RigidTransform(2.5, np.array([30.0, -7.0]))


def bent_line() -> np.ndarray:
    poses = LINE.copy()
    poses[:, 1] += 0.1 * BEND
    return poses


@pytest.mark.parametrize("frame", [RigidTransform.identity(), TURNED])
def test_error_by_hand_in_any_frame(frame: RigidTransform) -> None:
    errors = trajectory_errors(
        Trajectory(STAMPS, frame.apply_poses(bent_line())), TruthTrajectory(STAMPS, LINE)
    )
    assert errors is not None
    # Sizes 0.2, 0.1, 0.2, 0.1, 0.2.
    assert errors.aligned_m.rmse == pytest.approx(0.1 * np.sqrt(14 / 5))
    assert errors.aligned_m.median == pytest.approx(0.2)
    assert errors.aligned_m.max == pytest.approx(0.2)
    assert errors.aligned_m.p95 == pytest.approx(0.2)
    assert errors.heading_rad is not None
    assert errors.heading_rad.max == pytest.approx(0.0, abs=1e-12)
    assert errors.uncovered == 0
    np.testing.assert_allclose(errors.transform.rotation, frame.inverse().rotation, atol=1e-12)


def test_raw_error_keeps_the_shift_that_alignment_removes() -> None:
    shifted = LINE + np.array([3.0, -4.0, 0.0])
    errors = trajectory_errors(Trajectory(STAMPS, shifted), TruthTrajectory(STAMPS, LINE))
    assert errors is not None
    assert errors.raw_m.rmse == pytest.approx(5.0)
    assert errors.aligned_m.rmse == pytest.approx(0.0, abs=1e-12)


def test_heading_error_is_wrapped_and_in_the_frame_of_the_truth() -> None:
    poses = TURNED.apply_poses(LINE + np.array([0.0, 0.0, 0.05]))
    poses[:, 2] += 2.0 * np.pi * np.arange(5)
    errors = trajectory_errors(Trajectory(STAMPS, poses), TruthTrajectory(STAMPS, LINE))
    assert errors is not None and errors.heading_rad is not None
    assert errors.heading_rad.rmse == pytest.approx(0.05)


def test_stamps_outside_and_in_gaps_do_not_count_but_are_counted() -> None:
    stamps = np.array([0.0, 1.0, 2.0, 10.0, 11.0, 12.0])
    path = Trajectory(stamps, np.column_stack([stamps, np.zeros(6), np.zeros(6)]))
    true_stamps = np.arange(-1.0, 14.0)
    truth = TruthTrajectory(true_stamps, np.column_stack([true_stamps, np.zeros((15, 2))]))
    errors = trajectory_errors(path, truth, max_gap_s=1.0)
    assert errors is not None
    assert errors.stamp_s.tolist() == [0, 1, 2, 3, 9, 10, 11, 12]
    assert errors.uncovered == 7


def test_interpolation_goes_the_short_way_round() -> None:
    path = Trajectory(np.array([0.0, 1.0, 2.0]), np.array([[0, 0, 3.1], [1, 0, -3.1], [2, 1, -3.0]]))
    half = np.pi  # between 3.1 and 2 pi - 3.1
    truth = TruthTrajectory(np.array([0.0, 0.5, 2.0]), np.array([[0, 0, 3.1], [0.5, 0, half], [2, 1, -3.0]]))
    errors = trajectory_errors(path, truth)
    assert errors is not None and errors.heading_rad is not None
    assert errors.heading_rad.max == pytest.approx(0.0, abs=1e-9)


def test_unknown_headings_may_be_nan_and_give_no_heading_error() -> None:
    truth = TruthTrajectory(STAMPS, LINE + np.array([0, 0, np.nan]), heading_known=False)
    errors = trajectory_errors(Trajectory(STAMPS, bent_line()), truth)
    assert errors is not None
    assert errors.heading_rad is None
    assert errors.aligned_m.rmse == pytest.approx(0.1 * np.sqrt(14 / 5))
    assert relative_errors(Trajectory(STAMPS, bent_line()), truth) == {}


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_a_path_that_is_not_finite_is_refused(bad: float) -> None:
    poses = bent_line()
    poses[3, 1] = bad
    with pytest.raises(DataError, match="estimated path: row 3 is not finite"):
        trajectory_errors(Trajectory(STAMPS, poses), TruthTrajectory(STAMPS, LINE))
    with pytest.raises(DataError, match="true path: row 3"):
        trajectory_errors(Trajectory(STAMPS, LINE), TruthTrajectory(STAMPS, poses))


def test_a_path_that_runs_backwards_is_refused() -> None:
    with pytest.raises(DataError, match="go back at row 1"):
        trajectory_errors(Trajectory(STAMPS[::-1], LINE), TruthTrajectory(STAMPS, LINE))


@pytest.mark.parametrize("count", [0, 1])
def test_too_short_a_path_has_no_error(count: int) -> None:
    path = Trajectory(STAMPS[:count], LINE[:count])
    assert trajectory_errors(path, TruthTrajectory(STAMPS, LINE)) is None


def test_a_robot_that_stands_still_has_no_aligned_error() -> None:
    still = np.zeros((5, 3))
    assert trajectory_errors(Trajectory(STAMPS, still), TruthTrajectory(STAMPS, still)) is None


def test_relative_error_of_a_wrong_scale_grows_with_the_length() -> None:
    truth = TruthTrajectory(STAMPS, LINE)
    path = Trajectory(STAMPS, TURNED.apply_poses(LINE * [1.1, 1.0, 1.0]))
    errors = relative_errors(path, truth, distances_m=(1.0, 3.0, 5.0))
    # The path is 4 m long: 5 m is never reached.
    assert list(errors) == [1.0, 3.0]
    assert errors[1.0].rmse == pytest.approx(0.1)
    assert errors[3.0].max == pytest.approx(0.3)


def test_nees_by_hand_in_a_turned_frame() -> None:
    # Errors 0.2 m ahead and 0.3 m left, with standard deviations 0.2 m ahead and 0.1 m left: 1 + 9.
    estimate = LINE + np.array([0.2, 0.3, 0.0])
    covariance = np.tile(np.diag([0.04, 0.01, 0.0025]), (5, 1, 1))
    path = Trajectory(STAMPS, TURNED.apply_poses(estimate), TURNED.apply_covariances(covariance))
    found = pose_nees(path, TruthTrajectory(STAMPS, LINE), T_truth_world=TURNED.inverse())
    # The floor of (1 mm)² lowers it by 1e-4 of each part.
    np.testing.assert_allclose(found.nees, 10.0, rtol=1.1e-4)
    assert (len(found.nees), found.degrees_of_freedom, found.floored) == (5, 3, 0)


def test_nees_is_taken_where_the_truth_covers_the_estimate() -> None:
    stamps = np.array([0.5, 2.5, 3.5, 7.0])
    poses = np.column_stack([stamps + np.array([0.1, 0.2, 0.3, 0.0]), np.zeros((4, 2))])
    path = Trajectory(stamps, poses, np.tile(np.eye(3), (4, 1, 1)))
    found = pose_nees(path, TruthTrajectory(STAMPS, LINE))
    assert found.stamp_s.tolist() == [0.5, 2.5, 3.5]
    np.testing.assert_allclose(found.nees, [0.01, 0.04, 0.09], rtol=1e-5)


def test_nees_of_a_coalesced_cloud_is_finite_and_counted() -> None:
    path = Trajectory(STAMPS, LINE + np.array([0.001, 0.0, 0.0]), np.zeros((5, 3, 3)))
    truth = TruthTrajectory(STAMPS, LINE, heading_known=False)
    found = pose_nees(path, truth)
    np.testing.assert_allclose(found.nees, 1.0)
    assert (found.degrees_of_freedom, found.floored) == (2, 5)


def test_nees_without_covariance_is_refused() -> None:
    with pytest.raises(DataError, match="covariance"):
        pose_nees(Trajectory(STAMPS, LINE), TruthTrajectory(STAMPS, LINE))


@pytest.mark.parametrize(("runs", "low", "high"), [(50, 2.36, 3.72), (30, 2.19, 3.94)])
def test_nees_bounds_are_the_published_ones(runs: int, low: float, high: float) -> None:
    found = nees_bounds(runs=runs, degrees_of_freedom=3)
    assert found == pytest.approx((low, high), abs=0.005)

"""Rigid alignment, plain and against outliers."""

from __future__ import annotations

import numpy as np
import pytest
from fastslam.errors import DataError
from fastslam.evaluation import RigidTransform, align_points, align_points_robustly
from hypothesis import given
from hypothesis import strategies as st

POINTS_M = np.array([[0.0, 0.0], [4.0, 1.0], [2.0, 7.0], [-3.0, 0.5]])


@given(
    st.sampled_from([0.0, 1e-8, 1.0, -2.5, np.pi - 1e-9, -np.pi + 1e-9, np.pi]),
    st.floats(-100, 100),
    st.floats(-100, 100),
)
def test_alignment_recovers_the_motion(angle: float, x: float, y: float) -> None:
    motion = RigidTransform(angle, np.array([x, y]))
    found = align_points(POINTS_M, motion.apply_points(POINTS_M))
    np.testing.assert_allclose(found.apply_points(POINTS_M), motion.apply_points(POINTS_M), atol=1e-9)
    np.testing.assert_allclose(found.rotation, motion.rotation, atol=1e-9)


def test_swapping_the_sides_gives_the_inverse() -> None:
    target = RigidTransform(2.0, np.array([5.0, -1.0])).apply_points(POINTS_M) + 0.1 * POINTS_M[::-1]
    forward, backward = align_points(POINTS_M, target), align_points(target, POINTS_M)
    np.testing.assert_allclose(backward.rotation_rad, -forward.rotation_rad, atol=1e-12)
    np.testing.assert_allclose(backward.translation_m, forward.inverse().translation_m, atol=1e-12)


def test_a_quarter_turn_by_hand() -> None:
    motion = RigidTransform(np.pi / 2, np.array([10.0, 20.0]))
    np.testing.assert_allclose(motion.apply_points(np.array([[3.0, 1.0]])), [[9.0, 23.0]])
    np.testing.assert_allclose(
        motion.apply_poses(np.array([[3.0, 1.0, 0.5]])), [[9.0, 23.0, 0.5 + np.pi / 2]]
    )
    turned = motion.apply_covariances(np.array([[[4.0, 1.0, 0.3], [1.0, 9.0, 0.7], [0.3, 0.7, 2.0]]]))
    np.testing.assert_allclose(turned, [[[9.0, -1.0, -0.7], [-1.0, 4.0, 0.3], [-0.7, 0.3, 2.0]]], atol=1e-12)


def test_a_point_of_no_weight_does_not_count() -> None:
    target = POINTS_M.copy()
    target[1] += 50.0
    found = align_points(POINTS_M, target, weights=np.array([1.0, 0.0, 2.0, 1.0]))
    np.testing.assert_allclose(found.apply_points(POINTS_M), POINTS_M, atol=1e-12)


@pytest.mark.parametrize(
    ("source", "weights", "message"),
    [
        (POINTS_M[:1], None, "at least 2 pairs"),
        (POINTS_M[:0], None, "at least 2 pairs"),
        (POINTS_M, np.array([1.0, 0.0, 0.0, 0.0]), "at least 2 pairs"),
        (np.ones((4, 2)), None, "two places"),
        (np.where(POINTS_M == 7.0, np.nan, POINTS_M), None, "finite"),
        (np.ones((4, 3)), None, "shape"),
    ],
)
def test_what_determines_no_rotation_is_refused(
    source: np.ndarray, weights: np.ndarray | None, message: str
) -> None:
    with pytest.raises(DataError, match=message):
        align_points(source, source.copy(), weights=weights)


def test_wild_fixes_do_not_move_the_robust_alignment() -> None:
    rng = np.random.default_rng(4)
    source = rng.uniform(-100.0, 100.0, (300, 2))
    motion = RigidTransform(-0.6, np.array([70.0, 40.0]))
    target = motion.apply_points(source)
    wild = np.arange(300) % 4 == 0
    target[wild] += np.array([250.0, -90.0])
    plain = align_points(source, target)
    assert np.linalg.norm(plain.apply_points(source[~wild]) - target[~wild], axis=1).mean() > 50.0
    found = align_points_robustly(source, target)
    np.testing.assert_array_equal(found.inliers, ~wild)
    np.testing.assert_allclose(found.transform.apply_points(source[~wild]), target[~wild], atol=1e-9)


def test_the_inlier_distance_is_ten_metres() -> None:
    source = np.array([[x, y] for x in (0.0, 50.0, 100.0) for y in (0.0, 50.0, 100.0)])
    target = np.vstack([source, source[:1] + np.array([0.0, 9.0]), source[:1] + np.array([0.0, 12.0])])
    source = np.vstack([source, source[:1], source[:1]])
    # Fitting moves the transform by about a metre towards the inlier that is 9 m off, so that the other
    # stays outside: 12 - 1 > 10.
    found = align_points_robustly(source, target)
    assert found.inliers.tolist() == [True] * 10 + [False]

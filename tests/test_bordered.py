"""The core's least squares with parameters at the border, against equations written out here."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from fastslam._bordered import (
    GAUGE,
    PARAMETERS,
    SURVEY_STD_M,
    Batch,
    carried_by,
    clustered,
    moved_by,
    rows_of,
    solved,
)
from fastslam.datasets.planar import wrap_to_pi
from fastslam.errors import NumericalError
from fastslam.log import Floats

POSES, LANDMARKS, OF_MOTION = 6, 3, 2
BY_MOTION = np.random.default_rng(8).normal(size=(POSES - 1, 3, OF_MOTION))


def batch_of(*, surveyed: bool) -> Batch:
    """A bend with three landmarks; each is seen from every pose, one of them twice."""
    random = np.random.default_rng(3)
    turn = 0.4 * np.arange(POSES)
    poses = np.column_stack([2.0 * np.sin(turn), 1.5 - 2.0 * np.cos(turn), turn + 0.2])
    pose = np.append(np.repeat(np.arange(POSES), LANDMARKS), 2)
    landmark = np.append(np.tile(np.arange(LANDMARKS), POSES), 1)
    known = np.array([[4.0, 1.1], [np.nan, np.nan], [0.5, 3.0]])
    return Batch(
        poses=poses,
        landmarks_m=np.array([[4.1, 1.0], [-2.0, 3.5], [0.4, 2.9]]),
        parameters=np.array([1.04, 0.1, 0.3, -0.15, 0.08]),
        motion=random.normal([0.8, 0.1, 0.4], 0.05, size=(POSES - 1, 3)),
        pose=pose,
        landmark=landmark,
        range_m=random.uniform(2.0, 5.0, len(pose)),
        bearing_rad=random.uniform(-3.0, 3.0, len(pose)),
        surveyed_m=known if surveyed else np.full((LANDMARKS, 2), np.nan),
    )


def residuals(batch: Batch, change: Floats) -> Floats:
    """What is left to explain after a change of poses, landmarks, errors of the motion and of the sensor."""
    at = np.cumsum([3 * POSES, 2 * LANDMARKS, OF_MOTION])
    moves, shifts, errors, sensor = np.split(change, at)
    poses = batch.poses + moves.reshape(-1, 3)
    landmarks = batch.landmarks_m + shifts.reshape(-1, 2)
    scale, bias_m, x_m, y_m, yaw_rad = batch.parameters + sensor
    found = []
    for pose, landmark, range_m, bearing_rad in zip(
        batch.pose, batch.landmark, batch.range_m, batch.bearing_rad, strict=True
    ):
        x, y, heading = poses[pose]
        eye = complex(x, y) + np.exp(1j * heading) * complex(x_m, y_m)
        ray = complex(*landmarks[landmark]) - eye
        bearing = np.angle(ray * np.exp(-1j * (heading + yaw_rad)))
        found += [scale * abs(ray) + bias_m - range_m, float(wrap_to_pi(bearing - bearing_rad))]
    for before, after, motion, by in zip(poses[:-1], poses[1:], batch.motion, BY_MOTION, strict=True):
        step = complex(*(after - before)[:2]) * np.exp(-1j * before[2])
        found += list(np.array([step.real, step.imag, after[2] - before[2]]) - motion - by @ errors)
    return np.array(found)


@pytest.mark.parametrize("surveyed", [False, True])
def test_step_covariance_influence_and_response_are_those_of_dense_equations(surveyed: bool) -> None:
    batch, random = batch_of(surveyed=surveyed), np.random.default_rng(4)
    size, count = 3 * POSES + 2 * LANDMARKS, OF_MOTION + len(PARAMETERS)
    seen = random.uniform(5.0, 20.0, size=(len(batch.pose), 2))
    roots = random.normal(size=(POSES - 1, 3, 3)) + 10.0 * np.eye(3)
    prior_std = np.array([0.1, 0.2, 0.3, 0.0, 0.5, 0.4, 0.3])
    missing = random.normal(size=count) * 0.1 * (prior_std > 0)
    equations = solved(
        batch,
        rows_of(batch, BY_MOTION),
        whitening=(seen, roots),
        missing=missing,
        prior_std=prior_std,
    )
    # The same by differences and a dense solution.
    whiten = np.diag(np.append(seen.ravel(), np.zeros(3 * (POSES - 1))))
    for link, root in enumerate(roots):
        place = slice(seen.size + 3 * link, seen.size + 3 * link + 3)
        whiten[place, place] = root
    h, units = 1e-6, np.eye(size + count)
    jacobian = np.column_stack([residuals(batch, h * u) - residuals(batch, -h * u) for u in units]) / (2 * h)
    jacobian[:, size:] *= prior_std > 0
    jacobian, left = whiten @ jacobian, whiten @ residuals(batch, np.zeros(size + count))
    information = np.append(np.zeros(size), 1 / np.where(prior_std > 0, prior_std, 1e-9) ** 2)
    target = np.append(np.zeros(size), missing)
    if surveyed:
        known = np.isfinite(batch.surveyed_m).ravel()
        information[3 * POSES : size] = known / SURVEY_STD_M**2
        target[3 * POSES : size] = np.nan_to_num((batch.surveyed_m - batch.landmarks_m).ravel())
    else:
        information[:3] = GAUGE
    inverse = np.linalg.inv(jacobian.T @ jacobian + np.diag(information))
    step = inverse @ (information * target - jacobian.T @ left)
    # Differences are good to 1e-9 of numbers below 100, and a dense inverse with a gauge of 1e8 to 1e-8.
    np.testing.assert_allclose(equations.residuals(), left, atol=1e-9)
    np.testing.assert_allclose(np.concatenate(equations.step()), step, rtol=1e-6, atol=1e-7)
    np.testing.assert_allclose(equations.covariance(), inverse[size:, size:], rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(equations.influence(), jacobian @ inverse[:, size:], rtol=1e-6, atol=1e-7)
    noise = random.normal(size=len(left) + size + count)
    pushed = np.sqrt(information) * noise[len(left) :] - jacobian.T @ noise[: len(left)]
    np.testing.assert_allclose(equations.response(noise), jacobian @ inverse @ pushed, rtol=1e-5, atol=1e-6)
    unknowns, parameters = equations.step()
    parameters[:OF_MOTION] = 0.0
    moved = rows_of(moved_by(batch, unknowns, parameters[OF_MOTION:]))
    expected = residuals(batch, np.concatenate([unknowns, parameters]))
    np.testing.assert_allclose(np.append(moved.seen, moved.moved), expected, atol=1e-9)


def test_a_small_step_carries_as_it_moves() -> None:
    batch, random = batch_of(surveyed=False), np.random.default_rng(6)
    unknowns = 1e-4 * random.normal(size=3 * POSES + 2 * LANDMARKS)
    parameters = np.arange(5.0)
    carried, moved = (by(batch, unknowns, parameters) for by in (carried_by, moved_by))
    # What is of second order, over six poses of metres.
    np.testing.assert_allclose(carried.poses, moved.poses, atol=1e-6)
    np.testing.assert_allclose(carried.landmarks_m, moved.landmarks_m, atol=1e-6)
    np.testing.assert_array_equal(carried.parameters, moved.parameters)


def test_a_turn_carries_all_that_comes_after_without_bending_it() -> None:
    batch = batch_of(surveyed=False)
    batch = replace(batch, pose=np.full(len(batch.pose), 2))
    turn = 1.0
    turned_m = turn * (batch.poses[2:, :2] - batch.poses[2, :2])[:, ::-1] * [-1.0, 1.0]
    shifted_m = turn * (batch.landmarks_m - batch.poses[2, :2])[:, ::-1] * [-1.0, 1.0]
    steps = np.zeros_like(batch.poses)
    steps[2:] = np.column_stack([turned_m, np.full(len(turned_m), turn)])
    carried = carried_by(batch, np.concatenate([steps.ravel(), shifted_m.ravel()]), np.zeros(5))
    turning = np.exp(1j * turn)
    middle = complex(*batch.poses[2, :2])
    for before, after in ((batch.poses[2:], carried.poses[2:]), (batch.landmarks_m, carried.landmarks_m)):
        expected = middle + turning * (before[:, 0] + 1j * before[:, 1] - middle)
        np.testing.assert_allclose(after[:, 0] + 1j * after[:, 1], expected, atol=1e-12)
    np.testing.assert_allclose(carried.poses[:2], batch.poses[:2], atol=1e-12)


def test_scores_that_agree_within_stretches_widen_the_covariance() -> None:
    batch = replace(batch_of(surveyed=False), pose=np.repeat(np.arange(20), 5), poses=np.zeros((20, 3)))
    rows = 2 * 100 + 3 * 19
    alternating = np.where(np.arange(rows) % 2, 1.0, -1.0)[:, None]
    apart = np.sign(np.concatenate([np.repeat(batch.pose, 2), np.repeat(np.arange(19), 3)]) - 9.5)[:, None]
    covariance = np.array([[4.0]])
    np.testing.assert_array_equal(clustered(batch, 0.01 * alternating, covariance), covariance)
    # Ten stretches whose sums are all 0.01 * (20 + 6), the last 0.03 less, five of them negative.
    sums = 0.01 * np.array([-26.0] * 5 + [26.0] * 4 + [23.0])
    np.testing.assert_allclose(
        clustered(batch, 10 * 0.01 * apart, covariance), [[100 * np.sum(sums**2) * 10 / 9]], rtol=1e-12
    )


def test_what_nothing_holds_is_an_error() -> None:
    batch = replace(batch_of(surveyed=False), range_m=np.full(3 * POSES + 1, np.nan))
    with pytest.raises(NumericalError, match="do not hold path and landmarks"):
        solved(
            batch,
            rows_of(batch),
            whitening=(np.ones((len(batch.pose), 2)), np.tile(np.eye(3), (POSES - 1, 1, 1))),
            missing=np.zeros(5),
            prior_std=np.ones(5),
        )
    with pytest.raises(ValueError, match="which do not fit"):
        rows_of(replace(batch, poses=batch.poses[:2]))

"""`fastslam.FastSlam`: the filter over a stream."""

from __future__ import annotations

import numpy as np
import pytest
from fastslam import FastSlam
from fastslam.errors import ConfigError, DataError

LANDMARKS_M = {"oak": (4.0, 2.0), "elm": (6.0, -3.0), "ash": (1.0, 3.0)}


def drive(robot: FastSlam, *, steps: int = 40, named: bool = True) -> None:
    """One metre per second along x from the origin, all landmarks seen without noise at 10 Hz."""
    for step in range(1, steps + 1):
        robot.predict([1.0, 0.0], dt_s=0.1)
        x_m = 0.1 * step
        offset = np.array([(px - x_m, py) for px, py in LANDMARKS_M.values()])
        robot.update(
            x_m,
            range_m=np.hypot(*offset.T),
            bearing_rad=np.arctan2(offset[:, 1], offset[:, 0]),
            identity=list(LANDMARKS_M) if named else None,
        )


@pytest.mark.parametrize("named", [True, False])
def test_finds_pose_and_landmarks(named: bool) -> None:
    robot = FastSlam(identities="all" if named else "none")
    drive(robot, named=named)
    pose, covariance = robot.pose
    # Sightings without noise, believed to 10 cm and 20 mrad: a decimetre is over three final spreads.
    np.testing.assert_allclose(pose, [4.0, 0.0, 0.0], atol=0.1)
    assert np.linalg.eigvalsh(covariance).min() >= 0.0
    landmarks = robot.landmarks
    assert len(landmarks.ids) == len(LANDMARKS_M)
    for name, mean_m in zip(landmarks.ids, landmarks.mean_m, strict=True):
        truth = (
            LANDMARKS_M[name] if named else min(LANDMARKS_M.values(), key=lambda p: np.hypot(*(p - mean_m)))
        )
        np.testing.assert_allclose(mean_m, truth, atol=0.15)
    assert named == (set(landmarks.ids) == set(LANDMARKS_M))


def test_particles_and_path_have_the_shapes_that_are_promised() -> None:
    robot = FastSlam({"filter": {"particles": 30}})
    drive(robot, steps=10)
    poses, weights = robot.particles
    assert poses.shape == (30, 3) and weights.shape == (30,)
    assert weights.sum() == pytest.approx(1.0, abs=1e-12)
    assert robot.path.T_world_robot.shape == (len(robot.path.stamp_s), 3)


def test_an_empty_scan_is_a_step() -> None:
    robot = FastSlam()
    robot.predict([1.0, 0.0], dt_s=0.5)
    info = robot.update(0.5, range_m=[], bearing_rad=[])
    assert (info.sightings, info.landmarks) == (0, 0)
    np.testing.assert_allclose(robot.pose[0][:2], [0.5, 0.0], atol=0.3)


def test_sightings_that_cannot_be_used_are_skipped_and_counted() -> None:
    robot = FastSlam(identities="none")
    info = robot.update(0.0, range_m=[np.nan, 1e-9, 1e9, 2.0], bearing_rad=[0.1, 0.1, 0.1, 0.1])
    assert (info.skipped, info.new_landmarks) == (3, 1)
    assert np.isfinite(robot.landmarks.mean_m).all()


def test_a_step_is_a_prediction_and_an_update() -> None:
    alone, together = FastSlam(), FastSlam()
    for _ in range(3):
        alone.predict([1.0, 0.1], dt_s=0.2)
    alone.update(0.6, range_m=[3.0], bearing_rad=[0.2], identity=[7])
    for _ in range(2):
        together.predict([1.0, 0.1], dt_s=0.2)
    together.step([1.0, 0.1], dt_s=0.2, range_m=[3.0], bearing_rad=[0.2], identity=["7"])
    np.testing.assert_array_equal(alone.particles[0], together.particles[0])
    np.testing.assert_allclose(together.path.stamp_s, [0.6], atol=1e-12)
    assert together.landmarks.ids == ("7",)


def test_a_sighting_may_bring_its_own_covariance() -> None:
    robot = FastSlam()
    covariance = [[0.04, 0.0, 1e-4], [np.nan, np.nan, np.nan]]
    robot.update(
        0.0, range_m=[4.0, 4.0], bearing_rad=[0.0, 0.0], identity=["own", "default"], covariance=covariance
    )
    own, default = (robot.landmarks.covariance_m2[robot.landmarks.ids.index(n)] for n in ("own", "default"))
    # Straight ahead: the variance of the range along x, that of the bearing times 4 m squared along y.
    np.testing.assert_allclose(own, np.diag([0.04, 16e-4]), atol=1e-12)
    np.testing.assert_allclose(default, np.diag([0.1**2, (4.0 * 0.02) ** 2]), atol=1e-12)


def test_bad_calls_are_refused() -> None:
    with pytest.raises(ConfigError, match=r"^filter\.particles: "):
        FastSlam({"filter": {"particles": 0}})
    robot = FastSlam()
    with pytest.raises(DataError, match="expected speed_m_per_s, yaw_rate_rad_per_s"):
        robot.predict([1.0, 0.0, 0.0], dt_s=0.1)
    with pytest.raises(DataError):
        robot.predict([float("nan"), 0.0], dt_s=0.1)
    with pytest.raises(DataError, match="equal numbers"):
        robot.update(0.0, range_m=[1.0, 2.0], bearing_rad=[0.0])
    with pytest.raises(DataError, match="equal numbers"):
        robot.update(0.0, range_m=[1.0, 2.0], bearing_rad=[0.0, 0.1], identity=["one"])
    with pytest.raises(DataError, match="identity: got -2, expected a name"):
        robot.update(0.0, range_m=[1.0], bearing_rad=[0.0], identity=[-2])
    with pytest.raises(DataError, match="n x 3"):
        robot.update(0.0, range_m=[1.0, 2.0], bearing_rad=[0.0, 0.1], covariance=[[0.1, 0.0, 0.1]])
    robot.update(2.0, range_m=[1.0], bearing_rad=[0.0], identity=["one"])
    for stamp_s in (1.0, float("nan")):
        with pytest.raises(DataError, match=r"expected a finite time not before 2\.0"):
            robot.update(stamp_s, range_m=[1.0], bearing_rad=[0.0], identity=["one"])

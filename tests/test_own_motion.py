"""Motion models of one's own: displacements of a log, checked answers, and live."""

from __future__ import annotations

from dataclasses import replace

import fastslam
import numpy as np
import pytest
from fastslam.dead_reckoning import path_of_odometry
from fastslam.errors import DataError, ModelError
from fastslam.evaluation import evaluate
from fastslam.log import Floats, Log
from fastslam.motions import displacement, with_motion
from fastslam.robot import Robot
from fastslam.simulation import simulate

SPEED_STD, YAW_RATE_STD = 0.1, 0.05


class Arcs:
    """Speed and yaw rate, as the built-in model `velocity` has them."""

    def increments(self, controls: Floats, dt_s: Floats) -> Floats:
        along, turn = controls[:, 0] * dt_s, controls[:, 1] * dt_s
        chord = along * np.sinc(turn / (2.0 * np.pi))
        return np.column_stack([chord * np.cos(turn / 2.0), chord * np.sin(turn / 2.0), turn])

    def covariance(self, controls: Floats, dt_s: Floats) -> Floats:
        noise = np.diag([SPEED_STD**2, 1e-6, YAW_RATE_STD**2]) * 0.1
        scaled: Floats = dt_s[:, None, None] * noise
        return scaled


@pytest.fixture(scope="module")
def log() -> Log:
    motion = {"model": "velocity", "speed_std_m_per_s": SPEED_STD, "yaw_rate_std_rad_per_s": YAW_RATE_STD}
    return simulate({"seed": 7, "max_duration_s": 40.0, "motion": {**motion, "noise_period_s": 0.1}})


def test_the_path_of_odometry_is_that_of_the_built_in_model(log: Log) -> None:
    own = with_motion(log, Arcs())
    built_in, path = path_of_odometry(log), path_of_odometry(own)
    place = {
        round(stamp, 9): pose for stamp, pose in zip(path.stamp_s, _chained(path.increments), strict=True)
    }
    shared = [i for i, stamp in enumerate(built_in.stamp_s) if round(stamp, 9) in place]
    assert len(shared) > 100
    expected = _chained(built_in.increments)[shared]
    found = np.array([place[round(built_in.stamp_s[i], 9)] for i in shared])
    np.testing.assert_allclose(found, expected, atol=1e-6)


def _chained(increments: Floats) -> Floats:
    from fastslam.datasets.planar import chain_increments

    return chain_increments(increments)


def test_a_run_maps_as_well_as_with_the_built_in_model(log: Log) -> None:
    config = {"filter": {"particles": 50}, "seed": 1}
    own, built_in = (evaluate(fastslam.run(each, config), log) for each in (with_motion(log, Arcs()), log))
    assert own["landmark_matched"] == built_in["landmark_matched"] > 20
    assert 0.8 < own["smoothed_ate_rmse_m"] / built_in["smoothed_ate_rmse_m"] < 1.2


def test_odometry_may_have_more_columns_than_a_log(log: Log) -> None:
    class Wheels:
        """Four wheels that roll sideways too."""

        def increments(self, controls: Floats, dt_s: Floats) -> Floats:
            mixing = np.array([[1, 1, 1, 1], [-1, 1, 1, -1], [-2, 2, -2, 2]]) / 4.0
            moved: Floats = controls @ mixing.T * dt_s[:, None]
            return moved

        def covariance(self, controls: Floats, dt_s: Floats) -> Floats:
            return np.diag([1e-4, 4e-4, 1e-4])

    stamp_s = np.arange(0.0, 40.5, 0.5)
    speeds = np.tile([0.3, 0.5, 0.5, 0.3], (len(stamp_s), 1))
    moved = with_motion(log, Wheels(), controls=(stamp_s, speeds))
    assert moved.config["motion"] == {"model": "increments"} and moved.controls.covariance is not None
    first, *rest = moved.controls.values
    np.testing.assert_allclose(first, 0.0)
    np.testing.assert_allclose(rest, [[0.2, 0.05, 0.0]] * len(rest))
    assert moved.controls.stamp_s[-1] >= log.sightings.stamp_s[-1]


def test_live_takes_one_row_at_a_time(log: Log) -> None:
    model, own = Arcs(), with_motion(log, Arcs())
    robot = Robot({"motion": {"model": "increments"}, "filter": {"particles": 20}})
    stamp_s, values = log.controls.stamp_s, log.controls.values
    robot.odometry(float(stamp_s[0]), [0.0, 0.0, 0.0], covariance=1e-12 * np.eye(3))
    for i in range(50):
        moved, covariance = displacement(model, values[i], float(stamp_s[i + 1] - stamp_s[i]))
        np.testing.assert_allclose(moved, own.controls.values[i + 1], atol=1e-12)
        robot.odometry(float(stamp_s[i + 1]), moved, covariance=covariance)
    robot.end()
    assert np.linalg.norm(robot.pose[1][:2]) > 1.0


class Wrong(Arcs):
    """A model whose answers are replaced."""

    def __init__(self, **answers: object) -> None:
        self.answers = answers

    def increments(self, controls: Floats, dt_s: Floats) -> Floats:
        return self._or("increments", super().increments(controls, dt_s))

    def covariance(self, controls: Floats, dt_s: Floats) -> Floats:
        return self._or("covariance", super().covariance(controls, dt_s))

    def _or(self, part: str, right: Floats) -> Floats:
        answer = self.answers.get(part, right)
        return answer(right) if callable(answer) else answer  # type: ignore[return-value]


@pytest.mark.parametrize(
    ("answers", "message"),
    [
        ({"increments": lambda right: right[:, :2]}, r"Wrong\.increments: got shape \(\d+, 2\), expected"),
        ({"increments": lambda right: right * np.nan}, r"Wrong\.increments: row 0 is not finite"),
        ({"increments": lambda right: np.cumsum(right, axis=0)}, r"Wrong\.increments: row \d+ alone gives"),
        ({"increments": lambda right: 1 / 0}, r"Wrong\.increments: ZeroDivisionError"),
        (
            {"covariance": np.diag([1.0, 1.0, 0.0])},
            r"Wrong\.covariance: row 0 is .*, expected a positive definite",
        ),
        ({"covariance": [[1.0, 0.5, 0], [0, 1, 0], [0, 0, 1]]}, r"expected a positive definite"),
        ({"covariance": "wide"}, r"Wrong\.covariance: got what is no array"),
    ],
)
def test_wrong_answers_are_told_in_one_line(log: Log, answers: dict[str, object], message: str) -> None:
    with pytest.raises(ModelError, match=message) as error:
        with_motion(log, Wrong(**answers))
    assert "\n" not in str(error.value)


def test_what_is_no_model_or_no_table_is_told(log: Log) -> None:
    with pytest.raises(ModelError, match=r"object\.increments is missing"):
        with_motion(log, object())  # type: ignore[arg-type]
    for controls, message in [
        (([0.0, 0.0], [[1.0], [1.0]]), "row 1"),
        (([0.0], [1.0]), "shape"),
        (([0.0], [[1.0], [2.0]]), "1 stamps and 2 rows"),
        (([0.0, 1.0], [[1.0, np.inf]] * 2), "not finite"),
        (([1e17, 2e17], [[1.0]] * 2), "stamp_s: row 0"),
        (([], np.empty((0, 2))), "there are none"),
        (("abc", [[1.0]]), "numbers"),
    ]:
        with pytest.raises(DataError, match=message):
            with_motion(log, Arcs(), controls=controls)  # type: ignore[arg-type]
    alone = replace(log, controls=replace(log.controls, stamp_s=np.array([1e6]), values=np.ones((1, 2))))
    with pytest.raises(DataError, match="holds for no time"):
        with_motion(alone, Arcs())

"""How far sightings lie off the map is in the results, and landmarks at a wrong place are named."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import fastslam
import numpy as np
import pytest
from fastslam import runner
from fastslam.cards import calibration_text
from fastslam.errors import ModelError
from fastslam.log import Floats, Log
from fastslam.misplaced import Misplaced, _places, _Sighted, doubts_of, misplaced, without_misplaced
from fastslam.report import render_report
from fastslam.residuals import Group, compared
from fastslam.result import RunResult
from fastslam.resultfiles import read_result, write_result
from fastslam.simulation import resolve_simulation, simulate

FEW = {"filter": {"particles": 20}}
STD_M = 0.3


def beacons(model: str, **sensor: Any) -> Log:
    section = {"model": model, "range_std_m": STD_M, "max_range_m": 100.0, **sensor}
    return simulate({"seed": 4, "world": {"count": 8}, "sensor": section, "scan": {"period_s": 1.0}})


@pytest.fixture(scope="module")
def log() -> Log:
    return beacons("range")


@pytest.fixture(scope="module")
def result(log: Log) -> RunResult:
    return fastslam.run(log, FEW)


def moved(result: RunResult, row: int, to_m: Floats) -> RunResult:
    """The result with one landmark elsewhere, as surely as where it was."""
    mean_m = result.landmarks.mean_m.copy()
    mean_m[row] = to_m
    return replace(result, landmarks=replace(result.landmarks, mean_m=mean_m))


def placed(result: RunResult, log: Log) -> tuple[RunResult, Misplaced]:
    found = misplaced(result, compared(result, log))
    return without_misplaced(result, found), found


def test_residuals_of_a_right_map_are_what_the_noise_says(result: RunResult, log: Log) -> None:
    (of_range,) = result.landmarks.residuals
    assert of_range.kind == "range" and of_range.count.tolist() == result.landmarks.sightings.tolist()
    # A mean square of n squares of normal numbers errs by sqrt(2 / n): here n >= 100, five of these.
    assert of_range.count.min() >= 100
    assert of_range.rms.min() > 0.7 and of_range.rms.max() < 1.35
    assert np.abs(of_range.mean).max() < 0.5
    assert (result.verdict, result.doubts and result.doubts[0].rule) != ((), "misplaced")


@pytest.mark.parametrize("model", ["bearing", "range_bearing"])
def test_each_number_of_a_sighting_has_residuals(model: str) -> None:
    found = fastslam.run(beacons(model, bearing_std_rad=0.02), FEW).landmarks.residuals
    assert [of.kind for of in found] == (["bearing"] if model == "bearing" else ["range", "bearing"])
    for of in found:
        assert 0.6 < np.median(of.rms) < 1.3, of.rms


def test_without_names_residuals_are_of_what_lies_near() -> None:
    log = simulate(resolve_simulation({"seed": 3, "max_duration_s": 20.0}, preset="cones"))
    landmarks = fastslam.run(log, FEW).landmarks
    assert [of.kind for of in landmarks.residuals] == ["range", "bearing"]
    assert landmarks.confirmed is not None
    assert (landmarks.residuals[0].count[~landmarks.confirmed] == 0).all()
    assert 0.5 < np.nanmedian(landmarks.residuals[0].rms) < 1.5
    assert fastslam.run(log, {**FEW, "algorithm": "ekf"}).landmarks.residuals == ()


def test_residuals_and_calibration_are_in_files_and_report(
    result: RunResult, log: Log, tmp_path: Path
) -> None:
    assert set(result.calibration) == {
        *("range_scale", "range_scale_std", "range_bias_m", "range_bias_std_m"),
    }
    assert result.calibration["range_scale"] == pytest.approx(1.0, abs=0.02)
    assert calibration_text(result.calibration) in repr(result)
    write_result(result, log, tmp_path)
    read = read_result(tmp_path)
    assert read.calibration == result.calibration
    (ours,), (theirs,) = result.landmarks.residuals, read.landmarks.residuals
    np.testing.assert_allclose(theirs.rms, ours.rms, rtol=1e-8)
    assert theirs.count.tolist() == ours.count.tolist() and theirs.kind == ours.kind
    page = render_report(result, log)
    assert "<th>range residual</th><th>mean range residual</th>" in page
    assert "Learned of the sensor: range_scale" in page and f"range residual {ours.rms[0]:.2f}" in page
    told = fastslam.run(log, {**FEW, "sensor": {"range_scale_std": 0, "range_bias_std_m": 0}})
    assert told.calibration == {}


def test_a_landmark_at_a_wrong_place_is_named_with_the_right_one(result: RunResult, log: Log) -> None:
    right_m, name = result.landmarks.mean_m[2], result.landmarks.ids[2]
    wrong, found = placed(moved(result, 2, right_m + np.array([6.0, -5.0])), log)
    assert [stand.row for stand in found.elsewhere] == [2] and found.undecided == ()
    assert found.elsewhere[0].other is not None
    assert np.hypot(*(found.elsewhere[0].other.mean_m - right_m)) < 0.5
    (doubt,) = doubts_of(wrong, found)
    assert (
        doubt.ratio > 1.0
        and f"of 8 landmarks are not to be believed, and are provisional in the map: {name}: "
        in doubt.sentence
    )
    assert "7.8 m away" in doubt.sentence
    assert wrong.landmarks.confirmed is not None and result.landmarks.confirmed is not None
    assert (result.landmarks.confirmed & ~wrong.landmarks.confirmed).nonzero()[0].tolist() == [2]


def test_sightings_that_fit_nowhere_are_named_too(result: RunResult, log: Log) -> None:
    """One name on two beacons, in turn: no place explains both."""
    identity = log.sightings.identity.copy()
    of_first = np.flatnonzero(identity == 0)
    identity[of_first[::2]] = 1
    mixed = replace(log, sightings=replace(log.sightings, identity=identity))
    _, found = placed(result, mixed)
    assert result.landmarks.ids[found.elsewhere[0].row] == log.identity_names[1]


def straight(std_m: float = 0.1) -> Log:
    """Two bends near two masts, and a third one heard along a straight stretch alone: on either side."""
    turns = np.zeros(120)
    turns[:20], turns[20:40] = 0.3, -0.3
    poses = np.zeros((121, 3))
    for k, turn in enumerate(turns):
        x, y, heading = poses[k]
        poses[k + 1] = x + np.cos(heading + turn / 2), y + np.sin(heading + turn / 2), heading + turn
    masts_m = {"near": poses[10, :2] + [3.0, 4.0], "far": poses[30, :2] + [-4.0, 12.0]}
    masts_m["aside"] = poses[90, :2] + 8.0 * np.array([-np.sin(poses[90, 2]), np.cos(poses[90, 2])])
    rng = np.random.default_rng(7)
    seen = [
        (float(k), np.hypot(*(at - poses[k, :2])) + std_m * rng.standard_normal(), name)
        for k in range(121)
        for name, at in masts_m.items()
        if name != "aside" or k > 60
    ]
    stamp_s, range_m, names = zip(*seen, strict=True)
    noise = {"speed_std_m_per_s": 0.005, "yaw_rate_std_rad_per_s": 0.001}
    sensor = {"model": "range", "range_std_m": std_m, "range_scale_std": 0, "range_bias_std_m": 0}
    controls = np.arange(121.0), np.column_stack([np.ones(121), [*turns, 0.0]])
    config = {"motion": {"model": "velocity", **noise}, "sensor": sensor}
    return fastslam.Log.from_arrays(controls, (stamp_s, range_m), identities=names, config=config)


def test_a_mast_on_either_side_of_a_straight_path_is_undecided() -> None:
    log = straight()
    result = fastslam.run(log, FEW)
    row = result.landmarks.ids.index("aside")
    assert result.landmarks.confirmed is not None
    assert not result.landmarks.confirmed[row], "the filter itself does not give it as sure"
    # And where one did: on the one side, as surely as the others.
    (group,) = compared(result, log)
    at = group.pose[group.landmark == row]
    step = at[-1, :2] - at[0, :2]
    aside = np.array([-step[1], step[0]]) / np.hypot(*step)
    sure = moved(result, row, at[29, :2] + 8.0 * aside)
    confirmed, covariance_m2 = result.landmarks.confirmed.copy(), result.landmarks.covariance_m2.copy()
    confirmed[row], covariance_m2[row] = True, 0.01 * np.eye(2)
    landmarks = replace(sure.landmarks, confirmed=confirmed, covariance_m2=covariance_m2)
    named, found = placed(replace(sure, landmarks=landmarks), log)
    assert found.elsewhere == () and [stand.row for stand in found.undecided] == [row]
    assert "1 of the landmarks may as well stand elsewhere" in named.warnings[-1]
    assert "aside at (" in named.warnings[-1] and "m away" in named.warnings[-1]
    assert named.landmarks.confirmed is not None and not named.landmarks.confirmed[row]
    assert [doubt.ratio for doubt in doubts_of(named, found)] == [0.25], "one is not too many"
    (many,) = doubts_of(named, replace(found, undecided=4 * found.undecided, landmarks=30))
    assert many.ratio == 1.0 and many.sentence.startswith("4 of 30 landmarks may as well stand elsewhere")


class Forgetful:
    """A sensor that does not know what to expect of landmarks beyond a place."""

    def __init__(self, group: Group, beyond_m: float) -> None:
        self.sensor, self.beyond_m = group.sensor, beyond_m

    def off(self, poses: Floats, landmarks: Floats, measured: Floats) -> Floats:
        if (landmarks[:, 0] > self.beyond_m).any():
            raise ModelError("it does not know")
        return self.sensor.off(poses, landmarks, measured)

    def starts(self, pose: Floats, measured: Floats) -> Floats:
        return self.sensor.starts(pose, measured)


def test_landmarks_are_placed_together_as_each_alone(result: RunResult, log: Log) -> None:
    (group,) = compared(result, log)
    landmarks = result.landmarks
    columns = zip(landmarks.mean_m, landmarks.covariance_m2, strict=True)
    sighted = [_Sighted(*column, np.flatnonzero(group.landmark == k)) for k, column in enumerate(columns)]

    def told(group: Group, sighted: list[_Sighted]) -> list[Any]:
        found = _places(group, sighted)
        return [None if f is None else [(*p.mean_m, p.loss) for p in f if p is not None] for f in found]

    assert told(group, sighted) == [told(group, [one])[0] for one in sighted]
    forgetful = replace(group, sensor=Forgetful(group, 26.0))
    alone = [told(forgetful, [one])[0] for one in sighted]
    assert told(forgetful, sighted) == alone
    assert 0 < alone.count(None) < len(sighted)


def test_what_places_landmarks_at_sight_is_judged_by_other_rules(log: Log) -> None:
    both = beacons("range_bearing")
    result = fastslam.run(both, FEW)
    assert misplaced(moved(result, 0, np.array([50.0, 50.0])), compared(result, both)) == Misplaced()


def test_calibration_that_was_learned_is_taken_off(log: Log) -> None:
    stretched = replace(log.sightings, range_m=1.04 * log.sightings.range_m + 0.2)
    result = fastslam.run(replace(log, sightings=stretched), FEW)
    assert result.calibration["range_scale"] == pytest.approx(1.04, abs=0.01)
    assert result.landmarks.residuals[0].rms.max() < 1.4


class Deaf:
    """Ranges from in front of the sensor alone, after the run; in the run from everywhere."""

    measures, noise = ("range_m",), ((STD_M**2,),)
    is_deaf = False

    def expected(self, poses: Floats, landmarks: Floats) -> Any:
        range_m = np.linalg.norm(landmarks - poses[:, :2], axis=1)
        return np.where(self.is_deaf, np.nan, range_m)[:, None]


def test_a_sensor_that_cannot_be_asked_again_costs_residuals_and_not_the_run(
    log: Log, result: RunResult, monkeypatch: pytest.MonkeyPatch
) -> None:
    sensor = Deaf()
    whole = runner.compared

    def deaf(*arguments: Any) -> Any:
        sensor.is_deaf = True
        return whole(*arguments)

    monkeypatch.setattr(runner, "compared", deaf)
    found = fastslam.run(log, FEW, sensor=sensor)
    assert len(found.landmarks.ids) == 8 and found.landmarks.residuals == ()
    assert "how far sightings lie off the map is not known: Deaf.expected" in found.warnings[-1]
    monkeypatch.undo()
    own = fastslam.run(log, FEW, sensor=Deaf())
    np.testing.assert_allclose(own.landmarks.residuals[0].rms, result.landmarks.residuals[0].rms, rtol=1e-3)

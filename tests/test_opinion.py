"""Several seeds over one log: when maps are the same, which run is kept, what is said where none agree."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cli_runner import fastslam
from fastslam import opinion
from fastslam.errors import DataError, NumericalError
from fastslam.evaluation.align import RigidTransform
from fastslam.log import Log
from fastslam.opinion import agreement, best_of, is_second_run_due, second_opinion
from fastslam.result import LandmarkMap, RunResult
from fastslam.resultfiles import read_result, write_result
from fastslam.runner import configure, run
from fastslam.simulation import simulate

UNKNOWN = {"association": {"mode": "unknown"}, "filter": {"particles": 10}}
FIELD_M = np.array([[float(x), float(y)] for x in range(0, 30, 3) for y in range(0, 9, 3)])
FIELD_M += np.random.default_rng(1).uniform(-0.4, 0.4, FIELD_M.shape)


@pytest.fixture(scope="module")
def log() -> Log:
    return simulate({"seed": 1, "world": {"count": 20}, "max_duration_s": 20.0})


def map_of(mean_m: np.ndarray, confirmed: np.ndarray | None = None) -> LandmarkMap:
    return LandmarkMap(
        ids=tuple(str(row) for row in range(len(mean_m))),
        mean_m=mean_m,
        covariance_m2=np.tile(0.01 * np.eye(2), (len(mean_m), 1, 1)),
        sightings=np.full(len(mean_m), 9),
        confirmed=confirmed,
    )


def result_of(template: RunResult, mean_m: np.ndarray, confirmed: np.ndarray | None = None) -> RunResult:
    """A run with this map."""
    return dataclasses.replace(template, landmarks=map_of(mean_m, confirmed))


def moved(template: RunResult, angle_rad: float, offset_m: list[float]) -> RunResult:
    """The same run in another frame."""
    lie = RigidTransform(angle_rad, np.array(offset_m))
    smoothed = dataclasses.replace(
        template.smoothed, T_world_robot=lie.apply_poses(template.smoothed.T_world_robot)
    )
    return dataclasses.replace(
        template, smoothed=smoothed, landmarks=map_of(lie.apply_points(template.landmarks.mean_m))
    )


def test_runs_agree_whatever_their_frame_and_disagree_where_a_map_is_doubled_or_a_path_elsewhere(
    log: Log,
) -> None:
    template = result_of(run(log, UNKNOWN), FIELD_M)
    for frame in ((0.0, [0.0, 0.0]), (0.03, [0.3, -0.2]), (2.0, [40.0, 9.0])):
        assert agreement(template, moved(template, *frame)) == 1.0
    doubled = np.concatenate([FIELD_M, FIELD_M[:15] + np.array([1.5, 1.4])])
    assert agreement(template, result_of(template, doubled)) == pytest.approx(2 * 30 / (30 + 45))
    assert agreement(template, result_of(template, doubled, np.arange(45) < 30)) == 1.0
    T_world_robot = template.smoothed.T_world_robot.copy()
    T_world_robot[: len(T_world_robot) // 4, :2] += 2.0
    astray = dataclasses.replace(template.smoothed, T_world_robot=T_world_robot)
    assert agreement(template, dataclasses.replace(template, smoothed=astray)) == pytest.approx(
        0.75, abs=0.01
    )
    none = result_of(template, np.zeros((0, 2)))
    assert agreement(none, none) == 1.0 and agreement(none, template) == 0.0
    one, far = result_of(template, FIELD_M[:1]), result_of(template, FIELD_M[:1] + 9.0)
    assert agreement(one, one) == 1.0 and agreement(one, far) == 0.0


def test_where_a_second_run_makes_the_same_map_the_first_is_the_result_to_the_bit(log: Log) -> None:
    result, alone = second_opinion(log, {**UNKNOWN, "seed": 5}), run(log, {**UNKNOWN, "seed": 5})
    assert [one.seed for one in result.tries] == [5, 6] and alone.tries == ()
    np.testing.assert_array_equal(result.landmarks.mean_m, alone.landmarks.mean_m)
    np.testing.assert_array_equal(result.trajectory.T_world_robot, alone.trajectory.T_world_robot)
    assert result.verdict == alone.verdict


def made_up(
    log: Log, monkeypatch: pytest.MonkeyPatch, maps: dict[int, tuple[np.ndarray, float]]
) -> list[int]:
    """Lets the run of each seed make this map with this evidence; returns where seeds that ran are noted."""
    template, ran = run(log, UNKNOWN), []

    def made(_log: Log, config: dict[str, Any], **_others: Any) -> RunResult:
        seed = config["seed"]
        ran.append(seed)
        mean_m, evidence = maps[seed]
        steps = dataclasses.replace(template.steps, log_likelihood=np.array([evidence]))
        return dataclasses.replace(
            result_of(template, mean_m), config={**template.config, "seed": seed}, steps=steps
        )

    monkeypatch.setattr(opinion, "run", made)
    return ran


def test_where_maps_differ_two_more_seeds_run_and_the_likeliest_that_another_confirms_is_kept(
    log: Log, monkeypatch: pytest.MonkeyPatch
) -> None:
    wrong = FIELD_M * [1.4, 0.7]
    maps = {0: (wrong, 50.0), 1: (FIELD_M, 12.0), 2: (FIELD_M + 0.1, 13.0), 3: (wrong[:9], 0.0)}
    ran = made_up(log, monkeypatch, maps)
    result = second_opinion(log, UNKNOWN)
    assert sorted(ran) == [0, 1, 2, 3] and result.config["seed"] == 2 and result.verdict == ()
    assert [(one.seed, one.log_evidence, one.landmarks) for one in result.tries][2] == (2, 13.0, 30)


@pytest.mark.slow
def test_a_map_that_no_other_run_makes_is_not_believed(log: Log, monkeypatch: pytest.MonkeyPatch) -> None:
    maps = {seed: (FIELD_M * [1.0 + 0.4 * seed, 1.0 - 0.2 * seed], float(seed)) for seed in range(4)}
    made_up(log, monkeypatch, maps)
    result = second_opinion(log, UNKNOWN)
    assert len(result.verdict) == 1
    assert result.verdict[0].startswith("4 runs that differ in their seeds came to different maps or paths")


def test_a_second_run_that_fails_is_no_opinion_and_a_first_one_that_fails_is_an_error(
    log: Log, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = opinion.run

    def failing(which: int) -> Any:
        def run_or_fail(log: Log, config: dict[str, Any], **others: Any) -> RunResult:
            if config["seed"] == which:
                raise NumericalError("no particle is left")
            return whole(log, config, **others)

        return run_or_fail

    monkeypatch.setattr(opinion, "run", failing(1))
    assert second_opinion(log, UNKNOWN).tries == ()
    monkeypatch.setattr(opinion, "agreement", lambda _one, _other: 0.1)
    monkeypatch.setattr(opinion, "run", failing(2))
    assert [one.seed for one in second_opinion(log, UNKNOWN).tries] == [0, 1], "what there is stays"
    monkeypatch.setattr(opinion, "run", failing(0))
    with pytest.raises(NumericalError, match="no particle"):
        second_opinion(log, UNKNOWN)


def test_an_interrupt_stops_both_runs(log: Log) -> None:
    def interrupt(_done: int, _total: int) -> None:
        raise KeyboardInterrupt

    result = second_opinion(log, UNKNOWN, progress=interrupt)
    assert result.interrupted and result.tries == ()


def test_a_second_run_is_due_where_chance_may_err_and_it_costs_seconds(log: Log) -> None:
    assert is_second_run_due(log, configure(log, UNKNOWN))
    assert not is_second_run_due(log, configure(log, {}))
    assert not is_second_run_due(
        log, configure(log, {"association": {"mode": "unknown"}, "algorithm": "ekf"})
    )
    assert not is_second_run_due(log, configure(log, UNKNOWN, {"filter": {"particles": 10**5}}))


def test_known_identities_over_a_log_without_names_are_run_and_judged_as_unknown(log: Log) -> None:
    nobody = np.full(len(log.sightings.stamp_s), -1, dtype=np.int64)
    nameless = dataclasses.replace(
        log, sightings=dataclasses.replace(log.sightings, identity=nobody), identity_names=()
    )
    assert is_second_run_due(nameless, configure(nameless, {}))
    known = {"association": {"mode": "known"}, "filter": {"particles": 10}}
    result, plain = run(nameless, known), run(nameless, UNKNOWN)
    assert result.config == plain.config and result.verdict == plain.verdict
    np.testing.assert_array_equal(result.smoothed.T_world_robot, plain.smoothed.T_world_robot)
    added = set(result.warnings) - set(plain.warnings)
    assert len(added) == 1 and "no sighting of the log names a landmark" in added.pop()
    # Nobody stated it, or one sighting has a name: nothing to say.
    assert run(nameless, {"filter": {"particles": 10}}).warnings == plain.warnings
    nobody[0] = 0
    named = dataclasses.replace(nameless, identity_names=("oak",))
    assert configure(named, known)["association"]["mode"] == "known"


def test_the_tries_are_kept_in_the_results_and_one_run_is_had_for_the_asking(tmp_path: Path) -> None:
    made = ("simulate", tmp_path / "log", "--seed", "1", "--landmarks", "20", "--set", "max_duration_s=15")
    assert fastslam(*made).exit_code == 0
    common = ("run", tmp_path / "log", "--association", "unknown", "--particles", "10", "--no-report")
    outcome = fastslam(*common, "--out", tmp_path / "two")
    assert outcome.exit_code == 0 and "seed" not in outcome.stderr, outcome.stderr
    assert [one.seed for one in read_result(tmp_path / "two").tries] == [0, 1]
    assert fastslam(*common, "--best-of", "1", "--out", tmp_path / "one").exit_code == 0
    assert read_result(tmp_path / "one").tries == ()
    facts = json.loads((tmp_path / "two" / "run.json").read_text())
    facts["tries"] = [{"seed": 1}]
    (tmp_path / "two" / "run.json").write_text(json.dumps(facts))
    with pytest.raises(DataError, match="`tries` is of the wrong type"):
        read_result(tmp_path / "two")


def test_the_likeliest_of_several_tells_what_all_came_to(log: Log, tmp_path: Path) -> None:
    best = best_of(log, UNKNOWN, seeds=range(3))
    write_result(best, log, tmp_path)
    assert read_result(tmp_path).tries == best.tries and len(best.tries) == 3


def test_an_own_sensor_gets_a_second_opinion() -> None:
    class Beacons:
        measures, noise = ("range_m",), ((0.04,),)

        def expected(self, poses: Any, landmarks: Any) -> Any:
            return np.linalg.norm(landmarks - poses[:, :2], axis=1)[:, None]

    sensor = {"model": "range", "range_std_m": 0.2, "max_range_m": 100.0}
    settings = {"seed": 3, "world": {"count": 6}, "sensor": sensor, "scan": {"period_s": 2.0}}
    config = {"filter": {"particles": 10}}
    log, own = simulate(settings), Beacons()
    result, alone = second_opinion(log, config, sensor=own), run(log, config, sensor=own)
    assert len(result.tries) >= 2 and result.tries[0].agreement is not None
    if result.config["seed"] == alone.config["seed"]:
        np.testing.assert_array_equal(result.landmarks.mean_m, alone.landmarks.mean_m)

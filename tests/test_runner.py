"""`fastslam.run` and `run_many`: the Python side of a run over a log."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import fastslam
import numpy as np
import pytest
from fastslam.datasets.clean import no_sightings
from fastslam.errors import ConfigError, DataError
from fastslam.log import Log
from fastslam.opinion import best_of
from fastslam.result import RunResult
from fastslam.runner import configure, run, run_many
from fastslam.simulation import resolve_simulation, simulate
from small_log import LANDMARKS_M, make_small_log

FEW: dict[str, Any] = {"filter": {"particles": 20}}


def test_result_is_complete_and_consistent() -> None:
    log = make_small_log()
    result = fastslam.run(log, FEW)
    steps = len(result.steps.stamp_s)
    # Sightings every half second for 30 s; the gaps are no longer than the path period.
    assert steps >= 60
    assert result.trajectory.T_world_robot.shape == (steps, 3)
    assert result.trajectory.covariance is not None
    assert result.trajectory.covariance.shape == (steps, 3, 3)
    assert len(result.smoothed.stamp_s) == steps
    assert sorted(result.landmarks.ids) == sorted(log.identity_names)
    assert result.landmarks.covariance_m2.shape == (len(LANDMARKS_M), 2, 2)
    assert result.landmarks.sightings.sum() == len(log.sightings.stamp_s)
    assert result.config["filter"]["particles"] == 20
    assert result.version.startswith(fastslam.__version__)
    assert result.peak_memory_bytes > 10_000_000
    assert not result.interrupted


def test_map_is_close_to_truth_and_within_its_uncertainty() -> None:
    log = make_small_log()
    result = run(log, {"seed": 2})
    truth = dict(zip(log.identity_names, LANDMARKS_M, strict=True))
    error_m = result.landmarks.mean_m - np.array([truth[name] for name in result.landmarks.ids])
    nees = [
        error @ np.linalg.solve(covariance, error)
        for error, covariance in zip(error_m, result.landmarks.covariance_m2, strict=True)
    ]
    assert np.linalg.norm(error_m, axis=1).max() < 0.3
    # Particle filters are somewhat overconfident: three times the expectation of 2 is still credible.
    assert np.mean(nees) < 6.0


def test_same_seed_same_bits_and_another_seed_another_run() -> None:
    log = make_small_log()
    first, again, other = (run(log, {**FEW, "seed": seed}) for seed in (3, 3, 4))
    np.testing.assert_array_equal(first.trajectory.T_world_robot, again.trajectory.T_world_robot)
    np.testing.assert_array_equal(first.landmarks.mean_m, again.landmarks.mean_m)
    assert not np.array_equal(first.trajectory.T_world_robot, other.trajectory.T_world_robot)


def test_progress_ends_at_the_total() -> None:
    calls: list[tuple[int, int]] = []
    result = run(make_small_log(), FEW, progress=lambda done, total: calls.append((done, total)))
    steps = len(result.steps.stamp_s)
    assert calls[-1] == (steps, steps)
    assert all(0 < done <= total for done, total in calls)


def interrupt(done: int, total: int) -> None:
    raise KeyboardInterrupt


def test_interrupt_returns_what_was_computed() -> None:
    log = make_small_log()
    result = run(log, FEW, progress=interrupt)
    whole = run(log, FEW)
    steps = len(result.steps.stamp_s)
    assert result.interrupted
    assert 0 < steps < len(whole.steps.stamp_s)
    np.testing.assert_array_equal(result.trajectory.T_world_robot, whole.trajectory.T_world_robot[:steps])


def test_an_interrupt_at_the_very_end_loses_nothing() -> None:
    whole = run(make_small_log(), FEW)
    steps = len(whole.steps.stamp_s)

    def interrupt_at_the_end(done: int, total: int) -> None:
        if (done, total) == (steps, steps):
            raise KeyboardInterrupt

    result = run(make_small_log(), FEW, progress=interrupt_at_the_end)
    assert result.interrupted
    np.testing.assert_array_equal(result.trajectory.T_world_robot, whole.trajectory.T_world_robot)


def test_other_exceptions_of_progress_are_raised() -> None:
    def fail(done: int, total: int) -> None:
        raise ZeroDivisionError("mine")

    with pytest.raises(ZeroDivisionError, match="mine"):
        run(make_small_log(), FEW, progress=fail)


def test_run_many_counts_over_all_runs_and_stops_after_an_interrupt() -> None:
    log = make_small_log()
    calls: list[tuple[int, int]] = []
    results = list(run_many(log, FEW, seeds=range(3), progress=lambda *call: calls.append(call)))
    assert [result.config["seed"] for result in results] == [0, 1, 2]
    assert calls[-1][0] == calls[-1][1] == 3 * len(results[0].steps.stamp_s)
    stopped: list[RunResult] = list(run_many(log, FEW, seeds=range(3), progress=interrupt))
    assert [result.interrupted for result in stopped] == [True]


def test_the_likeliest_of_several_runs_is_kept() -> None:
    log = simulate(resolve_simulation({"seed": 2, "max_duration_s": 20.0}, preset="demo"))
    settings = {**FEW, "association": {"mode": "unknown"}}
    runs = list(run_many(log, settings, seeds=range(5, 9)))
    evidence = [result.log_evidence for result in runs]
    assert len(set(evidence)) == 4 and np.isfinite(evidence).all()
    best = best_of(log, settings, seeds=range(5, 9))
    assert [one.seed for one in best.tries] == [5, 6, 7, 8]
    assert [one.log_evidence for one in best.tries] == evidence
    likeliest = runs[int(np.argmax(evidence))]
    assert best.config["seed"] == likeliest.config["seed"]
    np.testing.assert_array_equal(best.landmarks.mean_m, likeliest.landmarks.mean_m)
    stopped = best_of(log, settings, seeds=range(3), progress=interrupt)
    assert stopped.interrupted and len(stopped.tries) == 1
    with pytest.raises(ConfigError, match="seeds: got none"):
        best_of(log, settings, seeds=())


def test_log_without_sightings_gives_a_path_and_no_map() -> None:
    log = make_small_log()
    none = no_sightings()
    result = run(replace(log, sightings=none), FEW)
    assert len(result.landmarks.ids) == 0
    assert len(result.trajectory.stamp_s) > 10
    assert np.isfinite(result.trajectory.T_world_robot).all()


def test_unsorted_arrays_are_refused() -> None:
    log = make_small_log()
    controls = replace(log.controls, stamp_s=log.controls.stamp_s[::-1].copy())
    with pytest.raises(DataError, match="made by a test: "):
        run(replace(log, controls=controls), FEW)


def test_bad_setting_of_the_log_names_the_log() -> None:
    log = make_small_log()
    bad = replace(log, config={**log.config, "sensor": {"range_std_m": -1.0}})
    with pytest.raises(ConfigError, match=r"^made by a test: sensor\.range_std_m: "):
        run(bad)
    with pytest.raises(ConfigError, match=r"^sensor\.range_std_m: "):
        configure(log, {"sensor": {"range_std_m": -1.0}})


def test_the_logs_own_association_is_for_particles() -> None:
    log = make_small_log()
    own = {
        "method": "sampled",
        "gate_probability": 0.95,
        "detection_probability": 0.7,
        "classes": {"number": 3},
    }
    log = replace(log, config={**log.config, "association": own})
    particles = configure(log)["association"]
    assert (particles["method"], particles["classes"]["number"]) == ("sampled", 3)
    ekf = configure(log, {"algorithm": "ekf"})["association"]
    assert (ekf["gate_probability"], ekf["detection_probability"], ekf["classes"]) == (0.95, None, None)
    assert ekf["method"] == "maximum_likelihood"
    with pytest.raises(ConfigError, match="method"):
        configure(log, {"algorithm": "ekf", "association": {"method": "sampled"}})


def silent_on_reach(log: Log) -> Log:
    """The log, saying no more how far its sensor sees."""
    sensor = {key: value for key, value in log.config["sensor"].items() if key != "max_range_m"}
    return replace(log, config={**log.config, "sensor": sensor})


def test_how_far_the_sensor_sees_is_learned_where_nobody_says() -> None:
    log = make_small_log()
    silent = silent_on_reach(log)
    farthest_m = float(log.sightings.range_m.max())
    learned_m = configure(silent)["sensor"]["max_range_m"]
    assert learned_m == pytest.approx(1.1 * farthest_m, rel=0.01) and learned_m > farthest_m
    assert run(silent, FEW).config["sensor"]["max_range_m"] == learned_m
    for told in ({"max_range_m": 100.0}, {"max_range_m": 3.0}):
        assert configure(silent, {"sensor": told})["sensor"]["max_range_m"] == told["max_range_m"]
    # As many metres as millimetres would be are no limit, and a few sightings tell none.
    seen = silent.sightings
    millimetres = replace(silent, sightings=replace(seen, range_m=1000.0 * seen.range_m))
    few = replace(silent, sightings=no_sightings())
    assert [configure(one)["sensor"]["max_range_m"] for one in (millimetres, few)] == [100.0, 100.0]


def test_single_sightings_far_beyond_all_others_are_not_how_far_a_sensor_sees() -> None:
    silent = silent_on_reach(make_small_log())
    seen, usual_m = silent.sightings, configure(silent_on_reach(make_small_log()))["sensor"]["max_range_m"]

    def learned_m(*changed: tuple[int, float]) -> float:
        range_m = seen.range_m.copy()
        for row, metres in changed:
            range_m[row] = metres
        log = replace(silent, sightings=replace(seen, range_m=range_m))
        return float(configure(log)["sensor"]["max_range_m"])

    rows, scans = len(seen.stamp_s), np.unique(seen.stamp_s, return_index=True)[1]
    nearest = int(np.argmin(seen.range_m))
    assert [learned_m((nearest, metres)) for metres in (60.0, 90.0, 500.0)] == [usual_m] * 3
    assert learned_m((nearest, 40.0), ((nearest + rows // 2) % rows, 80.0)) == usual_m
    # What is seen there again a scan later is a thing, and no sighting of it is left out.
    beyond = [(int(scans[20]), 50.0), (int(scans[21]), 51.0)]
    assert learned_m(*beyond) == pytest.approx(1.1 * 51.0)
    assert learned_m(beyond[0], (beyond[0][0] + 1, 51.0)) == usual_m, "two of one scan are no second look"


def test_what_vanished_is_noticed_though_no_limit_is_stated() -> None:
    log = simulate(resolve_simulation({"seed": 1, "max_duration_s": 120.0}, preset="orchard"))
    few = {"filter": {"particles": 20}, "association": {"mode": "unknown"}}
    layers = (few, {**few, "sensor": {"max_range_m": 100.0}})
    again = [run(silent_on_reach(log), layer).counts["landmarks_visited_again"] for layer in layers]
    assert again[0] > 60 and again[1] < 20, "beyond the true limit nothing is in view for long"

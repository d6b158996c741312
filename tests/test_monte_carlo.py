"""Consistency over many runs: values by hand, and that it tells a sound filter from an overconfident one."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cli_runner import fastslam as run_cli
from fabricate import T_WORLD_TRUTH, make_log, make_run, truth_path
from fastslam.config import merge
from fastslam.errors import DataError
from fastslam.evaluation import Consistency, run_consistency, summarize_consistency
from fastslam.log import Log
from fastslam.monte_carlo import consistency_facts, monte_carlo, simulated_logs
from fastslam.plots import consistency_figure, house_style

START = T_WORLD_TRUTH.apply_poses(truth_path().T_world_robot[:1])[0]


PLAIN = {"filter": {"rejuvenation": {"every_steps": 0}}}


def demo(algorithm: str, runs: int, settings: dict[str, Any] | None = None) -> Consistency:
    logs = simulated_logs({"max_duration_s": 20.0}, preset="demo")
    return monte_carlo(logs, merge(settings or {}, {"algorithm": algorithm}), seeds=range(1, runs + 1))


def test_normalised_errors_by_hand() -> None:
    """Errors of 0.2 m along x, forward and back in turn; the run is turned against the truth."""
    sign = np.where(np.arange(200) % 2 == 0, 1.0, -1.0)
    run = make_run(path_error_m=np.column_stack([0.2 * sign, np.zeros(200)]))
    found = run_consistency(run, make_log())
    assert found is not None and found.aligned
    assert found.pose.degrees_of_freedom == 3 and len(found.landmark_nees) == 8
    # The reported covariance is diag(0.04, 0.01) in the run's frame, turned by 0.7 rad; 1 mm² is added.
    inverse = np.diag(1.0 / (np.array([0.04, 0.01]) + 1e-6))
    turned = np.array([np.cos(0.7), np.sin(0.7)]) * 0.2
    assert np.median(found.position_nees) == pytest.approx(turned @ inverse @ turned, rel=2e-2)
    assert np.allclose(found.landmark_nees, 0.0, atol=1e-3)


def test_runs_without_a_true_path_are_refused() -> None:
    assert run_consistency(make_run(), make_log(truth=False)) is None

    def untold(seed: int) -> Log:
        return replace(simulated_logs({"max_duration_s": 2.0})(seed), truth_trajectory=None)

    with pytest.raises(DataError, match="true path"):
        monte_carlo(untold, {}, seeds=[1])
    with pytest.raises(DataError, match="at least one run"):
        monte_carlo(untold, {}, seeds=[])


def test_a_kalman_filter_is_consistent_and_a_depleted_particle_filter_is_not() -> None:
    kalman, particles = demo("ekf", 12), demo("fastslam1", 12, PLAIN)
    low, high = kalman.pose.bounds
    # 12 runs of one linearised filter: the mean lies within the 99.9 % bounds, the coverage within 15 points.
    assert 0.8 * low < kalman.pose.mean < 1.5 * high
    assert abs(kalman.position.coverage.found["90%"] - 0.9) < 0.15
    assert kalman.landmarks is not None and abs(kalman.landmarks.coverage.found["90%"] - 0.9) < 0.15
    assert particles.pose.mean > 5.0 * high
    assert particles.position.coverage.found["90%"] < 0.5
    assert not kalman.aligned and kalman.runs == 12
    assert kalman.pose_median_of_quarter[3] < 5.0 < particles.pose_median_of_quarter[3]


@pytest.mark.parametrize(
    ("algorithm", "mode"), [("fastslam2", "known"), ("fastslam2", "unknown"), ("fastslam1", "known")]
)
def test_what_is_reported_by_default_is_consistent(algorithm: str, mode: str) -> None:
    found = demo(algorithm, 12, {"association": {"mode": mode}})
    low, high = found.pose.bounds
    # As above; a covariance of three numbers from 32 members makes the mean 31 / 27 times as large.
    assert 0.5 * low < found.pose.mean < 1.5 * 31 / 27 * high
    assert 0.75 < found.position.coverage.found["90%"] <= 1.0
    assert 0.8 < found.position.coverage.found["95%"] <= 1.0


def test_the_figure_shows_every_variant_and_the_bounds() -> None:
    found = {"a": demo("ekf", 3), "b": demo("fastslam2", 3)}
    with house_style():
        figure = consistency_figure(found, title="both")
    left, right = figure.axes
    labels = left.get_legend_handles_labels()[1]
    assert labels[:2] == ["a", "b"] and "95 % bounds, 3 runs" in labels
    # Of each variant the coverage of positions and of landmarks, beside the diagonal.
    assert len(right.lines) == 5 and left.get_yscale() == "log"


def test_facts_are_fit_for_json() -> None:
    sets = [run_consistency(make_run(), make_log()), run_consistency(make_run(), make_log())]
    facts = consistency_facts(summarize_consistency([found for found in sets if found is not None]))
    again = json.loads(json.dumps(facts))
    assert again["runs"] == 2 and list(again["pose"]["coverage"]["found"]) == ["50%", "90%", "95%", "99%"]
    assert "fraction" not in again


def test_eval_runs_again_with_other_noise(tmp_path: Path) -> None:
    log, result = tmp_path / "log", tmp_path / "result"
    assert run_cli("simulate", str(log), "--set", "max_duration_s=8.0").exit_code == 0
    assert run_cli("run", str(log), "--particles", "20", "--no-report", "--out", str(result)).exit_code == 0
    done = run_cli("eval", str(result), "--runs", "3", "--out", str(tmp_path / "c"))
    assert done.exit_code == 0, done.stderr
    assert "NEES, mean" in done.stdout and "not independent" not in done.stderr
    facts = json.loads((tmp_path / "c" / "consistency.json").read_text())
    assert facts["runs"] == 3 and (tmp_path / "c" / "consistency.png").stat().st_size > 10_000
    # The first run is the one in the folder: its configuration, its seed, its log.
    config = merge({"filter": {"particles": 20}, "seed": 0})
    again = monte_carlo(simulated_logs({"max_duration_s": 8.0}), config, seeds=range(3))
    assert facts["pose"]["mean"] == pytest.approx(again.pose.mean, rel=1e-9)


def test_eval_runs_over_one_log_says_that_they_are_not_independent(tmp_path: Path) -> None:
    log, result = tmp_path / "log", tmp_path / "result"
    assert run_cli("simulate", str(log), "--set", "max_duration_s=6.0").exit_code == 0
    (log / "simulation.yaml").unlink()
    assert run_cli("run", str(log), "--particles", "10", "--no-report", "--out", str(result)).exit_code == 0
    done = run_cli("eval", str(result), "--runs", "2", "--json")
    assert done.exit_code == 0 and "not independent" in done.stderr
    assert json.loads(done.stdout)["runs"] == 2
    two = run_cli("eval", str(result), str(result), "--runs", "2")
    assert two.exit_code == 2 and "--runs takes one results folder, got 2" in two.stderr

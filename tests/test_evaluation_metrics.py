"""The table of metrics, GPS errors, and summaries over runs."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from fabricate import LANDMARKS_M, T_WORLD_TRUTH, make_log, make_map, make_run, make_steps, truth_path
from fastslam.evaluation import (
    METRIC_UNITS,
    EvaluationOptions,
    evaluate,
    evaluate_run,
    fix_errors,
    flatten,
    summarize,
)
from fastslam.evaluation.display import format_metric, metric_rows, summary_rows
from fastslam.log import PositionFixes
from fastslam.result import Trajectory

RUN_METRICS = {
    *(
        "steps",
        "sightings",
        "landmarks",
        "landmarks_provisional",
        "filter_seconds",
        "particle_updates_per_second",
    ),
    *("peak_memory_bytes", "map_bytes", "step_latency_us", "resamplings", "rejuvenations"),
    *("mean_effective_sample_size", "mean_particles", "nis", "health_ok_fraction", "health_lost_fraction"),
    "counts",
}


def test_run_metrics_by_hand() -> None:
    metrics = evaluate(make_run(), make_log(truth=False))
    assert set(metrics) == RUN_METRICS
    assert metrics["steps"] == 200
    assert metrics["sightings"] == 400
    assert metrics["landmarks"] == 8
    assert metrics["particle_updates_per_second"] == 100 * 400 / 2.0
    assert metrics["resamplings"] == 20
    assert metrics["mean_effective_sample_size"] == 100 - 5 * 4.5
    assert metrics["step_latency_us"] == {"p50": 100.5, "p99": pytest.approx(198.01), "max": 200.0}
    assert metrics["counts"] == {"covariance_repairs": 3}
    # Of 190 judged steps the last five of every fifty are degraded.
    assert metrics["health_ok_fraction"] == pytest.approx(170 / 190)
    assert (metrics["health_lost_fraction"], metrics["mean_particles"], metrics["nis"]) == (0.0, 100.0, None)


def test_truth_metrics_of_a_perfect_run_are_zero() -> None:
    metrics = evaluate(make_run(), make_log(fixes=True))
    for name in ("ate_rmse_m", "smoothed_ate_rmse_m", "landmark_rmse_m", "heading_rmse_rad", "gps_median_m"):
        assert metrics[name] == pytest.approx(0.0, abs=1e-12), name
    assert metrics["landmark_matched"] == 8
    assert (
        metrics["landmark_precision"] == metrics["landmark_recall"] == metrics["gps_inlier_fraction"] == 1.0
    )


def test_live_and_smoothed_errors_are_not_confused() -> None:
    truth = truth_path()
    sign = np.where(np.arange(200) % 2 == 0, 1.0, -1.0)
    error = np.column_stack([0.3 * sign, -0.4 * sign])
    metrics = evaluate(make_run(path_error_m=error), make_log())
    perfect = Trajectory(truth.stamp_s, T_WORLD_TRUTH.apply_poses(truth.T_world_robot))
    # An alternating error of 0.5 m is absorbed by alignment only to the order of 1 / 200.
    assert metrics["ate_rmse_m"] == pytest.approx(0.5, rel=0.01)
    assert metrics["ate_rmse_m"] == metrics["smoothed_ate_rmse_m"]
    better = evaluate(replace(make_run(path_error_m=error), smoothed=perfect), make_log())
    assert better["ate_rmse_m"] == metrics["ate_rmse_m"]
    assert better["smoothed_ate_rmse_m"] == pytest.approx(0.0, abs=1e-12)


def test_unknown_association_ignores_names_that_happen_to_agree() -> None:
    # Every landmark carries the name of another: by name the map is wrong, by position it is right.
    ids = tuple(f"tree{(k + 1) % 8}" for k in range(8))
    run = make_run(ids=ids)
    by_name = evaluate(run, make_log())
    assert isinstance(by_name["landmark_rmse_m"], float)
    assert by_name["landmark_rmse_m"] > 1.0
    unknown = replace(run, config={**run.config, "association": {"mode": "unknown"}})
    assert evaluate(unknown, make_log())["landmark_rmse_m"] == pytest.approx(0.0, abs=1e-12)
    forced = evaluate(run, make_log(), options=EvaluationOptions(identities="unknown"))
    assert forced["landmark_rmse_m"] == pytest.approx(0.0, abs=1e-12)


def test_an_empty_run_gives_nothing_where_nothing_is_determined() -> None:
    nothing = Trajectory(np.zeros(0), np.zeros((0, 3)))
    empty_map = make_map((), np.zeros((0, 2)))
    run = make_run(
        trajectory=nothing,
        smoothed=nothing,
        landmarks=empty_map,
        steps=make_steps(np.zeros(0)),
        filter_seconds=0.0,
    )
    metrics = evaluate(run, make_log(fixes=True))
    assert metrics["steps"] == metrics["landmark_matched"] == 0
    for name in (
        "ate_rmse_m",
        "smoothed_ate_rmse_m",
        "landmark_rmse_m",
        "landmark_precision",
        "gps_median_m",
    ):
        assert metrics[name] is None, name
    assert metrics["particle_updates_per_second"] is None
    assert metrics["step_latency_us"] == {"p50": None, "p99": None, "max": None}


def test_wild_fixes_do_not_spoil_the_gps_errors() -> None:
    truth = truth_path()
    fixes_m = 20.0 * truth.T_world_robot[:, :2]
    wild = np.arange(200) % 10 == 3
    fixes_m[wild] += [100.0, 30.0]
    path = Trajectory(truth.stamp_s, T_WORLD_TRUTH.apply_poses(truth.T_world_robot * [20.0, 20.0, 1.0]))
    found = fix_errors(path, PositionFixes(truth.stamp_s, fixes_m))
    assert found is not None
    assert found.inlier_fraction == pytest.approx(0.9)
    assert found.median_m == pytest.approx(0.0, abs=1e-9)
    assert found.inlier_rmse_m == pytest.approx(0.0, abs=1e-9)
    assert found.error_m.max() == pytest.approx(np.hypot(100.0, 30.0))


def test_the_antenna_may_sit_off_the_robots_origin() -> None:
    truth = truth_path()
    x, y, heading = truth.T_world_robot.T
    ahead, left = 2.0, 0.5
    antenna = np.column_stack(
        [
            x + ahead * np.cos(heading) - left * np.sin(heading),
            y + ahead * np.sin(heading) + left * np.cos(heading),
        ]
    )
    path = Trajectory(truth.stamp_s, T_WORLD_TRUTH.apply_poses(truth.T_world_robot))
    fixes = PositionFixes(truth.stamp_s, antenna)
    found = fix_errors(path, fixes, antenna_in_robot_m=(ahead, left))
    ignored = fix_errors(path, fixes)
    assert found is not None and ignored is not None
    assert found.median_m == pytest.approx(0.0, abs=1e-9)
    assert ignored.median_m > 0.1


def test_the_two_editions_of_the_victoria_park_fixes_differ_by_their_known_turn(data_dir: Path) -> None:
    edited = np.loadtxt(data_dir / "victoria_park" / "ascii_2003" / "GPS.txt")
    everything = np.loadtxt(data_dir / "victoria_park" / "features_rfs_slam" / "gps.dat")
    path = Trajectory(edited[:, 0], np.column_stack([edited[:, 2], edited[:, 1], np.zeros(len(edited))]))
    fixes = PositionFixes(everything[:, 0], everything[:, 1:])
    same = fix_errors(path, fixes, max_gap_s=0.3)
    assert same is not None
    assert len(same.error_m) >= len(edited)
    assert np.degrees(same.transform.rotation_rad) == pytest.approx(-33.0, abs=0.01)
    # The edited fixes are given to the centimetre.
    assert same.median_m < 0.01
    # Across the gaps that the editors cut out, straight lines meet the fixes that they distrusted.
    across = fix_errors(path, fixes, max_gap_s=1000.0)
    assert across is not None
    assert across.inlier_fraction < 0.99
    assert np.degrees(across.transform.rotation_rad) == pytest.approx(-33.0, abs=1.0)


def test_map_is_aligned_by_the_path_where_the_ids_say_nothing() -> None:
    run = make_run(ids=tuple(f"L{k}" for k in range(8)))
    found = evaluate_run(run, make_log())
    assert found.T_truth_world is not None
    np.testing.assert_allclose(found.T_truth_world.apply_points(run.landmarks.mean_m), LANDMARKS_M, atol=1e-9)
    assert found.metrics["landmark_matched"] == 8


def test_every_metric_has_a_unit_and_a_line_in_the_documentation() -> None:
    log = make_log(fixes=True)
    full = evaluate(make_run(), replace(log, edited_fixes=log.position_fixes))
    assert set(full) == set(METRIC_UNITS)
    page = Path(__file__).parent.parent / "docs" / "metrics.md"
    documented = set(re.findall(r"^\| `([a-z0-9_]+)", page.read_text(), flags=re.MULTILINE))
    assert set(METRIC_UNITS) <= documented


def test_summary_by_hand() -> None:
    runs = [{"a": value, "nested": {"p50": 2.0 * value}} for value in (1.0, 2.0, 6.0)]
    found = summarize([*runs, {"a": None, "counts": {"repairs": 4}}])
    # Mean 3, standard deviation sqrt(7), t(0.975, 2) = 4.30265.
    assert found["a"].mean == 3.0
    assert found["a"].ci95 == pytest.approx(4.30265 * np.sqrt(7.0 / 3.0), rel=1e-5)
    assert (found["a"].runs, found["a"].median, found["a"].min, found["a"].max) == (3, 2.0, 1.0, 6.0)
    assert found["nested.p50"].mean == 6.0
    # Three runs had no repairs.
    assert (found["counts.repairs"].runs, found["counts.repairs"].mean) == (4, 1.0)
    assert summarize([{"a": 5}])["a"].ci95 is None
    assert summarize([{"a": None}]) == {}


def test_numbers_are_shown_with_sensible_digits_and_units() -> None:
    assert format_metric("peak_memory_bytes", 12_345_678) == ("12.35", "MB")
    assert format_metric("ate_rmse_m", 0.123456) == ("0.1235", "m")
    assert format_metric("ate_rmse_m", None) == ("-", "m")
    assert format_metric("steps", 12609) == ("12,609", "")
    assert format_metric("step_latency_us.p99", 1234.5) == ("1,234", "µs")
    rows = metric_rows(evaluate(make_run(), make_log()))
    assert {row.name for row in rows} >= {"step_latency_us.p50", "counts.covariance_repairs", "ate_rmse_m"}
    row = next(row for row in summary_rows([{"steps": 3}, {"steps": 5}]) if row.name == "steps")
    assert (row.mean, row.median, row.min, row.max) == ("4", "4", "3", "5")


def test_all_values_of_a_row_share_one_unit() -> None:
    row = summary_rows([{"peak_memory_bytes": 10_000_000}, {"peak_memory_bytes": 20_000_000}])[0]
    # t(0.975, 1) = 12.7062; standard deviation of the mean 5 MB.
    assert (row.mean, row.ci95, row.min, row.max, row.unit) == ("15", "63.53", "10", "20", "MB")


def test_flatten_keeps_the_order() -> None:
    assert list(flatten({"b": 1, "a": {"y": 2, "x": None}})) == ["b", "a.y", "a.x"]


def test_edited_fixes_by_hand() -> None:
    """Every second fix 0.3 m off along x, the others as much the other way: no alignment takes that out."""
    truth = truth_path()
    sign = np.where(np.arange(200) % 2 == 0, 1.0, -1.0)
    shifted = truth.T_world_robot[:, :2] + np.column_stack([0.3 * sign, np.zeros(200)])
    log = replace(make_log(truth=False), edited_fixes=PositionFixes(truth.stamp_s, shifted))
    # The alignment turns by the little that chance correlation of the signs with the path allows.
    assert evaluate(make_run(), log)["edited_fixes_rms_m"] == pytest.approx(0.3, rel=1e-3)
    assert "edited_fixes_rms_m" not in evaluate(make_run(), make_log(fixes=True))
    still = make_run(trajectory=Trajectory(truth.stamp_s, np.zeros((200, 3))))
    assert evaluate(still, log)["edited_fixes_rms_m"] is None

"""Calibration finds what was put into a log."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cli_runner import fastslam
from fastslam.calibration import Calibration, Reference, calibrate
from fastslam.config import Config, load_config, merge
from fastslam.datasets import load, write_native
from fastslam.errors import ConfigError, DataError
from fastslam.evaluation import evaluate
from fastslam.localisation import between
from fastslam.log import Log
from fastslam.result import RunResult
from fastslam.runner import run
from fastslam.simulation import resolve_simulation, simulate
from small_log import make_small_log

SCALE, BIAS_M, YAW_RAD, AHEAD_M = 1.03, 0.1, 0.06, 0.4


def miscalibrated_log() -> Log:
    """Ranges read 3 % and 0.1 m too long, and the sensor is turned left by 0.06 rad and sits 0.4 m ahead."""
    settings = {"seed": 3, "sensor": {"mounting": {"x_m": AHEAD_M}}}
    log = simulate(resolve_simulation(settings, preset="demo"))
    sightings = replace(
        log.sightings,
        range_m=SCALE * log.sightings.range_m + BIAS_M,
        bearing_rad=log.sightings.bearing_rad - YAW_RAD,
    )
    sensor = {key: value for key, value in log.config["sensor"].items() if key != "mounting"}
    return replace(log, sightings=sightings, config={**log.config, "sensor": sensor})


def within(found: Calibration, key: str, expected: float) -> bool:
    parameter = found[key]
    return abs(parameter.value - expected) < 4 * parameter.standard_error + 1e-3


@pytest.mark.parametrize("reference", ["odometry", "survey"])
def test_what_was_put_in_is_found(reference: Reference) -> None:
    log = miscalibrated_log()
    found = calibrate(log, {"seed": 1}, reference=reference)
    assert within(found, "range_scale", SCALE) and found["range_scale"].standard_error < 0.01
    assert within(found, "range_bias_m", BIAS_M) and found["range_bias_m"].standard_error < 0.05
    assert within(found, "mounting.yaw_rad", YAW_RAD) and found["mounting.yaw_rad"].standard_error < 0.02
    assert within(found, "mounting.x_m", AHEAD_M) and within(found, "mounting.y_m", 0.0)
    assert found["range_std_m"].value == pytest.approx(SCALE * 0.1, rel=0.1)
    assert found["bearing_std_rad"].value == pytest.approx(np.radians(1.5), rel=0.1)


TRUE = {"range_scale": 1.02, "range_bias_m": 0.05, "mounting.x_m": 0.3, "mounting.yaw_rad": 0.04}
COVERAGE_LOGS = 24


def log_of_seed(seed: int, *, correlation_s: float) -> Log:
    """A minute of driving; the sightings also err together, by errors that fade over `correlation_s`."""
    settings = {"seed": seed, "sensor": {"mounting": {"x_m": TRUE["mounting.x_m"]}}, "max_duration_s": 60.0}
    log = simulate(resolve_simulation(settings, preset="demo"))
    stamps, scan = np.unique(log.sightings.stamp_s, return_inverse=True)
    rng = np.random.default_rng(seed)
    kept = np.exp(-np.diff(stamps, prepend=0.0) / correlation_s)
    common = np.zeros((len(stamps), 2))
    for row, (keep, fresh) in enumerate(zip(kept, rng.normal(size=(len(stamps), 2)), strict=True)):
        common[row] = keep * common[row - 1] + np.sqrt(1 - keep**2) * fresh if row else fresh
    error = common[scan] * ([0.05, 0.01] if correlation_s > 0.1 else [0.0, 0.0])
    sightings = replace(
        log.sightings,
        range_m=TRUE["range_scale"] * log.sightings.range_m + TRUE["range_bias_m"] + error[:, 0],
        bearing_rad=log.sightings.bearing_rad - TRUE["mounting.yaw_rad"] + error[:, 1],
    )
    sensor = {key: value for key, value in log.config["sensor"].items() if key != "mounting"}
    return replace(log, sightings=sightings, config={**log.config, "sensor": sensor})


@pytest.mark.slow
@pytest.mark.parametrize("correlation_s", [0.01, 2.0], ids=["white", "correlated"])
def test_the_interval_holds_the_truth_in_95_percent_of_logs(correlation_s: float) -> None:
    inside = []
    for seed in range(1, COVERAGE_LOGS + 1):
        log = log_of_seed(seed, correlation_s=correlation_s)
        found = calibrate(log, {"seed": 1, "filter": {"particles": 10}}, reference="odometry")
        assert found.converged
        for key, value in {**TRUE, "mounting.y_m": 0.0}.items():
            low, high = found[key].interval95
            inside.append(low <= value <= high)
    assert len(inside) == 5 * COVERAGE_LOGS
    # Three standard errors of a binomial share below 95 %: one false alarm in about 700.
    assert np.mean(inside) >= 0.95 - 3 * np.sqrt(0.95 * 0.05 / len(inside))


def test_a_straight_path_does_not_tell_the_mounting(tmp_path: Path) -> None:
    curved = miscalibrated_log()
    # Beside a row of posts, straight ahead: moving the sensor and the map together changes nothing.
    settings = {"seed": 5, "trajectory": {"kind": "line", "sway_m": 0.0}, "sensor": {"max_range_m": 10.0}}
    straight = simulate(resolve_simulation(settings))
    found = calibrate(straight, {"seed": 1})
    assert not found["mounting.x_m"].observable and not found["mounting.y_m"].observable
    assert not found["mounting.x_m"].significant and "mounting" not in found.settings.get("sensor", {})
    assert all(parameter.observable for parameter in calibrate(curved, {"seed": 1}).parameters)
    folder = write_native(straight, tmp_path / "log")
    outcome = fastslam("calibrate", folder, "--out", tmp_path / "out.yaml")
    # A narrow table breaks the line between the two words.
    assert outcome.exit_code == 0 and "observable" in outcome.stdout
    assert "does not tell mounting.x_m, mounting.y_m" in " ".join(outcome.stderr.split())


def test_ranges_cut_at_the_limit_do_not_shrink_the_scale() -> None:
    """Half of the sightings of landmarks at the limit of the range read longer than it."""
    log = simulate(resolve_simulation({"seed": 2}, preset="demo"))
    sensor = {**log.config["sensor"], "max_range_m": 7.0}
    log = replace(log, config={**log.config, "sensor": sensor})
    few = {"filter": {"particles": 30}}
    found = calibrate(log, {**few, "seed": 1}, reference="survey")
    low, high = found["range_scale"].interval95
    assert low <= 1.0 <= high


def test_trusted_ranges_stay_as_configured() -> None:
    found = calibrate(miscalibrated_log(), {"seed": 1})
    keys = [parameter.key for parameter in found.parameters]
    assert keys[:3] == ["mounting.x_m", "mounting.y_m", "mounting.yaw_rad"] and len(keys) == 5


def test_the_filter_takes_systematic_errors_out() -> None:
    clean = make_small_log()
    sightings = replace(
        clean.sightings,
        range_m=1.25 * clean.sightings.range_m - 0.5,
        bearing_rad=clean.sightings.bearing_rad + 0.2,
    )
    errors = {"range_scale": 1.25, "range_bias_m": -0.5, "bearing_bias_rad": 0.2}
    expected = run(clean, {"seed": 1}).landmarks
    found = run(replace(clean, sightings=sightings), {"seed": 1, "sensor": errors}).landmarks
    np.testing.assert_allclose(found.mean_m, expected.mean_m, atol=1e-6)
    with pytest.raises(ConfigError, match="range_scale"):
        run(clean, {"sensor": {"range_scale": 0.0}})


def test_a_run_with_the_settings_found_has_a_better_map() -> None:
    log = miscalibrated_log()
    found = calibrate(log, {"seed": 1}, reference="odometry")
    assert log.truth_landmarks is not None

    def size_m(config: dict[str, object]) -> float:
        map_m = run(log, {**config, "seed": 2}).landmarks.mean_m
        return float(np.hypot(*(map_m - map_m.mean(axis=0)).T).mean())

    truth_m = log.truth_landmarks.position_m
    true_size_m = float(np.hypot(*(truth_m - truth_m.mean(axis=0)).T).mean())
    before, after = size_m({}), size_m(found.settings)
    assert abs(after / true_size_m - 1) < 0.01 < abs(before / true_size_m - 1)


def test_unknown_identities_are_taken_from_the_map() -> None:
    found = calibrate(miscalibrated_log(), {"seed": 1, "association": {"mode": "unknown"}})
    assert found["mounting.yaw_rad"].value == pytest.approx(YAW_RAD, abs=0.02)
    assert found.sightings > 1500


def test_logs_with_too_little_and_wrong_references_are_errors() -> None:
    log = make_small_log(steps=20)
    with pytest.raises(DataError, match="calibration needs 100 sightings"):
        calibrate(log)
    with pytest.raises(ConfigError, match="reference: got truth"):
        calibrate(log, reference="truth")  # type: ignore[arg-type]
    with pytest.raises(DataError, match="survey"):
        calibrate(replace(make_small_log(), truth_landmarks=None), reference="survey")


def test_the_command_writes_a_configuration_for_run(tmp_path: Path) -> None:
    log = write_native(miscalibrated_log(), tmp_path / "log")
    out = tmp_path / "calibration.yaml"
    outcome = fastslam("calibrate", log, "--reference", "odometry", "--noise", "--out", out)
    assert outcome.exit_code == 0 and "range_scale" in outcome.stdout
    settings = load_config(out)
    assert set(settings["sensor"]) >= {"range_scale", "mounting", "range_std_m", "bearing_std_rad"}
    assert Config.resolve(settings)["sensor"]["range_scale"] == pytest.approx(SCALE, abs=0.02)
    again = fastslam("calibrate", log, "--reference", "odometry", "--noise", "--out", out, "--json")
    facts = json.loads(again.stdout)
    assert facts["settings"] == settings and facts["file"] == str(out)
    found = {parameter["key"]: parameter for parameter in facts["parameters"]}
    assert found["range_scale"]["value"] == pytest.approx(SCALE, abs=0.02)
    fastslam("calibrate", log, "--reference", "x").assert_one_line_error(exit_code=2, contains="reference")


@pytest.mark.slow
def test_the_lever_arm_of_lost_in_the_woods_is_found(data_dir: Path) -> None:
    log = load(data_dir / "lost_in_the_woods")
    without = {"sensor": {"mounting": {"x_m": 0.0}}, "filter": {"particles": 50}, "seed": 0}
    found = calibrate(log, without)
    assert found.converged
    assert found["mounting.x_m"].value == pytest.approx(0.219, abs=0.015)
    assert found["mounting.yaw_rad"].value == pytest.approx(0.08, abs=0.01)


@pytest.mark.slow
def test_the_range_scale_of_a_camera_is_found_and_its_map_gets_better(data_dir: Path) -> None:
    whole = load(data_dir / "utias_mrclam" / "MRCLAM_Dataset2", robot=5)
    # Twelve of its 34 minutes, with 4,508 of the sightings.
    log = between(whole, -np.inf, whole.controls.stamp_s[0] + 700.0)
    few = {"filter": {"particles": 30}}
    found = calibrate(log, {**few, "seed": 1}, reference="survey")
    # A batch solution with given identities finds its map 0.6 to 3.1 % too large: its ranges read too short.
    assert found.converged and 0.96 < found["range_scale"].value < 0.99 and found["range_scale"].significant

    def map_error_m(config: dict[str, object]) -> float:
        runs = [run(log, merge(few, config, {"seed": seed})) for seed in (1, 2, 3)]
        return float(np.median([evaluate(result, log)["landmark_rmse_m"] for result in runs]))

    assert map_error_m(found.settings) < 0.6 * map_error_m({})


def test_a_lost_run_is_refused_and_what_explains_the_log_worse_is_not_kept(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    log = log_of_seed(5, correlation_s=0.01)
    found = calibrate(log, {"filter": {"particles": 15}}, reference="odometry")
    assert found.evidence_gain > 0 and found.settings
    calls: list[float] = []

    def worse(result: RunResult, from_s: float, common: Mapping[str, Any]) -> float:
        calls.append(from_s)
        return -float(len(calls) == 1)

    monkeypatch.setattr("fastslam.calibration.evidence", worse)
    kept = calibrate(log, {"filter": {"particles": 15}}, reference="odometry")
    assert len(calls) == 2 and kept.evidence_gain == -1.0 and kept.settings == {}
    lost = replace(log.sightings, bearing_rad=-log.sightings.bearing_rad)
    with pytest.raises(DataError, match="nothing can be calibrated from this run"):
        calibrate(replace(log, sightings=lost), {"filter": {"particles": 15}})

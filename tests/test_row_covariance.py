"""The covariance that rows of odometry state reaches the filter."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import fastslam
import numpy as np
import pytest
from fastslam.datasets import load, write_native
from fastslam.errors import DataError
from fastslam.log import Log
from fastslam.result import RunResult
from fastslam.simulation import resolve_simulation, simulate

STDS = np.array([0.01, 0.01, 0.002])


def told(stds: np.ndarray) -> dict[str, object]:
    """The section `motion` with these standard deviations of each row."""
    names = ("x_std_m", "y_std_m", "heading_std_rad")
    return {"model": "increments", **dict(zip(names, stds.tolist(), strict=True))}


SETTINGS = {
    "control_period_s": 1.0,
    "scan": {"period_s": 1.0},
    "max_duration_s": 300.0,
    "trajectory": {"laps": 3},
    "motion": told(STDS),
}
TRIANGLE = [0, 3, 5]


def slippery(seed: int) -> Log:
    """Every fourth row errs by ten times the noise of the others, and says so."""
    log = simulate(resolve_simulation({"seed": seed, **SETTINGS}))
    values = log.controls.values.copy()
    stds = np.tile(STDS, (len(values), 1))
    stds[::4] *= 10.0
    values[::4] += np.random.default_rng(seed).normal(0.0, np.sqrt(stds[::4] ** 2 - STDS**2))
    covariance = np.zeros((len(values), 6))
    covariance[:, TRIANGLE] = stds**2
    return replace(log, controls=replace(log.controls, values=values, covariance=covariance))


def evidence(result: RunResult) -> float:
    return float(np.sum(result.steps.log_likelihood))


@pytest.mark.parametrize("algorithm", ["fastslam2", "ekf"])
def test_rows_that_say_how_uncertain_they_are_explain_the_log_better(algorithm: str) -> None:
    settings = {"algorithm": algorithm, "filter": {"particles": 50}}
    gains = []
    for seed in (1, 2, 3):
        log = slippery(seed)
        # One noise for all rows with the same mean variance: the best that the settings can say.
        assert log.controls.covariance is not None
        mean = np.sqrt(np.mean(log.controls.covariance[:, TRIANGLE], axis=0))
        bare = replace(log, controls=replace(log.controls, covariance=None))
        plain = fastslam.run(bare, {**settings, "motion": told(mean)})
        own = fastslam.run(log, settings)
        # Nobody tells keys by rows that do not use them.
        assert not any("motion." in warning for warning in own.warnings), own.warnings
        gains.append(evidence(own) - evidence(plain))
    # Measured over six worlds: 90 to 180. The sensor hides what it is worth to the map.
    assert min(gains) > 60.0, gains


def test_rows_without_a_covariance_have_the_configured_noise() -> None:
    log = simulate(resolve_simulation({"seed": 1, **SETTINGS}))
    stated = np.zeros((len(log.controls.values), 6))
    stated[:, TRIANGLE] = STDS**2
    some = stated.copy()
    some[::3, 2] = np.nan
    results = [
        evidence(fastslam.run(replace(log, controls=replace(log.controls, covariance=covariance))))
        for covariance in (None, stated, some)
    ]
    assert results[1] == pytest.approx(results[0], abs=1e-9)
    assert results[2] == pytest.approx(results[0], abs=1e-9)


def test_a_native_folder_keeps_what_rows_state(tmp_path: Path) -> None:
    log = slippery(1)
    write_native(log, tmp_path / "log")
    back = load(tmp_path / "log")
    assert evidence(fastslam.run(back)) == pytest.approx(evidence(fastslam.run(log)), rel=1e-6)


@pytest.mark.parametrize(
    ("rows", "covariance", "message"),
    [
        (3, [0.0] * 6, "controls: 3 covariances for"),
        (None, [1.0] * 4, "covariances of controls: got 4 columns, expected 6"),
        (None, [-1.0, 0.0, 0.0, 1.0, 0.0, 1.0], "covariance of control 0 is"),
    ],
)
def test_what_is_no_covariance_is_an_error_in_a_line(
    rows: int | None, covariance: list[float], message: str
) -> None:
    log = simulate(resolve_simulation({"seed": 1, **SETTINGS}))
    stated = np.tile(covariance, (rows or len(log.controls.values), 1))
    with pytest.raises(DataError, match=message):
        fastslam.run(replace(log, controls=replace(log.controls, covariance=stated)))

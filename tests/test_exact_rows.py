"""Logs whose rows last a second and have exactly the noise that they state: every cutting says the same."""

from __future__ import annotations

from pathlib import Path

import fastslam
import numpy as np
import pytest

PERIODS_S = (5.0, 0.4, 0.12)


@pytest.mark.slow
@pytest.mark.parametrize("algorithm", ["fastslam2", "ekf"])
@pytest.mark.parametrize("case", ["92-exact-rows-increments", "93-exact-rows-velocity"])
def test_the_noise_is_right_however_rows_are_cut(cases: Path, case: str, algorithm: str) -> None:
    log = fastslam.load(cases / case)
    evidence, steps = [], []
    for path_period_s in PERIODS_S:
        settings = {"algorithm": algorithm, "seed": 1, "filter": {"path_period_s": path_period_s}}
        result = fastslam.run(log, settings)
        assert result.warnings == (), result.warnings
        # Some 2,000 scans of two numbers and more: the standard error of the mean is 0.02 of 2 and less.
        assert abs(result.noise["nis"] - 2.0) < 0.12, result.noise["nis"]
        evidence.append(float(np.sum(result.steps.log_likelihood)))
        steps.append(len(result.steps.stamp_s))
    assert steps[0] < steps[1] < steps[2], "rows were cut"
    assert np.ptp(evidence) < 1e-9 * abs(evidence[0]), evidence

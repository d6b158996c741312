"""The comparison with GTSAM runs and its solvers agree; skipped where GTSAM is not installed."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
from fastslam.errors import ConfigError
from fastslam.simulation import resolve_simulation, simulate

pytest.importorskip("gtsam", reason="GTSAM is not installed: pip install 'fastslam[peers]'")
sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "benchmarks/peers"))

import gtsam_peer


def test_the_smoothers_agree_and_beat_the_filters_on_the_past() -> None:
    log = simulate(resolve_simulation({"max_duration_s": 30.0}, preset="demo"))
    outcomes = {outcome.solver: outcome for outcome in gtsam_peer.compare(log)}
    assert len(outcomes) == 5
    isam2, batch = outcomes["GTSAM iSAM2"], outcomes["GTSAM batch (Levenberg-Marquardt)"]
    assert isam2.smoothed_rmse_m == pytest.approx(batch.smoothed_rmse_m, rel=0.2)
    joint = outcomes["EKF-SLAM"].live_rmse_m
    assert joint is not None and isam2.live_rmse_m is not None and isam2.smoothed_rmse_m is not None
    # The same posterior but for linearisation: the two live errors are within a factor of two.
    assert 0.5 < joint / isam2.live_rmse_m < 2.0
    assert isam2.smoothed_rmse_m < joint


def test_a_motion_model_that_is_not_translated_is_refused() -> None:
    log = simulate(resolve_simulation({"max_duration_s": 2.0}, preset="victoria-like"))
    with pytest.raises(ConfigError, match=r"motion.model: got ackermann"):
        gtsam_peer.compare(log)

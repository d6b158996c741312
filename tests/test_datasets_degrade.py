"""Logs with worse odometry."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from fabricate import make_log
from fastslam.datasets.degrade import degraded_victoria_park, with_odometry_noise
from fastslam.errors import DataError
from fastslam.log import Controls, Log


def driving(rows: int = 4003) -> Log:
    values = np.column_stack([np.full(rows, 2.0), np.linspace(-0.1, 0.1, rows)])
    return replace(make_log(), controls=Controls(0.025 * np.arange(rows), values))


def test_noise_is_held_has_its_deviation_and_is_that_of_the_seed() -> None:
    log = driving()
    noisy = with_odometry_noise(log, std=(1.0, 0.14), hold_rows=8, seed=5)
    noise = noisy.controls.values - log.controls.values
    held = noise[:4000].reshape(500, 8, 2)
    assert np.allclose(held, held[:, :1])
    assert not np.allclose(held[1:, 0], held[:-1, 0])
    # 501 draws: the standard deviation errs by 3 % (one standard error); 4 of them.
    assert held[:, 0].std(axis=0) == pytest.approx([1.0, 0.14], rel=4 / np.sqrt(2 * 500))
    again = with_odometry_noise(log, std=(1.0, 0.14), hold_rows=8, seed=5)
    assert np.array_equal(again.controls.values, noisy.controls.values)
    other = with_odometry_noise(log, std=(1.0, 0.14), hold_rows=8, seed=6)
    assert not np.array_equal(other.controls.values, noisy.controls.values)
    assert noisy.name == "made-up_degraded"


def test_the_filter_is_told() -> None:
    log = replace(driving(), config={"motion": {"model": "ackermann", "wheelbase_m": 2.83}})
    told = degraded_victoria_park(log, seed=1).config["motion"]
    assert told["speed_std_m_per_s"] == 3.8 and told["wheelbase_m"] == 2.83
    assert np.rad2deg(told["steering_std_rad"]) == pytest.approx(25.6)


def test_another_number_of_columns_is_refused() -> None:
    with pytest.raises(DataError, match="got 3 values held for 8 rows, expected 2"):
        with_odometry_noise(driving(), std=(1.0, 1.0, 1.0), hold_rows=8, seed=1)

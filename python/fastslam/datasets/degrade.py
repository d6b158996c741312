"""Logs with worse odometry, to see what the sightings alone can hold."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..config import merge
from ..errors import DataError
from ..log import Controls, Log

DEGRADED_VICTORIA_PARK = {
    "motion": {"speed_std_m_per_s": 3.8, "steering_std_rad": float(np.deg2rad(25.6))},
}
"""What the filter is to be told of the noise of `degraded_victoria_park`, per control of 25 ms."""


def with_odometry_noise(log: Log, *, std: Sequence[float], hold_rows: int, seed: int) -> Log:
    """The log with white noise on its controls, each draw held for `hold_rows` rows.

    `std` has one standard deviation per column of the controls, in its unit. The same seed gives the same
    log. Errors: `DataError` for another number of columns.
    """
    rows, columns = log.controls.values.shape
    if len(std) != columns or hold_rows < 1:
        raise DataError(
            f"noise: got {len(std)} values held for {hold_rows} rows, expected {columns} for 1 or more"
        )
    draws = np.random.default_rng(seed).normal(0.0, 1.0, (-(-rows // hold_rows), columns))
    noise = np.repeat(draws, hold_rows, axis=0)[:rows] * np.asarray(std)
    return replace(
        log,
        name=f"{log.name}_degraded",
        controls=Controls(log.controls.stamp_s, log.controls.values + noise),
    )


def degraded_victoria_park(log: Log, *, seed: int) -> Log:
    """Victoria Park with 1 m/s and 8 degrees of noise held for 0.2 s, and with settings that say so."""
    noisy = with_odometry_noise(log, std=(1.0, float(np.deg2rad(8.0))), hold_rows=8, seed=seed)
    return replace(noisy, config=merge(log.config, DEGRADED_VICTORIA_PARK))

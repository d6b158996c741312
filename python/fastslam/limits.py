"""What no robot's numbers exceed: the same for files and for live calls."""

from __future__ import annotations

import math

import numpy as np

from . import _core
from .log import Bools, Floats

LARGEST_STAMP_S = 1e11
"""Seconds since 1970 stay below this until the year 5138; milliseconds since 1970 do not."""
OF_SETTINGS = _core.limits()
"""The largest size of a setting by the unit that ends its key; see `docs/configuration.md`."""
LARGEST_MAGNITUDE = OF_SETTINGS["state"]
"""As in the core: the squares of larger numbers, and products of these, are none."""
WIDEST_GAP_S = 5e6
"""58 days, or ten million steps of the default `filter.path_period_s`: wider gaps are wrong stamps."""
LARGEST_BEARING_RAD = 4.0 * math.pi
"""Bearings turned once or twice too often are wrapped; beyond this they are degrees."""
DEGREES_HINT = "bearings beyond +-4 pi: expected radians, are these degrees?"


def bounds_of(key: str) -> tuple[float, float]:
    """The least (above 0) and the largest size of a setting by the unit that ends its key, as in the core."""
    unit = max((unit for unit in OF_SETTINGS if key.endswith(unit)), key=len)
    return OF_SETTINGS["least"], OF_SETTINGS[unit]


def stamp_fault(stamp_s: float) -> str | None:
    """What is wrong with a stamp that cannot be in seconds, and the unit that it seems to have; else None."""
    if abs(stamp_s) < LARGEST_STAMP_S:
        return None
    size = abs(stamp_s)
    unit = "nanoseconds" if size >= 1e17 else "microseconds" if size >= 1e14 else "milliseconds"
    hint = f", {unit}?" if size < 1e20 else ""
    return f"the stamp {stamp_s:.15g} is beyond what seconds can be{hint}"


def is_definite(covariance: Floats) -> Bools:
    """Which covariances (n, 3) of range and bearing, as (xx, xy, yy), are finite and positive definite."""
    xx, xy, yy = covariance.T
    with np.errstate(over="ignore", invalid="ignore"):
        definite = (xx > 0) & (yy > 0) & (xx * yy > xy**2)
    return np.asarray(definite & np.isfinite(covariance).all(axis=1), dtype=np.bool_)

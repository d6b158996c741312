"""The settings that a log brings."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ..errors import ConfigError
from ..log import Log
from ..runner import check_own_settings
from .finding import Finding
from .subject import Subject

OUT_OF_VIEW = 0.2
"""Share of bearings outside the field of view from which on one of the two is wrong."""


def own_settings(log: Log) -> Iterator[Finding]:
    """Keys and values of the log's own settings against the schema."""
    try:
        check_own_settings(log)
    except ConfigError as error:
        yield Finding("settings", "error", str(error), "see `fastslam config explain`")


def view(subject: Subject) -> Iterator[Finding]:
    """Bearings outside the field of view that the settings give the sensor."""
    bearing_rad, view_rad = subject.log.sightings.bearing_rad, subject.config["sensor"]["field_of_view_rad"]
    outside = np.abs(bearing_rad) > 0.5 * view_rad + 3.0 * subject.config["sensor"]["bearing_std_rad"]
    if len(bearing_rad) == 0 or float(np.mean(outside)) < OUT_OF_VIEW:
        return
    message = (
        f"{np.mean(outside):.0%} of the sightings lie outside sensor.field_of_view_rad = {view_rad:.4g} "
        f"(bearings from {bearing_rad.min():.3g} to {bearing_rad.max():.3g}): they will be skipped"
    )
    wide = 2.0 * float(np.quantile(np.abs(bearing_rad), 0.999))
    yield Finding("view-limit", "problem", message, f"sensor.field_of_view_rad={min(wide, 2 * np.pi):.4g}")

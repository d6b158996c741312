"""What is in a log, in numbers: counts, rates, gaps, identities, extents and the problems found."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..log import Floats, Ints, Log, Problem


@dataclass(frozen=True)
class Extent:
    """Smallest, median and largest of some quantity."""

    minimum: float
    median: float
    maximum: float


@dataclass(frozen=True)
class StreamInfo:
    """One stream of stamped rows. `period_s` is over distinct stamps; None where there are fewer than two."""

    rows: int
    stamps: int
    first_s: float
    last_s: float
    period_s: Extent | None

    @property
    def rate_hz(self) -> float:
        """Mean number of distinct stamps a second; 0 for a single one."""
        span_s = self.last_s - self.first_s
        return (self.stamps - 1) / span_s if span_s > 0 else 0.0

    @property
    def longest_gap_s(self) -> float:
        """Longest time without a row; 0 for a single one."""
        return 0.0 if self.period_s is None else self.period_s.maximum


@dataclass(frozen=True)
class LogInfo:
    """A summary of one log, as `fastslam info` prints it."""

    name: str
    format: str
    motion_model: str
    duration_s: float
    """From the first to the last control or sighting."""
    controls: StreamInfo
    sightings: StreamInfo | None
    """None when the log holds no sighting."""
    sightings_per_stamp: Extent | None
    range_m: Extent | None
    bearing_rad: Extent | None
    identified: int
    """Sightings that say which landmark they are of."""
    sightings_per_landmark: dict[str, int]
    classes: dict[str, int]
    with_signature: int
    truth_poses: int
    truth_heading_known: bool
    truth_landmarks: int
    position_fixes: int
    scans: StreamInfo | None
    """Laser scans; None when the log holds none."""
    beams_per_scan: int
    problems: tuple[Problem, ...]
    sensors: dict[str, int]
    """Sightings of each sensor, where these say which made them."""


def describe(log: Log) -> LogInfo:
    """Count and measure everything in a log."""
    sightings = log.sightings
    stamps = np.concatenate([log.controls.stamp_s, sightings.stamp_s])
    some = len(sightings.stamp_s) > 0
    counts = np.unique(sightings.stamp_s, return_counts=True)[1].astype(np.float64)
    scans = log.scans if log.scans is not None and len(log.scans.stamp_s) > 0 else None
    truth, landmarks, fixes = log.truth_trajectory, log.truth_landmarks, log.position_fixes
    return LogInfo(
        name=log.name,
        format=log.format,
        motion_model=str(log.config.get("motion", {}).get("model", "not given")),
        duration_s=float(np.ptp(stamps)),
        controls=_stream(log.controls.stamp_s),
        sightings=_stream(sightings.stamp_s) if some else None,
        sightings_per_stamp=_extent(counts),
        range_m=_extent(sightings.range_m),
        bearing_rad=_extent(sightings.bearing_rad),
        identified=int(np.sum(sightings.identity >= 0)),
        sightings_per_landmark=_tally(sightings.identity, log.identity_names),
        classes=_tally(sightings.class_index, log.class_names),
        with_signature=int(np.sum(~np.isnan(sightings.signature))),
        truth_poses=0 if truth is None else len(truth.stamp_s),
        truth_heading_known=truth is not None and truth.heading_known,
        truth_landmarks=0 if landmarks is None else len(landmarks.names),
        position_fixes=0 if fixes is None else len(fixes.stamp_s),
        scans=None if scans is None else _stream(scans.stamp_s),
        beams_per_scan=0 if scans is None else scans.ranges_m.shape[1],
        problems=log.problems,
        sensors={} if sightings.sensor_index is None else _tally(sightings.sensor_index, log.sensor_names),
    )


def _stream(stamp_s: Floats) -> StreamInfo:
    distinct = np.unique(stamp_s)
    return StreamInfo(
        rows=len(stamp_s),
        stamps=len(distinct),
        first_s=float(distinct[0]),
        last_s=float(distinct[-1]),
        period_s=_extent(np.diff(distinct)),
    )


def _extent(values: Floats) -> Extent | None:
    values = values[~np.isnan(values)]
    if len(values) == 0:
        return None
    return Extent(float(values.min()), float(np.median(values)), float(values.max()))


def _tally(indices: Ints, names: tuple[str, ...]) -> dict[str, int]:
    counts = np.bincount(indices[indices >= 0], minlength=len(names))
    return {name: int(count) for name, count in zip(names, counts, strict=True)}

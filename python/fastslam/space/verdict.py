"""What speaks against a run in space."""

from __future__ import annotations

import numpy as np

from ..verdict import said_of
from .log import SpaceLog
from .result import SpaceResult

LARGEST_RATIO = 2.0
"""Squared innovations over what the noise explains, from where on the noise is said to be too small."""
LOST_RATIO = 16.0
SMALLEST_RATIO = 0.3
LONGEST_BLINDNESS_S = 5.0
WIDEST_TURN_RAD = 0.3
WIDEST_SHIFT_M = 1.0
WIDEST_SHAPE_M = 0.5
"""How surely landmarks must lie to each other where there is no odometry."""
_LOST = "lost: "
_NO_LANDMARK = "no landmark"


def warnings_of(result: SpaceResult, log: SpaceLog) -> tuple[str, ...]:
    """A sentence each; none where nothing was found."""
    found = [*_skipped(result)]
    if len(result.landmarks.ids) == 0:
        return (*found, f"{_NO_LANDMARK} was mapped: no sighting names one, or none could be used")
    if result.config["motion"]["kind"] == "odometry":
        found += [*_fit(result.innovation_ratio, "odometry"), *_blindness(log), *_end(result)]
    else:
        found += [*_hold(result), *_blindness(log)]
    return tuple(found)


def _fit(ratio: float, corrected: str) -> list[str]:
    if np.isnan(ratio):
        return [f"{_NO_LANDMARK} was seen twice, so nothing corrects the {corrected}"]
    if ratio > LARGEST_RATIO:
        lost = _LOST if ratio > LOST_RATIO else ""
        return [
            f"{lost}sightings lie {np.sqrt(ratio):.1f} times as far off as their noise says: "
            "its standard deviations, or those of the motion, are too small, or names are mixed up"
        ]
    if ratio < SMALLEST_RATIO:
        return [
            f"sightings lie {np.sqrt(ratio):.2f} times as far off as their noise says: "
            "its standard deviations are too large, and so are the covariances"
        ]
    return []


def _end(result: SpaceResult) -> list[str]:
    covariance = result.trajectory.covariance
    if covariance is None or not len(covariance):
        return []
    shift, turn = (np.sqrt(np.trace(covariance[-1, part, part])) for part in (slice(0, 3), slice(3, 6)))
    if shift <= WIDEST_SHIFT_M and turn <= WIDEST_TURN_RAD:
        return []
    return [f"{_LOST}at the end the pose is known to {shift:.2f} m and {np.degrees(turn):.0f} degrees"]


def _hold(result: SpaceResult) -> list[str]:
    """Without odometry: where the frame lies, and where a blind stretch went, may be open; a map must not."""
    if np.isnan(result.innovation_ratio):
        return _fit(float("nan"), "path")
    if result.hold is None:
        return [f"{_LOST}no path explains the sightings"]
    # Settings are for any camera: one that moves less than they say explains more than it should.
    found = _fit(max(result.hold.misfit, 1.0), "path")
    if result.hold.shape_std_m > WIDEST_SHAPE_M:
        found.append(
            f"{_LOST}sightings alone hold the landmarks to {result.hold.shape_std_m:.2f} m of each other: "
            "a gyro, odometry or more landmarks at once would hold them better"
        )
    return found


def is_unsound(result: SpaceResult) -> bool:
    """Whether what was found says that map and path are not to be believed, and not that noise is off."""
    return any(sentence.startswith((_LOST, _NO_LANDMARK)) for sentence in result.warnings)


def in_one_line(result: SpaceResult) -> str:
    """Whether the run is to be believed, in a few words that are never missing."""
    return said_of(is_believable(result), "see the warnings", result)


def is_believable(result: SpaceResult) -> bool | None:
    """Whether map and path are to be believed; None where the run was stopped before anybody can tell."""
    if is_unsound(result):
        return False
    return None if result.interrupted else True


def _skipped(result: SpaceResult) -> list[str]:
    total = sum(result.counts.values())
    if not total:
        return []
    reasons = ", ".join(
        f"{count:,} {name.removeprefix('sightings_').replace('_', ' ')}"
        for name, count in result.counts.items()
        if count
    )
    return [f"{total:,} sightings were left out: {reasons}"]


def _blindness(log: SpaceLog) -> list[str]:
    stamps = np.unique(log.sighting_stamp_s)
    if len(stamps) < 2:
        return []
    gap = np.diff(stamps)
    longest = int(np.argmax(gap))
    if gap[longest] <= LONGEST_BLINDNESS_S:
        return []
    return [f"nothing was seen for {gap[longest]:.1f} s from {stamps[longest]:.1f} s on"]

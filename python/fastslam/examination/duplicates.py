"""Things that are there twice."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ..log import Floats, Ints, Sightings
from .finding import Finding
from .subject import Subject

TWIN_SQUARED = 9.0
"""Two sightings of one stamp this near, in squared standard deviations, are twins."""
MOST_SCANS = 0.6
MOST_SIGHTINGS = 0.5
LEAST_SCANS = 20


def twins(subject: Subject) -> Iterator[Finding]:
    """Two sightings of one thing at one stamp, in most scans: two detectors, or every row written twice."""
    sightings = subject.log.sightings
    first, second = _neighbours(sightings)
    if len(first) == 0:
        return
    near = _squared_distance(subject, first, second) < TWIN_SQUARED
    identity = sightings.identity
    near &= (identity[first] < 0) | (identity[second] < 0) | (identity[first] == identity[second])
    has_twin = np.zeros(len(identity), dtype=np.bool_)
    has_twin[first[near]] = has_twin[second[near]] = True
    stamp, counts = np.unique(sightings.stamp_s, return_inverse=True, return_counts=True)[1:]
    several = counts >= 2
    of_scans = np.bincount(stamp, has_twin, minlength=len(counts))[several] > 0
    of_sightings = float(np.mean(has_twin[several[stamp]]))
    if len(of_scans) < LEAST_SCANS or of_scans.mean() < MOST_SCANS or of_sightings < MOST_SIGHTINGS:
        return
    message = (
        f"{of_sightings:.0%} of the sightings have another one of the same stamp closer than the sensor's "
        f"noise, in {of_scans.mean():.0%} of {len(of_scans):,} scans: two detectors at once?"
    )
    yield Finding(
        "seen-twice", "problem", message, "keep one detector's rows, or merge what is closer than the noise"
    )


def _neighbours(sightings: Sightings) -> tuple[Ints, Ints]:
    """Pairs of sightings of one stamp that are near in bearing or range: neighbours in an order by either."""
    pairs = []
    for key in (sightings.bearing_rad, sightings.range_m):
        order = np.lexsort((key, sightings.stamp_s))
        for apart in (1, 2):
            same = sightings.stamp_s[order[apart:]] == sightings.stamp_s[order[:-apart]]
            pairs.append(np.column_stack([order[:-apart], order[apart:]])[same])
    both = np.vstack(pairs)
    return both[:, 0], both[:, 1]


def _squared_distance(subject: Subject, first: Ints, second: Ints) -> Floats:
    sensor, sightings = subject.config["sensor"], subject.log.sightings
    turn = sightings.bearing_rad[first] - sightings.bearing_rad[second]
    turn = np.arctan2(np.sin(turn), np.cos(turn))
    apart_m = sightings.range_m[first] - sightings.range_m[second]
    squared: Floats = (apart_m / sensor["range_std_m"]) ** 2 + (turn / sensor["bearing_std_rad"]) ** 2
    return 0.5 * squared

"""Errors of an estimated map of point landmarks against the surveyed one."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ..errors import DataError
from ..log import Bools, Floats, Ints, TruthLandmarks
from ..result import LandmarkMap
from .align import RigidTransform, align_points
from .assignment import Gospa, assign_points, gospa
from .constellation import find_transform, refine_transform

GATE_M = 0.5
MIN_SIGHTINGS_KNOWN = 1
MIN_SIGHTINGS_UNKNOWN = 5
"""A landmark that was born of clutter seldom gets a fifth sighting; a real one has dozens."""


@dataclass(frozen=True)
class LandmarkMatching:
    """How to decide which estimate is which true landmark.

    `identities` are the ids that name a true landmark; every other estimate is matched by position.
    `initial` is `T_truth_estimate` from the paths where those are known; else it is searched for (seeded).
    `min_sightings` leaves out estimates seen less often; None leaves out those that are provisional, and
    where the map does not say, is 1 for identities and 5 for the others.
    """

    identities: Collection[str] = ()
    initial: RigidTransform | None = None
    gate_m: float = GATE_M
    gospa_cutoff_m: float | None = None
    """None: two gates."""
    min_sightings: int | None = None
    seed: int = 0


@dataclass(frozen=True)
class LandmarkErrors:
    """Matched landmarks and their errors.

    `estimate_index` and `truth_index` (P,) pair rows of the map with rows of the truth, `error_m` (P,) are
    their distances after alignment. `rmse_m` is None without pairs, or where neither two of them nor the path
    fix an alignment.
    `duplicates` are unmatched estimates within the gate of a matched true landmark. `false_landmarks` are
    the unmatched estimates, or only the duplicates where the truth is not complete. `considered` counts the
    estimates that were seen often enough.
    """

    transform: RigidTransform | None
    """`T_truth_estimate`; None where nothing determines it."""
    estimate_index: Ints
    truth_index: Ints
    error_m: Floats
    rmse_m: float | None
    considered: int
    duplicates: int
    false_landmarks: int
    missed: int
    gospa: Gospa | None

    @property
    def matched(self) -> int:
        """Number of true landmarks that were found."""
        return len(self.truth_index)

    @property
    def precision(self) -> float | None:
        """matched / (matched + false); None for an empty map."""
        claimed = self.matched + self.false_landmarks
        return self.matched / claimed if claimed else None

    @property
    def recall(self) -> float | None:
        """matched / (matched + missed); None where there is no true landmark."""
        present = self.matched + self.missed
        return self.matched / present if present else None


def landmark_errors(
    estimate: LandmarkMap, truth: TruthLandmarks, *, matching: LandmarkMatching | None = None
) -> LandmarkErrors:
    """Match the map with the truth and measure it after rigid alignment of the matched landmarks.

    Ids that are identities are paired by name, however far apart; the rest by optimal assignment within the
    gate among what is left. Errors: `DataError` for a map or truth that is not finite.
    """
    how = LandmarkMatching() if matching is None else matching
    _check(estimate, truth)
    identities = set(how.identities)
    named = np.array([name in identities for name in estimate.ids], dtype=bool)
    kept = np.flatnonzero(_considered(estimate, named, how.min_sightings))
    names = [estimate.ids[row] if named[row] else None for row in kept]
    points_m = estimate.mean_m[kept]
    return _measure(kept, points_m, truth, match=_match(names, points_m, truth, how), how=how)


def _considered(estimate: LandmarkMap, named: Bools, min_sightings: int | None) -> Bools:
    """Which estimates are landmarks at all."""
    if min_sightings is not None:
        return np.asarray(estimate.sightings >= min_sightings)
    if estimate.confirmed is not None:
        return np.asarray(named | estimate.confirmed)
    least = np.where(named, MIN_SIGHTINGS_KNOWN, MIN_SIGHTINGS_UNKNOWN)
    return np.asarray(estimate.sightings >= least)


def _check(estimate: LandmarkMap, truth: TruthLandmarks) -> None:
    for what, points in (("estimated map", estimate.mean_m), ("true map", truth.position_m)):
        if points.ndim != 2 or points.shape[1] != 2:
            raise DataError(f"{what}: expected positions (K, 2), got {points.shape}")
        bad = np.flatnonzero(~np.isfinite(points).all(axis=1))
        if len(bad):
            raise DataError(f"{what}: landmark in row {bad[0]} is not finite ({len(bad)} such rows)")


class _Match(NamedTuple):
    """`T_truth_estimate`, and the paired rows of the considered estimates and of the truth."""

    transform: RigidTransform | None
    rows: Ints
    true_rows: Ints


def _match(names: list[str | None], points_m: Floats, truth: TruthLandmarks, how: LandmarkMatching) -> _Match:
    """Pair by name what has one, the rest by position; named pairs come first."""
    row_of = {name: row for row, name in enumerate(truth.names)}
    by_name = [(row, row_of[name]) for row, name in enumerate(names) if name is not None and name in row_of]
    named = np.array(by_name, dtype=np.int64).reshape(-1, 2)
    free = np.array([row for row, name in enumerate(names) if name is None], dtype=np.int64)
    true_free = np.setdiff1d(np.arange(len(truth.names)), named[:, 1])
    transform = _align_or(points_m[named[:, 0]], truth.position_m[named[:, 1]], how.initial)
    if len(free) == 0 or len(true_free) == 0:
        return _Match(transform, *named.T)
    free_m, true_free_m = points_m[free], truth.position_m[true_free]
    if transform is None:
        transform = find_transform(free_m, true_free_m, gate_m=how.gate_m, seed=how.seed)
    if transform is None:
        return _Match(None, *named.T)
    if len(named) < 2:
        transform, _, _ = refine_transform(transform, free_m, true_free_m, gate_m=how.gate_m)
    found, true_found = assign_points(transform.apply_points(free_m), true_free_m, gate_m=how.gate_m)
    rows = np.concatenate([named[:, 0], free[found]])
    true_rows = np.concatenate([named[:, 1], true_free[true_found]])
    return _Match(_align_or(points_m[rows], truth.position_m[true_rows], transform), rows, true_rows)


def _align_or(points_m: Floats, true_m: Floats, otherwise: RigidTransform | None) -> RigidTransform | None:
    """Alignment of the pairs, or `otherwise` where they do not determine one."""
    try:
        return align_points(points_m, true_m)
    except DataError:
        return otherwise


def _measure(
    kept: Ints,
    points_m: Floats,
    truth: TruthLandmarks,
    *,
    match: _Match,
    how: LandmarkMatching,
) -> LandmarkErrors:
    transform, rows, true_rows = match
    aligned_m = points_m if transform is None else transform.apply_points(points_m)
    unmatched = np.setdiff1d(np.arange(len(points_m)), rows)
    duplicates = 0
    if transform is not None and len(unmatched) and len(true_rows):
        from scipy.spatial import cKDTree

        distance, _ = cKDTree(truth.position_m[true_rows]).query(aligned_m[unmatched])
        duplicates = int(np.count_nonzero(distance <= how.gate_m))
    error_m = np.linalg.norm(aligned_m[rows] - truth.position_m[true_rows], axis=1)
    cutoff_m = 2.0 * how.gate_m if how.gospa_cutoff_m is None else how.gospa_cutoff_m
    return LandmarkErrors(
        transform=transform,
        estimate_index=kept[rows],
        truth_index=true_rows,
        error_m=error_m if transform is not None else np.full(len(rows), np.nan),
        rmse_m=float(np.sqrt(np.mean(error_m**2))) if transform is not None and len(rows) else None,
        considered=len(kept),
        duplicates=duplicates,
        false_landmarks=len(unmatched) if truth.complete else duplicates,
        missed=len(truth.names) - len(true_rows),
        gospa=None
        if transform is None and len(points_m)
        else gospa(aligned_m, truth.position_m, cutoff_m=cutoff_m, count_false=truth.complete),
    )

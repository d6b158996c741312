"""Stretches of a map that stand there once more: what is sighted together lies as earlier landmarks do.

A robot that comes back off its path maps a field anew. Along that path nothing need speak against either map,
but no two fields are alike: what was sighted within some time, laid on what was known before and is not
sighted then (`placement`), fits there as by chance in no other field.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .evaluation.align import wrap_angle
from .laid import Laid
from .log import Floats, Ints
from .placement import Constellation, Placement, View, apply, odds_of, placements
from .standing import surplus

STRETCH = 16
"""So many landmarks are laid on the map together."""
LEAST_MATCHED = 6
SURE = 1e-3
"""So rarely a sound map has one stretch that is taken for another one."""
MOST_STRETCHES = 200
"""Of longer logs every n-th stretch is looked at."""
MOST_DRIFT = 0.1
"""Share of its way by which a robot comes back off; what lies further apart is another field, but alike."""
MOST_TURNED_RAD = 0.5
TOGETHER = 0.25
"""Where more of the pairs are sighted in one look they are two things each."""
MATCHED_STDS = 3.0
MOST_POSES = 40


@dataclass(frozen=True)
class _Known:
    """Landmarks (K,) with their variances, the look of the first sighting of each, and all looks of each."""

    mean_m: Floats
    variance_m2: Floats
    first: Floats
    looks: tuple[frozenset[int], ...]


def twofold(laid: Laid, variance_m2: Floats, noise_m2: float) -> list[int]:
    """The landmarks that are one too many, as rows of the map that was laid on.

    `variance_m2` (K,) is the mean of the two of each landmark, `noise_m2` what the errors of a stretch have
    in common. View and reach are those of the sightings.
    """
    good = np.flatnonzero(laid.explained)
    if len(good) == 0:
        return []
    look, explained = laid.look, laid.explained
    own = [rows[explained[rows]] for rows in laid.by_landmark()]
    first = np.array([laid.stamp_s[rows].min() if len(rows) else np.inf for rows in own])
    looks = tuple(frozenset(look[rows].tolist()) for rows in own)
    known = _Known(laid.mean_m, variance_m2 + noise_m2, first, looks)
    stretches = _stretches(laid, good)
    pairs: set[tuple[int, int]] = set()
    step = max(1, len(stretches) // MOST_STRETCHES)
    for rows in stretches[::step]:
        pairs |= _twins(laid, known, rows, len(stretches))
    return surplus(sorted(pairs))


def _stretches(laid: Laid, good: Ints) -> list[Ints]:
    """Rows of sightings, in order of time, that show STRETCH landmarks or so; each begins half-way in one."""
    cuts, seen = [0], set()
    for place, landmark in enumerate(laid.landmark[good].tolist()):
        seen.add(landmark)
        if len(seen) >= STRETCH // 2:
            cuts.append(place + 1)
            seen = set()
    cuts.append(len(good))
    return [good[start:end] for start, end in zip(cuts[:-2], cuts[2:], strict=True)]


def _twins(laid: Laid, known: _Known, rows: Ints, stretches: int) -> set[tuple[int, int]]:
    """Pairs of a landmark of a stretch and an earlier one that is the same; none unless that is sure."""
    local = np.unique(laid.landmark[rows])
    begin_s = float(laid.stamp_s[rows[0]])
    rest = np.setdiff1d(np.flatnonzero(known.first < begin_s), local)
    if min(len(local), len(rest), int((known.first[local] >= begin_s).sum())) < LEAST_MATCHED:
        return set()
    poses = laid.origin[rows[np.linspace(0, len(rows) - 1, min(MOST_POSES, len(rows))).astype(np.int64)]]
    view = View(poses, 0.7 * float(np.quantile(laid.range_m, 0.9)), float(np.abs(laid.bearing_rad).max()))
    found = placements(_constellation(known, local), _constellation(known, rest), view)
    if not found or odds_of(found)[0] < 1.0 - SURE or found[0].log_odds < np.log(stretches / SURE):
        return set()
    pairs = _matched(known, local, rest, found[0])
    apart = sum(not known.looks[one].isdisjoint(known.looks[other]) for one, other in pairs)
    if len(pairs) < LEAST_MATCHED or apart > TOGETHER * len(pairs):
        return set()
    return pairs if _is_drift(laid, known, rows, pairs, found[0]) else set()


def _constellation(known: _Known, chosen: Ints) -> Constellation:
    return Constellation(known.mean_m[chosen], known.variance_m2[chosen], np.full(len(chosen), -1))


def _matched(known: _Known, local: Ints, rest: Ints, placed: Placement) -> set[tuple[int, int]]:
    moved = apply(placed.T_map_local, known.mean_m[local])
    apart = np.hypot(*np.moveaxis(moved[:, None] - known.mean_m[rest], -1, 0))
    nearest = apart.argmin(axis=1)
    std = np.sqrt(known.variance_m2[local] + known.variance_m2[rest[nearest]])
    near = apart.min(axis=1) < MATCHED_STDS * std
    return {
        (min(one, other), max(one, other))
        for one, other in zip(local[near].tolist(), rest[nearest[near]].tolist(), strict=True)
    }


def _is_drift(laid: Laid, known: _Known, rows: Ints, pairs: set[tuple[int, int]], placed: Placement) -> bool:
    """Whether a robot may have come so far off its path on its way between the two stretches."""
    if abs(wrap_angle(placed.T_map_local[2])) > MOST_TURNED_RAD:
        return False
    apart_m = np.median([np.hypot(*(known.mean_m[one] - known.mean_m[other])) for one, other in pairs])
    before_s = np.median([min(known.first[one], known.first[other]) for one, other in pairs])
    between = np.arange(np.searchsorted(laid.stamp_s, before_s), rows[0] + 1)
    way_m = np.hypot(*np.diff(laid.origin[between, :2], axis=0).T).sum()
    return bool(apart_m < MOST_DRIFT * way_m)

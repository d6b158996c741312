"""Finding how two sets of points lie to each other when neither poses nor identities are known."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from ..errors import DataError
from ..log import Floats, Ints
from .align import RigidTransform, align_points
from .assignment import assign_points

_MAX_POINTS = 300
_MAX_HYPOTHESES = 20_000
_BEST = 5


def find_transform(
    estimate_m: Floats, truth_m: Floats, *, gate_m: float, seed: int = 0
) -> RigidTransform | None:
    """The `T_truth_estimate` under which most points of two unlabelled sets fall within `gate_m`.

    Every pair of estimates and pair of true points with the same distance (within the gate) proposes a
    transform; a transform is judged by Σ min(d², gate²) over the true points, and the best few are refined
    by assignment and alignment. Where there are more than 20,000 proposals a seeded random choice of them is
    judged, and of more than 300 points per side a random choice proposes: meant for up to some hundred
    landmarks. None where no transform brings three true points (or all, where there are fewer) within the
    gate. Fewer than two points on a side, or a symmetric world, cannot be decided.
    """
    if len(estimate_m) < 2 or len(truth_m) < 2:
        return None
    rng = np.random.default_rng(seed)
    proposals = _proposals(_subset(estimate_m, rng), _subset(truth_m, rng), gate_m, rng)
    if len(proposals) == 0:
        return None
    scores = _scores(proposals, estimate_m, truth_m, gate_m)
    best: tuple[int, float, RigidTransform] | None = None
    for index in np.argsort(scores, kind="stable")[:_BEST]:
        angle, x, y = proposals[index]
        start = RigidTransform(float(angle), np.array([x, y]))
        transform, paired, true_paired = refine_transform(start, estimate_m, truth_m, gate_m=gate_m)
        residual = transform.apply_points(estimate_m[paired]) - truth_m[true_paired]
        candidate = (-len(paired), float(np.sum(residual**2)), transform)
        if best is None or candidate[:2] < best[:2]:
            best = candidate
    enough = min(3, len(truth_m), len(estimate_m))
    return None if best is None or -best[0] < enough else best[2]


def refine_transform(
    start: RigidTransform, estimate_m: Floats, truth_m: Floats, *, gate_m: float
) -> tuple[RigidTransform, Ints, Ints]:
    """Alternate assignment within the gate and rigid alignment of the pairs until the pairs stay.

    The first assignment is within three gates, since the start may be off by more than one. Returns the
    transform and the paired indices of estimates and true points.
    """
    transform, gates = start, [3.0 * gate_m, *[gate_m] * 30]
    previous: tuple[Ints, Ints] | None = None
    for gate in gates:
        pairs = assign_points(transform.apply_points(estimate_m), truth_m, gate_m=gate)
        if gate == gate_m and previous is not None and all(map(np.array_equal, pairs, previous)):
            break
        try:
            transform = align_points(estimate_m[pairs[0]], truth_m[pairs[1]])
        except DataError:
            # Too few pairs to turn by: the start is the best there is.
            transform = start
        previous = pairs
    pairs = assign_points(transform.apply_points(estimate_m), truth_m, gate_m=gate_m)
    return transform, *pairs


def _subset(points_m: Floats, rng: np.random.Generator) -> Floats:
    if len(points_m) <= _MAX_POINTS:
        return points_m
    return points_m[np.sort(rng.choice(len(points_m), _MAX_POINTS, replace=False))]


def _proposals(estimate_m: Floats, truth_m: Floats, gate_m: float, rng: np.random.Generator) -> Floats:
    """Transforms (H, 3) as rotation, x, y, one for each consistent pair of pairs (both directions)."""
    first, second, lengths = _pairs(estimate_m)
    order = np.argsort(lengths)
    first, second, lengths = first[order], second[order], lengths[order]
    true_first, true_second, true_lengths = _pairs(truth_m)
    # Short pairs fix the rotation badly; a world smaller than that keeps its longest ones.
    long_enough = true_lengths >= min(4.0 * gate_m, 0.5 * float(true_lengths.max()))
    true_first, true_second = true_first[long_enough], true_second[long_enough]
    true_lengths = true_lengths[long_enough]
    low = np.searchsorted(lengths, true_lengths - gate_m)
    count = np.searchsorted(lengths, true_lengths + gate_m, side="right") - low
    ends = np.cumsum(count)
    total = int(ends[-1]) if len(ends) else 0
    chosen = (
        np.arange(total) if total <= _MAX_HYPOTHESES else np.sort(rng.integers(0, total, _MAX_HYPOTHESES))
    )
    true_pair = np.searchsorted(ends, chosen, side="right")
    pair = low[true_pair] + chosen - (ends - count)[true_pair]
    return np.concatenate(
        [
            _transforms(
                estimate_m[a], estimate_m[b], truth_m[true_first[true_pair]], truth_m[true_second[true_pair]]
            )
            for a, b in ((first[pair], second[pair]), (second[pair], first[pair]))
        ]
    )


def _pairs(points_m: Floats) -> tuple[Ints, Ints, Floats]:
    first, second = np.triu_indices(len(points_m), k=1)
    return first, second, np.linalg.norm(points_m[first] - points_m[second], axis=1)


def _transforms(first_m: Floats, second_m: Floats, true_first_m: Floats, true_second_m: Floats) -> Floats:
    """Transforms (H, 3) that bring each segment onto its true one, middle on middle."""
    segment, true_segment = second_m - first_m, true_second_m - true_first_m
    angle = np.arctan2(true_segment[:, 1], true_segment[:, 0]) - np.arctan2(segment[:, 1], segment[:, 0])
    middle, true_middle = (first_m + second_m) / 2.0, (true_first_m + true_second_m) / 2.0
    cosine, sine = np.cos(angle), np.sin(angle)
    x = true_middle[:, 0] - (cosine * middle[:, 0] - sine * middle[:, 1])
    y = true_middle[:, 1] - (sine * middle[:, 0] + cosine * middle[:, 1])
    return np.column_stack([angle, x, y])


def _scores(proposals: Floats, estimate_m: Floats, truth_m: Floats, gate_m: float) -> Floats:
    """Σ min(d², gate²) over the true points, d to the nearest estimate, for each proposal."""
    from scipy.spatial import cKDTree

    tree = cKDTree(estimate_m)
    return np.concatenate(
        [_chunk_scores(chunk, tree, truth_m, gate_m) for chunk in _chunks(proposals, len(truth_m))]
    )


def _chunks(proposals: Floats, points: int) -> Iterator[Floats]:
    """Pieces whose points fit in a few megabytes."""
    size = max(1, 200_000 // points)
    for start in range(0, len(proposals), size):
        yield proposals[start : start + size]


def _chunk_scores(proposals: Floats, tree: Any, truth_m: Floats, gate_m: float) -> Floats:
    offset = truth_m[None] - proposals[:, None, 1:]
    cosine, sine = np.cos(proposals[:, :1]), np.sin(proposals[:, :1])
    x = cosine * offset[..., 0] + sine * offset[..., 1]
    y = -sine * offset[..., 0] + cosine * offset[..., 1]
    distance, _ = tree.query(np.stack([x, y], axis=-1), distance_upper_bound=gate_m)
    return np.asarray((np.minimum(distance, gate_m) ** 2).sum(axis=1))

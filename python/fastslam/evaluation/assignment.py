"""Pairing two sets of points: optimal assignment within a gate, and GOSPA, which rests on it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..log import Floats, Ints

MOST_COMPARED = 1_000_000
"""Distances that are simply computed; more are looked up in a tree, for which SciPy must be loaded."""


def assign_points(first_m: Floats, second_m: Floats, *, gate_m: float) -> tuple[Ints, Ints]:
    """The one-to-one pairing with the least sum of d² over pairs plus gate² for each pair not made.

    Shapes: (N, 2) and (M, 2) in one frame. Returns the indices of the paired points, sorted by the first.
    Only points within `gate_m` of each other can be paired, so the problem falls apart into small groups,
    each solved exactly: fifty thousand landmarks take seconds and little memory.
    """
    first, second, distance_m = _near(first_m, second_m, gate_m)
    # Two that are near each other and nothing else are a pair. The rest needs SciPy, which loads longer than
    # most runs take.
    alone = (np.bincount(first)[first] == 1) & (np.bincount(second)[second] == 1)
    pairs = [(first[alone], second[alone])]
    if not alone.all():
        pairs += _assign_groups(first[~alone], second[~alone], distance_m[~alone], gate_m)
    first = np.concatenate([pair[0] for pair in pairs]).astype(np.int64)
    second = np.concatenate([pair[1] for pair in pairs]).astype(np.int64)
    order = np.argsort(first)
    return first[order], second[order]


def _near(first_m: Floats, second_m: Floats, gate_m: float) -> tuple[Ints, Ints, Floats]:
    """The pairs of points within `gate_m` of each other, and their distances."""
    if len(first_m) * len(second_m) <= MOST_COMPARED:
        apart = first_m[:, None] - second_m[None]
        distance_m = np.hypot(apart[..., 0], apart[..., 1])
        first, second = np.nonzero(distance_m <= gate_m)
        return first, second, distance_m[first, second]
    from scipy.spatial import cKDTree

    near = cKDTree(first_m).sparse_distance_matrix(cKDTree(second_m), gate_m, output_type="ndarray")
    return near["i"], near["j"], near["v"]


def _assign_groups(first: Ints, second: Ints, distance_m: Floats, gate_m: float) -> list[tuple[Ints, Ints]]:
    """The pairings of all that hang together by near pairs."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    points = (first.max() + 1, second.max() + 1)
    graph = coo_matrix((np.ones(len(first)), (first, second + points[0])), shape=(sum(points),) * 2)
    _, group = connected_components(graph, directed=False)
    order = np.argsort(group[first], kind="stable")
    cuts = np.flatnonzero(np.diff(group[first[order]])) + 1
    return [
        _assign_group(first[edges], second[edges], distance_m[edges], gate_m)
        for edges in np.split(order, cuts)
    ]


def _assign_group(first: Ints, second: Ints, distance_m: Floats, gate_m: float) -> tuple[Ints, Ints]:
    if len(first) == 1:
        return first, second
    rows, row_of = np.unique(first, return_inverse=True)
    columns, column_of = np.unique(second, return_inverse=True)
    # A cell that is no pair costs what leaving both alone costs. The tiny bonus keeps a pair that lies
    # exactly on the gate.
    cost = np.zeros((len(rows), len(columns)))
    cost[row_of, column_of] = distance_m**2 - gate_m**2 * (1.0 + 1e-12)
    from scipy.optimize import linear_sum_assignment

    row, column = linear_sum_assignment(cost)
    paired = cost[row, column] < 0.0
    return rows[row[paired]], columns[column[paired]]


@dataclass(frozen=True)
class Gospa:
    """Generalised optimal sub-pattern assignment distance with p = 2, alpha = 2, and its three parts.

    `distance_m`² = `localization_m2` + `missed_m2` + `false_m2`.
    Source: Rahmathullah, Garcia-Fernandez, Svensson 2017, equation 3.
    """

    distance_m: float
    localization_m2: float
    """Sum of squared distances over the pairs."""
    missed_m2: float
    """cutoff² / 2 for each true point without an estimate."""
    false_m2: float
    """cutoff² / 2 for each estimate without a true point."""


def gospa(estimate_m: Floats, truth_m: Floats, *, cutoff_m: float, count_false: bool = True) -> Gospa:
    """GOSPA between point sets (N, 2) and (M, 2) of one frame.

    With `count_false=False` estimates without a partner cost nothing, for a truth that is not complete.
    """
    paired, true_paired = assign_points(estimate_m, truth_m, gate_m=cutoff_m)
    localization = float(np.sum((estimate_m[paired] - truth_m[true_paired]) ** 2))
    missed = 0.5 * cutoff_m**2 * (len(truth_m) - len(paired))
    false = 0.5 * cutoff_m**2 * (len(estimate_m) - len(paired)) if count_false else 0.0
    return Gospa(float(np.sqrt(localization + missed + false)), localization, missed, false)

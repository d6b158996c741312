"""What the noise in rows of a graph means: covariance, information, or the square root of information."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from ..log import Bools, Floats

Matrices = Floats
"""Shape (N, n, n), NaN where a row says nothing."""

TORO_ORDER = (0, 1, 4, 2, 5, 3)
"""Places of xx, xy, xh, yy, yh, hh among TORO's six, which are xx, xy, yy, hh, xh, yh."""


def triangles(noises: Sequence[tuple[float, ...]], size: int) -> Floats:
    """Upper triangles by row, shape (N, size (size + 1) / 2); NaN where there are none or all are zero."""
    width = size * (size + 1) // 2
    rows = np.full((len(noises), width), np.nan)
    for index, noise in enumerate(noises):
        if any(noise):
            rows[index] = noise
    return rows


def from_covariance(triangle: Floats) -> Matrices:
    """Covariances as they stand."""
    upper = _upper(triangle)
    full: Matrices = upper + np.triu(upper, 1).swapaxes(1, 2)
    return full


def from_information(triangle: Floats) -> Matrices:
    """Covariances of information matrices (their inverses)."""
    return _inverse(from_covariance(triangle))


def from_square_root(triangle: Floats) -> Matrices:
    """Covariances of upper square roots S of information matrices SᵀS."""
    upper = _upper(triangle)
    return _inverse(upper.swapaxes(1, 2) @ upper)


def from_toro(triangle: Floats) -> Matrices:
    """Covariances of information matrices of poses in TORO's order; of points as they stand."""
    return from_information(triangle[:, TORO_ORDER] if triangle.shape[1] == 6 else triangle)


def meaning_of_edge2(triangle: Floats, *, with_vertices: bool) -> tuple[Callable[[Floats], Matrices], str]:
    """What the six numbers of EDGE2 and ODOMETRY mean, and in words; programs disagree.

    TORO (and GTSAM's `.graph`) writes information in an order of its own, iSAM the square root of
    information, others covariances. The order shows where matrices are diagonal; of the two others the
    heading tells, since no odometer turns by a standard deviation of more than one radian a row.
    """
    given = triangle[~np.isnan(triangle).any(axis=1)]
    used = (given != 0).any(axis=0) if len(given) else np.zeros(6, dtype=bool)
    if (used[2] and not used[5]) or (used.all() and with_vertices):
        return from_toro, "information in TORO's order"
    if len(given) and np.median(given[:, 5]) < 1:
        return from_covariance, "covariances"
    return from_square_root, "square roots of information, as iSAM has it"


def wrong_row(matrices: Matrices) -> int | None:
    """The first row whose covariance is not positive definite."""
    finite = np.isfinite(matrices).all(axis=(1, 2))
    wrong: Bools = np.any(np.isinf(matrices), axis=(1, 2))
    wrong[finite] = np.linalg.eigvalsh(matrices[finite])[:, 0] <= 0
    return int(np.argmax(wrong)) if wrong.any() else None


def _upper(triangle: Floats) -> Matrices:
    size = 3 if triangle.shape[1] == 6 else 2 if triangle.shape[1] == 3 else 1
    full: Floats = np.zeros((len(triangle), size, size))
    rows, columns = np.triu_indices(size)
    full[:, rows, columns] = triangle
    return full


def _inverse(matrices: Matrices) -> Matrices:
    """Inverses; infinity where there is none, NaN stays."""
    inverse = np.full_like(matrices, np.nan)
    given = ~np.isnan(matrices).any(axis=(1, 2))
    regular = given.copy()
    regular[given] = np.abs(np.linalg.det(matrices[given])) > 0
    inverse[regular] = np.linalg.inv(matrices[regular])
    inverse[given & ~regular] = np.inf
    return inverse

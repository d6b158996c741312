"""Covariances of poses: exactly symmetric where they leave, and judged with the reason where they come in."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from ._given import numbers
from .errors import DataError
from .log import Floats

ASYMMETRY = 1e-9
"""What rounding makes of symmetry, relative to the standard deviations of row and column."""


def symmetric(covariance: Floats) -> Floats:
    """Matrices (.., n, n) with their upper triangle below too: the bits above the diagonal stay."""
    upper = np.triu(covariance)
    return upper + np.swapaxes(np.triu(covariance, 1), -1, -2)


def pose_covariance(name: str, covariance: ArrayLike) -> Floats:
    """A covariance (3, 3) of a pose, exactly symmetric. Errors: `DataError` that says why it is none."""
    matrix = numbers(name, covariance)
    if matrix.shape != (3, 3):
        raise DataError(f"{name}: got shape {matrix.shape}, expected (3, 3)")
    why = _fault(matrix)
    if why is not None:
        raise DataError(f"{name}: got {matrix.tolist()}, expected a covariance: {why}")
    return symmetric(matrix)


def _fault(matrix: Floats) -> str | None:
    """Why a matrix is no covariance; None where it is one to rounding."""
    if not np.isfinite(matrix).all():
        return "not all of it is finite"
    variances = np.diag(matrix)
    if (variances < 0.0).any():
        return f"it is not positive, a variance is {variances.min():.6g}"
    std = np.sqrt(variances)
    apart = np.abs(matrix - matrix.T)
    row, column = np.unravel_index(int(np.argmax(apart - ASYMMETRY * np.outer(std, std))), matrix.shape)
    if apart[row, column] > ASYMMETRY * std[row] * std[column]:
        return (
            f"it is not symmetric, [{row}][{column}] is {matrix[row, column]:.9g} "
            f"and [{column}][{row}] is {matrix[column, row]:.9g}"
        )
    least = float(np.linalg.eigvalsh(symmetric(matrix))[0])
    if least < -1e-12 * variances.max():
        return f"it is not positive, its smallest eigenvalue is {least:.6g}"
    return None

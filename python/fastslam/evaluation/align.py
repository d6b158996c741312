"""Rigid alignment of an estimate with its truth: SLAM fixes a result only up to a motion of the plane."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..errors import DataError
from ..log import Bools, Floats

INLIER_DISTANCE_M = 10.0
_MAX_ITERATIONS = 100


def wrap_angle(angle_rad: Floats) -> Floats:
    """Angles brought into [-pi, pi)."""
    return np.asarray((angle_rad + np.pi) % (2.0 * np.pi) - np.pi)


@dataclass(frozen=True)
class RigidTransform:
    """A motion of the plane `T_target_source`: rotate by `rotation_rad`, then add `translation_m` (2,)."""

    rotation_rad: float
    translation_m: Floats

    @classmethod
    def identity(cls) -> RigidTransform:
        """The transform that changes nothing."""
        return cls(0.0, np.zeros(2))

    @property
    def rotation(self) -> Floats:
        """The 2 by 2 rotation matrix."""
        cosine, sine = np.cos(self.rotation_rad), np.sin(self.rotation_rad)
        return np.array([[cosine, -sine], [sine, cosine]])

    def apply_points(self, points_m: Floats) -> Floats:
        """Points (N, 2) of the source frame in the target frame."""
        return np.asarray(points_m @ self.rotation.T + self.translation_m)

    def apply_poses(self, T_source_robot: Floats) -> Floats:
        """Poses (N, 3) as x, y, heading of the source frame in the target frame; headings are not wrapped."""
        positions = self.apply_points(T_source_robot[:, :2])
        return np.column_stack([positions, T_source_robot[:, 2] + self.rotation_rad])

    def apply_covariances(self, covariance: Floats) -> Floats:
        """Covariances (N, 2, 2) of points, or (N, 3, 3) of poses, in the target frame."""
        rotation = np.eye(covariance.shape[-1])
        rotation[:2, :2] = self.rotation
        return np.asarray(rotation @ covariance @ rotation.T)

    def inverse(self) -> RigidTransform:
        """`T_source_target`."""
        return RigidTransform(-self.rotation_rad, -(self.translation_m @ self.rotation))


def align_points(source_m: Floats, target_m: Floats, *, weights: Floats | None = None) -> RigidTransform:
    """The `T_target_source` that minimises the weighted sum of squared distances between paired points.

    Shapes: both (N, 2); `weights` (N,), not negative. Errors: `DataError` where the rotation is not
    determined: fewer than two pairs, or all points of one side in one place; or where a value is not finite.
    Source: Umeyama 1991 without scale, which in the plane has the closed form used here.
    """
    if source_m.shape != target_m.shape or source_m.ndim != 2 or source_m.shape[1] != 2:
        raise DataError(f"alignment needs two arrays of shape (N, 2), got {source_m.shape}, {target_m.shape}")
    weight = np.ones(len(source_m)) if weights is None else np.asarray(weights, dtype=float)
    if not (np.isfinite(source_m).all() and np.isfinite(target_m).all() and np.isfinite(weight).all()):
        raise DataError("alignment needs finite points and weights")
    if np.count_nonzero(weight > 0) < 2:
        raise DataError(f"alignment needs at least 2 pairs, got {np.count_nonzero(weight > 0)}")
    weight = weight / weight.sum()
    source_centre, target_centre = weight @ source_m, weight @ target_m
    source, target = source_m - source_centre, target_m - target_centre
    dot = float(weight @ (source * target).sum(axis=1))
    cross = float(weight @ (source[:, 0] * target[:, 1] - source[:, 1] * target[:, 0]))
    spread = np.sqrt((weight @ (source**2).sum(axis=1)) * (weight @ (target**2).sum(axis=1)))
    if np.hypot(dot, cross) <= 1e-12 * max(spread, 1e-300) or spread < 1e-18:
        raise DataError("alignment needs points in at least two places: their rotation is not determined")
    rotation_only = RigidTransform(float(np.arctan2(cross, dot)), np.zeros(2))
    translation = target_centre - rotation_only.apply_points(source_centre[None])[0]
    return RigidTransform(rotation_only.rotation_rad, translation)


@dataclass(frozen=True)
class RobustAlignment:
    """Result of `align_points_robustly`; `inliers` (N,) tells which pairs the transform was fitted to."""

    transform: RigidTransform
    inliers: Bools


def align_points_robustly(
    source_m: Floats, target_m: Floats, *, inlier_distance_m: float = INLIER_DISTANCE_M
) -> RobustAlignment:
    """The `T_target_source` fitted to the pairs that it brings within `inlier_distance_m` of each other.

    Starts from the alignment with the least sum of (not squared) distances, which a minority of wild fixes
    hardly moves, then alternates between choosing the inliers and fitting to them until the choice stays.
    Each turn lowers the sum of min(distance², inlier_distance²), so it ends. Where fewer than two pairs are
    inliers the start is kept, and `inliers` says so. Shapes and errors: as `align_points`.
    """
    transform = _align_least_distances(source_m, target_m)
    inliers = _within(transform, source_m, target_m, inlier_distance_m)
    for _ in range(_MAX_ITERATIONS):
        if np.count_nonzero(inliers) < 2:
            break
        transform = align_points(source_m, target_m, weights=inliers.astype(float))
        previous, inliers = inliers, _within(transform, source_m, target_m, inlier_distance_m)
        if np.array_equal(previous, inliers):
            break
    return RobustAlignment(transform, inliers)


def _within(transform: RigidTransform, source_m: Floats, target_m: Floats, distance_m: float) -> Bools:
    distances = np.linalg.norm(transform.apply_points(source_m) - target_m, axis=1)
    return np.asarray(distances <= distance_m)


def _align_least_distances(source_m: Floats, target_m: Floats) -> RigidTransform:
    """Least sum of distances by iteratively reweighted least squares (weights 1 / distance)."""
    transform = align_points(source_m, target_m)
    for _ in range(_MAX_ITERATIONS):
        distances = np.linalg.norm(transform.apply_points(source_m) - target_m, axis=1)
        floor = max(1e-6, 1e-3 * float(np.median(distances)))
        refined = align_points(source_m, target_m, weights=1.0 / np.maximum(distances, floor))
        step = np.abs(refined.translation_m - transform.translation_m).max()
        turn = abs(refined.rotation_rad - transform.rotation_rad)
        transform = refined
        if step < 1e-6 and turn < 1e-9:
            break
    return transform

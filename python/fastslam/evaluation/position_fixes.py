"""Errors of a path against GPS-like fixes, some of which are wild."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..errors import DataError
from ..log import Floats, PositionFixes
from ..result import Trajectory
from .align import INLIER_DISTANCE_M, RigidTransform, align_points, align_points_robustly
from .trajectory import check_trajectory, default_max_gap_s, interpolate_poses


@dataclass(frozen=True)
class FixErrors:
    """Distances between a path and the fixes that it covers, after robust rigid alignment.

    `stamp_s`, `error_m` (N,). The median is over all covered fixes, the RMSE over those within the inlier
    distance; `inlier_rmse_m` is None where there is none. `uncovered` counts the fixes before, after, or in
    a gap of the path.
    """

    transform: RigidTransform
    """`T_fixes_world`."""
    stamp_s: Floats
    error_m: Floats
    median_m: float
    inlier_rmse_m: float | None
    inlier_fraction: float
    uncovered: int


def fix_errors(
    estimate: Trajectory,
    fixes: PositionFixes,
    *,
    inlier_distance_m: float = INLIER_DISTANCE_M,
    antenna_in_robot_m: tuple[float, float] = (0.0, 0.0),
    max_gap_s: float | None = None,
) -> FixErrors | None:
    """Compare the path of the antenna with the fixes after `align_points_robustly`.

    None where fewer than two fixes are covered or the robot never left its place. Fixes that are not finite
    are refused. Errors: `DataError`.
    """
    check_trajectory(estimate.stamp_s, estimate.T_world_robot, what="estimated path")
    padded = np.column_stack([fixes.position_m, np.zeros(len(fixes.stamp_s))])
    check_trajectory(fixes.stamp_s, padded, what="position fixes")
    gap_s = default_max_gap_s(estimate.stamp_s) if max_gap_s is None else max_gap_s
    poses, covered = interpolate_poses(
        estimate.stamp_s, estimate.T_world_robot, fixes.stamp_s, max_gap_s=gap_s
    )
    antenna_m, fix_m = antenna_positions(poses[covered], antenna_in_robot_m), fixes.position_m[covered]
    try:
        alignment = align_points_robustly(antenna_m, fix_m, inlier_distance_m=inlier_distance_m)
    except DataError:
        return None
    error_m = np.linalg.norm(alignment.transform.apply_points(antenna_m) - fix_m, axis=1)
    inlier_m = error_m[alignment.inliers]
    return FixErrors(
        transform=alignment.transform,
        stamp_s=fixes.stamp_s[covered],
        error_m=error_m,
        median_m=float(np.median(error_m)),
        inlier_rmse_m=float(np.sqrt(np.mean(inlier_m**2))) if len(inlier_m) else None,
        inlier_fraction=float(np.mean(alignment.inliers)),
        uncovered=int(np.count_nonzero(~covered)),
    )


def edited_fix_rms_m(
    estimate: Trajectory,
    fixes: PositionFixes,
    *,
    antenna_in_robot_m: tuple[float, float] = (0.0, 0.0),
    max_gap_s: float | None = None,
) -> float | None:
    """Root mean square distance of the path to fixes that are all good, after the best rigid alignment.

    None where fewer than two fixes are covered or the robot never left its place. Errors: `DataError` for
    values that are not finite.
    """
    check_trajectory(estimate.stamp_s, estimate.T_world_robot, what="estimated path")
    padded = np.column_stack([fixes.position_m, np.zeros(len(fixes.stamp_s))])
    check_trajectory(fixes.stamp_s, padded, what="edited fixes")
    gap_s = default_max_gap_s(estimate.stamp_s) if max_gap_s is None else max_gap_s
    poses, covered = interpolate_poses(
        estimate.stamp_s, estimate.T_world_robot, fixes.stamp_s, max_gap_s=gap_s
    )
    antenna_m, fix_m = antenna_positions(poses[covered], antenna_in_robot_m), fixes.position_m[covered]
    try:
        transform = align_points(antenna_m, fix_m)
    except DataError:
        return None
    error_m = np.linalg.norm(transform.apply_points(antenna_m) - fix_m, axis=1)
    return float(np.sqrt(np.mean(error_m**2)))


def antenna_positions(T_world_robot: Floats, antenna_in_robot_m: tuple[float, float]) -> Floats:
    """Positions (N, 2) in the world of a point that is fixed to the robot."""
    ahead, left = antenna_in_robot_m
    cosine, sine = np.cos(T_world_robot[:, 2]), np.sin(T_world_robot[:, 2])
    return np.column_stack(
        [
            T_world_robot[:, 0] + cosine * ahead - sine * left,
            T_world_robot[:, 1] + sine * ahead + cosine * left,
        ]
    )

"""Errors of an estimated path against the true one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..errors import DataError
from ..log import Bools, Floats, TruthTrajectory
from ..result import Trajectory
from .align import RigidTransform, align_points, wrap_angle


@dataclass(frozen=True)
class ErrorSummary:
    """Root mean square, median, 95th percentile and largest of a set of errors, in the unit of the errors."""

    rmse: float
    median: float
    p95: float
    max: float

    @classmethod
    def of(cls, errors: Floats) -> ErrorSummary:
        """Summarise errors (N,), N at least 1."""
        size = np.abs(errors)
        return cls(
            rmse=float(np.sqrt(np.mean(size**2))),
            median=float(np.median(size)),
            p95=float(np.percentile(size, 95)),
            max=float(size.max()),
        )


@dataclass(frozen=True)
class TrajectoryErrors:
    """Absolute errors of a path at the true stamps that it covers.

    `stamp_s` (N,) are those stamps, `error_m` (N,) the position errors after alignment. `raw_m` is without
    alignment: meaningful where the run was started at the true pose. `uncovered` counts the true stamps
    before, after, or in a gap of the estimate: they score nothing.
    """

    transform: RigidTransform
    """`T_truth_estimate`, fitted to all covered positions."""
    stamp_s: Floats
    error_m: Floats
    aligned_m: ErrorSummary
    raw_m: ErrorSummary
    heading_rad: ErrorSummary | None
    uncovered: int


def check_trajectory(stamp_s: Floats, poses: Floats, *, what: str) -> None:
    """Refuse a path that cannot be scored: wrong shape, not finite, or stamps that do not increase.

    Errors: `DataError` naming the first bad row, counted from 0.
    """
    if stamp_s.ndim != 1 or poses.shape != (len(stamp_s), 3):
        raise DataError(f"{what}: expected stamps (T,) and poses (T, 3), got {stamp_s.shape}, {poses.shape}")
    bad = np.flatnonzero(~(np.isfinite(stamp_s) & np.isfinite(poses).all(axis=1)))
    if len(bad):
        raise DataError(f"{what}: row {bad[0]} is not finite ({len(bad)} such rows)")
    backward = np.flatnonzero(np.diff(stamp_s) < 0)
    if len(backward):
        raise DataError(f"{what}: stamps go back at row {backward[0] + 1}")


def default_max_gap_s(stamp_s: Floats) -> float:
    """1 s, or three median intervals of the estimate where that is longer (logs that count steps as time)."""
    if len(stamp_s) < 2:
        return 1.0
    return max(1.0, 3.0 * float(np.median(np.diff(stamp_s))))


def interpolate_poses(
    stamp_s: Floats, poses: Floats, query_s: Floats, *, max_gap_s: float
) -> tuple[Floats, Bools]:
    """Poses (Q, 3) at `query_s`, linear in x, y and unwrapped heading, and which are covered (Q,).

    A query outside the stamps, or farther than `max_gap_s` from the nearest of them, is not covered; its row
    holds NaN.
    """
    found = np.full((len(query_s), 3), np.nan)
    if len(stamp_s) == 0:
        return found, np.zeros(len(query_s), dtype=bool)
    after = np.clip(np.searchsorted(stamp_s, query_s), 0, len(stamp_s) - 1)
    before = np.clip(after - 1, 0, None)
    nearest = np.minimum(np.abs(stamp_s[after] - query_s), np.abs(stamp_s[before] - query_s))
    covered = (query_s >= stamp_s[0]) & (query_s <= stamp_s[-1]) & (nearest <= max_gap_s)
    heading = np.unwrap(poses[:, 2])
    for column, values in enumerate((poses[:, 0], poses[:, 1], heading)):
        found[covered, column] = np.interp(query_s[covered], stamp_s, values)
    return found, np.asarray(covered)


def trajectory_errors(
    estimate: Trajectory, truth: TruthTrajectory, *, max_gap_s: float | None = None
) -> TrajectoryErrors | None:
    """Absolute trajectory error, raw and after rigid alignment of the positions.

    The estimate is interpolated to the true stamps (`interpolate_poses`). None where fewer than two true
    stamps are covered or the robot never left its place, so that no alignment exists.
    Errors: `DataError` for a path that is not finite or runs backwards.
    """
    check_trajectory(estimate.stamp_s, estimate.T_world_robot, what="estimated path")
    check_trajectory(truth.stamp_s, _finite_heading(truth), what="true path")
    gap_s = default_max_gap_s(estimate.stamp_s) if max_gap_s is None else max_gap_s
    poses, covered = interpolate_poses(
        estimate.stamp_s, estimate.T_world_robot, truth.stamp_s, max_gap_s=gap_s
    )
    poses, true_poses = poses[covered], truth.T_world_robot[covered]
    try:
        transform = align_points(poses[:, :2], true_poses[:, :2])
    except DataError:
        return None
    aligned = transform.apply_poses(poses)
    error_m = np.linalg.norm(aligned[:, :2] - true_poses[:, :2], axis=1)
    heading = wrap_angle(aligned[:, 2] - true_poses[:, 2]) if truth.heading_known else None
    return TrajectoryErrors(
        transform=transform,
        stamp_s=truth.stamp_s[covered],
        error_m=error_m,
        aligned_m=ErrorSummary.of(error_m),
        raw_m=ErrorSummary.of(np.linalg.norm(poses[:, :2] - true_poses[:, :2], axis=1)),
        heading_rad=None if heading is None else ErrorSummary.of(heading),
        uncovered=int(np.count_nonzero(~covered)),
    )


def relative_errors(
    estimate: Trajectory,
    truth: TruthTrajectory,
    *,
    distances_m: Sequence[float] = (1.0, 5.0, 10.0, 50.0),
    max_gap_s: float | None = None,
) -> dict[float, ErrorSummary]:
    """Position error of the motion over stretches of the true path that are `distances_m` long.

    For each start the end is the first true stamp that lies that far along the true path; the error is the
    distance between the estimated and the true end seen from the start pose. It needs no alignment. Lengths
    that the path does not reach are left out, and all are where true headings are unknown.
    """
    if not truth.heading_known:
        return {}
    check_trajectory(estimate.stamp_s, estimate.T_world_robot, what="estimated path")
    check_trajectory(truth.stamp_s, truth.T_world_robot, what="true path")
    gap_s = default_max_gap_s(estimate.stamp_s) if max_gap_s is None else max_gap_s
    poses, covered = interpolate_poses(
        estimate.stamp_s, estimate.T_world_robot, truth.stamp_s, max_gap_s=gap_s
    )
    poses, true_poses = poses[covered], truth.T_world_robot[covered]
    steps = np.linalg.norm(np.diff(true_poses[:, :2], axis=0), axis=1)
    travelled = np.concatenate([[0.0], np.cumsum(steps)]) if len(true_poses) else np.zeros(0)
    errors = {}
    for distance in distances_m:
        end = np.searchsorted(travelled, travelled + distance * (1.0 - 1e-12))
        start = np.flatnonzero(end < len(travelled))
        if len(start):
            estimated = _seen_from(poses[start], poses[end[start]])
            true = _seen_from(true_poses[start], true_poses[end[start]])
            errors[distance] = ErrorSummary.of(np.linalg.norm(estimated - true, axis=1))
    return errors


def _seen_from(T_world_start: Floats, T_world_end: Floats) -> Floats:
    """End positions (N, 2) in the frames of the start poses."""
    offset = T_world_end[:, :2] - T_world_start[:, :2]
    cosine, sine = np.cos(T_world_start[:, 2]), np.sin(T_world_start[:, 2])
    ahead = cosine * offset[:, 0] + sine * offset[:, 1]
    left = -sine * offset[:, 0] + cosine * offset[:, 1]
    return np.column_stack([ahead, left])


def _finite_heading(truth: TruthTrajectory) -> Floats:
    """True poses with unknown headings, which may be NaN, set to zero."""
    if truth.heading_known:
        return truth.T_world_robot
    return np.column_stack([truth.T_world_robot[:, :2], np.zeros(len(truth.stamp_s))])

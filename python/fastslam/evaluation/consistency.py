"""Whether the reported covariance can be believed: normalised estimation error squared (NEES)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .._quantiles import chi_squared_quantile
from ..errors import DataError
from ..log import Floats, TruthTrajectory
from ..result import Trajectory
from .align import RigidTransform, wrap_angle
from .trajectory import check_trajectory, interpolate_poses

POSITION_STD_FLOOR_M = 1e-3
HEADING_STD_FLOOR_RAD = 1e-3


@dataclass(frozen=True)
class PoseNees:
    """NEES at the estimate's stamps that the truth covers: `stamp_s`, `nees` (N,).

    Its expectation is `degrees_of_freedom`: 3, or 2 where true headings are unknown. `floored` counts the
    stamps whose covariance was so small (a coalesced cloud) that the floor more than doubled it.
    """

    stamp_s: Floats
    nees: Floats
    degrees_of_freedom: int
    floored: int


def pose_nees(
    estimate: Trajectory,
    truth: TruthTrajectory,
    *,
    T_truth_world: RigidTransform | None = None,
    max_gap_s: float = 1.0,
    position_only: bool = False,
) -> PoseNees:
    """eᵀ C⁻¹ e of the pose errors, with the covariance of the mixture turned into the frame of the truth.

    `T_truth_world` aligns the frames; None where the run was started at the true pose. (1 mm)² and (1 mrad)²
    are added to the variances. `position_only` leaves the heading out (2 degrees of freedom).
    Errors: `DataError` where the trajectory has no covariance or one that is not positive semi-definite.
    """
    if estimate.covariance is None:
        raise DataError("NEES needs a trajectory with covariance")
    check_trajectory(estimate.stamp_s, estimate.T_world_robot, what="estimated path")
    transform = RigidTransform.identity() if T_truth_world is None else T_truth_world
    true_poses, covered = interpolate_poses(
        truth.stamp_s, truth.T_world_robot, estimate.stamp_s, max_gap_s=max_gap_s
    )
    size = 3 if truth.heading_known and not position_only else 2
    error = transform.apply_poses(estimate.T_world_robot[covered]) - true_poses[covered]
    error[:, 2] = wrap_angle(error[:, 2])
    covariance = transform.apply_covariances(estimate.covariance[covered])[:, :size, :size]
    floor = np.diag([POSITION_STD_FLOOR_M**2, POSITION_STD_FLOOR_M**2, HEADING_STD_FLOOR_RAD**2])
    floor = floor[:size, :size]
    variances = np.diagonal(covariance, axis1=1, axis2=2)
    try:
        factor = np.linalg.cholesky(covariance + floor)
    except np.linalg.LinAlgError as error_found:
        raise DataError("a covariance of the trajectory is not positive semi-definite") from error_found
    whitened = np.linalg.solve(factor, error[:, :size, None])[..., 0]
    return PoseNees(
        stamp_s=estimate.stamp_s[covered],
        nees=np.sum(whitened**2, axis=1),
        degrees_of_freedom=size,
        floored=int(np.count_nonzero((variances < np.diag(floor)).any(axis=1))),
    )


def nees_bounds(*, runs: int, degrees_of_freedom: int, probability: float = 0.95) -> tuple[float, float]:
    """Interval that holds the NEES averaged over independent runs with this probability, if consistent.

    χ²_{dN} quantiles over N: for 50 runs of 3 degrees of freedom (2.36, 3.72).
    """
    tail = (1.0 - probability) / 2.0
    total = degrees_of_freedom * runs
    low, high = (chi_squared_quantile(level, total) / runs for level in (tail, 1.0 - tail))
    return low, high

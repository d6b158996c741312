"""Whether reported uncertainties can be believed, over many runs: NEES, and coverage of ellipses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from .._quantiles import chi_squared_quantile
from ..log import Floats, Log
from ..result import RunResult
from .align import RigidTransform
from .consistency import POSITION_STD_FLOOR_M, PoseNees, nees_bounds, pose_nees
from .metrics import Evaluation, EvaluationOptions, evaluate_run

LEVELS = (0.5, 0.9, 0.95, 0.99)
"""Probabilities of the ellipses whose coverage is reported."""
QUARTERS = 4
BINS = 60
"""Pieces of a run in which the NEES is averaged for a plot."""
SAME_START_M = 0.01
"""A run that starts this near to the true pose is compared without alignment."""


@dataclass(frozen=True)
class RunConsistency:
    """One run: NEES of the pose at each stamp, of the position alone (T,), and of each paired landmark (K,).

    `aligned`: the run did not start at the true pose, so it was aligned with the truth first, which makes
    every NEES somewhat smaller.
    """

    pose: PoseNees
    position_nees: Floats
    landmark_nees: Floats
    aligned: bool


@dataclass(frozen=True)
class Coverage:
    """Which fraction of the errors lies in the reported ellipses (intervals) of each of `LEVELS`."""

    found: dict[str, float]

    @classmethod
    def of(cls, nees: Floats, degrees_of_freedom: int) -> Coverage:
        """From errors normalised by their reported covariance. `nees` must not be empty."""
        return cls(
            {
                f"{100 * level:g}%": float(np.mean(nees <= chi_squared_quantile(level, degrees_of_freedom)))
                for level in LEVELS
            }
        )


@dataclass(frozen=True)
class NeesSummary:
    """NEES over runs; `mean` is that of the runs' own means, as the bounds are about."""

    degrees_of_freedom: int
    mean: float
    median: float
    bounds: tuple[float, float]
    """What holds 95 % of the means of so many independent consistent runs."""
    coverage: Coverage


@dataclass(frozen=True)
class Consistency:
    """What a set of independent runs says about the reported uncertainties."""

    runs: int
    aligned: bool
    pose: NeesSummary
    position: NeesSummary
    landmarks: NeesSummary | None
    pose_median_of_quarter: tuple[float, ...]
    """Median over runs and stamps of the pose's NEES in each quarter of the run."""
    floored: int
    """Stamps whose covariance had collapsed below the floor, over all runs."""
    fraction: Floats = field(repr=False, compare=False)
    """Middles of the pieces of the run, from 0 to 1."""
    mean_over_runs: Floats = field(repr=False, compare=False)
    """Mean of the pose's NEES over runs in each piece."""
    median_over_runs: Floats = field(repr=False, compare=False)


def run_consistency(
    result: RunResult, log: Log, *, options: EvaluationOptions | None = None
) -> RunConsistency | None:
    """Normalised errors of one run; None where the log has no true path or the run does not overlap it.

    Errors: `DataError` as for `pose_nees`.
    """
    if log.truth_trajectory is None or len(result.trajectory.stamp_s) == 0:
        return None
    evaluation = evaluate_run(result, log, options=options)
    if evaluation.live is None:
        return None
    raw = pose_nees(result.trajectory, log.truth_trajectory)
    if len(raw.nees) == 0:
        return None
    aligned = not _starts_at_truth(result, log)
    transform = evaluation.live.transform if aligned else RigidTransform.identity()
    pose = pose_nees(result.trajectory, log.truth_trajectory, T_truth_world=transform) if aligned else raw
    position = pose
    if pose.degrees_of_freedom == 3:
        position = pose_nees(
            result.trajectory, log.truth_trajectory, T_truth_world=transform, position_only=True
        )
    return RunConsistency(pose, position.nees, _landmark_nees(result, log, evaluation, transform), aligned)


def summarize_consistency(runs: Sequence[RunConsistency]) -> Consistency:
    """Brings independent runs (other noise in each) together. `runs` must not be empty."""
    pose = [run.pose.nees for run in runs]
    degrees = runs[0].pose.degrees_of_freedom
    fractions = [_fractions(run.pose.stamp_s) for run in runs]
    landmarks = [run.landmark_nees for run in runs if len(run.landmark_nees)]
    pieces = [[_in_piece(f, k, BINS) for k in range(BINS)] for f in fractions]
    means = np.array([[_mean(n[piece]) for piece in p] for n, p in zip(pose, pieces, strict=True)])
    quarters = [
        np.concatenate([n[_in_piece(f, k, QUARTERS)] for n, f in zip(pose, fractions, strict=True)])
        for k in range(QUARTERS)
    ]
    filled = ~np.isnan(means).all(axis=0)
    return Consistency(
        runs=len(runs),
        aligned=any(run.aligned for run in runs),
        pose=_summary(pose, degrees),
        position=_summary([run.position_nees for run in runs], 2),
        landmarks=_summary(landmarks, 2) if landmarks else None,
        pose_median_of_quarter=tuple(
            float(np.median(quarter)) if len(quarter) else float("nan") for quarter in quarters
        ),
        floored=sum(run.pose.floored for run in runs),
        fraction=((np.arange(BINS) + 0.5) / BINS)[filled],
        mean_over_runs=np.nanmean(means[:, filled], axis=0),
        median_over_runs=np.nanmedian(means[:, filled], axis=0),
    )


def _summary(nees: Sequence[Floats], degrees_of_freedom: int) -> NeesSummary:
    together = np.concatenate(nees)
    return NeesSummary(
        degrees_of_freedom=degrees_of_freedom,
        mean=float(np.mean([np.mean(values) for values in nees])),
        median=float(np.median(together)),
        bounds=nees_bounds(runs=len(nees), degrees_of_freedom=degrees_of_freedom),
        coverage=Coverage.of(together, degrees_of_freedom),
    )


def _starts_at_truth(result: RunResult, log: Log) -> bool:
    assert log.truth_trajectory is not None
    start = result.config.get("initial_pose", {})
    first = log.truth_trajectory.T_world_robot[0]
    distance_m = np.hypot(start.get("x_m", 0.0) - first[0], start.get("y_m", 0.0) - first[1])
    turned = abs(np.angle(np.exp(1j * (start.get("heading_rad", 0.0) - first[2]))))
    heading_known = log.truth_trajectory.heading_known
    return bool(distance_m < SAME_START_M and (turned < 0.01 or not heading_known))


def _landmark_nees(result: RunResult, log: Log, evaluation: Evaluation, transform: RigidTransform) -> Floats:
    """Squared errors of the paired landmarks over their covariance, with the floor of `pose_nees`."""
    pairs = evaluation.landmarks
    if pairs is None or log.truth_landmarks is None:
        return np.zeros(0)
    estimate, truth = pairs.estimate_index, pairs.truth_index
    error = transform.apply_points(result.landmarks.mean_m[estimate]) - log.truth_landmarks.position_m[truth]
    rotation = transform.rotation
    covariance = rotation @ result.landmarks.covariance_m2[estimate] @ rotation.T
    covariance = covariance + POSITION_STD_FLOOR_M**2 * np.eye(2)
    solved = np.linalg.solve(covariance, error[..., None])[..., 0]
    return np.asarray(np.sum(error * solved, axis=1))


def _fractions(stamp_s: Floats) -> Floats:
    length_s = float(stamp_s[-1] - stamp_s[0])
    return (stamp_s - stamp_s[0]) / length_s if length_s > 0.0 else np.zeros(len(stamp_s))


def _in_piece(fraction: Floats, piece: int, pieces: int) -> Floats:
    index = np.minimum((fraction * pieces).astype(int), pieces - 1)
    return np.asarray(index == piece)


def _mean(values: Floats) -> float:
    return float(np.mean(values)) if len(values) else float("nan")

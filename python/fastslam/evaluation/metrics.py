"""One flat table of numbers for one run."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal, TypeAlias

import numpy as np

from ..health import health_summary
from ..log import Log
from ..result import RunResult
from .align import INLIER_DISTANCE_M, RigidTransform
from .landmarks import GATE_M, LandmarkErrors, LandmarkMatching, landmark_errors
from .position_fixes import FixErrors, edited_fix_rms_m, fix_errors
from .trajectory import ErrorSummary, TrajectoryErrors, relative_errors, trajectory_errors

Number: TypeAlias = "float | int | None"
Metrics: TypeAlias = "dict[str, Number | dict[str, Number]]"
"""Metric name to value; None where the truth is there but the metric is not determined."""

METRIC_UNITS: dict[str, str] = {
    "steps": "",
    "sightings": "",
    "landmarks": "",
    "landmarks_provisional": "",
    "filter_seconds": "s",
    "particle_updates_per_second": "1/s",
    "peak_memory_bytes": "B",
    "map_bytes": "B",
    "step_latency_us": "µs",
    "resamplings": "",
    "rejuvenations": "",
    "mean_effective_sample_size": "particles",
    "mean_particles": "particles",
    "nis": "",
    "health_ok_fraction": "",
    "health_lost_fraction": "",
    "ate_rmse_m": "m",
    "ate_median_m": "m",
    "ate_p95_m": "m",
    "ate_max_m": "m",
    "ate_raw_rmse_m": "m",
    "heading_rmse_rad": "rad",
    "smoothed_ate_rmse_m": "m",
    "smoothed_heading_rmse_rad": "rad",
    "relative_rmse_m": "m",
    "truth_stamps_uncovered": "",
    "landmark_rmse_m": "m",
    "landmark_matched": "",
    "landmark_precision": "",
    "landmark_recall": "",
    "landmark_duplicates": "",
    "landmark_gospa_m": "m",
    "landmark_gospa_localization_m2": "m²",
    "landmark_gospa_missed_m2": "m²",
    "landmark_gospa_false_m2": "m²",
    "gps_median_m": "m",
    "gps_inlier_rmse_m": "m",
    "gps_inlier_fraction": "",
    "gps_fixes_uncovered": "",
    "edited_fixes_rms_m": "m",
    "counts": "",
}
"""Unit of every metric, for display; the members of a nested metric share it. Empty: a plain number."""


@dataclass(frozen=True)
class EvaluationOptions:
    """What a user may choose about scoring; the defaults are those of the published figures."""

    gate_m: float = GATE_M
    """Largest distance at which an unnamed estimate can be a true landmark."""
    gospa_cutoff_m: float | None = None
    """None: two gates."""
    min_sightings: int | None = None
    """None: all landmarks but the provisional ones."""
    identities: Literal["auto", "known", "unknown"] = "auto"
    """Whether ids that occur among the log's names are identities; `auto` asks the run's configuration."""
    max_gap_s: float | None = None
    """None: 1 s, or three median intervals of the estimate where that is longer."""
    inlier_distance_m: float = INLIER_DISTANCE_M
    antenna_in_robot_m: tuple[float, float] = (0.0, 0.0)
    seed: int = 0
    """For the search that places an unlabelled map without true poses."""


@dataclass(frozen=True)
class Evaluation:
    """All that scoring a run found; a part is None where the log lacks its truth or nothing is determined."""

    metrics: Metrics
    live: TrajectoryErrors | None
    smoothed: TrajectoryErrors | None
    landmarks: LandmarkErrors | None
    fixes: FixErrors | None

    @property
    def T_truth_world(self) -> RigidTransform | None:
        """Alignment of the run's world frame with the truth: by the path, else the map, else the fixes.

        By the smoothed path where there is one: the map is that of the end, and the drift of the live path
        before the first loop closed would turn the truth away from it.
        """
        for path in (self.smoothed, self.live):
            if path is not None:
                return path.transform
        if self.landmarks is not None and self.landmarks.transform is not None:
            return self.landmarks.transform
        return None if self.fixes is None else self.fixes.transform


def evaluate(result: RunResult, log: Log, *, options: EvaluationOptions | None = None) -> Metrics:
    """The metrics of one run (docs/metrics.md defines each); those without truth in the log are absent.

    Errors: `DataError` where the estimate or the truth holds values that are not finite.
    """
    return evaluate_run(result, log, options=options).metrics


def evaluate_run(result: RunResult, log: Log, *, options: EvaluationOptions | None = None) -> Evaluation:
    """As `evaluate`, with the errors per stamp and per landmark that the figures need."""
    chosen = EvaluationOptions() if options is None else options
    metrics = run_metrics(result)
    live = smoothed = landmarks = fixes = None
    if log.truth_trajectory is not None:
        live = trajectory_errors(result.trajectory, log.truth_trajectory, max_gap_s=chosen.max_gap_s)
        smoothed = trajectory_errors(result.smoothed, log.truth_trajectory, max_gap_s=chosen.max_gap_s)
        metrics |= _path_metrics(live, smoothed)
        relative = relative_errors(result.trajectory, log.truth_trajectory, max_gap_s=chosen.max_gap_s)
        if relative:
            metrics["relative_rmse_m"] = {f"{length:g}m": error.rmse for length, error in relative.items()}
    if log.truth_landmarks is not None:
        path = smoothed if smoothed is not None else live
        matching = _matching(result, log, None if path is None else path.transform, chosen)
        landmarks = landmark_errors(result.landmarks, log.truth_landmarks, matching=matching)
        metrics |= _landmark_metrics(landmarks)
    if log.position_fixes is not None:
        fixes = fix_errors(
            result.trajectory,
            log.position_fixes,
            inlier_distance_m=chosen.inlier_distance_m,
            antenna_in_robot_m=chosen.antenna_in_robot_m,
            max_gap_s=chosen.max_gap_s,
        )
        metrics |= _fix_metrics(fixes)
    if log.edited_fixes is not None:
        metrics["edited_fixes_rms_m"] = edited_fix_rms_m(
            result.trajectory,
            log.edited_fixes,
            antenna_in_robot_m=chosen.antenna_in_robot_m,
            max_gap_s=chosen.max_gap_s,
        )
    metrics["counts"] = dict(result.counts)
    return Evaluation(metrics, live, smoothed, landmarks, fixes)


def run_metrics(result: RunResult) -> Metrics:
    """The metrics that need no truth."""
    steps = result.steps
    sightings = int(steps.sightings.sum())
    particles = particle_count(result.config)
    rate = None
    if particles is not None and result.filter_seconds > 0.0:
        rate = float(steps.particles @ steps.sightings) / result.filter_seconds
    health = health_summary(steps)
    confirmed = result.landmarks.confirmed
    provisional = 0 if confirmed is None else int(np.count_nonzero(~confirmed))
    return {
        "steps": len(steps.stamp_s),
        "sightings": sightings,
        "landmarks": len(result.landmarks.ids) - provisional,
        "landmarks_provisional": provisional,
        "filter_seconds": float(result.filter_seconds),
        "particle_updates_per_second": rate,
        "peak_memory_bytes": int(result.peak_memory_bytes),
        "map_bytes": int(result.map_bytes),
        "step_latency_us": _latency(result),
        "resamplings": int(np.count_nonzero(steps.resampled)),
        "rejuvenations": int(np.count_nonzero(steps.rejuvenated)),
        "mean_effective_sample_size": _finite(np.mean(steps.effective_sample_size))
        if len(steps.stamp_s)
        else None,
        "mean_particles": _finite(np.mean(steps.particles)) if len(steps.stamp_s) else None,
        "nis": _finite(result.noise["nis"]) if result.noise.get("sightings") else None,
        "health_ok_fraction": health.ok,
        "health_lost_fraction": health.lost,
    }


def particle_count(config: dict[str, Any]) -> int | None:
    """Number of particles in an effective configuration (1 for EKF-SLAM); None where it does not say."""
    if config.get("algorithm") == "ekf":
        return 1
    particles = config.get("filter", {}).get("particles")
    return particles if isinstance(particles, int) else None


def _latency(result: RunResult) -> dict[str, Number]:
    latency_us = result.steps.latency_us
    if len(latency_us) == 0:
        return {"p50": None, "p99": None, "max": None}
    p50, p99 = np.percentile(latency_us, [50, 99])
    return {"p50": _finite(p50), "p99": _finite(p99), "max": _finite(latency_us.max())}


def _path_metrics(live: TrajectoryErrors | None, smoothed: TrajectoryErrors | None) -> Metrics:
    metrics: Metrics = {"ate_rmse_m": None, "smoothed_ate_rmse_m": None}
    if live is not None:
        metrics |= {
            "ate_rmse_m": live.aligned_m.rmse,
            "ate_median_m": live.aligned_m.median,
            "ate_p95_m": live.aligned_m.p95,
            "ate_max_m": live.aligned_m.max,
            "ate_raw_rmse_m": live.raw_m.rmse,
            "truth_stamps_uncovered": live.uncovered,
        }
        metrics |= _heading("heading_rmse_rad", live.heading_rad)
    if smoothed is not None:
        metrics["smoothed_ate_rmse_m"] = smoothed.aligned_m.rmse
        metrics |= _heading("smoothed_heading_rmse_rad", smoothed.heading_rad)
    return metrics


def _heading(name: str, errors: ErrorSummary | None) -> Metrics:
    return {} if errors is None else {name: errors.rmse}


def _landmark_metrics(landmarks: LandmarkErrors) -> Metrics:
    metrics: Metrics = {
        "landmark_rmse_m": landmarks.rmse_m,
        "landmark_matched": landmarks.matched,
        "landmark_precision": landmarks.precision,
        "landmark_recall": landmarks.recall,
        "landmark_duplicates": landmarks.duplicates,
    }
    if landmarks.gospa is not None:
        metrics |= {
            "landmark_gospa_m": landmarks.gospa.distance_m,
            "landmark_gospa_localization_m2": landmarks.gospa.localization_m2,
            "landmark_gospa_missed_m2": landmarks.gospa.missed_m2,
            "landmark_gospa_false_m2": landmarks.gospa.false_m2,
        }
    return metrics


def _fix_metrics(fixes: FixErrors | None) -> Metrics:
    if fixes is None:
        return {"gps_median_m": None, "gps_inlier_rmse_m": None, "gps_inlier_fraction": None}
    return {
        "gps_median_m": fixes.median_m,
        "gps_inlier_rmse_m": fixes.inlier_rmse_m,
        "gps_inlier_fraction": fixes.inlier_fraction,
        "gps_fixes_uncovered": fixes.uncovered,
    }


def _matching(
    result: RunResult, log: Log, initial: RigidTransform | None, options: EvaluationOptions
) -> LandmarkMatching:
    known = options.identities == "known"
    if options.identities == "auto":
        known = result.config.get("association", {}).get("mode") != "unknown"
    return LandmarkMatching(
        identities=log.identity_names if known else (),
        initial=initial,
        gate_m=options.gate_m,
        gospa_cutoff_m=options.gospa_cutoff_m,
        min_sightings=options.min_sightings,
        seed=options.seed,
    )


def _finite(value: Any) -> float | None:
    number = float(value)
    return number if np.isfinite(number) else None

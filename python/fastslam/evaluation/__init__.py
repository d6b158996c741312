"""Scoring a run against the truth of its log."""

from .align import RigidTransform, RobustAlignment, align_points, align_points_robustly
from .assignment import Gospa, assign_points, gospa
from .consistency import PoseNees, nees_bounds, pose_nees
from .landmarks import LandmarkErrors, LandmarkMatching, landmark_errors
from .metrics import METRIC_UNITS, Evaluation, EvaluationOptions, Metrics, evaluate, evaluate_run
from .monte_carlo import Consistency, RunConsistency, run_consistency, summarize_consistency
from .position_fixes import FixErrors, fix_errors
from .runs import MetricSummary, flatten, summarize
from .trajectory import ErrorSummary, TrajectoryErrors, relative_errors, trajectory_errors

__all__ = [
    "METRIC_UNITS",
    "Consistency",
    "ErrorSummary",
    "Evaluation",
    "EvaluationOptions",
    "FixErrors",
    "Gospa",
    "LandmarkErrors",
    "LandmarkMatching",
    "MetricSummary",
    "Metrics",
    "PoseNees",
    "RigidTransform",
    "RobustAlignment",
    "RunConsistency",
    "TrajectoryErrors",
    "align_points",
    "align_points_robustly",
    "assign_points",
    "evaluate",
    "evaluate_run",
    "fix_errors",
    "flatten",
    "gospa",
    "landmark_errors",
    "nees_bounds",
    "pose_nees",
    "relative_errors",
    "run_consistency",
    "summarize",
    "summarize_consistency",
    "trajectory_errors",
]

"""Figure 5: maps and paths with a large and a small perceptual field."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import EllipseCollection
from matplotlib.figure import Figure

from ..charts.map import ellipse_axes
from ..config import merge
from ..evaluation import Evaluation, RigidTransform, evaluate_run
from ..log import Log
from ..plots import new_figure, plot_map, style
from ..result import RunResult
from ..runner import run
from ..simulation import simulate
from .experiment import PLAIN, Claim, Scale

LARGE_M, SMALL_M = 25.0, 6.0


@dataclass(frozen=True)
class _Field:
    reach_m: float
    log: Log
    result: RunResult

    @property
    def landmark_std_m(self) -> float:
        """Root of the mean variance of a landmark, in the worst direction."""
        return float(np.sqrt(np.linalg.eigvalsh(self.result.landmarks.covariance_m2)[:, 1].mean()))

    @property
    def path_std_m(self) -> float:
        """Root of the mean variance of the position along the path."""
        covariance = self.result.trajectory.covariance
        assert covariance is not None, "a live trajectory has its covariance"
        return float(np.sqrt(np.linalg.eigvalsh(covariance[:, :2, :2])[:, 1].mean()))


def perceptual_fields(scale: Scale) -> list[Claim]:
    """The same world seen far and near."""
    fields = [_run(reach_m, particles=100 if scale.quick else 1000) for reach_m in (LARGE_M, SMALL_M)]
    rows = []
    for field in fields:
        found = evaluate_run(field.result, field.log)
        rows.append(
            {
                "reach_m": field.reach_m,
                "landmark_std_m": field.landmark_std_m,
                "path_std_m": field.path_std_m,
                "ate_rmse_m": found.metrics["ate_rmse_m"],
                "landmark_rmse_m": found.metrics["landmark_rmse_m"],
                "landmarks": len(field.result.landmarks.ids),
            }
        )
    scale.write_csv("figure5", rows)
    scale.write_figure("figure5", lambda: _draw(fields))
    large, small = fields
    return [
        Claim(
            "5: maps and paths with their uncertainty, for a large and a small perceptual field",
            "pictures only",
            f"std of a landmark {large.landmark_std_m:.2g} m at {LARGE_M:g} m of sight, "
            f"{small.landmark_std_m:.2g} m at {SMALL_M:g} m; of the robot {large.path_std_m:.2g} and "
            f"{small.path_std_m:.2g} m",
        )
    ]


def _run(reach_m: float, particles: int) -> _Field:
    settings = {
        "seed": 4,
        "world": {"layout": "random", "count": 80, "size_m": [60.0, 50.0], "min_spacing_m": 2.0},
        "trajectory": {"kind": "loop", "laps": 2, "margin_m": 8.0, "corner_radius_m": 8.0},
        "motion": {"model": "velocity", "speed_std_m_per_s": 0.2, "yaw_rate_std_rad_per_s": 0.05},
        "sensor": {"range_std_m": 0.2, "bearing_std_rad": 0.035, "max_range_m": reach_m},
        "scan": {"period_s": 0.4},
    }
    log = simulate(settings, name=f"reach {reach_m:g} m")
    config = merge(PLAIN, {"algorithm": "fastslam1", "filter": {"particles": particles}, "seed": 1})
    return _Field(reach_m, log, run(log, config))


def _in_world(field: _Field) -> Evaluation:
    """The evaluation without alignment: the start is known, so the run's world is the true one."""
    found = evaluate_run(field.result, field.log)
    assert found.live is not None, "a simulated log has its true path"
    return replace(found, live=replace(found.live, transform=RigidTransform.identity()))


def _draw_path_ellipses(axis: Axes, result: RunResult) -> None:
    """Uncertainty of the position every few seconds, as it was then."""
    trajectory = result.trajectory
    assert trajectory.covariance is not None, "a live trajectory has its covariance"
    some = slice(None, None, max(1, len(trajectory.stamp_s) // 60))
    major, minor, angle = ellipse_axes(trajectory.covariance[some, :2, :2])
    axis.add_collection(
        EllipseCollection(
            major,
            minor,
            angle,
            units="xy",
            offsets=trajectory.T_world_robot[some, :2],
            offset_transform=axis.transData,
            facecolors=style.LIVE + "30",
            edgecolors=style.LIVE,
            linewidths=0.5,
            zorder=2.5,
        )
    )


def _draw(fields: list[_Field]) -> Figure:
    figure = new_figure(10.5, 5.4)
    for axis, field in zip(figure.subplots(1, 2), fields, strict=True):
        plot_map(axis, field.result, field.log, evaluation=_in_world(field))
        _draw_path_ellipses(axis, field.result)
        axis.set_title(f"Perceptual field of {field.reach_m:g} m")
    return figure

"""Figures 6a and 6b: error against the number of landmarks and of particles; error against computing time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ..config import merge
from ..plots import new_figure, style
from ..sweep import Group, SimulatedLog, SweepSpec
from .experiment import PLAIN, Claim, Scale, interval, plot_series, series_rows

_ERRORS = ("ate_rmse_m", "landmark_rmse_m")
_COLOR = {"fastslam1": style.LANDMARK, "fastslam2": style.LIVE, "ekf": style.INK}
_LABEL = {"fastslam1": "FastSLAM 1.0", "fastslam2": "FastSLAM 2.0", "ekf": "EKF-SLAM"}


def _world(landmarks: int) -> dict[str, Any]:
    """A field of 60 m by 50 m, two laps, a sensor of 8 m; another number of landmarks in the same field."""
    return {
        "world": {"layout": "random", "count": landmarks, "size_m": [60.0, 50.0], "min_spacing_m": 0.2},
        "trajectory": {"kind": "loop", "laps": 2, "margin_m": 8.0, "corner_radius_m": 8.0},
        "motion": {"model": "velocity", "speed_std_m_per_s": 0.2, "yaw_rate_std_rad_per_s": 0.05},
        "sensor": {"range_std_m": 0.2, "bearing_std_rad": 0.035, "max_range_m": 8.0},
        "scan": {"period_s": 0.4},
    }


def error_against_landmarks(scale: Scale) -> list[Claim]:
    """Figure 6a: M fixed, K from few to many in the same field."""
    counts = (30, 100, 300, 1000) if scale.quick else (30, 100, 300, 1000, 3000)
    particles = 50 if scale.quick else 250
    groups = scale.sweep(
        "figure6a",
        SweepSpec(
            logs=[SimulatedLog(f"K={k}", settings=_world(k), new_world=True) for k in counts],
            seeds=scale.seeds(quick=12, full=60),
            config=merge(PLAIN, {"algorithm": "fastslam1", "filter": {"particles": particles}}),
        ),
    )
    rows = [{"landmarks": k, **row} for k, row in zip(counts, series_rows(groups, _ERRORS), strict=True)]
    scale.write_csv("figure6a", rows)
    scale.write_figure("figure6a", lambda: _draw_6a(groups, counts, particles))
    few, many = groups[0].summary, groups[-1].summary
    return [
        Claim(
            "6a: many landmarks reduce the error of the robot, with little effect on the map's",
            "robot error falls with K, up to K = 50,000; curve only",
            f"robot {interval(few['ate_rmse_m'])} at K = {counts[0]}, "
            f"{interval(many['ate_rmse_m'])} at K = {counts[-1]:,}; "
            f"map {interval(few['landmark_rmse_m'])} and {interval(many['landmark_rmse_m'])} "
            f"(M = {particles}, {few['ate_rmse_m'].runs} worlds)",
        )
    ]


def _draw_6a(groups: Sequence[Group], counts: Sequence[int], particles: int) -> Figure:
    figure = new_figure(6.0, 3.8)
    axis = figure.subplots()
    for metric, label, color in zip(
        _ERRORS, ("robot", "landmarks"), (style.LIVE, style.LANDMARK), strict=True
    ):
        values = [group.summary[metric] for group in groups]
        plot_series(axis, counts, values, label=label, color=color)
    axis.set_xscale("log")
    axis.set_ylim(bottom=0.0)
    axis.set_xlabel("landmarks K in the same field")
    axis.set_ylabel("error, RMS over the run [m]")
    axis.set_title(f"Error against landmarks, FastSLAM 1.0, M = {particles}")
    style.plain_log_ticks(axis.xaxis)
    style.legend_below(axis)
    return figure


def _against_particles(scale: Scale) -> tuple[tuple[int, ...], list[Group], list[Group]]:
    """The runs of figure 6b and of error against time: (M, FastSLAM by algorithm then M, EKF-SLAM)."""
    counts = (1, 3, 10, 30, 100) if scale.quick else (1, 3, 10, 30, 100, 300, 1000)
    logs = [SimulatedLog("K=100", settings=_world(100), new_world=True)]
    seeds = scale.seeds(quick=12, full=60)
    grid: dict[str, list[Any]] = {"algorithm": ["fastslam1", "fastslam2"], "filter.particles": list(counts)}
    filters = scale.sweep("figure6b", SweepSpec(logs=logs, seeds=seeds, grid=grid, config=PLAIN), processes=1)
    ekf = scale.sweep("figure6b", SweepSpec(logs=logs, seeds=seeds, grid={"algorithm": ["ekf"]}), processes=1)
    return counts, filters, ekf


def error_against_particles(scale: Scale) -> list[Claim]:
    """Figure 6b: K fixed, M from one to many."""
    counts, filters, ekf = _against_particles(scale)
    scale.write_csv("figure6b", series_rows([*filters, *ekf], (*_ERRORS, "filter_seconds")))
    scale.write_figure("figure6b", lambda: _draw_6b(counts, filters, ekf))
    found = {(g.point["algorithm"], g.point["filter.particles"]): g.summary["ate_rmse_m"] for g in filters}
    few, enough, most = (found["fastslam1", m] for m in (1, 100, counts[-1]))
    return [
        Claim(
            "6b: as few as 100 particles do",
            "error levels off at about M = 100; curve only",
            f"FastSLAM 1.0, robot: {interval(few)} at M = 1, {interval(enough)} at 100"
            + (f", {interval(most)} at {counts[-1]:,}" if counts[-1] > 100 else "")
            + f"; EKF-SLAM {interval(ekf[0].summary['ate_rmse_m'])} ({enough.runs} worlds)",
        )
    ]


def _draw_6b(counts: Sequence[int], filters: Sequence[Group], ekf: Sequence[Group]) -> Figure:
    figure = new_figure(8.4, 3.8)
    axes = figure.subplots(1, 2, sharey=True)
    for axis, metric, title in zip(axes, _ERRORS, ("Robot", "Landmarks"), strict=True):
        for number, name in enumerate(("fastslam1", "fastslam2")):
            own = filters[number * len(counts) : (number + 1) * len(counts)]
            values = [group.summary[metric] for group in own]
            plot_series(axis, counts, values, label=_LABEL[name], color=_COLOR[name])
        level = ekf[0].summary[metric]
        half = level.ci95 or 0.0
        axis.axhspan(level.mean - half, level.mean + half, color=style.MUTED, alpha=0.25, linewidth=0)
        axis.axhline(level.mean, color=_COLOR["ekf"], linestyle="--", label=_LABEL["ekf"])
        axis.set_xscale("log")
        axis.set_yscale("log")
        axis.set_xlabel("particles M")
        axis.set_title(f"{title}, K = 100")
        style.plain_log_ticks(axis.xaxis)
        style.plain_log_ticks(axis.yaxis)
    axes[0].set_ylabel("error, RMS over the run [m]")
    style.legend_below(axes[0])
    return figure


def error_against_time(scale: Scale) -> list[Claim]:
    """FastSLAM 1.0, 2.0 and EKF-SLAM: what computing time buys."""
    counts, filters, ekf = _against_particles(scale)
    metrics = (*_ERRORS, "filter_seconds")
    scale.write_csv("error-against-time", series_rows([*filters, *ekf], metrics))
    scale.write_figure("error-against-time", lambda: _draw_time(counts, filters, ekf))

    def said(group: Group) -> str:
        robot, landmarks = (interval(group.summary[metric]) for metric in _ERRORS)
        return f"robot {robot}, map {landmarks}"

    def at(name: str, m: int) -> str:
        group = next(g for g in filters if g.point == {"algorithm": name, "filter.particles": m})
        seconds = group.summary["filter_seconds"].mean
        return f"{_LABEL[name]} with M = {m}: {said(group)} in {seconds:.3g} s"

    joint = ekf[0].summary
    return [
        Claim(
            "error against computing time (not in the paper)",
            "—",
            f"{at('fastslam1', 100)}; {at('fastslam2', 10)}; {at('fastslam2', 100)}; "
            f"EKF-SLAM: {said(ekf[0])} in "
            f"{joint['filter_seconds'].mean:.3g} s (K = 100)",
        )
    ]


def _draw_time(counts: Sequence[int], filters: Sequence[Group], ekf: Sequence[Group]) -> Figure:
    figure = new_figure(8.8, 4.2)
    axes = figure.subplots(1, 2)
    for axis, metric, title in zip(axes, _ERRORS, ("Robot", "Landmarks"), strict=True):
        for number, name in enumerate(("fastslam1", "fastslam2")):
            own = filters[number * len(counts) : (number + 1) * len(counts)]
            _plot_against_time(axis, own, metric, name)
            for m, group in zip(counts, own, strict=True):
                at = (group.summary["filter_seconds"].mean, group.summary[metric].mean)
                offset = (4, 6) if number == 0 else (4, -11)
                axis.annotate(
                    f"{m}", at, offset, textcoords="offset points", fontsize=7.5, color=_COLOR[name]
                )
        _plot_against_time(axis, ekf, metric, "ekf")
        axis.set_xscale("log")
        axis.set_yscale("log")
        axis.set_xlabel("computing time of the run [s]")
        axis.set_ylabel("error, RMS [m]")
        axis.set_title(f"{title}, K = 100 (numbers: M)")
        style.plain_log_ticks(axis.xaxis)
        style.plain_log_ticks(axis.yaxis)
    style.legend_below(axes[0])
    return figure


def _plot_against_time(axis: Axes, groups: Sequence[Group], metric: str, name: str) -> None:
    x = [group.summary["filter_seconds"].mean for group in groups]
    values = [group.summary[metric] for group in groups]
    marker = "s" if name == "ekf" else "o"
    plot_series(axis, x, values, label=_LABEL[name], color=_COLOR[name], marker=marker)

# ---
# jupyter:
#   jupytext:
#     formats: py:percent
#     text_representation: {extension: .py, format_name: percent}
#   kernelspec: {display_name: Python 3, language: python, name: python3}
# ---

# %% [markdown]
# # The FastSLAM paper in one notebook
#
# Montemerlo, Thrun, Koller and Wegbreit (AAAI 2002), remade small enough to run in seconds. This file
# is plain Python: open it with Jupytext, or run it. `own_log.py` and `compare_filters.py` beside it go on.
# `fastslam reproduce all` makes the figures at full size; `docs/paper-claims.md` has what came out.
#
# Make `SEEDS` and `PARTICLES` larger for smoother curves.

# %%
import fastslam
import numpy as np
from fastslam.evaluation import evaluate, summarize
from fastslam.plots import house_style, map_figure, new_figure
from fastslam.simulation import resolve_simulation, simulate

SEEDS = range(1, 13)
PARTICLES = 20


def world(landmarks, *, reach_m=8.0, seed=1):
    """A field of 60 m by 50 m, one lap, a sensor that sees `reach_m`; the truth comes with the log."""
    settings = {
        "seed": seed,
        "world": {"layout": "random", "count": landmarks, "size_m": [60.0, 50.0], "min_spacing_m": 0.2},
        "trajectory": {"kind": "loop", "laps": 1, "margin_m": 8.0, "corner_radius_m": 8.0},
        "motion": {"model": "velocity", "speed_std_m_per_s": 0.2, "yaw_rate_std_rad_per_s": 0.05},
        "sensor": {"range_std_m": 0.2, "bearing_std_rad": 0.035, "max_range_m": reach_m},
        "scan": {"period_s": 0.8},
    }
    return simulate(settings, name=f"{landmarks} landmarks")


def curve(axis, label, xs, metric, runs):
    """The mean of a metric with its 95 % interval; `runs` has the metrics of all seeds for each x."""
    found = [summarize(metrics)[metric] for metrics in runs]
    means = [value.mean for value in found]
    axis.errorbar(xs, means, yerr=[value.ci95 for value in found], marker="o", capsize=3, label=label)
    axis.set_xticks(xs, [f"{x}" for x in xs])
    axis.minorticks_off()
    axis.set_ylim(bottom=0.0)
    return means


# %% [markdown]
# ## The idea
#
# Given the path, the landmarks are independent of each other. So each particle carries a path and, for every
# landmark, a Gaussian of two numbers. A log and a result show themselves:

# %%
log = world(60)
log

# %%
result = fastslam.run(log, {"algorithm": "fastslam1", "filter": {"particles": PARTICLES}, "seed": 1})
result

# %%
map_figure(result, log)

# %% [markdown]
# ## Figure 4: from raw laser scans to a map of rocks
#
# Nobody says which rock is which, and nobody says where in a scan a rock is. Ten particles, as in the paper.

# %%
rover = simulate(resolve_simulation({"seed": 1, "max_duration_s": 60.0}, preset="rover"), name="rover")
rocks = fastslam.run(rover, {"filter": {"particles": 10}, "seed": 1})
print(f"residual map error {100 * evaluate(rocks, rover)['landmark_rmse_m']:.2f} cm (the paper: 8.3 cm)")
map_figure(rocks, rover)

# %% [markdown]
# ## Figure 5: a large and a small perceptual field
#
# A robot that sees far ties everything together; one that sees little drifts between what it sees.

# %%
uncertainty_m = {}
for reach_m in (25.0, 6.0):
    seen = world(60, reach_m=reach_m)
    found = fastslam.run(seen, {"filter": {"particles": PARTICLES}, "seed": 1})
    along_path = np.linalg.eigvalsh(found.trajectory.covariance[:, :2, :2])[:, 1]
    uncertainty_m[reach_m] = float(np.sqrt(along_path.mean()))
    print(f"sight {reach_m:4.0f} m: standard deviation of the robot {uncertainty_m[reach_m]:.2f} m")

# %% [markdown]
# ## Figure 6a: many landmarks help the robot

# %%
counts = (30, 100, 300)
config = {"algorithm": "fastslam1", "filter": {"particles": PARTICLES}}
metrics = []
for count in counts:
    logs = [world(count, seed=seed) for seed in SEEDS]
    metrics.append([evaluate(fastslam.run(log, {**config, "seed": 1}), log) for log in logs])
with house_style():
    figure_6a = new_figure(6.0, 3.6)
    axis = figure_6a.add_subplot(xscale="log", xlabel="landmarks K", ylabel="error [m]")
    robot_by_count = curve(axis, "robot", counts, "ate_rmse_m", metrics)
    curve(axis, "landmarks", counts, "landmark_rmse_m", metrics)
    axis.legend()
figure_6a

# %% [markdown]
# ## Figure 6b: how many particles, and compare filters
#
# FastSLAM 1.0 draws poses from odometry alone and needs particles; 2.0 looks at the sighting first. EKF-SLAM
# keeps all correlations in one matrix, which grows with the square of the map.

# %%
numbers = (1, 5, 25)
field = [world(60, seed=seed) for seed in SEEDS]


def scores(config):
    return [evaluate(fastslam.run(log, {**config, "seed": 1}), log) for log in field]


with house_style():
    figure_6b = new_figure(6.0, 3.6)
    axis = figure_6b.add_subplot(xscale="log", xlabel="particles M", ylabel="error of the map [m]")
    map_error_m = {}
    for algorithm in ("fastslam1", "fastslam2"):
        runs = [scores({"algorithm": algorithm, "filter": {"particles": number}}) for number in numbers]
        map_error_m[algorithm] = curve(axis, algorithm, numbers, "landmark_rmse_m", runs)
    map_error_m["ekf"] = [summarize(scores({"algorithm": "ekf"}))["landmark_rmse_m"].mean]
    axis.axhline(map_error_m["ekf"][0], color="black", linestyle="--", label="EKF-SLAM")
    axis.legend()
figure_6b

# ---
# jupyter:
#   jupytext:
#     formats: py:percent
#     text_representation: {extension: .py, format_name: percent}
#   kernelspec: {display_name: Python 3, language: python, name: python3}
# ---

# %% [markdown]
# # Filters compared on one log
#
# FastSLAM 1.0, FastSLAM 2.0 and EKF-SLAM, with and without names of the landmarks, over several seeds of the
# filter. Put your own log into `log`; where it has no truth, compare the evidence alone.

# %%
import fastslam
import numpy as np
from fastslam.evaluation import evaluate
from fastslam.plots import house_style, new_figure
from fastslam.simulation import simulate

SEEDS = range(1, 6)
PARTICLES = 30

log = simulate(
    {
        "seed": 2,
        "world": {"layout": "random", "count": 60, "size_m": [40.0, 30.0], "min_spacing_m": 0.5},
        "trajectory": {"kind": "loop", "laps": 1, "margin_m": 6.0, "corner_radius_m": 6.0},
        "sensor": {"range_std_m": 0.2, "bearing_std_rad": 0.035, "max_range_m": 8.0},
        "scan": {"period_s": 0.5},
    },
    name="forty by thirty metres",
)
log

# %% [markdown]
# ## Runs
#
# `log_likelihood` sums how well each scan was predicted by all before it: it needs no truth. It compares
# filters with one association only: who founds more landmarks tells the sightings otherwise.

# %%
FILTERS = {
    "FastSLAM 1.0": {"algorithm": "fastslam1", "filter": {"particles": PARTICLES}},
    "FastSLAM 2.0": {"algorithm": "fastslam2", "filter": {"particles": PARTICLES}},
    "EKF-SLAM": {"algorithm": "ekf"},
}
scores = {}
for mode in ("known", "unknown"):
    for name, config in FILTERS.items():
        seeds = list(SEEDS)[:1] if name == "EKF-SLAM" else SEEDS  # it draws nothing
        runs = [fastslam.run(log, {**config, "association": {"mode": mode}, "seed": seed}) for seed in seeds]
        metrics = [evaluate(run, log) for run in runs]
        scores[mode, name] = {
            "path [m]": [found["ate_rmse_m"] for found in metrics],
            "map [m]": [found["landmark_rmse_m"] for found in metrics],
            "landmarks": [len(run.landmarks.ids) for run in runs],
            "evidence": [float(run.steps.log_likelihood.sum()) for run in runs],
        }

columns = ("path [m]", "map [m]", "landmarks", "evidence")
print(f"{'identities':<11}{'filter':<14}" + "".join(f"{column:>12}" for column in columns))
for (mode, name), found in scores.items():
    print(f"{mode:<11}{name:<14}" + "".join(f"{np.median(found[column]):>12.4g}" for column in columns))

# %% [markdown]
# ## The spread over seeds
#
# One dot is one seed. What the algorithm gains must be more than what the seed does.

# %%
with house_style():
    figure = new_figure(7.0, 3.4)
    axis = figure.add_subplot(ylabel="error of the map [m]")
    labels = []
    for place, ((mode, name), found) in enumerate(scores.items()):
        axis.plot([place] * len(found["map [m]"]), found["map [m]"], "o", alpha=0.6)
        labels.append(f"{name}\n{mode}")
    axis.set_xticks(range(len(labels)), labels, fontsize=7.5)
    axis.set_ylim(bottom=0.0)
figure

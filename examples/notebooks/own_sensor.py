# ---
# jupyter:
#   jupytext:
#     formats: py:percent
#     text_representation: {extension: .py, format_name: percent}
#   kernelspec: {display_name: Python 3, language: python, name: python3}
# ---

# %% [markdown]
# # A sensor of your own
#
# A class that says what it should measure, on arrays; `docs/own-sensor.md` says what else it may have.
# Here: beacons that are heard, whose ranges are known only up to a scale and a bias.

# %%
import fastslam
import matplotlib.pyplot as plt
import numpy as np
from fastslam.evaluation import evaluate
from fastslam.plots import map_figure
from fastslam.sensors import check
from fastslam.simulation import simulate


class Beacons:
    measures = ("range_m",)
    noise = ((0.3**2,),)

    def expected(self, poses, landmarks):
        return np.linalg.norm(landmarks - poses[:, :2], axis=1)[:, None]


# %% [markdown]
# ## Does it conform?
#
# Shapes, derivatives against differences, angles, and where a landmark may be after one sighting.

# %%
cases = check(Beacons())
print(f"{cases} cases")

# %% [markdown]
# ## A log, and a run with it
#
# The ranges of this log are 5 % too long, and nobody says so.

# %%
sensor = {"model": "range", "range_std_m": 0.3, "max_range_m": 100.0, "range_scale": 1.05}
log = simulate({"seed": 4, "world": {"count": 8}, "sensor": sensor, "scan": {"period_s": 1.0}})
settings = {"sensor": {"range_scale": 1.0}, "filter": {"particles": 30}}
result = fastslam.run(log, settings, sensor=Beacons())
result

# %%
map_figure(result, log)

# %% [markdown]
# ## Beside the built-in model
#
# Derivatives by differences are right to nine digits, and so is the path.

# %%
built_in = fastslam.run(log, settings)
apart_m = np.abs(result.trajectory.T_world_robot - built_in.trajectory.T_world_robot).max()
error_m = evaluate(result, log)["smoothed_ate_rmse_m"]
print(f"path off by {error_m:.2f} m, {apart_m:.1e} from that of the built-in model")

# %% [markdown]
# ## Where a beacon may be
#
# Step by step: the first range leaves a ring, and the map says so by its covariance.

# %%
robot = fastslam.FastSlam({"filter": {"particles": 30}}, sensor=Beacons(), identities="all")
mast_m, widths_m = np.array([20.0, 5.0]), []
for k in range(80):
    x, y = np.sin(0.1 * k) / 0.1, (1.0 - np.cos(0.1 * k)) / 0.1
    robot.update(float(k), range_m=[np.hypot(*(mast_m - [x, y]))], identity=["mast"])
    widths_m.append(np.sqrt(np.linalg.eigvalsh(robot.landmarks.covariance_m2[0]).max()))
    robot.predict([1.0, 0.1], dt_s=1.0)
print(f"standard deviation of the mast: {widths_m[0]:.1f} m at first, {widths_m[-1]:.2f} m at the end")

# %%
figure, axes = plt.subplots()
axes.semilogy(widths_m)
axes.set(xlabel="step", ylabel="standard deviation of the mast, m")
figure

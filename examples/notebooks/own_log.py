# ---
# jupyter:
#   jupytext:
#     formats: py:percent
#     text_representation: {extension: .py, format_name: percent}
#   kernelspec: {display_name: Python 3, language: python, name: python3}
# ---

# %% [markdown]
# # A log of your own
#
# From files to a map, with what speaks against either. Here the cells write the files of a log first; put
# the path of yours into `FOLDER` and leave that cell out. `docs/native-log-format.md` says what they hold,
# and `docs/formats.md` which other formats `fastslam.load` reads.

# %%
from pathlib import Path
from tempfile import mkdtemp

import fastslam
import numpy as np
from fastslam.examination import examine
from fastslam.plots import map_figure
from fastslam.tuning import diagnose
from fastslam.verdict import warnings_of

FOLDER = Path(mkdtemp()) / "garden"

# %% [markdown]
# ## Three files
#
# Odometry and sightings as tables, and what is known of the noise. Five posts; nobody says which is which.

# %%
rng = np.random.default_rng(7)
posts_m = np.array([[6.0, 2.0], [2.0, 7.0], [-3.0, 3.0], [-1.0, 9.0], [4.5, 5.5]])
odometry_s = np.arange(0.0, 50.0, 0.1)
speed, yaw_rate = (rng.normal(mean, std, odometry_s.shape) for mean, std in ((1.0, 0.05), (0.2, 0.02)))
scan_s = np.repeat(np.arange(0.5, 50.0, 0.5), len(posts_m))
heading_rad = 0.2 * scan_s
robot_m = 5.0 * np.column_stack([np.sin(heading_rad), 1.0 - np.cos(heading_rad)])
offset_m = np.tile(posts_m, (len(scan_s) // len(posts_m), 1)) - robot_m
range_m = np.hypot(*offset_m.T) + rng.normal(0.0, 0.05, scan_s.shape)
bearing_rad = np.arctan2(offset_m[:, 1], offset_m[:, 0]) - heading_rad + rng.normal(0.0, 0.02, scan_s.shape)
bearing_rad = np.arctan2(np.sin(bearing_rad), np.cos(bearing_rad))

FOLDER.mkdir()
odometry = np.column_stack([odometry_s, speed, yaw_rate])
sightings = np.column_stack([scan_s, range_m, bearing_rad])
for name, header, table in (
    ("odometry.csv", "stamp_s,speed_m_per_s,yaw_rate_rad_per_s", odometry),
    ("sightings.csv", "stamp_s,range_m,bearing_rad", sightings),
):
    np.savetxt(FOLDER / name, table, delimiter=",", header=header, comments="")
_ = (FOLDER / "log.yaml").write_text(
    """format_version: 1
motion: {model: velocity, speed_std_m_per_s: 0.1, yaw_rate_std_rad_per_s: 0.05}
sensor: {model: range_bearing, range_std_m: 0.05, bearing_std_rad: 0.02}
"""
)

# %% [markdown]
# ## What is in it, and what is visibly wrong
#
# `examine` looks at the rows, before any filter; `diagnose` asks how much better other readings of the
# numbers (degrees, mirrored bearings, late sightings) would explain the log.

# %%
log = fastslam.load(FOLDER)
log

# %%
findings = examine(log)
for finding in findings:
    print(finding)
diagnosis = diagnose(log)
print(f"{len(findings)} findings, {len(diagnosis.suspected)} readings suspected")

# %% [markdown]
# ## A run, and whether to believe it

# %%
result = fastslam.run(log, {"filter": {"particles": 30}, "seed": 1})
print(*warnings_of(result) or ["no check speaks against this run"], sep="\n")
result

# %%
map_figure(result, log)

# %% [markdown]
# ## Taking the map along
#
# A folder of text that the next run can begin in (`docs/maps.md`), or a table.

# %%
result.map.save(FOLDER / "map")
print(
    f"{len(result.landmarks.ids)} landmarks, farthest standard deviation "
    f"{np.sqrt(np.linalg.eigvalsh(result.landmarks.covariance_m2).max()):.3f} m"
)

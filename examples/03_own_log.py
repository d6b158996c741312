"""Turn arrays of your own into a native log, save it, and run the filter over it."""

from pathlib import Path

import fastslam
import numpy as np
from fastslam.datasets import write_native
from fastslam.log import Controls, Log, Sightings

# Yours: odometry at 10 Hz, and what a detector saw of three posts at 2 Hz. Here: a drive straight ahead.
rng = np.random.default_rng(2)
odometry_s = np.arange(0.0, 20.0, 0.1)
speed_m_per_s = 0.5 + rng.normal(0.0, 0.02, odometry_s.shape)
yaw_rate_rad_per_s = rng.normal(0.0, 0.01, odometry_s.shape)
posts_m = np.array([[3.0, 1.5], [6.0, -1.0], [9.0, 2.0]])
scan_s = np.arange(0.5, 20.0, 0.5)
offset_m = posts_m[None] - np.column_stack([0.5 * scan_s, np.zeros_like(scan_s)])[:, None]
range_m = np.hypot(offset_m[..., 0], offset_m[..., 1]) + rng.normal(0.0, 0.03, offset_m.shape[:2])
bearing_rad = np.arctan2(offset_m[..., 1], offset_m[..., 0]) + rng.normal(0.0, 0.01, offset_m.shape[:2])

count = range_m.size
log = Log(
    name="corridor",
    source="examples/03_own_log.py",
    format="native",
    controls=Controls(odometry_s, np.column_stack([speed_m_per_s, yaw_rate_rad_per_s])),
    sightings=Sightings(
        stamp_s=np.repeat(scan_s, len(posts_m)),
        range_m=range_m.ravel(),
        bearing_rad=bearing_rad.ravel(),
        identity=np.full(count, -1),  # nobody says which post it is: the filter finds out
        class_index=np.full(count, -1),
        signature=np.full(count, np.nan),
    ),
    config={
        "motion": {"model": "velocity", "speed_std_m_per_s": 0.05, "yaw_rate_std_rad_per_s": 0.02},
        "sensor": {"model": "range_bearing", "range_std_m": 0.03, "bearing_std_rad": 0.01},
    },
)
folder = write_native(log, Path("corridor"))
result = fastslam.run(folder)
print(f"{folder}: {len(result.landmarks.ids)} posts found")
for name, position_m in zip(result.landmarks.ids, result.landmarks.mean_m, strict=True):
    print(f"{name}: {position_m[0]:.2f}, {position_m[1]:.2f} m")

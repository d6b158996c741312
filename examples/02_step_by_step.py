"""Feed the filter one control and one scan at a time, as a robot does, and ask it where it is."""

import numpy as np
from fastslam import FastSlam

POSTS_M = {"gate": (6.0, 2.0), "lamp": (2.0, 7.0), "door": (-3.0, 3.0)}
SPEED_M_PER_S, YAW_RATE_RAD_PER_S, DT_S = 1.0, 0.25, 0.1
rng = np.random.default_rng(1)

robot = FastSlam({"filter": {"particles": 50}, "motion": {"model": "velocity"}}, identities="all")
x_m = y_m = heading_rad = 0.0
for step in range(1, 252):  # once around a circle of 4 m
    heading_rad += YAW_RATE_RAD_PER_S * DT_S
    x_m += SPEED_M_PER_S * DT_S * np.cos(heading_rad)
    y_m += SPEED_M_PER_S * DT_S * np.sin(heading_rad)
    robot.predict([SPEED_M_PER_S + rng.normal(0, 0.05), YAW_RATE_RAD_PER_S + rng.normal(0, 0.02)], DT_S)
    if step % 5 == 0:  # the sensor is slower than the odometry
        offset_m = np.array(list(POSTS_M.values())) - (x_m, y_m)
        info = robot.update(
            step * DT_S,
            range_m=np.hypot(*offset_m.T) + rng.normal(0, 0.1, 3),
            bearing_rad=np.arctan2(offset_m[:, 1], offset_m[:, 0]) - heading_rad + rng.normal(0, 0.02, 3),
            identity=list(POSTS_M),
        )

mean, covariance = robot.pose
print(f"robot at x {mean[0]:.2f} m, y {mean[1]:.2f} m, within {np.sqrt(covariance[0, 0]):.2f} m (1 std)")
for name, position_m in zip(robot.landmarks.ids, robot.landmarks.mean_m, strict=True):
    print(f"{name}: {position_m[0]:.2f}, {position_m[1]:.2f} m (true {POSTS_M[name]})")

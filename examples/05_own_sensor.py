"""A sensor of your own in a few lines: beacons that say how far they are, simulated and on Plaza 1."""

import os
from pathlib import Path

import fastslam
import numpy as np
from fastslam.evaluation import evaluate
from fastslam.sensors import check
from fastslam.simulation import simulate


class Beacons:
    measures = ("range_m",)

    def __init__(self, std_m):
        self.noise = [[std_m**2]]

    def expected(self, poses, landmarks):
        return np.sqrt(((landmarks - poses[:, :2]) ** 2).sum(axis=1))[:, None]

    def jacobian(self, poses, landmarks):  # May be left out: then derivatives are taken by differences.
        towards = ((landmarks - poses[:, :2]) / self.expected(poses, landmarks))[:, None]
        return towards, np.concatenate([-towards, np.zeros((len(poses), 1, 1))], axis=2)


print(f"{check(Beacons(0.2))} cases conform")
sensor = {"model": "range", "range_std_m": 0.2, "max_range_m": 100.0}
world = {"seed": 1, "world": {"count": 8}, "sensor": sensor, "scan": {"period_s": 1.0}}
logs = {"simulated": simulate(world)}
data = Path(os.environ.get("FASTSLAM_DATA", "no data"))
if (data / "plaza1").is_dir():
    logs["plaza1"] = fastslam.load(data / "plaza1")

for name, log in logs.items():
    settings = {"filter": {"particles": 30}}
    own = fastslam.run(log, settings, sensor=Beacons(log.config["sensor"]["range_std_m"]))
    built_in = fastslam.run(log, settings)
    apart_m = np.abs(own.trajectory.T_world_robot - built_in.trajectory.T_world_robot).max()
    error_m = evaluate(own, log)["smoothed_ate_rmse_m"]
    print(f"{name}: path off by {error_m:.2f} m, {apart_m:.0e} from that of the built-in model")

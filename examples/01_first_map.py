"""Simulate a drive, run the filter over its log, draw the map."""

from pathlib import Path

import fastslam
from fastslam.evaluation import evaluate
from fastslam.plots import write_figures
from fastslam.simulation import resolve_simulation, simulate

log = simulate(resolve_simulation({"seed": 1}, preset="demo"))
result = fastslam.run(log)
metrics = evaluate(result, log)

print(f"{len(result.landmarks.ids)} landmarks, placed to {metrics['landmark_rmse_m']:.3f} m RMSE")
print(f"path to {metrics['ate_rmse_m']:.3f} m RMSE")
folder = Path("first-map")
folder.mkdir(exist_ok=True)
write_figures(result, log, folder)
print(f"figures: {folder}/map.png and others")

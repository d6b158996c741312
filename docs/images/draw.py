"""Draws docs/images/map.png, the picture on the front page: `python docs/images/draw.py`."""

from __future__ import annotations

from pathlib import Path

import fastslam
import numpy as np
from fastslam.log import Controls, Floats
from fastslam.plots import house_style, new_figure, plot_map, render
from fastslam.simulation import resolve_simulation, simulate

WORLD = {
    "seed": 5,
    "motion": {"model": "velocity", "speed_std_m_per_s": 0.3, "yaw_rate_std_rad_per_s": 0.15},
    "scan": {"identities": "none", "detection_probability": 0.9},
}
GREY = "#9aa4ae"


def dead_reckoning(controls: Controls) -> Floats:
    """Positions (N, 2) that speeds and yaw rates alone lead to, from the origin."""
    dt_s = np.diff(controls.stamp_s)
    speed, yaw_rate = controls.values[:-1].T
    heading = np.concatenate([[0.0], np.cumsum(yaw_rate * dt_s)])
    middle = 0.5 * (heading[1:] + heading[:-1])
    steps = (speed * dt_s)[:, None] * np.column_stack([np.cos(middle), np.sin(middle)])
    return np.vstack([[0.0, 0.0], np.cumsum(steps, axis=0)])


def main() -> None:
    """Simulates two laps with poor odometry, runs the filter without identities, draws both."""
    log = simulate(resolve_simulation(WORLD), name="front page")
    result = fastslam.run(log, {"seed": 1, "filter": {"particles": 200}})
    with house_style():
        figure = new_figure(7.0, 5.8)
        axis = figure.add_subplot()
        alone_m = dead_reckoning(log.controls)
        axis.plot(*alone_m.T, color=GREY, linewidth=1.2, label="odometry alone", zorder=1)
        plot_map(axis, result, log)
        axis.set_title("Two laps among 100 unlabelled landmarks")
    (Path(__file__).parent / "map.png").write_bytes(render(figure, "png"))


if __name__ == "__main__":
    main()

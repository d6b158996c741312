"""Measures what an adaptive number of particles saves on real logs, and draws it over time.

    python experiments/adaptive/run.py [--seeds 5] [--out docs/adaptive-particles.md]

The logs are read from the folder that the environment variable FASTSLAM_DATA names (default:
`../shared/data`). The tables stand between two marks in the page, the figures in the folder of the same name
beside it.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import fastslam
import numpy as np
from fastslam.config import merge
from fastslam.datasets import load
from fastslam.evaluation import evaluate
from fastslam.log import Log
from fastslam.plots import house_style, new_figure, render
from fastslam.plots.style import BAND, LIVE, MUTED, legend_below
from fastslam.result import RunResult
from fastslam.resultfiles import write_atomically, write_measured

MAXIMUM = 200

LOGS: dict[str, tuple[str, float | None, dict[str, Any]]] = {
    "Lost in the Woods": ("lost_in_the_woods", None, {}),
    "Lost in the Woods, ranges to 1 m": ("lost_in_the_woods", 1.0, {}),
    "Victoria Park": ("victoria_park", None, {}),
}
"""Title: folder, largest range, settings over the log's own."""

VARIANTS: dict[str, dict[str, Any]] = {
    "10": {"particles": 10},
    "50": {"particles": 50},
    str(MAXIMUM): {"particles": MAXIMUM},
    f"10 to {MAXIMUM}, bins 0.1 m, 0.02 rad": {
        "particles": MAXIMUM,
        "adaptive": {"number": "kld", "bin_m": 0.1, "bin_rad": 0.02},
    },
    f"10 to {MAXIMUM}, bins 0.2 m, 0.05 rad": {"particles": MAXIMUM, "adaptive": {"number": "kld"}},
    f"10 to {MAXIMUM}, bins 0.5 m, 0.1 rad": {
        "particles": MAXIMUM,
        "adaptive": {"number": "kld", "bin_m": 0.5, "bin_rad": 0.1},
    },
}


def measure(log: Log, settings: dict[str, Any], seeds: int) -> tuple[list[float], RunResult]:
    """Medians over seeds of mean M, updates, path and map error; and one of the runs."""
    rows, result = [], None
    for seed in range(1, seeds + 1):
        result = fastslam.run(log, merge(settings, {"seed": seed}), auto=False)
        metrics = evaluate(result, log)
        updates = float(result.steps.particles @ result.steps.sightings)
        path = metrics.get("ate_rmse_m", metrics.get("edited_fixes_rms_m", metrics.get("gps_inlier_rmse_m")))
        rows.append([metrics["mean_particles"], updates, path, metrics.get("landmark_rmse_m", np.nan)])
    assert result is not None
    return np.median(np.array(rows, dtype=float), axis=0).tolist(), result


def section(title: str, rows: dict[str, list[float]], figure: str) -> str:
    """The table of one log as Markdown."""
    most = rows[str(MAXIMUM)][1]
    lines = [
        f"### {title}",
        "",
        f"![Particles over time]({figure})",
        "",
        "| particles | mean number | particle-sightings | path error [m] | map error [m] |",
        "|---|---|---|---|---|",
    ]
    for name, (particles, updates, path_m, map_m) in rows.items():
        map_cell = "" if np.isnan(map_m) else f"{map_m:.3f}"
        lines.append(
            f"| {name} | {particles:.0f} | {100 * updates / most:.0f} % | {path_m:.3f} | {map_cell} |"
        )
    return "\n".join(lines)


def draw(title: str, result: RunResult) -> bytes:
    """Particles and sightings over time."""
    with house_style():
        figure = new_figure(8.0, 3.2)
        axis = figure.subplots()
        time_s = result.steps.stamp_s - result.steps.stamp_s[0]
        axis.plot(
            time_s, result.steps.particles, color=LIVE, linewidth=0.8, drawstyle="steps-post", label="M"
        )
        axis.fill_between(
            time_s,
            0,
            result.steps.effective_sample_size,
            color=BAND,
            alpha=0.5,
            linewidth=0,
            label="effective sample size",
        )
        axis.axhline(MAXIMUM, color=MUTED, linestyle=(0, (4, 2)), linewidth=1.0, label="maximum")
        axis.set_title(f"{title}: number of particles")
        axis.set_xlabel("time since the first step [s]")
        axis.set_ylabel("particles")
        axis.set_ylim(bottom=0)
        axis.margins(x=0.01)
        legend_below(axis)
        return render(figure, "png")


def main(arguments: Sequence[str] | None = None) -> None:
    """Runs everything and writes figures and tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--out", type=Path, help="page with the two marks; without it the tables are printed")
    options = parser.parse_args(arguments)
    data = Path(os.environ.get("FASTSLAM_DATA", "../shared/data"))
    if not data.is_dir():
        parser.error(f"nothing to measure: {data} is no folder")
    figures = Path("adaptive-particles") if options.out is None else options.out.with_suffix("")
    sections = [f"Medians over {options.seeds} seeds, FastSLAM 2.0."]
    for title, (folder, max_range_m, settings) in LOGS.items():
        limits = {} if max_range_m is None else {"max_range_m": max_range_m}
        log = load(data / folder, **limits)
        rows, drawn = {}, None
        for name, variant in VARIANTS.items():
            rows[name], result = measure(log, merge(settings, {"filter": variant}), options.seeds)
            drawn = result if name.endswith("0.05 rad") else drawn
        assert drawn is not None
        name = title.lower().replace(" ", "-").replace(",", "")
        write_atomically(figures / f"{name}.png", draw(title, drawn))
        sections.append(section(title, rows, f"{figures.name}/{name}.png"))
    text = "\n\n".join(sections)
    if options.out is None:
        print(text)
        return
    write_measured(options.out, text)


if __name__ == "__main__":
    main()

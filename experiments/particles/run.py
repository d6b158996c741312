"""Measures the error against the number of particles for FastSLAM 1.0, 2.0, and 2.0 that draws paths anew.

    python experiments/particles/run.py [--seeds 10] [--seeds-of-many 2] [--particles 1 3 10 30 100 300]
        [--workers N] [--out docs]

Identities are given. UTIAS takes half of the seeds, since one stands for 15 runs there, and the real logs
with 300 particles and more take `--seeds-of-many`. The real logs are read from the folder that the
environment variable FASTSLAM_DATA names (default: `../shared/data`). With `--out` it writes `particles.md`
and `images/particles.png` there.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import fastslam
import numpy as np
from fastslam.config import merge
from fastslam.datasets import load
from fastslam.evaluation import evaluate
from fastslam.log import Log
from fastslam.plots import style
from fastslam.resultfiles import write_atomically
from fastslam.simulation import resolve_simulation, simulate
from matplotlib.figure import Figure

PLAIN: dict[str, Any] = {"filter": {"rejuvenation": {"every_steps": 0}}}
FILTERS: dict[str, dict[str, Any]] = {
    "FastSLAM 1.0": merge(PLAIN, {"algorithm": "fastslam1"}),
    "FastSLAM 2.0": merge(PLAIN, {"algorithm": "fastslam2"}),
    "2.0, paths drawn by need": {"filter": {"rejuvenation": {"every_steps": None, "spread": 1.0}}},
}
"""The papers' filters, and the default, also where a log's reader sets a schedule."""
COLORS = dict(zip(FILTERS, (style.LANDMARK, style.LIVE, style.GOOD), strict=True))
MANY = 300
"""From so many particles on, a run over a real log takes a minute."""


@dataclass(frozen=True)
class World:
    """A group of logs that make one panel; every run's number is the map error, metres."""

    title: str
    logs: tuple[Callable[[int], Log], ...]
    simulated: bool


def worlds(data: Path) -> Iterator[World]:
    """The panels."""
    yield World("Lost in the Woods", (partial(_real, data / "lost_in_the_woods"),), simulated=False)
    robots = [(number, robot) for number in (1, 2, 6) for robot in range(1, 6)]
    yield World(
        "UTIAS 1, 2, 6 (median of 15 robots)",
        tuple(partial(_real, data / f"utias_mrclam/MRCLAM_Dataset{n}", robot=robot) for n, robot in robots),
        simulated=False,
    )
    for preset in ("demo", "loop"):
        yield World(f"simulated {preset}", (partial(_simulated, preset),), simulated=True)


def _real(path: Path, _seed: int, robot: int | None = None) -> Log:
    return load(path) if robot is None else load(path, robot=robot)


def _simulated(preset: str, seed: int) -> Log:
    return simulate(resolve_simulation({"seed": seed, "max_duration_s": 120.0}, preset=preset))


def map_error_m(world: World, filter_name: str, particles: int, seed: int) -> float:
    """Median over the logs of a world."""
    settings = merge(FILTERS[filter_name], {"seed": seed, "filter": {"particles": particles}})
    errors = [
        evaluate(fastslam.run(log, settings, auto=False), log)["landmark_rmse_m"]
        for log in (f(seed) for f in world.logs)
    ]
    return float(np.median(errors))


Table = dict[tuple[str, str, int], list[float]]
"""Map errors over the seeds by world, filter and particles."""


@dataclass(frozen=True)
class Seeds:
    """How many runs a number of the table comes from: seeds 1 to this."""

    usual: int
    of_many: int

    def of(self, world: World, count: int) -> range:
        """The seeds of one world with so many particles."""
        usual = self.usual if len(world.logs) == 1 else max(1, self.usual // 2)
        few = count >= MANY and not world.simulated
        return range(1, 1 + (min(usual, self.of_many) if few else usual))


def measure(panels: Sequence[World], counts: Sequence[int], seeds: Seeds, workers: int | None) -> Table:
    """All runs, on all cores."""
    with ProcessPoolExecutor(workers) as pool:
        waiting = {
            (world.title, name, count): [
                pool.submit(map_error_m, world, name, count, seed) for seed in seeds.of(world, count)
            ]
            for world in panels
            for name in FILTERS
            for count in counts
        }
        return {key: [found.result() for found in runs] for key, runs in waiting.items()}


def draw(table: Table, panels: Sequence[World], counts: Sequence[int]) -> Figure:
    """One panel per world: medians as lines, least to largest as bands."""
    with style.house_style():
        figure = style.new_figure(9.0, 6.4)
        for axis, world in zip(figure.subplots(2, 2).flat, panels, strict=True):
            for name, color in COLORS.items():
                runs = [table[world.title, name, count] for count in counts]
                least, middle, largest = (list(map(of, runs)) for of in (min, np.median, max))
                axis.plot(counts, middle, color=color, marker="o", markersize=3.5, label=name)
                axis.fill_between(counts, least, largest, color=color, alpha=0.15, linewidth=0)
            axis.set(
                xscale="log", yscale="log", xlabel="particles", ylabel="map error [m]", title=world.title
            )
            style.plain_log_ticks(axis.xaxis)
            style.plain_log_ticks(axis.yaxis)
        figure.axes[0].legend()
        return figure


def markdown(table: Table, panels: Sequence[World], counts: Sequence[int], seeds: Seeds) -> str:
    """The page."""
    lines = [
        f"Medians over {seeds.usual} seeds (UTIAS {max(1, seeds.usual // 2)}; real logs with {MANY} "
        f"particles and more {seeds.of_many}), worst in brackets; metres after rigid alignment; "
        f"fastslam {fastslam.__version__}.",
        "",
        "| world | filter | " + " | ".join(f"M = {count}" for count in counts) + " |",
        "|---|---" + "|---" * len(counts) + "|",
    ]
    for world in panels:
        for name in FILTERS:
            cells = [table[world.title, name, count] for count in counts]
            numbers = " | ".join(f"{np.median(runs):.3f} ({max(runs):.3f})" for runs in cells)
            lines.append(f"| {world.title} | {name} | {numbers} |")
    return PAGE.format(table="\n".join(lines))


PAGE = """# Error against the number of particles

Made by `python experiments/particles/run.py --out docs`; identities given, simulated worlds of 120 s.
FastSLAM 1.0 and 2.0 are the papers' filters (`filter.rejuvenation.every_steps: 0`), "paths drawn by need" is
[the default](rejuvenation.md).

![Map error against the number of particles](images/particles.png)

{table}

Ten particles of FastSLAM 2.0 do as well as a hundred of 1.0 on Lost in the Woods and in the demo, and a
little worse on UTIAS and in the loop. With paths drawn by need ten do better than three hundred of either
without; one does nearly as well, because what then decides is the posterior over paths and no longer the
particles.
"""


def main() -> None:
    """Measures, then prints or writes."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--seeds-of-many", type=int, default=2)
    parser.add_argument("--particles", type=int, nargs="+", default=[1, 3, 10, 30, 100, 300])
    parser.add_argument("--workers", type=int)
    parser.add_argument(
        "--out", type=Path, help="folder of the documentation; without it the page is printed"
    )
    options = parser.parse_args()
    data = Path(os.environ.get("FASTSLAM_DATA", "../shared/data"))
    if not data.is_dir():
        parser.error(f"nothing to measure: {data} is no folder")
    panels = list(worlds(data))
    seeds = Seeds(options.seeds, options.seeds_of_many)
    table = measure(panels, options.particles, seeds, options.workers)
    page = markdown(table, panels, options.particles, seeds)
    if options.out is None:
        print(page)
        return
    write_atomically(options.out / "particles.md", page)
    draw(table, panels, options.particles).savefig(options.out / "images" / "particles.png")


if __name__ == "__main__":
    main()

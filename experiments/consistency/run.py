"""Measures whether reported uncertainties can be believed and writes them into `docs/consistency.md`.

    python experiments/consistency/run.py [--runs 50] [--particles 100] [--only WORLD]
        [--variant "NAME: key=value key=value"] [--out docs/consistency.md]

Every run of a world has its own landmarks, motion noise and sensor noise; run k of every variant sees the
same log. `--variant` adds one more line to every table and figure; it may be given several times. The tables
stand between two marks in the page, the figures in the folder of the same name beside it.
"""

from __future__ import annotations

import argparse
import json
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

from fastslam.config import merge, parse_assignments
from fastslam.evaluation import Consistency
from fastslam.monte_carlo import consistency_facts, monte_carlo, simulated_logs
from fastslam.plots import consistency_figure, house_style, render
from fastslam.resultfiles import to_json, write_atomically, write_measured

FIRST_SEED = 1

WORLDS: dict[str, tuple[str, str, dict[str, Any]]] = {
    "demo": ("demo", "two laps among 60 landmarks, 50 s", {}),
    "loop-120": ("loop", "one lap of 280 m among 200 landmarks, 120 s", {"max_duration_s": 120.0}),
    "loop": ("loop", "five such laps, 557 s", {}),
}
"""Name: preset, what it is, settings over the preset."""

PLAIN: dict[str, Any] = {"filter": {"rejuvenation": {"every_steps": 0}}}

VARIANTS: dict[str, dict[str, Any]] = {
    "1.0, plain": merge(PLAIN, {"algorithm": "fastslam1"}),
    "2.0, plain": PLAIN,
    "2.0, plain, exponent 0.5": merge(PLAIN, {"filter": {"likelihood_exponent": 0.5}}),
    "2.0, plain, exponent 0.2": merge(PLAIN, {"filter": {"likelihood_exponent": 0.2}}),
    "defaults": {},
    "defaults, identities unknown": {"association": {"mode": "unknown"}},
    "drawn every 20 steps": {"filter": {"rejuvenation": {"every_steps": 20}}},
    "EKF": {"algorithm": "ekf"},
}


def measure(world: str, variant: dict[str, Any], particles: int, runs: int) -> Consistency:
    """All runs of one variant in one world."""
    preset, _, settings = WORLDS[world]
    config = merge({"filter": {"particles": particles}}, variant)
    seeds = range(FIRST_SEED, FIRST_SEED + runs)
    return monte_carlo(simulated_logs(settings, preset=preset), config, seeds=seeds)


def tables(world: str, found: dict[str, Consistency], figure: str) -> str:
    """The section of one world as Markdown."""
    first = next(iter(found.values()))
    low, high = first.pose.bounds
    lines = [
        f"### `{world}`: {WORLDS[world][1]}",
        "",
        f"![NEES over the run and coverage]({figure})",
        "",
        "| filter | NEES of the pose, median of each quarter | mean over the run | position inside its "
        "50 / 90 / 95 / 99 % ellipse | landmarks: mean NEES | landmark inside its "
        "50 / 90 / 95 / 99 % ellipse |",
        "|---|---|---|---|---|---|",
        f"| *expected* | *2.4* | *3 ({low:.2f} to {high:.2f})* | *50 / 90 / 95 / 99 %* | *2* | "
        "*50 / 90 / 95 / 99 %* |",
    ]
    for name, consistency in found.items():
        quarters = " / ".join(_short(value) for value in consistency.pose_median_of_quarter)
        cells = [
            name,
            quarters,
            _short(consistency.pose.mean),
            _coverage(consistency.position.coverage.found),
        ]
        if consistency.landmarks is None:
            cells += ["", ""]
        else:
            cells += [_short(consistency.landmarks.mean), _coverage(consistency.landmarks.coverage.found)]
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


def _short(value: float) -> str:
    return f"{value:.1f}" if value < 100.0 else f"{value:,.0f}"


def _coverage(found: dict[str, float]) -> str:
    return " / ".join(f"{100.0 * value:.0f}" for value in found.values()) + " %"


def parse_variant(text: str) -> tuple[str, dict[str, Any]]:
    """`NAME: key=value key=value` as a name and its settings."""
    name, _, assignments = text.partition(":")
    return name.strip(), dict(parse_assignments(assignments.split()))


def main() -> None:
    """Runs everything on all cores, writes figures, and the tables into the page."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--runs", type=int, default=50)
    parser.add_argument("--particles", type=int, default=100)
    parser.add_argument("--workers", type=int)
    parser.add_argument("--only", choices=list(WORLDS))
    parser.add_argument("--variant", action="append", default=[], type=parse_variant)
    parser.add_argument("--out", type=Path, help="page with the two marks; without it the tables are printed")
    arguments = parser.parse_args()
    worlds = [arguments.only] if arguments.only else list(WORLDS)
    variants = VARIANTS | dict(arguments.variant)
    with ProcessPoolExecutor(arguments.workers) as pool:
        waiting = {
            (world, name): pool.submit(measure, world, settings, arguments.particles, arguments.runs)
            for world in worlds
            for name, settings in variants.items()
        }
        found = {world: {name: waiting[world, name].result() for name in variants} for world in worlds}
    figures = Path("consistency") if arguments.out is None else arguments.out.with_suffix("")
    sections = [
        f"Measured over {arguments.runs} runs (seeds {FIRST_SEED} to {FIRST_SEED + arguments.runs - 1}) with "
        f"{arguments.particles} particles."
    ]
    for world, of_world in found.items():
        with house_style():
            figure = consistency_figure(of_world, title=f"NEES in `{world}`")
        write_atomically(figures / f"{world}.png", render(figure, "png"))
        facts = {name: consistency_facts(consistency) for name, consistency in of_world.items()}
        write_atomically(figures / f"{world}.json", to_json(facts))
        sections.append(tables(world, of_world, f"{figures.name}/{world}.png"))
    text = "\n\n".join(sections)
    if arguments.out is None:
        print(text)
        return
    write_measured(arguments.out, text)
    print(json.dumps({world: str(figures / f"{world}.png") for world in worlds}, indent=2))


if __name__ == "__main__":
    main()

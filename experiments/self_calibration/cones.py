"""Counts the cones that runs find on tracks nobody tuned on, with nothing told of the noise.

    python experiments/self_calibration/cones.py [--laps 1] [--seeds 101 113]

Each seed draws another closed track of 90 cones in two colours, and odometry whose gains are off by up
to 4 %. Landmarks are counted with the settings as they are, and where noise was learned first (default).
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass, replace

import fastslam
import numpy as np
from fastslam.log import Floats, Log
from fastslam.runner import run

TICK_S = 0.02
"""Of the odometry; every second or third one has a scan."""
SETTINGS = {
    "motion": {"model": "velocity"},
    "sensor": {"model": "range_bearing", "max_range_m": 15.0, "field_of_view_rad": 1.9},
    "association": {"mode": "unknown", "classes": {"number": 2, "correct_probability": 0.95}},
}


@dataclass(frozen=True)
class Track:
    """The middle of a track (400, 2), its cones (90, 2), left ones first, and the gains of the odometry."""

    middle_m: Floats
    cones_m: Floats
    gains: Floats


def track(rng: np.random.Generator) -> Track:
    """A closed track of some 150 to 250 m, either way round."""
    at = np.linspace(0, 2 * np.pi, 400, endpoint=False)
    bends = [
        rng.uniform(-most, most) * np.sin(order * at + rng.uniform(0, 6)) for order, most in ((2, 5), (3, 3))
    ]
    radius = 22 + sum(bends)
    middle = np.column_stack([rng.uniform(1.1, 1.7) * radius * np.cos(at), radius * np.sin(at)])
    middle = middle[::-1] if rng.random() < 0.5 else middle
    ahead = np.roll(middle, -1, 0) - np.roll(middle, 1, 0)
    aside = np.column_stack([-ahead[:, 1], ahead[:, 0]]) / np.linalg.norm(ahead, axis=1)[:, None]
    cones = np.concatenate([(middle + side * 1.8 * aside)[::9] for side in (1, -1)])
    return Track(middle, cones, 1 + rng.uniform(-0.04, 0.04, 2))


def drive(world: Track, laps: int, rng: np.random.Generator) -> Log:
    """A log of so many laps and a tenth."""
    line = np.vstack([np.tile(world.middle_m, (laps, 1)), world.middle_m[:40]])
    way_m = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])
    heading = np.unwrap(np.arctan2(np.gradient(line[:, 1]), np.gradient(line[:, 0])))
    odometry, seen, at_m = [], [], 0.0
    for tick in range(1_000_000):
        if at_m >= way_m[-1] - 1:
            break
        speed, stamp_s = min(3 + TICK_S * tick, 9.0), TICK_S * tick
        x, y, turned, next_turned = (
            *(np.interp(at_m, way_m, column) for column in (*line.T, heading)),
            np.interp(at_m + speed * TICK_S, way_m, heading),
        )
        moved = np.array([speed, (next_turned - turned) / TICK_S]) * world.gains
        odometry.append((stamp_s, *(moved + rng.normal(0, (0.1, 0.03)))))
        if tick % 5 in (0, 2):
            seen += [(stamp_s, *row) for row in scan(world.cones_m, (x, y, turned), rng)]
        at_m += speed * TICK_S
    controls, sightings = np.array(odometry), np.array(seen)
    log = Log.from_arrays((controls[:, 0], controls[:, 1:]), tuple(sightings[:, :3].T), config=SETTINGS)
    classes = sightings[:, 3].astype(np.int64)
    return replace(log, sightings=replace(log.sightings, class_index=classes), class_names=("yellow", "blue"))


def scan(
    cones_m: Floats, pose: tuple[float, float, float], rng: np.random.Generator
) -> list[tuple[float, ...]]:
    """Range, bearing, class (1 left, 0 right, -1 not told) of cones in view, now and then of nothing."""
    apart = cones_m - pose[:2]
    ranges = np.hypot(*apart.T)
    bearings = (np.arctan2(apart[:, 1], apart[:, 0]) - pose[2] + np.pi) % (2 * np.pi) - np.pi
    view = (ranges < 14) & (np.abs(bearings) < 0.9) & (rng.random(len(cones_m)) < 0.85)
    rows = [
        (
            ranges[i] * (1 + rng.normal(0, 0.02)) + rng.normal(0, 0.03),
            bearings[i] + rng.normal(0, 0.01),
            float(i < len(cones_m) // 2) if rng.random() < 0.97 else -1.0,
        )
        for i in np.flatnonzero(view)
    ]
    return [*rows, (rng.uniform(2, 14), rng.uniform(-0.9, 0.9), 0.0)] if rng.random() < 0.05 else rows


def main() -> None:
    """Prints a line for each track."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--laps", type=int, default=1)
    parser.add_argument("--seeds", type=int, nargs=2, default=(101, 113), metavar=("FROM", "TO"))
    given = parser.parse_args()
    for seed in range(*given.seeds):
        rng = np.random.default_rng([seed, 77])
        world = track(rng)
        log = drive(world, given.laps, rng)
        plain, learned = run(log), fastslam.run(log)
        counts = [
            f"{len(result.map.landmarks.ids)} ({len(result.verdict)} doubts)" for result in (plain, learned)
        ]
        print(f"track {seed}: {len(world.cones_m)} cones, {counts[0]}, learned {counts[1]}", flush=True)


if __name__ == "__main__":
    main()

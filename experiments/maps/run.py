"""Measures maps that are merged: forest and Victoria Park cut in two, five robots of UTIAS, different places.

    python experiments/maps/run.py [--seeds 1] [--workers N] [--out docs/maps.md]

`FASTSLAM_DATA` names the folder of the data sets. With `--out` the table takes the place of the one that the
page has between its marks.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Iterator, Sequence
from concurrent.futures import Executor, ProcessPoolExecutor
from itertools import combinations
from pathlib import Path

import fastslam
import numpy as np
import yaml
from fastslam import Log, Map, RunResult
from fastslam.errors import DataError
from fastslam.evaluation.align import align_points_robustly, wrap_angle
from fastslam.localisation import between
from fastslam.maps import merge
from fastslam.overlays import Overlap, overlap
from fastslam.placement import apply
from fastslam.resultfiles import write_measured
from forest import Floats, reference_m, relative
from forest import load as load_forest
from scipy.spatial import cKDTree

DATA = Path(os.environ.get("FASTSLAM_DATA", "FASTSLAM_DATA"))
UNKNOWN = {"association": {"mode": "unknown"}}
SETS = (1, 2, 6)


def measure_forest(seed: int) -> list[float]:
    """Error of the relative pose (m, rad), of the map of one run (m), of the merged one (m)."""
    forest = load_forest(DATA / "oxford_forest_trees")
    count = len(forest.stamp_s)
    first, second, whole = (
        fastslam.run(forest.log(begin, end, seed=seed), {"seed": seed}).map
        for begin, end in ((0, count // 2), (count // 2, count), (0, count))
    )
    merged = merge([first, second])
    poses = forest.T_world_robot
    off = merged.parts[1].T_map_part - relative(poses[:1], poses[count // 2 : count // 2 + 1])[0]
    heading = abs(float(wrap_angle(off[2])))
    trees_m = reference_m(forest, count)
    truth = Map.at({f"L{row}": at for row, at in enumerate(trees_m)}, std_m=0.05, role="prior")
    return [float(np.hypot(*off[:2])), heading, map_error_m(truth, whole), map_error_m(truth, merged.map)]


def map_error_m(truth: Map, chart: Map) -> float:
    """RMS distance of a map's landmarks from those of the truth that they are, the map laid on the truth."""
    found = overlap(truth, chart)
    return float(np.sqrt(2.0)) * found.overlays[0].apart_m if found.overlays else float("nan")


def measure_park(seed: int) -> list[float]:
    """RMS distance from GPS of one run, and of two halves that were merged (m), inliers of both."""
    log = fastslam.load(DATA / "victoria_park")
    middle = 0.5 * float(log.controls.stamp_s[0] + log.controls.stamp_s[-1])
    ends = ((-np.inf, np.inf), (-np.inf, middle), (middle, np.inf))
    whole, first, second = (
        fastslam.run(between(log, *stretch), {**UNKNOWN, "seed": seed}) for stretch in ends
    )
    part = merge([first.map, second.map]).parts[1]
    stamps, poses = path(first)
    later, moved = path(second)
    joined = np.concatenate([poses, apply(part.T_map_part, moved)])
    return [gps_m(log, *path(whole)), gps_m(log, np.concatenate([stamps, later]), joined)]


def path(result: RunResult) -> tuple[Floats, Floats]:
    assert result.smoothed is not None
    return result.smoothed.stamp_s, result.smoothed.T_world_robot[:, :2]


def gps_m(log: Log, stamp_s: Floats, places_m: Floats) -> float:
    fixes = log.position_fixes
    assert fixes is not None
    at = np.column_stack([np.interp(fixes.stamp_s, stamp_s, column) for column in places_m.T])
    aligned = align_points_robustly(at, fixes.position_m)
    off = aligned.transform.apply_points(at) - fixes.position_m
    return float(np.sqrt(np.mean(np.sum(off[aligned.inliers] ** 2, axis=1))))


def measure_robots(number: int, seed: int) -> list[float]:
    """Landmarks of the merged map that are true, all it has, its error, the median of single maps (m)."""
    logs = [
        fastslam.load(DATA / f"utias_mrclam/MRCLAM_Dataset{number}", robot=robot) for robot in range(1, 6)
    ]
    places = logs[0].truth_landmarks
    assert places is not None
    truth = Map.at({f"L{row}": at for row, at in enumerate(places.position_m)}, std_m=0.03, role="prior")
    maps = [fastslam.run(log, {**UNKNOWN, "seed": seed}).map for log in logs]
    single = float(np.median([map_error_m(truth, chart) for chart in maps]))
    try:
        merged = merge(maps).map
    except DataError as error:
        print(f"UTIAS {number}, seed {seed}: {error}", file=sys.stderr)
        return [float("nan"), float("nan"), float("nan"), single]
    found = overlap(truth, merged)
    true = float(len(found.overlays[0].pairs)) if found.overlays else 0.0
    return [true, float(len(merged.role)), map_error_m(truth, merged), single]


def strangers() -> Iterator[tuple[Map, Map]]:
    """Maps of different places of one kind: stretches of two logs that are far apart, tracks, streets."""
    forest = load_forest(DATA / "oxford_forest_trees")
    walked = forest.T_world_robot[:, :2]
    frames = range(0, len(walked) - 50, 50)
    pieces = [(fastslam.run(forest.log(k, k + 50)).map, walked[k : k + 50]) for k in frames]
    yield from far_apart(pieces, 55.0)
    log = fastslam.load(DATA / "victoria_park")
    stamp_s, places_m = path(fastslam.run(log, UNKNOWN))
    stretches = [(begin, begin + 80.0) for begin in np.arange(0.0, 1540.0, 80.0)]
    driven = [places_m[(stamp_s >= begin) & (stamp_s < end)] for begin, end in stretches]
    maps = [fastslam.run(between(log, *stretch), UNKNOWN).map for stretch in stretches]
    yield from far_apart([*zip(maps, driven, strict=True)], 160.0)
    yield from combinations([track(file) for file in sorted((DATA / "fs_tracks").glob("FS*.yaml"))], 2)
    yield from combinations([street(file) for file in sorted((DATA / "pole_maps").glob("*.csv"))], 2)


def far_apart(pieces: Sequence[tuple[Map, Floats]], least_m: float) -> Iterator[tuple[Map, Map]]:
    """Pairs of maps whose paths came no nearer to each other than that; maps of less than ten are none."""
    for (ours, here), (theirs, there) in combinations(pieces, 2):
        enough = min(len(ours.role), len(theirs.role)) >= 10
        if enough and cKDTree(here).query(there)[0].min() > least_m:
            yield ours, theirs


def track(file: Path) -> Map:
    layout = yaml.safe_load(file.read_text())["track"]
    cones = [cone["position"][:2] for side in ("left", "right") for cone in layout[side]]
    return mapped(np.array(cones), file.stem)


def street(file: Path) -> Map:
    return mapped(np.loadtxt(file, delimiter=",", skiprows=1), file.stem)


def mapped(places_m: Floats, name: str) -> Map:
    """A layout as a robot would map it."""
    rng = np.random.default_rng(len(places_m))
    places_m = places_m + rng.normal(0.0, 0.1, places_m.shape)
    return Map.at({f"L{row}": at for row, at in enumerate(places_m)}, std_m=0.1, role="prior", name=name)


def status(pair: tuple[Map, Map]) -> tuple[str, str]:
    found: Overlap = overlap(*pair)
    return found.status, f"{pair[0].name}, {pair[1].name}"


def table(pool: Executor, seeds: range) -> str:
    forest = np.array([*pool.map(measure_forest, seeds)])
    park = np.array([*pool.map(measure_park, seeds)])
    robots = {number: np.array([*pool.map(measure_robots, [number] * len(seeds), seeds)]) for number in SETS}
    others = [*pool.map(status, strangers())]
    joined = [name for found, name in others if found == "found"]
    print(*(f"merged though different: {name}" for name in joined), sep="\n", file=sys.stderr)
    most_m = [1.05 * float(np.median(column)) for column in (forest[:, 2], park[:, 0])]
    lines = [
        f"| {len(seeds)} seed{'s' if len(seeds) > 1 else ''}, median (worst) | one run | merged | bar |",
        "|---|---|---|---|",
        f"| forest cut in two, relative pose | | {spread(forest[:, 0], 'm')} | 0.05 m |",
        f"| the same, heading | | {spread(forest[:, 1], 'rad', 4)} | |",
        f"| the same, map | {spread(forest[:, 2], 'm')} | {spread(forest[:, 3], 'm')} | {most_m[0]:.3f} m |",
        f"| Victoria Park cut in two, path to GPS | {spread(park[:, 0], 'm')} |"
        f" {spread(park[:, 1], 'm')} | {most_m[1]:.3f} m |",
    ]
    for number, rows in robots.items():
        done = np.isfinite(rows[:, 2])
        what = f"refused {np.count_nonzero(~done)} of {len(rows)}"
        if done.any():
            true, held = np.median(rows[done, 0]), np.median(rows[done, 1])
            what = f"{spread(rows[done, 2], 'm')}, {true:.0f} of 15, {held - true:.0f} more; {what}"
        lines.append(f"| UTIAS {number}, five robots, map | {spread(rows[:, 3], 'm')} | {what} | 0.050 m |")
    lines.append(f"| pairs of different places that were merged | | {len(joined)} of {len(others)} | 0 |")
    return "\n".join(lines) + "\n"


def spread(values: Floats, unit: str, digits: int = 3) -> str:
    known = values[np.isfinite(values)]
    if len(known) == 0:
        return "none"
    return f"{np.median(known):.{digits}f} ({known.max():.{digits}f}) {unit}"


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--workers", type=int, default=None)
    parser.add_argument("--out", type=Path, default=None, help="a page with the marks of the table")
    options = parser.parse_args(arguments)
    if not (DATA / "oxford_forest_trees").is_dir():
        print(f"{DATA / 'oxford_forest_trees'} is no folder: set FASTSLAM_DATA", file=sys.stderr)
        return 2
    with ProcessPoolExecutor(options.workers) as pool:
        text = table(pool, range(1, options.seeds + 1))
    print(text)
    if options.out is not None:
        write_measured(options.out, text)
    return 0


if __name__ == "__main__":
    sys.exit(main())

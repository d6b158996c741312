"""A walk through a real forest (`oxford_forest_trees`) as a log: trees by range and bearing, no identities.

The set has no odometry: it is made of the reference poses with noise. Trees of a frame are levelled by the
reference's roll and pitch; a frame holds what its makers had gathered around the robot, so that frames that
follow each other are not independent.
"""

from __future__ import annotations

import csv
import gzip
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from fastslam import Log
from fastslam.evaluation.align import wrap_angle
from fastslam.placement import apply
from scipy.spatial import cKDTree

Floats = np.ndarray
STEP_STD = (0.03, 0.03, 0.005)
"""Noise of the odometry that is made: metres, metres, radians per row."""
SENSOR = {"range_std_m": 0.07, "bearing_std_rad": 0.007, "max_range_m": 25.0}


@dataclass(frozen=True)
class Forest:
    """Poses (F, 3) at stamps (F,), and the trees of each frame in the levelled frame of the robot."""

    stamp_s: Floats
    T_world_robot: Floats
    trees_m: list[Floats]
    diameter_m: list[Floats]

    def log(self, begin: int, end: int, *, every: int = 2, seed: int = 1) -> Log:
        """Frames from `begin` up to `end` as a log that starts at its own origin."""
        rng = np.random.default_rng(seed)
        frames = np.arange(begin, end, every)
        poses = self.T_world_robot[frames]
        moved = relative(poses[:-1], poses[1:]) + rng.normal(0.0, STEP_STD, (len(frames) - 1, 3))
        stamps = self.stamp_s[frames]
        moved = np.concatenate([np.zeros((1, 3)), moved])
        seen = [near(self.trees_m[frame]) for frame in frames]
        measured = np.concatenate(seen)
        when = np.repeat(stamps, [len(trees) for trees in seen])
        config = {
            "motion": {
                "model": "increments",
                "x_std_m": STEP_STD[0],
                "y_std_m": STEP_STD[1],
                "heading_std_rad": STEP_STD[2],
            },
            "sensor": SENSOR,
            "association": {"mode": "unknown"},
        }
        bearing = np.arctan2(measured[:, 1], measured[:, 0])
        return Log.from_arrays(
            (stamps, moved),
            (when, np.hypot(*measured.T), bearing),
            config=config,
            name=f"forest, frames {begin} to {end}",
        )


def reference_m(forest: Forest, frames: int) -> Floats:
    """Trees (N, 2) where the reference poses of the first frames put them, seen five times within 15 m."""
    seen = np.concatenate([_placed(forest, frame) for frame in range(0, frames, 4)])
    left = np.ones(len(seen), dtype=bool)
    trees: list[Floats] = []
    for row, around in enumerate(cKDTree(seen).query_ball_point(seen, 0.4)):
        fresh = np.array(around)[left[around]]
        if left[row] and len(fresh) >= 5:
            trees.append(np.median(seen[fresh], axis=0))
            left[around] = False
    return np.array(trees)


def _placed(forest: Forest, frame: int) -> Floats:
    trees_m = forest.trees_m[frame]
    return apply(forest.T_world_robot[frame], trees_m[np.hypot(*trees_m.T) < 15.0])


def near(trees_m: Floats) -> Floats:
    return trees_m[np.hypot(*trees_m.T) < SENSOR["max_range_m"]]


def relative(before: Floats, after: Floats) -> Floats:
    """Poses (N, 3) in the frames of others."""
    cosine, sine = np.cos(before[:, 2]), np.sin(before[:, 2])
    x, y = (after - before)[:, :2].T
    turned = wrap_angle(after[:, 2] - before[:, 2])
    return np.column_stack([cosine * x + sine * y, -sine * x + cosine * y, turned])


def load(folder: Path) -> Forest:
    """The forest of a folder."""
    rows = np.loadtxt(folder / "trajectory.txt")
    rotation = rotations(rows[:, 4:])
    heading = np.arctan2(rotation[:, 1, 0], rotation[:, 0, 0])
    with gzip.open(folder / "trees.csv.gz", "rt") as lines:
        table = csv.reader(lines)
        next(table)
        values = np.array([[float(cell or "nan") for cell in row[:5]] for row in table])
    frame = values[:, 0].astype(int)
    world = np.einsum("nij,nj->ni", rotation[frame], values[:, 1:4])
    cosine, sine = np.cos(heading[frame]), np.sin(heading[frame])
    level = np.column_stack(
        [cosine * world[:, 0] + sine * world[:, 1], -sine * world[:, 0] + cosine * world[:, 1]]
    )
    cuts = np.searchsorted(frame, np.arange(1, len(rows)))
    poses = np.column_stack([rows[:, 1:3], heading])
    return Forest(rows[:, 0], poses, np.split(level, cuts), np.split(values[:, 4], cuts))


def rotations(quaternion: Floats) -> Floats:
    """Matrices (N, 3, 3) of quaternions x, y, z, w."""
    x, y, z, w = (quaternion / np.linalg.norm(quaternion, axis=1, keepdims=True)).T
    return np.moveaxis(
        np.array(
            [
                [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
                [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
                [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
            ]
        ),
        2,
        0,
    )

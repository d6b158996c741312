"""cityTrees10000: a simulated graph of 10000 poses and 100 trees, with the same graph free of noise as truth.

The stamp of a pose is its index, in seconds; a sighting has the stamp of its pose. Observations are
Cartesian in the robot frame and become range and bearing. The truth file prints few digits, but its turns
are whole quarter turns: restoring them makes the chained truth exact (trees agree to 1e-10 m instead of
0.015 m).
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import DataError
from ..log import Floats, Ints, Log, Sightings, TruthLandmarks, TruthTrajectory
from .clean import clean_controls, clean_sightings
from .options import LoadOptions
from .planar import chain_increments, to_world, wrap_to_pi
from .text import find_file, is_number, read_text

FILE = "cityTrees10000.txt"
QUARTER_TURN_TOLERANCE_RAD = 1e-4
FIELDS = {"EDGE2": 12, "LANDMARK": 8}


@dataclass(frozen=True)
class Graph:
    """Shapes: `increments` (N, 3), from pose i to i + 1; `pose`, `tree` (S,); `point_in_robot_m` (S, 2)."""

    increments: Floats
    pose: Ints
    tree: Ints
    point_in_robot_m: Floats


def matches(path: Path) -> bool:
    """The file `cityTrees10000.txt` or its folder; any other file of such rows is for `toro`."""
    if path.is_dir():
        return find_file(path, FILE) is not None
    return path.name in (FILE, f"{FILE}.gz") and path.is_file()


def load(path: Path, options: LoadOptions) -> Log:
    """Read the graph and, where `<name>_groundtruth.txt` lies beside it, the truth. Errors: DataError."""
    file = path if path.is_file() else find_file(path, FILE)
    if file is None:
        raise DataError(f"the file {FILE} is missing", path)
    graph = _read_graph(file)
    trees, identity = np.unique(graph.tree, return_inverse=True)
    stamps = np.arange(1, len(graph.increments) + 1, dtype=np.float64)
    controls, control_problems = clean_controls(stamps, graph.increments, path=file)
    sightings, sighting_problems = clean_sightings(_sightings(graph, identity.astype(np.int64)), path=file)
    truth_file = find_file(file.parent, file.name.split(".txt")[0] + "_groundtruth.txt")
    trajectory, landmarks = (None, None) if truth_file is None else _truth(_read_graph(truth_file))
    return Log(
        name="city_trees10000",
        source=str(path),
        format="city_trees10000",
        controls=controls,
        sightings=sightings,
        identity_names=tuple(str(tree) for tree in trees),
        truth_trajectory=trajectory,
        truth_landmarks=landmarks,
        config=_config(sightings.range_m),
        problems=control_problems + sighting_problems,
    )


def _read_graph(file: Path) -> Graph:
    edges: list[list[float]] = []
    landmarks: list[list[float]] = []
    for number, line in enumerate(read_text(file).splitlines(), start=1):
        fields = line.split()
        if not fields:
            continue
        kind, values = fields[0], fields[1:]
        if kind not in FIELDS:
            raise DataError(f"got row '{kind}', expected EDGE2 or LANDMARK", file, number)
        if len(fields) != FIELDS[kind]:
            raise DataError(f"{kind}: got {len(fields)} columns, expected {FIELDS[kind]}", file, number)
        try:
            numbers = [float(value) for value in values]
        except ValueError:
            wrong = next(value for value in values if not is_number(value))
            raise DataError(f"{kind}: got '{wrong}', expected a number", file, number) from None
        if not np.isfinite(numbers).all():
            raise DataError(f"{kind}: got NaN or infinity, expected finite numbers", file, number)
        if kind == "EDGE2" and (numbers[0], numbers[1]) != (len(edges), len(edges) + 1):
            raise DataError(f"EDGE2: got poses {values[0]} {values[1]}, expected consecutive", file, number)
        if kind == "LANDMARK" and not (0 <= numbers[0] <= len(edges) and numbers[0].is_integer()):
            raise DataError(f"LANDMARK: pose {values[0]} is not known yet", file, number)
        if kind == "LANDMARK" and not numbers[1].is_integer():
            raise DataError(f"LANDMARK: got landmark '{values[1]}', expected a whole number", file, number)
        (edges if kind == "EDGE2" else landmarks).append(numbers)
    if not edges or not landmarks:
        raise DataError(f"holds {len(edges)} EDGE2 and {len(landmarks)} LANDMARK rows, needs both", file)
    edge_rows, landmark_rows = np.array(edges), np.array(landmarks)
    pose, tree = landmark_rows[:, 0].astype(np.int64), landmark_rows[:, 1].astype(np.int64)
    return Graph(edge_rows[:, 2:5], pose, tree, landmark_rows[:, 2:4])


def _sightings(graph: Graph, identity: Ints) -> Sightings:
    x, y = graph.point_in_robot_m.T
    return Sightings(
        stamp_s=graph.pose.astype(np.float64),
        range_m=np.hypot(x, y),
        bearing_rad=np.arctan2(y, x),
        identity=identity,
        class_index=np.full(len(x), -1, dtype=np.int64),
        signature=np.full(len(x), np.nan),
    )


def _truth(graph: Graph) -> tuple[TruthTrajectory, TruthLandmarks]:
    increments = graph.increments.copy()
    turns = np.round(increments[:, 2] / (np.pi / 2)) * (np.pi / 2)
    whole = np.abs(turns - increments[:, 2]) < QUARTER_TURN_TOLERANCE_RAD
    increments[whole, 2] = turns[whole]
    poses = chain_increments(increments)
    points = to_world(poses[graph.pose], graph.point_in_robot_m)
    trees, identity = np.unique(graph.tree, return_inverse=True)
    count = np.bincount(identity)
    mean = np.column_stack([np.bincount(identity, weights=points[:, axis]) / count for axis in (0, 1)])
    poses[:, 2] = wrap_to_pi(poses[:, 2])
    trajectory = TruthTrajectory(np.arange(len(poses), dtype=np.float64), poses)
    return trajectory, TruthLandmarks(tuple(str(tree) for tree in trees), mean)


def _config(range_m: Floats) -> dict[str, Any]:
    """The file's own square-root information: 50, 50, 100 and 10, 10.

    The noise of an observation is round (0.1 m each way), so its bearing noise depends on the range; the
    root mean square over the sightings stands for it.
    """
    point_std_m = 0.1
    return {
        "motion": {"model": "increments", "x_std_m": 0.02, "y_std_m": 0.02, "heading_std_rad": 0.01},
        "sensor": {
            "model": "range_bearing",
            "range_std_m": point_std_m,
            "bearing_std_rad": round(point_std_m * float(np.sqrt(np.mean(range_m**-2))), 4),
        },
    }

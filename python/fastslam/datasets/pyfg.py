"""PyFG text: graphs of several robots with true poses, relative landmarks, and ranges between robots.

Names begin with the letter of a robot (A, B, ...) or L for a landmark; one robot makes a log. Noise is
covariance. Ranges to landmarks make a log of ranges alone where nothing else shows them; those between robots
are not used.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from ..log import Log, TruthLandmarks, TruthTrajectory
from .graph import GraphFile, log_of_graph
from .graph_noise import from_covariance
from .graph_rows import Kind, Row, Shape, read_rows, unusable
from .options import LoadOptions
from .text import first_words

NAME = "pyfg"
SHAPES = {
    "VERTEX_SE2": Shape(Kind.POSE, 1, 3),
    "VERTEX_XY": Shape(Kind.LANDMARK, 1, 2),
    "EDGE_SE2": Shape(Kind.MOTION, 2, 3, 6),
    "EDGE_SE2_XY": Shape(Kind.POINT, 2, 2, 3),
    "EDGE_RANGE": Shape(Kind.RANGE, 2, 1, 1),
}
SUFFIXES = (".pyfg", ".fg")
VERTEX_COLUMNS = 6
"""Of VERTEX_SE2, which has five in g2o."""


def matches(path: Path) -> bool:
    """A text file that begins with a row of a graph, and is called so or has the columns."""
    words = first_words(path) if path.is_file() else []
    if not words or not words[0].startswith(("VERTEX_", "EDGE_")):
        return False
    named = path.name.removesuffix(".gz").endswith(SUFFIXES)
    return named or (words[0] == "VERTEX_SE2" and len(words) == VERTEX_COLUMNS)


def load(path: Path, options: LoadOptions) -> Log:
    """Read one robot, the first by letter unless `options.robot` numbers one from 1. Errors: DataError."""
    rows = read_rows(path, SHAPES, format=NAME, stamped=True)
    robots = sorted({row.names[0][0] for row in rows if row.kind is Kind.POSE})
    number = 1 if options.robot is None else options.robot
    if not 1 <= number <= len(robots):
        there = ", ".join(f"{index} ({letter})" for index, letter in enumerate(robots, start=1))
        raise unusable(path, NAME, f"has no robot {number}; robots there: {there or 'none'}")
    robot = robots[number - 1]
    landmarks = [row for row in rows if row.kind is Kind.LANDMARK]
    own = [*landmarks, *(row for row in rows if any(name.startswith(robot) for name in row.names))]
    log = log_of_graph(GraphFile(path, NAME, own, from_covariance), name=f"{path.name.split('.')[0]}_{robot}")
    note = (f"robot {number} of {len(robots)}, {robot}",) if len(robots) > 1 else ()
    return replace(
        log,
        truth_trajectory=_trajectory([row for row in own if row.kind is Kind.POSE]),
        truth_landmarks=_landmarks(landmarks),
        notes=log.notes + note,
    )


def _trajectory(poses: list[Row]) -> TruthTrajectory | None:
    stamps = np.array([row.stamp_s for row in poses])
    if len(poses) == 0:
        return None
    if (np.diff(stamps) <= 0).any():
        # As the log has them then.
        stamps = np.arange(len(poses), dtype=np.float64)
    return TruthTrajectory(stamps, np.array([row.values for row in poses]))


def _landmarks(landmarks: list[Row]) -> TruthLandmarks | None:
    if not landmarks:
        return None
    return TruthLandmarks(
        tuple(row.names[0] for row in landmarks), np.array([row.values for row in landmarks])
    )

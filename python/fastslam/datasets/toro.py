"""TORO, iSAM and GTSAM text: VERTEX2, EDGE2 or ODOMETRY, and LANDMARK or BR (bearing and range).

Programs disagree about the noise of a row; `graph_noise.meaning_of_edge2` says how it is told. Poses and
landmarks may share their numbers.
"""

from __future__ import annotations

from pathlib import Path

from ..log import Log
from . import city_trees
from .graph import GraphFile, log_of_graph
from .graph_noise import meaning_of_edge2, triangles
from .graph_rows import Kind, Shape, read_rows
from .options import LoadOptions
from .text import first_words

NAME = "toro"
_POSE = Shape(Kind.POSE, 1, 3)
_MOTION = Shape(Kind.MOTION, 2, 3, 6)
SHAPES = {
    "VERTEX2": _POSE,
    "VERTEX": _POSE,
    "EDGE2": _MOTION,
    "EDGE": _MOTION,
    "ODOMETRY": _MOTION,
    "LANDMARK": Shape(Kind.POINT, 2, 2, 3),
    "BR": Shape(Kind.POLAR, 2, 2, 2),
    "EQUIV": Shape(Kind.IGNORED),
}
LEAST_COLUMNS = 6
"""Of a row of ODOMETRY: those of the Freiburg course have four."""


def matches(path: Path) -> bool:
    """A text file that begins with one of the rows, but cityTrees10000, which has settings of its own."""
    if not path.is_file() or city_trees.matches(path):
        return False
    words = first_words(path)
    return bool(words) and words[0] in SHAPES and not (words[0] == "ODOMETRY" and len(words) < LEAST_COLUMNS)


def load(path: Path, options: LoadOptions) -> Log:
    """Read the graph. Errors: DataError that names the line, the format and the page on converting."""
    rows = read_rows(path, SHAPES, format=NAME)
    noises = triangles([row.noise for row in rows if row.kind is Kind.MOTION], 3)
    with_vertices = any(row.kind is Kind.POSE for row in rows)
    covariances, meaning = meaning_of_edge2(noises, with_vertices=with_vertices)
    notes: tuple[str, ...] = (f"the noise of edges is taken as {meaning}",)
    if with_vertices:
        notes += ("vertices are an initial guess, not truth: only the first one is taken, as the start",)
    file = GraphFile(path, NAME, rows, covariances, notes)
    return log_of_graph(file, name=path.name.split(".")[0])

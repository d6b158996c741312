"""g2o text: a pose graph with landmarks in the plane.

Vertices hold an initial guess, not the truth: only that of the first pose is taken, as the start. Noise is
information, or missing in files of students. Edges between poses that close loops are not used.
"""

from __future__ import annotations

from pathlib import Path

from ..log import Log
from . import pyfg
from .graph import GraphFile, log_of_graph
from .graph_noise import from_information
from .graph_rows import IN_SPACE, Kind, Shape, read_rows
from .options import LoadOptions
from .text import first_words

NAME = "g2o"
_POINT = Shape(Kind.POINT, 2, 2, 3)
_BEARING = Shape(Kind.BEARING, 2, 1, 1)
_RANGE = Shape(Kind.RANGE, 2, 1, 1)
_IGNORED = Shape(Kind.IGNORED)
SHAPES = {
    "VERTEX_SE2": Shape(Kind.POSE, 1, 3),
    "VERTEX_XY": Shape(Kind.LANDMARK, 1, 2),
    "EDGE_SE2": Shape(Kind.MOTION, 2, 3, 6),
    "EDGE_SE2_XY": _POINT,
    "EDGE_SE2_POINT_XY": _POINT,
    "EDGE_SE2_POINTXY": _POINT,
    "EDGE_BEARING_SE2_XY": _BEARING,
    "EDGE_SE2_XY_BEARING": _BEARING,
    "EDGE_SE2_POINT_XY_BEARING": _BEARING,
    "EDGE_SE2_POINTXY_BEARING": _BEARING,
    "EDGE_RANGE_SE2_XY": _RANGE,
    "EDGE_SE2_XY_RANGE": _RANGE,
    "EDGE_SE2_POINT_XY_RANGE": _RANGE,
    "FIX": _IGNORED,
    "PARAMS_SE2OFFSET": _IGNORED,
    "EDGE_PRIOR_SE2": _IGNORED,
    "EDGE_SE2_PRIOR": _IGNORED,
    "EDGE_PRIOR_SE2_XY": _IGNORED,
}


def matches(path: Path) -> bool:
    """A text file that begins with a row of g2o, in the plane or in space, or is called so."""
    if not path.is_file() or pyfg.matches(path):
        return False
    tag = next(iter(first_words(path)), "")
    return tag in SHAPES or tag in IN_SPACE or path.name.removesuffix(".gz").endswith(".g2o")


def load(path: Path, options: LoadOptions) -> Log:
    """Read the graph. Errors: DataError that names the line, the format and the page on converting."""
    rows = read_rows(path, SHAPES, format=NAME)
    notes: tuple[str, ...] = ()
    if any(row.kind is Kind.POSE for row in rows):
        notes = ("vertices are an initial guess, not truth: only the first one is taken, as the start",)
    file = GraphFile(path, NAME, rows, from_information, notes)
    return log_of_graph(file, name=path.name.split(".")[0])

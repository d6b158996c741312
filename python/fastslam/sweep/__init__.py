"""Sweeps: a grid over configuration keys, seeds and logs, run on many processes, resumed where it stopped."""

from .cells import Cell, measure_cell
from .execute import Progress, sweep_cells
from .spec import SimulatedLog, StoredLog, SweepSpec, load_spec
from .store import ResultStore
from .table import Group, Row, group_rows, read_rows, summary_csv, tidy_csv

__all__ = [
    "Cell",
    "Group",
    "Progress",
    "ResultStore",
    "Row",
    "SimulatedLog",
    "StoredLog",
    "SweepSpec",
    "group_rows",
    "load_spec",
    "measure_cell",
    "read_rows",
    "summary_csv",
    "sweep_cells",
    "tidy_csv",
]

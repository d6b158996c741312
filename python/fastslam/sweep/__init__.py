"""Sweeps: a grid over configuration keys, seeds and logs, run on many processes, resumed where it stopped."""

from .cells import Cell, measure_cell
from .execute import Progress, sweep_cells
from .page import PAGE_FILE, best_of, interval_text, render_sweep, write_sweep_page
from .spec import SimulatedLog, StoredLog, SweepSpec, load_spec
from .store import ResultStore
from .table import Group, Row, group_rows, read_rows, summary_csv, tidy_csv

__all__ = [
    "PAGE_FILE",
    "Cell",
    "Group",
    "Progress",
    "ResultStore",
    "Row",
    "SimulatedLog",
    "StoredLog",
    "SweepSpec",
    "best_of",
    "group_rows",
    "interval_text",
    "load_spec",
    "measure_cell",
    "read_rows",
    "render_sweep",
    "summary_csv",
    "sweep_cells",
    "tidy_csv",
    "write_sweep_page",
]

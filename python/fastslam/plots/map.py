"""The map: landmarks with their uncertainty, the path, and the truth where it is known."""

from __future__ import annotations

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ..charts.figures import WIDE_IN
from ..charts.map import map_panel
from ..evaluation import Evaluation, evaluate_run
from ..log import Log
from ..result import RunResult
from .panel import draw_panel


def plot_map(axis: Axes, result: RunResult, log: Log, *, evaluation: Evaluation | None = None) -> Axes:
    """Draw landmarks with covariance ellipses, live and smoothed path, and truth, in the world of the run.

    The truth is brought into the run's world by the rigid alignment of the evaluation; fixes farther from
    the path than the inlier distance are left out. `evaluation` saves evaluating again.
    """
    found = evaluate_run(result, log) if evaluation is None else evaluation
    small = isinstance(axis.figure, Figure) and axis.figure.get_figwidth() <= WIDE_IN
    return draw_panel(axis, map_panel(result, log, found, small=small))

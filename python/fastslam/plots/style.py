"""The one look of all figures: colours that the colour-blind can tell apart, quiet axes."""

from __future__ import annotations

import io
from collections.abc import Sequence
from typing import Any

import matplotlib
from matplotlib.axes import Axes
from matplotlib.axis import XAxis, YAxis
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter
from matplotlib.transforms import ScaledTranslation

from ..charts.palette import (
    BAND,
    CLASSES,
    EVENT,
    GOOD,
    GRID,
    INK,
    LANDMARK,
    LIVE,
    MUTED,
    PAPER,
    SMOOTHED,
    TRUTH,
)

__all__ = [
    "BAND",
    "CLASSES",
    "EVENT",
    "GOOD",
    "GRID",
    "INK",
    "LANDMARK",
    "LIVE",
    "MAX_VECTOR_POINTS",
    "MUTED",
    "PAPER",
    "SMOOTHED",
    "TRUTH",
    "house_style",
    "is_heavy",
    "legend_below",
    "new_figure",
    "plain_log_ticks",
]

MAX_VECTOR_POINTS = 20_000
"""Marks with more points than this are drawn as an image inside vector figures, to keep those small."""

_SETTINGS: Any = {
    "axes.axisbelow": True,
    "axes.edgecolor": MUTED,
    "axes.facecolor": "none",
    "axes.grid": True,
    "axes.labelcolor": INK,
    "axes.labelsize": 10,
    "axes.linewidth": 0.8,
    "axes.spines.right": False,
    "axes.spines.top": False,
    "axes.titlecolor": INK,
    "axes.titlelocation": "left",
    "axes.titlepad": 10,
    "axes.titlesize": 11.5,
    "axes.titleweight": "bold",
    "figure.dpi": 150,
    "figure.facecolor": PAPER,
    "font.size": 9.5,
    "grid.color": GRID,
    "grid.linewidth": 0.6,
    "legend.fontsize": 8.5,
    "legend.frameon": False,
    "legend.labelcolor": INK,
    "lines.linewidth": 1.4,
    "lines.solid_capstyle": "round",
    "path.simplify": True,
    "savefig.dpi": 150,
    "svg.fonttype": "path",
    "svg.hashsalt": "fastslam",
    "text.color": INK,
    "xtick.color": MUTED,
    "xtick.labelcolor": INK,
    "ytick.color": MUTED,
    "ytick.labelcolor": INK,
}


def house_style() -> Any:
    """A context in which Matplotlib draws in this library's style; the user's settings come back after."""
    return matplotlib.rc_context(_SETTINGS)


class NotebookFigure(Figure):
    """A figure that a notebook shows when a cell ends with it, whether or not pyplot was loaded."""

    def _repr_png_(self) -> bytes:
        buffer = io.BytesIO()
        with house_style():
            self.savefig(buffer, format="png", dpi=100.0, metadata={"Software": None})
        return buffer.getvalue()


def new_figure(width_in: float, height_in: float) -> Figure:
    """A figure that belongs to no window system and no global list; draw and save it in `house_style`."""
    return NotebookFigure(figsize=(width_in, height_in), layout="constrained")


def legend_below(axis: Axes, *, columns: int = 4, handles: Sequence[Any] | None = None) -> None:
    """The legend under the axis and its label, where it hides no data; of these handles, or of all."""
    assert axis.figure is not None
    below = axis.transAxes + ScaledTranslation(0.0, -0.5, axis.figure.dpi_scale_trans)
    anchor: dict[str, Any] = {"bbox_to_anchor": (0.5, 0.0), "bbox_transform": below}
    if handles is not None:
        anchor["handles"] = handles
    axis.legend(loc="upper center", ncols=columns, borderaxespad=0.0, **anchor)


def plain_log_ticks(axis: XAxis | YAxis) -> None:
    """Ticks 1, 2, 5, 10, ... written as plain numbers on an axis that is already logarithmic."""
    low, high = sorted(axis.get_view_interval())
    few = high / max(low, 1e-300) > 100.0
    axis.set_major_locator(LogLocator(subs=(1.0,) if few else (1.0, 2.0, 5.0), numticks=12))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:,g}"))
    axis.set_minor_formatter(NullFormatter())


def is_heavy(points: int) -> bool:
    """Whether that many points are better drawn as an image."""
    return points > MAX_VECTOR_POINTS

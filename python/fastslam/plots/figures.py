"""The figures that every run gets, as objects, PNG files or SVG text."""

from __future__ import annotations

import io
from collections.abc import Mapping
from pathlib import Path
from typing import Literal

from matplotlib import rcParams
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure

from ..charts.figures import map_chart, run_charts
from ..evaluation import Evaluation, evaluate_run
from ..log import Log
from ..result import RunResult
from ..resultfiles import write_atomically
from . import style
from .panel import chart_figure


def map_figure(
    result: RunResult, log: Log, *, evaluation: Evaluation | None = None, width_in: float = 8.0
) -> Figure:
    """The map with path and truth as a figure; a notebook shows it when a cell ends with it.

    Letters are of one size: a figure of 4 inches can be read on a phone.
    """
    found = evaluate_run(result, log) if evaluation is None else evaluation
    return chart_figure(map_chart(result, log, found, width_in=width_in))


def make_figures(result: RunResult, log: Log, *, evaluation: Evaluation | None = None) -> dict[str, Figure]:
    """The figures `map`, `error`, `health`, `effective_sample_size` and `latency`, by name."""
    found = evaluate_run(result, log) if evaluation is None else evaluation
    return {name: chart_figure(chart) for name, chart in run_charts(result, log, found).items()}


def write_figures(
    result: RunResult, log: Log, folder: Path | str, *, evaluation: Evaluation | None = None
) -> dict[str, Path]:
    """Write the figures as `<name>.png`, each whole or not at all; returns file name to path.

    Errors: `DataError` where the folder cannot be written.
    """
    return save_figures(make_figures(result, log, evaluation=evaluation), folder)


def save_figures(figures: Mapping[str, Figure], folder: Path | str) -> dict[str, Path]:
    """Write figures that are made already as `<name>.png`; returns file name to path.

    Errors: `DataError` where the folder cannot be written.
    """
    names = {f"{name}.png": figure for name, figure in figures.items()}
    return {
        name: write_atomically(Path(folder) / name, render(figure, "png")) for name, figure in names.items()
    }


def render(figure: Figure, image_format: Literal["png", "svg"]) -> bytes:
    """A figure as bytes of a `png` or `svg` file; figures that are made alike give the same bytes.

    Where everything stands is settled by the first call. `Figure.savefig` would settle it
    each time, and draw twice.
    """
    buffer = io.BytesIO()
    with style.house_style():
        figure.set_dpi(float(rcParams["savefig.dpi"]))
        if image_format == "svg":
            FigureCanvasSVG(figure).print_svg(buffer, metadata={"Date": None})  # type: ignore[no-untyped-call]
        else:
            FigureCanvasAgg(figure).print_png(buffer, metadata={"Software": None})  # type: ignore[no-untyped-call]
    figure.set_layout_engine("none")
    return buffer.getvalue()

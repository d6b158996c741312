"""A map that is kept, as a picture."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from matplotlib.axes import Axes
from matplotlib.collections import EllipseCollection
from matplotlib.figure import Figure

from ..charts.map import ELLIPSE_SIGMAS, ellipse_axes
from ..charts.palette import LANDMARK, class_color
from ..errors import DataError
from ..maps import Map

MOST_NAMES = 60
"""More landmarks than this are drawn without their ids."""


def plot_chart(axis: Axes, chart: Map) -> Axes:
    """Landmarks with their ellipses in the map's frame, in the colours of their classes.

    Fixed ones are squares.
    """
    landmarks = chart.landmarks
    names = [landmarks.class_name(row) for row in range(len(landmarks.ids))]
    known = sorted({name for name in names if name})
    color_of = {"": LANDMARK} | {name: class_color(name, number) for number, name in enumerate(known)}
    for name, role in sorted(set(zip(names, chart.role, strict=True))):
        rows = [pair == (name, role) for pair in zip(names, chart.role, strict=True)]
        label = f"{role}, {name or 'class unknown'}" if known else role
        look: dict[str, Any] = {"marker": "s" if role == "fixed" else "o", "linestyle": "none"}
        axis.plot(*landmarks.mean_m[rows].T, color=color_of[name], markersize=4, label=label, **look)
    if names:
        major, minor, angle = ellipse_axes(landmarks.covariance_m2)
        look = {"facecolors": "none", "edgecolors": [color_of[name] for name in names]}
        axis.add_collection(
            EllipseCollection(
                *(major, minor, angle),
                units="xy",
                offsets=landmarks.mean_m,
                offset_transform=axis.transData,
                **look,
            )
        )
    if len(names) <= MOST_NAMES:
        for name, place in zip(landmarks.ids, landmarks.mean_m, strict=True):
            axis.annotate(name, place, xytext=(3, 3), textcoords="offset points", fontsize=7)
    axis.set_aspect("equal", adjustable="datalim")
    axis.set(
        xlabel="x (m)", ylabel="y (m)", title=f"{chart.name}: {len(names):,} landmarks, {ELLIPSE_SIGMAS:g}σ"
    )
    if len(names):
        axis.legend(loc="best")
    return axis


def write_chart(chart: Map, path: Path) -> Path:
    """Draws a map into a file. Errors: `DataError` where it cannot be written."""
    figure = Figure(figsize=(8.0, 6.0), layout="constrained")
    plot_chart(figure.add_subplot(), chart)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(path, dpi=150)
    except (OSError, ValueError) as error:
        raise DataError(f"cannot write: {error}", path) from None
    return path

"""A map that is kept, as a picture."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import EllipseCollection
from matplotlib.figure import Figure

from ..charts.map import ELLIPSE_SIGMAS
from ..errors import DataError
from ..maps import Map
from . import style

MOST_NAMES = 60
"""More landmarks than this are drawn without their ids."""


def plot_chart(axis: Axes, chart: Map) -> Axes:
    """Landmarks with their ellipses in the map's frame; fixed ones are squares."""
    landmarks = chart.landmarks
    fixed = np.array([role == "fixed" for role in chart.role], dtype=bool)
    for chosen, marker, label in ((~fixed, "o", "prior"), (fixed, "s", "fixed")):
        if chosen.any():
            places = landmarks.mean_m[chosen]
            axis.plot(*places.T, marker, color=style.LANDMARK, markersize=4, linestyle="none", label=label)
    values, vectors = np.linalg.eigh(landmarks.covariance_m2) if len(fixed) else (np.zeros((0, 2)), None)
    if vectors is not None:
        size_m = 2.0 * ELLIPSE_SIGMAS * np.sqrt(np.maximum(values, 0.0))
        angle = np.degrees(np.arctan2(vectors[:, 1, 1], vectors[:, 0, 1]))
        axis.add_collection(
            EllipseCollection(
                size_m[:, 1],
                size_m[:, 0],
                angle,
                units="xy",
                offsets=landmarks.mean_m,
                transOffset=axis.transData,
                facecolors="none",
                edgecolors=style.LANDMARK,
            )
        )
    if len(fixed) <= MOST_NAMES:
        for name, place in zip(landmarks.ids, landmarks.mean_m, strict=True):
            axis.annotate(name, place, xytext=(3, 3), textcoords="offset points", fontsize=7)
    axis.set_aspect("equal", adjustable="datalim")
    axis.set(
        xlabel="x (m)", ylabel="y (m)", title=f"{chart.name}: {len(fixed):,} landmarks, {ELLIPSE_SIGMAS:g}σ"
    )
    if len(fixed):
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

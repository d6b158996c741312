"""Where a small map of one's own lies in a large one: all places that are likely, with their odds.

A local map of a few landmarks is laid on a kept map wherever a pair of its landmarks has the distance of a
pair there. A place is judged by evidence: how much likelier the local landmarks lie as they do if the robot
is there than if they had nothing to do with the map. The integral over the pose is Laplace's.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from . import _core
from .evaluation.align import wrap_angle
from .log import Floats, Ints

_REFINED = 150
"""Places that look best at first, which are refined."""
_LEAST_VARIANCE_M2 = 1e-8
"""Of what is said to be known exactly."""


@dataclass(frozen=True)
class Constellation:
    """Landmarks with what says which they may be.

    Shapes: `mean_m` (N, 2), `variance_m2` (N,) the mean of the two of each, `label` (N,) -1 where nobody
    says. With `exact` labels are names, which never differ, else classes, which may be told wrong.
    """

    mean_m: Floats
    variance_m2: Floats
    label: Ints
    exact: bool = False


@dataclass(frozen=True)
class View:
    """From where a local map was seen: poses (T, 3) of the sensor in its frame, reach, half field of view."""

    T_local_sensor: Floats
    reach_m: float
    half_view_rad: float


@dataclass(frozen=True)
class Placement:
    """A place at which the local map may lie: `T_map_local` as x, y, heading with its covariance (3, 3).

    `log_odds` are those against a local map that has nothing to do with the map; `matched` is how many of its
    landmarks are explained.
    """

    T_map_local: Floats
    covariance: Floats
    log_odds: float
    matched: int


def common_variance_m2(sensor: Mapping[str, Any]) -> float:
    """A quarter of that of a sighting at five metres: what the errors of one's own map have in common."""
    return float(0.25 * (sensor["range_std_m"] ** 2 + (5.0 * sensor["bearing_std_rad"]) ** 2))


def charted(chart: Constellation) -> _core.Chart:
    """A map ready to be asked again and again."""
    return _core.Chart(_columns(chart), chart.exact)


def placements(
    local: Constellation,
    chart: Constellation | _core.Chart,
    view: View,
    *,
    most: int = 30,
    refined: int = _REFINED,
) -> list[Placement]:
    """The likeliest places, the best first; fewer than two landmarks in common place nothing.

    The `refined` that look best at first are refined, the `most` best of these returned. Places nearer to
    each other than half a metre and a tenth of a radian count once.
    """
    index = charted(chart) if isinstance(chart, Constellation) else chart
    sensors = np.ascontiguousarray(view.T_local_sensor, dtype=np.float64)
    seen = (sensors, view.reach_m, view.half_view_rad)
    found = index.placements(_columns(local), seen, (refined, most))
    return [
        Placement(pose, covariance, float(odds), int(count))
        for pose, covariance, odds, count in zip(*found, strict=True)
    ]


def _columns(landmarks: Constellation) -> _core._Marks:
    return (
        np.ascontiguousarray(landmarks.mean_m, dtype=np.float64),
        np.maximum(landmarks.variance_m2, _LEAST_VARIANCE_M2),
        np.ascontiguousarray(landmarks.label, dtype=np.int64),
    )


def composed(a: Floats, b: Floats) -> Floats:
    """The pose `b` (3,) as seen from where `a` is the origin's pose."""
    return np.array([*apply(a, b[None, :2])[0], wrap_angle(a[2] + b[2])])


def inverse(a: Floats) -> Floats:
    """The pose (3,) the other way round."""
    return np.array([*apply(np.array([0.0, 0.0, -a[2]]), -a[None, :2])[0], -a[2]])


def odds_of(found: Sequence[Placement]) -> Floats:
    """The probability of each place, and last that of none, which is as likely as all at the outset."""
    logs = np.array([*(placement.log_odds for placement in found), 0.0])
    weights = np.exp(logs - logs.max())
    return np.asarray(weights / weights.sum())


def apply(T: Floats, points_m: Floats) -> Floats:
    """Points moved by poses (..., 3): (..., N, 2)."""
    cosine, sine = np.cos(T[..., 2:3]), np.sin(T[..., 2:3])
    x = T[..., 0:1] + cosine * points_m[:, 0] - sine * points_m[:, 1]
    y = T[..., 1:2] + sine * points_m[:, 0] + cosine * points_m[:, 1]
    return np.stack([x, y], axis=-1)

"""Changes to a map by hand."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from .errors import ConfigError
from .maps import Map, Role


@dataclass(frozen=True)
class Edits:
    """What is to be changed, by ids."""

    remove: tuple[str, ...] = ()
    merge: tuple[tuple[str, str], ...] = ()
    move: tuple[tuple[str, float, float], ...] = ()
    name: tuple[tuple[str, str], ...] = ()
    role: tuple[tuple[str, Role], ...] = ()

    @classmethod
    def parse(
        cls,
        *,
        remove: Sequence[str] | None = None,
        merge: Sequence[str] | None = None,
        move: Sequence[str] | None = None,
        name: Sequence[str] | None = None,
        fix: Sequence[str] | None = None,
        free: Sequence[str] | None = None,
    ) -> Edits:
        """Of texts such as `L3,L9`, `L4=3.2,1.1`, `L7=gate`. Errors: `ConfigError` that names the option."""
        fixed: list[tuple[str, Role]] = [(one, "fixed") for one in _ids(fix)]
        return cls(
            remove=_ids(remove),
            merge=tuple(_pair("merge", text) for text in merge or ()),
            move=tuple(_place(text) for text in move or ()),
            name=tuple(_assignment("name", text) for text in name or ()),
            role=(*fixed, *((one, "prior") for one in _ids(free))),
        )


def edited(chart: Map, edits: Edits) -> Map:
    """The changed map. Errors: `ConfigError` for a landmark that is not there, or a name that is taken."""
    for one in edits.remove:
        row = _row(chart, "remove", one)
        chart = chart.rows([other for other in range(len(chart.role)) if other != row])
    for kept, other in edits.merge:
        chart = _merged(chart, _row(chart, "merge", kept), _row(chart, "merge", other))
    mean_m, ids, roles = chart.landmarks.mean_m.copy(), list(chart.landmarks.ids), list(chart.role)
    for one, x_m, y_m in edits.move:
        mean_m[_row(chart, "move", one)] = x_m, y_m
    for one, role in edits.role:
        row = _row(chart, "fix" if role == "fixed" else "free", one)
        if role == "prior" and not np.linalg.det(chart.landmarks.covariance_m2[row]) > 0.0:
            raise ConfigError(f"--free {one}: it has no covariance, which a prior landmark needs")
        roles[row] = role
    for one, new in edits.name:
        row = _row(chart, "name", one)
        if new in ids:
            raise ConfigError(f"--name {one}={new}: another landmark has this name")
        ids[row] = new
    landmarks = replace(chart.landmarks, ids=tuple(ids), mean_m=mean_m)
    return replace(chart, landmarks=landmarks, role=tuple(roles))


def _merged(chart: Map, kept: int, other: int) -> Map:
    """Two landmarks as one: the product of their Gaussians; a fixed one stays as it is."""
    landmarks = chart.landmarks
    if kept == other:
        raise ConfigError(f"--merge: {landmarks.ids[kept]} is one with itself already")
    mean_m, covariance_m2 = landmarks.mean_m.copy(), landmarks.covariance_m2.copy()
    sightings = landmarks.sightings.copy()
    fixed = [row for row in (kept, other) if chart.role[row] == "fixed"]
    if fixed:
        mean_m[kept], covariance_m2[kept] = mean_m[fixed[0]], covariance_m2[fixed[0]]
    else:
        first, second = (np.linalg.inv(covariance_m2[row]) for row in (kept, other))
        both = np.linalg.inv(first + second)
        mean_m[kept] = both @ (first @ mean_m[kept] + second @ mean_m[other])
        covariance_m2[kept] = 0.5 * (both + both.T)
    sightings[kept] += sightings[other]
    roles = list(chart.role)
    roles[kept] = "fixed" if fixed else roles[kept]
    joined = replace(landmarks, mean_m=mean_m, covariance_m2=covariance_m2, sightings=sightings)
    changed = replace(chart, landmarks=joined, role=tuple(roles))
    return changed.rows([row for row in range(len(roles)) if row != other])


def _row(chart: Map, option: str, one: str) -> int:
    try:
        return chart.landmarks.ids.index(one)
    except ValueError:
        raise ConfigError(f"--{option}: the map has no landmark {one}") from None


def _ids(texts: Sequence[str] | None) -> tuple[str, ...]:
    return tuple(one.strip() for text in texts or () for one in text.split(",") if one.strip())


def _pair(option: str, text: str) -> tuple[str, str]:
    ids = _ids([text])
    if len(ids) != 2:
        raise ConfigError(f"--{option} {text}: expected two ids with a comma between them")
    return ids[0], ids[1]


def _assignment(option: str, text: str) -> tuple[str, str]:
    one, sign, value = text.partition("=")
    if not (sign and one.strip() and value.strip()):
        raise ConfigError(f"--{option} {text}: expected ID=VALUE")
    return one.strip(), value.strip()


def _place(text: str) -> tuple[str, float, float]:
    one, value = _assignment("move", text)
    try:
        x_m, y_m = map(float, value.split(","))
    except ValueError:
        raise ConfigError(f"--move {text}: expected ID=X,Y in metres") from None
    if not (math.isfinite(x_m) and math.isfinite(y_m)):
        raise ConfigError(f"--move {text}: expected finite numbers")
    return one, x_m, y_m

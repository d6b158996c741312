"""Maps that are kept, and where a robot starts in them."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypeAlias, get_args

import numpy as np
from numpy.typing import ArrayLike

from ._given import numbers
from .covariances import pose_covariance
from .errors import ConfigError, DataError
from .identity import nobody_knows
from .log import Floats, Ints
from .result import Columns, LandmarkMap, Table

if TYPE_CHECKING:
    from . import _core
    from .mapmerge import Merged, Part
    from .result import RunResult

Role: TypeAlias = Literal["fixed", "prior"]
"""`fixed`: surveyed, no sighting changes it; `prior`: known as a Gaussian, which sightings improve."""
ROLES: tuple[Role, ...] = get_args(Role)

_RUNNING_NUMBER = re.compile(r"L(\d+)(#\d+)?")
"""What landmarks are called that nobody has named."""
_SUREST = 1e-9
"""An existence of 0 or 1 is taken as this far from it."""


@dataclass(frozen=True)
class Map(Table):
    """Landmarks that are kept: places with covariance, and what sightings may do to them.

    Shapes: `role` and `note` have an entry per landmark, `existence` (K,) is a probability, NaN where nobody
    says. Coordinates are in metres in `frame`, which a robot that starts in the map shares. `made_from` says
    where the map comes from, as keys and values.

    >>> import tempfile
    >>> chart = Map.at({"oak": (1.0, 2.0), "elm": (4.0, -1.0)}, std_m=0.05)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     Map.load(chart.save(folder + "/yard.map")).landmarks.ids
    ('oak', 'elm')
    """

    landmarks: LandmarkMap
    role: tuple[Role, ...]
    existence: Floats
    note: tuple[str, ...]
    name: str = "map"
    frame: str = "map"
    made_from: dict[str, Any] = field(default_factory=dict)

    @classmethod
    def at(
        cls,
        places: Mapping[str, Sequence[float] | Floats],
        *,
        std_m: float = 0.0,
        role: Role = "fixed",
        name: str = "map",
    ) -> Map:
        """A map of landmarks at places (x, y), each known to `std_m` in every direction."""
        position_m = numbers("places", [[x_m, y_m] for x_m, y_m in places.values()]).reshape(-1, 2)
        landmarks = LandmarkMap(
            ids=tuple(places),
            mean_m=position_m,
            covariance_m2=np.tile(std_m**2 * np.eye(2), (len(position_m), 1, 1)),
            sightings=np.zeros(len(position_m), dtype=np.int64),
        )
        return cls.of_landmarks(landmarks, role=role, name=name)

    @classmethod
    def of_landmarks(cls, landmarks: LandmarkMap, *, role: Role = "prior", name: str = "map") -> Map:
        """A map of landmarks that all have one role."""
        count = len(landmarks.ids)
        return cls(landmarks, (role,) * count, np.full(count, np.nan), ("",) * count, name)

    @classmethod
    def of_result(cls, result: RunResult) -> Map:
        """The map of a run: its confirmed landmarks; role, note and names of a map it began with stay."""
        made_from = {"log": result.log_name, "version": result.version, "seed": result.config.get("seed")}
        return cls.of_found(result.landmarks, result.chart, made_from)

    @classmethod
    def of_found(cls, landmarks: LandmarkMap, before: Map | None, made_from: dict[str, Any]) -> Map:
        """As `of_result`, of landmarks that were found, perhaps in an older map; named after `log`."""
        kept = landmarks if landmarks.confirmed is None else select(landmarks, landmarks.confirmed)
        chart = replace(cls.of_landmarks(kept, name=made_from["log"]), made_from=made_from)
        return chart if before is None else chart._after(before)

    def _after(self, before: Map) -> Map:
        """Takes over what an older map says of its landmarks beside their places."""
        row_of = {name: row for row, name in enumerate(before.landmarks.ids)}
        rows = [row_of.get(name) for name in self.landmarks.ids]
        return replace(
            self,
            role=tuple("prior" if row is None else before.role[row] for row in rows),
            existence=np.array(
                [np.nan if row is None else before.existence[row] for row in rows], dtype=float
            ),
            note=tuple("" if row is None else before.note[row] for row in rows),
            name=before.name,
            frame=before.frame,
            made_from={**before.made_from, "extended_with": self.made_from},
        )

    @classmethod
    def load(cls, path: Path | str) -> Map:
        """A map's folder, or a table of landmarks (`id`, `x_m`, `y_m` and what else it has).

        Errors: `DataError` with file and line.
        """
        from .mapfiles import read_map

        return read_map(Path(path))

    def save(self, folder: Path | str) -> Path:
        """Writes `map.yaml` and `landmarks.csv`. Errors: `DataError` where the folder cannot be written."""
        from .mapfiles import write_map

        return write_map(self, Path(folder))

    def rows(self, chosen: ArrayLike) -> Map:
        """Some of the landmarks: a mask or row numbers."""
        index = np.arange(len(self.landmarks.ids))[np.asarray(chosen)]
        return replace(
            self,
            landmarks=select(self.landmarks, index),
            role=tuple(self.role[row] for row in index),
            existence=self.existence[index],
            note=tuple(self.note[row] for row in index),
        )

    def to_columns(self) -> Columns:
        """The columns of the map's `landmarks.csv`: those of a run's, `existence`, `role` and `note`."""
        more = {"existence": self.existence, "role": list(self.role), "note": list(self.note)}
        return self.landmarks.to_columns() | more

    def with_role(self, role: Role) -> Map:
        """The same map with one role for all landmarks."""
        return replace(self, role=(role,) * len(self.role))

    def identities(self, names: Sequence[str]) -> tuple[Ints, tuple[str, ...]]:
        """The number of each landmark among the names of a log (-1: nobody knows), and those names with more.

        A name that the log does not have is one all the same, unless it is a running number such as `L7`.
        """
        index_of = {name: index for index, name in enumerate(names)}
        identity = np.full(len(self.landmarks.ids), -1, dtype=np.int64)
        for row, name in enumerate(self.landmarks.ids):
            if name in index_of or not (_RUNNING_NUMBER.fullmatch(name) or nobody_knows(name)):
                identity[row] = index_of.setdefault(name, len(index_of))
        return identity, tuple(index_of)

    def core_columns(self, identity: Ints, class_names: Sequence[str]) -> _core._MapColumns:
        """What the core takes; classes go by their names in the log."""
        landmarks = self.landmarks
        index_of = {name: index for index, name in enumerate(class_names)}
        classes = [index_of.get(landmarks.class_name(row), -1) for row in range(len(landmarks.ids))]
        probability = np.clip(self.existence, _SUREST, 1.0 - _SUREST)
        covariance = landmarks.covariance_m2.reshape(-1, 4)[:, [0, 1, 3]]
        unknown = np.full(len(landmarks.ids), np.nan)
        return (
            np.ascontiguousarray(landmarks.mean_m, dtype=np.float64),
            np.ascontiguousarray(covariance, dtype=np.float64),
            identity,
            np.array(classes, dtype=np.int64),
            unknown if landmarks.signature is None else landmarks.signature,
            np.log(probability) - np.log1p(-probability),
            np.asarray(landmarks.sightings, dtype=np.int64),
            np.array([role == "fixed" for role in self.role], dtype=np.bool_),
        )

    def __repr__(self) -> str:
        fixed = sum(role == "fixed" for role in self.role)
        count = len(self.role)
        return f"Map({self.name}: {count:,} landmarks in frame {self.frame}, {fixed:,} of them fixed)"


def select(landmarks: LandmarkMap, chosen: ArrayLike) -> LandmarkMap:
    """Some rows of a map: a mask or row numbers."""
    index = np.arange(len(landmarks.ids))[np.asarray(chosen)]

    def of(column: Any) -> Any:
        return None if column is None else column[index]

    return replace(
        landmarks,
        ids=tuple(landmarks.ids[row] for row in index),
        mean_m=landmarks.mean_m[index],
        covariance_m2=landmarks.covariance_m2[index],
        sightings=landmarks.sightings[index],
        confirmed=of(landmarks.confirmed),
        class_index=of(landmarks.class_index),
        signature=of(landmarks.signature),
        residuals=tuple(residuals[index] for residuals in landmarks.residuals),
    )


@dataclass(frozen=True)
class Start:
    """Where a robot starts: `T_world_robot`, known to these standard deviations (or to a covariance (3, 3)).

    >>> Start(3.0, 2.0, 0.5, std=(0.5, 0.5, 0.1)).core_start()[0].tolist()
    [[3.0, 2.0, 0.5]]
    """

    x_m: float = 0.0
    y_m: float = 0.0
    heading_rad: float = 0.0
    std: Sequence[float] = (0.0, 0.0, 0.0)
    covariance: ArrayLike | None = None

    def core_start(self) -> _core._Start:
        """What the core takes. Errors: `DataError`."""
        pose = numbers("start", [[self.x_m, self.y_m, self.heading_rad]])
        spread = numbers("start", self.std)
        if spread.shape != (3,) or not (np.isfinite(spread).all() and (spread >= 0.0).all()):
            raise DataError(f"start: got std {self.std}, expected three numbers from 0 (m, m, rad)")
        if self.covariance is None:
            return pose, np.diag(spread**2)
        return pose, pose_covariance("start.covariance", self.covariance)


@dataclass(frozen=True)
class Anywhere:
    """A start of which nothing is known but that it is in the map."""


StartLike: TypeAlias = Start | Anywhere | ArrayLike | None
"""A start, poses (N, 3) of which each is as likely, or None for the configured pose."""


def core_start(start: StartLike) -> _core._Start | None:
    """What the core takes of a start. Errors: `DataError`, `ConfigError`."""
    if start is None:
        return None
    if isinstance(start, Start):
        return start.core_start()
    if isinstance(start, Anywhere):
        raise ConfigError("start: a filter cannot start anywhere; fastslam.localize finds where it is")
    poses = numbers("start", start)
    if poses.ndim != 2 or poses.shape[1] != 3 or len(poses) == 0:
        raise DataError(f"start: got shape {poses.shape}, expected poses (n, 3) as x, y, heading")
    return poses, None


MISSED = 10
"""A landmark is gone that was in view in so many scans at least,"""
GONE_FRACTION = 0.05
"""and sighted in at most this fraction of them; in none where sightings name it."""
FAR_OFF_M = 1000.0
"""So far from all others hardly a landmark is meant to stand."""
SAME_PLACE_M = 0.05
"""Landmarks this close to each other stand at one place, however well they are known."""


@dataclass(frozen=True)
class Changes:
    """What a run found that the map does not say: ids."""

    new: tuple[str, ...]
    """Confirmed landmarks that the map lacks."""
    gone: tuple[str, ...]
    """Landmarks of the map that were in view again and again and hardly sighted, and never by their name."""
    sighted: int
    """Landmarks of the map that were sighted at least once."""
    renamed: tuple[tuple[str, str], ...] = ()
    """What would be new and gone, but stands at one place: the name it goes by now, and that of the map."""

    def lines(self) -> list[str]:
        """A sentence each for what is new, what is gone and what has another name."""
        found = [("new", self.new), ("gone", self.gone)]
        lines = [
            f"{len(names)} {what}: {', '.join(names[:20])}{' ...' if len(names) > 20 else ''}"
            for what, names in found
            if names
        ]
        return [*lines, *(f"{now} stands where {before} stands: renamed?" for now, before in self.renamed)]


def changes(
    landmarks: LandmarkMap, chart: Map, columns: dict[str, np.ndarray], config: Mapping[str, Any]
) -> Changes:
    """What the core's counts of sightings and of misses in view say of a map.

    With names that are trusted, what was sighted by its name is not gone, however seldom that was.
    """
    known = set(chart.landmarks.ids)
    confirmed = (
        np.ones(len(landmarks.ids), dtype=bool) if landmarks.confirmed is None else landmarks.confirmed
    )
    sighted, missed = columns["given_sighted"], columns["given_missed"]
    most = 0.0 if config["association"]["mode"] == "known" else GONE_FRACTION
    gone = (missed >= MISSED) & (sighted <= most * (sighted + missed))
    held = set(landmarks.ids)
    new = [name for name, sure in zip(landmarks.ids, confirmed, strict=True) if sure and name not in known]
    lacking = [
        *(name for name, off in zip(landmarks.ids, gone, strict=True) if off and name in known),
        *(name for name in chart.landmarks.ids if name not in held),
    ]
    renamed = _renamed(landmarks, new, chart.landmarks, lacking)
    now, before = {pair[0] for pair in renamed}, {pair[1] for pair in renamed}
    return Changes(
        new=tuple(name for name in new if name not in now),
        gone=tuple(name for name in lacking if name not in before),
        sighted=int(np.sum(sighted > 0)),
        renamed=renamed,
    )


def _renamed(
    ours: LandmarkMap, new: Sequence[str], theirs: LandmarkMap, gone: Sequence[str]
) -> tuple[tuple[str, str], ...]:
    """Which new names, running numbers aside, stand where names that are gone do, as closely as is known."""
    row_of = {name: row for row, name in enumerate(ours.ids)}
    left = np.flatnonzero(np.isin(theirs.ids, list(gone)))
    pairs: list[tuple[str, str]] = []
    for name in new:
        if _RUNNING_NUMBER.fullmatch(name) or len(left) == 0:
            continue
        apart = _closeness(ours, row_of[name], theirs, left)
        nearest = int(np.argmin(apart))
        if apart[nearest] <= 1.0:
            pairs.append((name, theirs.ids[left[nearest]]))
            left = np.delete(left, nearest)
    return tuple(pairs)


def _closeness(ours: LandmarkMap, row: int, theirs: LandmarkMap, others: Ints) -> Floats:
    """How far a landmark is from others (n,), each as a part of how far one may be from itself."""
    spread = ours.covariance_m2[row] + theirs.covariance_m2[others]
    limit_m = 3.0 * np.sqrt(0.5 * np.trace(spread, axis1=1, axis2=2)) + SAME_PLACE_M
    return np.asarray(np.linalg.norm(ours.mean_m[row] - theirs.mean_m[others], axis=1) / limit_m)


def merge(maps: Sequence[Map | Path | str]) -> Merged:
    """Maps of several robots or days as one, in the frame of the first; nobody says how they lie.

    Relative poses come from the landmarks alone, and so does which landmarks are one. Maps may overlap in
    part, and one may join two others. Landmarks keep the ids of the first map that has them. `existence`
    falls where a map that knows the place lacks a landmark.

    >>> places = [(0, 0), (5, 1), (2, 6), (9, 4), (4, 9), (8, 8), (12, 1)]
    >>> yard = Map.at({f"L{row}": place for row, place in enumerate(places)}, std_m=0.05)
    >>> turned = Map.at({f"L{row}": (-y, x) for row, (x, y) in enumerate(places)}, std_m=0.05)
    >>> merged = merge([yard, turned])
    >>> len(merged.map.role), round(float(merged.parts[1].T_map_part[2]), 3)
    (7, -1.571)

    Errors: `DataError` where no overlap is found for sure, or several that are as likely.
    """
    from .mapmerge import merge

    return merge([Map.load(one) if isinstance(one, Path | str) else one for one in maps])


def align(chart: Map, onto: Map) -> tuple[Map, Part]:
    """A map in the frame of another one, of a survey for one, and where it lies there; nobody says how.

    Errors: as `merge`.
    """
    from .mapmerge import align

    return align(chart, onto)


def first_free_number(ids: Sequence[str]) -> int:
    """The lowest number such that neither it nor a higher one names a landmark of these."""
    taken = [int(match[1]) for name in ids if (match := _RUNNING_NUMBER.fullmatch(name))]
    return max(taken, default=-1) + 1


def facts(chart: Map) -> dict[str, tuple[Any, str]]:
    """What is in a map: value and unit by name."""
    landmarks = chart.landmarks
    count = len(chart.role)
    std_m = np.sqrt(0.5 * np.trace(landmarks.covariance_m2, axis1=1, axis2=2))
    size_m = np.ptp(landmarks.mean_m, axis=0) if count else np.zeros(2)
    found: dict[str, tuple[Any, str]] = {
        "name": (chart.name, ""),
        "frame": (chart.frame, ""),
        "landmarks": (count, ""),
        "fixed": (chart.role.count("fixed"), ""),
        "prior": (chart.role.count("prior"), ""),
        "width": (round(float(size_m[0]), 3), "m"),
        "height": (round(float(size_m[1]), 3), "m"),
        "standard deviation, median": (round(float(np.median(std_m)), 4) if count else None, "m"),
        "standard deviation, largest": (round(float(std_m.max()), 4) if count else None, "m"),
    }
    for name in landmarks.class_names:
        of_class = sum(landmarks.class_name(row) == name for row in range(count))
        found[f"class {name}"] = (of_class, "")
    return found | {f"made from: {key}": (str(value), "") for key, value in chart.made_from.items()}


def oddities(chart: Map) -> list[str]:
    """What is allowed and yet hardly meant, a sentence each."""
    from scipy.spatial import cKDTree

    landmarks = chart.landmarks
    lines = []
    if len(chart.role) >= 2:
        variance = 0.5 * np.trace(landmarks.covariance_m2, axis1=1, axis2=2)
        pairs = cKDTree(landmarks.mean_m).query_pairs(
            float(2.0 * np.sqrt(2.0 * variance.max()) + SAME_PLACE_M)
        )
        for a, b in sorted(pairs):
            apart_m = float(np.linalg.norm(landmarks.mean_m[a] - landmarks.mean_m[b]))
            if apart_m <= 2.0 * math.sqrt(float(variance[a] + variance[b])) + SAME_PLACE_M:
                lines.append(f"{landmarks.ids[a]} and {landmarks.ids[b]} may be one: {apart_m:.2f} m apart")
    lines += [*_far_off(landmarks), *_alike(landmarks.ids)]
    unlikely = [name for name, odds in zip(landmarks.ids, chart.existence, strict=True) if odds < 0.5]
    return [*lines, *(f"{name} exists with less than even odds" for name in unlikely)]


def _far_off(landmarks: LandmarkMap) -> list[str]:
    """Landmarks that are far from all others: a digit too many, or another frame."""
    from scipy.spatial import cKDTree

    if len(landmarks.ids) < 3:
        return []
    nearest_m = cKDTree(landmarks.mean_m).query(landmarks.mean_m, k=2)[0][:, 1]
    return [
        f"{name} stands {apart_m:,.0f} m from the nearest other landmark"
        for name, apart_m in zip(landmarks.ids, nearest_m.tolist(), strict=True)
        if apart_m >= FAR_OFF_M
    ]


def _alike(ids: Sequence[str]) -> list[str]:
    """Names that differ in capital letters alone."""
    of_word: dict[str, list[str]] = {}
    for name in ids:
        of_word.setdefault(name.casefold(), []).append(name)
    return [f"{' and '.join(names)} differ only in case" for names in of_word.values() if len(names) > 1]


def difference(before: Map, after: Map, *, gate_m: float = 1.0) -> dict[str, Any]:
    """Which landmarks of one map are those of another in the same frame, the nearest within a distance.

    `common` pairs, their RMS distance `rms_m`, `moved` (id, id, metres) by more than three standard
    deviations, `gone` and `new` ids, `changed` (id, id, `name`, `role` or `note`, before, after).
    """
    from .evaluation.assignment import assign_points

    ours, theirs = before.landmarks, after.landmarks
    first, second = assign_points(ours.mean_m, theirs.mean_m, gate_m=gate_m)
    apart_m = np.linalg.norm(ours.mean_m[first] - theirs.mean_m[second], axis=1)
    spread = ours.covariance_m2[first] + theirs.covariance_m2[second]
    limit_m = 3.0 * np.sqrt(0.5 * np.trace(spread, axis1=1, axis2=2)) + 1e-9
    moved = np.flatnonzero(apart_m > limit_m)
    pairs = list(zip(first.tolist(), second.tolist(), strict=True))
    return {
        "common": len(first),
        "rms_m": float(np.sqrt(np.mean(apart_m**2))) if len(first) else 0.0,
        "moved": [(ours.ids[first[k]], theirs.ids[second[k]], float(apart_m[k])) for k in moved],
        "changed": [change for pair in pairs for change in _edits(before, after, *pair)],
        "gone": [name for row, name in enumerate(ours.ids) if row not in set(first.tolist())],
        "new": [name for row, name in enumerate(theirs.ids) if row not in set(second.tolist())],
    }


def _edits(before: Map, after: Map, ours: int, theirs: int) -> Iterator[tuple[str, str, str, str, str]]:
    """What one landmark of two maps is called, may do or has as note that differs."""
    one, other = before.landmarks.ids[ours], after.landmarks.ids[theirs]
    sides = (
        ("name", one, other),
        ("role", before.role[ours], after.role[theirs]),
        ("note", before.note[ours], after.note[theirs]),
    )
    for what, was, now in sides:
        if was != now:
            yield one, other, what, was, now

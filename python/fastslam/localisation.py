"""Where a robot is in a map that was kept: from a known start, or from anywhere in it."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from .config import Config, merge, without_detector
from .datasets.registry import load
from .detection import with_sightings
from .joined import joined, searched
from .log import Floats, Log
from .lost import lost_since_s
from .maps import Anywhere, Map, Start, StartLike
from .result import LandmarkMap, RunResult
from .runner import Progress, configure, run
from .settings import Layer
from .several import refuse_several
from .trust import WAS_LOST

if TYPE_CHECKING:
    from .placement import Constellation, Placement, View

SURE = 0.999
"""A place is taken that is a thousand times likelier than all others together, twice in a row."""
FIRST_WINDOW_S = 5.0
WINDOW_GROWTH = 1.4
LONGEST_WINDOW_S = 300.0
"""How long the robot's own map grows before the search gives up."""
FEWEST_SIGHTINGS = 3
"""Landmarks that were seen less often place nothing."""
MOST_SEARCHES = 10
"""A robot that is lost more often than this in one log is not searched for any more."""
MOST_LANDMARKS = 25
FEWEST_MATCHED = 4
"""Fewer common landmarks place nothing for sure."""
_SAME_M, _SAME_RAD = 1.0, 0.2
_LISTED = 1e-3
"""Places less likely than this are not shown."""


@dataclass(frozen=True)
class Mode:
    """A place where the robot may have started: `T_map_robot` (3,) with its covariance and probability."""

    T_map_robot: Floats
    covariance: Floats
    probability: float
    matched: int
    """Landmarks of the robot's own map that the map explains there."""


@dataclass(frozen=True)
class Again:
    """A search for a robot that was lost on the way; other fields as in `Localisation`."""

    lost_s: float
    """Stamp from which on it was lost, and looked for."""
    status: Literal["found", "searching"]
    modes: tuple[Mode, ...]
    searched_s: float


@dataclass(frozen=True)
class Localisation:
    """Where a robot is in a map.

    `status` is `found`, or `searching` where no place is a thousand times likelier than all others: then
    `modes` are the places that remain, perhaps none. `searched_s` is how long the robot drove until its place
    was sure. `start` is where the run began: `given` by the caller, `stated` by the settings or the log, or
    `anywhere`, after a search. `again` are the searches for a robot that was lost on the way. There is no
    `result` where not even its start was found; where it was lost on the way and not found again, status and
    `modes` are those of the last search, and what the result says from there on is not to be used.
    """

    status: Literal["found", "searching"]
    modes: tuple[Mode, ...]
    searched_s: float
    result: RunResult | None
    start: Literal["given", "stated", "anywhere"] = "anywhere"
    again: tuple[Again, ...] = ()

    @property
    def sentence(self) -> str:
        """Where the run began, or what the search for its start comes to."""
        if self.start == "given":
            return "starts as given"
        if self.start == "stated":
            return "starts at the initial_pose of the settings"
        if self.status == "found" or self.result is not None:
            return f"found after {self.searched_s:.1f} s"
        return f"searching: after {self.searched_s:.1f} s {_places(self.modes)}"


def localize(
    source: Log | Path | str,
    map: Map | Path | str,
    *,
    start: StartLike = None,
    config: Layer | None = None,
    keep: bool = True,
    progress: Progress | None = None,
) -> Localisation:
    """Follows a robot through a map, from a start or, with `Anywhere()`, after finding it there.

    Without `start` it begins at the `initial_pose` that `config` or the log states; where neither does,
    anywhere.
    With `keep` the map is not changed: what does not fit is in `result.changes`. Otherwise prior landmarks
    improve and new ones are added; `result.map` is the map then. A robot that is lost for longer than
    `lost.LOST_S` is searched for from where that began, as a `Robot` is, and followed from where it is
    found: `again` and the verdict say when, and the health of the steps until then is `searching`.

    >>> from fastslam import Anywhere, run
    >>> from fastslam.simulation import simulate
    >>> log = simulate({"seed": 1, "world": {"count": 20}})
    >>> unknown = {"association": {"mode": "unknown"}, "filter": {"particles": 30}}
    >>> localize(log, run(log, unknown).map, start=Anywhere(), config=unknown).status
    'found'

    Errors: as `run`.
    """
    log = with_sightings(source if isinstance(source, Log) else load(source), config)
    chart = Map.load(map) if isinstance(map, Path | str) else map
    used = chart.with_role("fixed") if keep else chart
    complete = configure(log, config or {})
    configuration = without_detector(complete)
    if start is None and not _states_a_start(log, config):
        start = Anywhere()
    if isinstance(start, Anywhere):
        found = find(log, chart, config=configuration)
        if found.status == "searching":
            return found
        start = start_of(found.modes[0])
    else:
        found = Localisation("found", (), 0.0, None, "stated" if start is None else "given")

    def follow(part: Log, start: StartLike) -> RunResult:
        result = run(part, configuration, map=used, start=start, progress=progress)
        return replace(result, config=dict(complete))

    def search(part: Log) -> Localisation:
        return find(part, chart, config=configuration)

    return _followed(log, replace(found, result=follow(log, start)), start, follow=follow, search=search)


def _followed(
    log: Log,
    found: Localisation,
    start: StartLike,
    *,
    follow: Callable[[Log, StartLike], RunResult],
    search: Callable[[Log], Localisation],
) -> Localisation:
    """What became of a robot that was followed through the whole log: where it was lost it is searched for.

    What it learnt before is given up, since a robot that was lost spoils it, but for its path.
    """
    assert found.result is not None
    begin_s, rest, result = _begin_s(log), log, found.result
    parts: list[RunResult] = []
    again: list[Again] = []
    while not result.interrupted and len(again) < MOST_SEARCHES:
        lost_s = lost_since_s(result.steps)
        if lost_s is None:
            break
        after = between(rest, lost_s, math.inf)
        looked = search(after)
        again.append(Again(lost_s, looked.status, looked.modes, looked.searched_s))
        if looked.status == "searching":
            break
        before = between(rest, -math.inf, math.nextafter(lost_s, -math.inf))
        if len(before.sightings.stamp_s):
            parts.append(follow(before, start))
        rest, start = after, start_of(looked.modes[0])
        result = follow(rest, start)
    whole = joined([*parts, result]) if parts else result
    if found.start == "anywhere":
        whole = searched(whole, begin_s, begin_s + found.searched_s)
    for one in again:
        whole = searched(
            whole, one.lost_s, one.lost_s + one.searched_s if one.status == "found" else math.inf
        )
    if not again:
        return replace(found, result=whole)
    told = [_told(one, begin_s) for one in again]
    # How often it was lost says less than when.
    others = [sentence for sentence in whole.verdict if not sentence.startswith(WAS_LOST)]
    whole, last = replace(whole, verdict=(*told, *others)), again[-1]
    modes = last.modes if last.status == "searching" else found.modes
    return replace(found, status=last.status, modes=modes, result=whole, again=tuple(again))


def _told(one: Again, begin_s: float) -> str:
    lost = f"{WAS_LOST} after {one.lost_s - begin_s:.1f} s; searching the map from there on"
    if one.status == "found":
        return f"{lost} found the robot {one.searched_s:.1f} s later"
    return f"{lost} is not over: after {one.searched_s:.1f} s {_places(one.modes)}"


def _places(modes: tuple[Mode, ...]) -> str:
    return f"{len(modes)} places are likely" if modes else "no place of the map fits"


def _states_a_start(log: Log, config: Layer | None) -> bool:
    """Whether the settings, or the log's own, say where the robot starts."""
    return "initial_pose" in merge(log.config, config or {})


def start_of(mode: Mode) -> Start:
    """A start at a place that was found."""
    # The pose is as sure as independent errors make it; those of a map are not independent.
    spread = 4.0 * mode.covariance + np.diag([0.05, 0.05, 0.01]) ** 2
    x_m, y_m, heading_rad = mode.T_map_robot.tolist()
    return Start(x_m, y_m, heading_rad, covariance=0.5 * (spread + spread.T))


def find(log: Log, chart: Map, *, config: Layer | None = None) -> Localisation:
    """Where the log starts in a map, from constellations of what is seen on the way; there is no `result`.

    The robot makes a map of its own, which grows until it fits into the map at one place alone.
    """
    configuration = without_detector(configure(log, config or {}))
    refuse_several(configuration, "localize")
    search = Search(chart, configuration)
    window_s = 0.0
    for window_s in _windows(log):
        local = run(_until(log, window_s), configuration)
        if search.look(local.landmarks, local.path.T_world_robot, log.sightings.range_m):
            return Localisation("found", search.modes[:1], window_s, None)
    likely = tuple(mode for mode in search.modes if mode.probability >= _LISTED)
    return Localisation("searching", likely, window_s, None)


class Search:
    """Where a robot with a map of its own is in one that was kept, asked again as its own map grows."""

    def __init__(self, chart: Map, config: Config) -> None:
        self._chart, self._config = chart, config
        self._before: Mode | None = None
        self.modes: tuple[Mode, ...] = ()
        """Where it may have started, the likeliest first."""

    def look(self, landmarks: LandmarkMap, T_world_robot: Floats, range_m: Floats) -> bool:
        """Whether the first mode is sure now: it was so the last time too, at the same place.

        Shapes: `T_world_robot` (T, 3) is the path so far in the robot's own map, `range_m` what was measured.
        """
        from .placement import odds_of, placements

        ours, theirs = _constellations(landmarks, self._chart, self._config)
        found = placements(ours, theirs, _view(T_world_robot, range_m, self._config))
        odds = odds_of(found)
        self.modes = tuple(
            _mode(placed, float(p), self._config) for placed, p in zip(found, odds, strict=False)
        )
        best = self.modes[0] if self.modes else None
        sure = best is not None and best.probability >= SURE and best.matched >= FEWEST_MATCHED
        before, self._before = self._before, best if sure else None
        return sure and before is not None and best is not None and _are_same(best, before)


def _windows(log: Log) -> Iterator[float]:
    """Lengths of what is looked at, from the log's beginning, seconds."""
    stamps = log.sightings.stamp_s
    if len(stamps) == 0:
        return
    begin, end = _begin_s(log), float(stamps.max())
    longest = min(LONGEST_WINDOW_S, end - begin)
    window = FIRST_WINDOW_S
    while window < longest:
        yield window
        window *= WINDOW_GROWTH
    yield longest


def _begin_s(log: Log) -> float:
    firsts = [float(stamps[0]) for stamps in (log.controls.stamp_s, log.sightings.stamp_s) if len(stamps)]
    return min(firsts)


def _until(log: Log, window_s: float) -> Log:
    """The beginning of a log, without truth."""
    return between(log, -math.inf, _begin_s(log) + window_s)


def between(log: Log, begin_s: float, end_s: float) -> Log:
    """The controls and sightings of a stretch of a log, without scans and truth."""

    def rows(columns: Any) -> Any:
        kept = (columns.stamp_s >= begin_s) & (columns.stamp_s <= end_s)
        picked = {name: None if value is None else value[kept] for name, value in vars(columns).items()}
        return replace(columns, **picked)

    return replace(
        log,
        controls=rows(log.controls),
        sightings=rows(log.sightings),
        scans=None,
        truth_trajectory=None,
        position_fixes=None,
        edited_fixes=None,
    )


def _mode(placed: Placement, probability: float, config: Config) -> Mode:
    """Where the robot started if its own map lies there."""
    initial = config["initial_pose"]
    x, y, heading = placed.T_map_local
    dx, dy = initial["x_m"], initial["y_m"]
    cosine, sine = math.cos(heading), math.sin(heading)
    pose = np.array(
        [
            x + cosine * dx - sine * dy,
            y + sine * dx + cosine * dy,
            math.remainder(heading + initial["heading_rad"], 2.0 * math.pi),
        ]
    )
    moved = np.eye(3)
    moved[0, 2], moved[1, 2] = y - pose[1], pose[0] - x
    return Mode(pose, moved @ placed.covariance @ moved.T, probability, placed.matched)


def _are_same(a: Mode, b: Mode) -> bool:
    turned = abs(math.remainder(float(a.T_map_robot[2] - b.T_map_robot[2]), 2.0 * math.pi))
    apart_m = float(np.linalg.norm(a.T_map_robot[:2] - b.T_map_robot[:2]))
    return apart_m <= _SAME_M and turned <= _SAME_RAD


def _constellations(local: LandmarkMap, chart: Map, config: Config) -> tuple[Constellation, Constellation]:
    """The robot's own landmarks that are known best, and those of the map, with labels that both have."""
    from .placement import Constellation, common_variance_m2

    def variances(landmarks: LandmarkMap) -> Floats:
        return np.asarray(0.5 * np.trace(landmarks.covariance_m2, axis1=1, axis2=2))

    seen = np.flatnonzero(local.sightings >= FEWEST_SIGHTINGS)
    rows = seen[np.argsort(variances(local)[seen], kind="stable")[:MOST_LANDMARKS]]
    known = config["association"]["mode"] == "known" and bool(set(local.ids) & set(chart.landmarks.ids))

    def labels(landmarks: LandmarkMap) -> list[str]:
        if known:
            return list(landmarks.ids)
        return [landmarks.class_name(row) for row in range(len(landmarks.ids))]

    theirs = labels(chart.landmarks)
    number = {name: index for index, name in enumerate(dict.fromkeys(filter(None, theirs)))}
    ours = [labels(local)[row] for row in rows]
    least_m2 = common_variance_m2(config["sensor"])

    def constellation(mean_m: Floats, variance_m2: Floats, names: list[str]) -> Constellation:
        label = np.array([number.get(name, -1) for name in names], dtype=np.int64)
        return Constellation(mean_m, variance_m2, label, exact=known)

    return (
        constellation(local.mean_m[rows], variances(local)[rows] + least_m2, ours),
        constellation(chart.landmarks.mean_m, variances(chart.landmarks), theirs),
    )


def _view(T_world_robot: Floats, range_m: Floats, config: Config) -> View:
    from .placement import View

    mounting = config["sensor"]["mounting"]
    poses = T_world_robot[np.linspace(0, len(T_world_robot) - 1, min(len(T_world_robot), 40)).astype(int)]
    cosine, sine = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    sensors = np.column_stack(
        [
            poses[:, 0] + cosine * mounting["x_m"] - sine * mounting["y_m"],
            poses[:, 1] + sine * mounting["x_m"] + cosine * mounting["y_m"],
            poses[:, 2] + mounting["yaw_rad"],
        ]
    )
    ranges = range_m[np.isfinite(range_m)]
    reach_m = 0.7 * float(np.percentile(ranges, 90)) if len(ranges) else 0.0
    return View(sensors, reach_m, 0.45 * config["sensor"]["field_of_view_rad"])

"""What a filter looks like on its way: views in bounded memory for whoever watches, and the pace of a run."""

from __future__ import annotations

import json
import math
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Literal, TypeAlias

import numpy as np

from .config import Config
from .filter import StepInfo, landmark_map
from .health import REASONS
from .log import Bools, Floats
from .result import LandmarkMap, Trajectory
from .several import each_sensor

FRAME_PERIOD_S = 0.1
"""Views are at least so far apart on the clock,"""
SHARE = 0.05
"""and further where making them would take more than this share of the time."""
MOST_FRAMES = 600
MOST_BYTES = 24_000_000
MOST_PARTICLES = 150
MOST_PATH_POINTS = 500
GRACE_S = 2.0
"""A page that is loaded again is away for less than this."""


@dataclass(frozen=True)
class View:
    """What is known after a step, and what the best particle took the sightings of its scan for.

    Shapes: `seen` (S, 2) range and bearing of the usable sightings, `taken` (S) the id of the landmark of
    each ("" where it was left out, or its landmark was merged away), `founded` (S) whether that is new.
    """

    stamp_s: float
    T_world_robot: Floats
    covariance: Floats
    info: StepInfo
    particles: tuple[Floats, Floats]
    landmarks: LandmarkMap
    path: Trajectory
    seen: Floats
    taken: tuple[str, ...]
    founded: Bools
    sensor: int = 0
    """Number of the one that made the scan: its place in the order of the names."""
    verdict: tuple[str, ...] = ()
    """What speaks against the drive so far; of a `Robot`."""


Watch: TypeAlias = Callable[[View], tuple[float, float]]
"""Called with a view; answers in how many seconds, or from which stamp on, it wants the next one."""


def view_of(
    columns: dict[str, Any],
    names: tuple[tuple[str, ...], tuple[str, ...], tuple[str, ...]],
    step: tuple[float, Floats, Floats, StepInfo],
) -> View:
    """A view of the core's columns; `names` are of identities, of classes, and the ids of a given map."""
    landmarks = landmark_map(columns["map"], *names)
    code = columns["taken"]
    founded = code <= -2
    name_of = dict(zip(columns["map"]["birth"].tolist(), landmarks.ids, strict=True))
    taken = tuple(name_of.get(birth, "") for birth in np.where(founded, -2 - code, code).tolist())
    path, seen = Trajectory(*columns["path"]), columns["seen"]
    return View(*step, columns["particles"], landmarks, path, seen, taken, founded, columns["sensor"])


def frame_of(view: View, mounting: tuple[float, float, float]) -> dict[str, Any]:
    """What a page draws of a view, as JSON can carry it; `mounting` is the sensor's pose on the robot."""
    landmarks = view.landmarks
    row_of = {name: row for row, name in enumerate(landmarks.ids)}
    x, y, heading = view.T_world_robot.tolist()
    sensor_x = x + math.cos(heading) * mounting[0] - math.sin(heading) * mounting[1]
    sensor_y = y + math.sin(heading) * mounting[0] + math.cos(heading) * mounting[1]
    towards = view.seen[:, 1] + heading + mounting[2]
    ends = view.seen[:, :1] * np.column_stack([np.cos(towards), np.sin(towards)]) + [sensor_x, sensor_y]
    rows = [row_of.get(name, -1) for name in view.taken]
    seen = [
        [*end, row, int(new)] for end, row, new in zip(_short(ends), rows, view.founded.tolist(), strict=True)
    ]
    poses = view.particles[0]
    covariance = landmarks.covariance_m2.reshape(-1, 4)[:, [0, 1, 3]]
    classes = [landmarks.class_name(row) for row in range(len(landmarks.ids))]
    sure = landmarks.confirmed
    return {
        "t": round(view.stamp_s, 4),
        "pose": _short(view.T_world_robot),
        "cov": [float(f"{view.covariance[row, column]:.3g}") for row, column in ((0, 0), (0, 1), (1, 1))],
        "health": view.info.health,
        "why": [REASONS[name] for name in view.info.health_reasons],
        "verdict": view.verdict,
        "ess": round(view.info.effective_sample_size, 1),
        "n": len(poses),
        "p": _short(_thinned(poses, MOST_PARTICLES).ravel()),
        "id": list(landmarks.ids),
        "xy": _short(landmarks.mean_m.ravel()),
        "e": [float(f"{value:.3g}") for value in covariance.ravel()],
        "k": classes if any(classes) else None,
        "s": landmarks.sightings.tolist(),
        "sure": None if sure is None or sure.all() else sure.astype(int).tolist(),
        "path": _short(_thinned(view.path.T_world_robot[:, :2], MOST_PATH_POINTS).ravel()),
        "from": [round(sensor_x, 3), round(sensor_y, 3)],
        "seen": seen,
    }


def _short(values: Floats) -> list[Any]:
    """Numbers as they are drawn: to a millimetre."""
    rounded: list[Any] = np.round(values, 3).tolist()
    return rounded


def _thinned(rows: Floats, most: int) -> Floats:
    if len(rows) <= most:
        return rows
    return np.asarray(rows[np.linspace(0, len(rows) - 1, most).astype(int)])


@dataclass
class History:
    """Frames as bytes, the newest in full and the older the fewer; never more than memory allows."""

    frames: list[tuple[int, bytes]] = field(default_factory=list)
    size_bytes: int = 0
    number: int = 0
    """Of the next frame."""

    def add(self, frame: bytes) -> None:
        """Adds the newest; where there are too many, every second one goes, but for the newest."""
        self.frames.append((self.number, frame))
        self.number += 1
        self.size_bytes += len(frame)
        while len(self.frames) > MOST_FRAMES or (self.size_bytes > MOST_BYTES and len(self.frames) > 2):
            self.frames = self.frames[-1::-2][::-1]
            self.size_bytes = sum(len(kept) for _, kept in self.frames)

    def after(self, number: int) -> list[tuple[int, bytes]]:
        """All frames for one who has none (-1), else the newest where there is a newer one."""
        if number < 0:
            return list(self.frames)
        return self.frames[-1:] if self.frames and self.frames[-1][0] > number else []


@dataclass(frozen=True)
class Pace:
    """How a run goes on: whether it stands, and its speed in terms of the drive (0: as fast as it can)."""

    paused: bool = False
    speed: float = 0.0


class Watcher:
    """Between a filter, which shows views, and pages, which draw them; any thread may call it.

    `kind` is `run` where pages may hold the filter up, and `live` where nothing may.
    """

    def __init__(self, name: str, config: Config, *, kind: Literal["run", "live"]) -> None:
        self.configure(config)
        self.kind = kind
        self.scene = {"name": name, "kind": kind, "begun": time.time()}
        self._history = History()
        self._pace = Pace()
        self._since: tuple[float, float] | None = None
        """Clock and stamp from which the pace counts."""
        self._pages = 0
        self._left_s = -math.inf
        self._due_s = -math.inf
        self._version = 0
        self._ended = False
        self._learning: list[dict[str, Any]] = []
        self._changed = threading.Condition()

    def configure(self, config: Config) -> None:
        """The settings of what is shown from now on: where the sensors stand."""
        mountings = [sensor["mounting"] for sensor in each_sensor(config)]
        self._mountings = [(one["x_m"], one["y_m"], one["yaw_rad"]) for one in mountings]

    def show_learning(self, passes: list[dict[str, Any]]) -> None:
        """What a log is teaching before its run (`tuning.passes`), in the place of what was told before."""
        with self._changed:
            self._learning = passes
            self._version += 1
            self._changed.notify_all()

    def __call__(self, view: View) -> tuple[float, float]:
        """Shows a step of a run, and returns when it is time for the next: a `Watch`."""
        self.show(view)
        with self._changed:
            self._hold(view.stamp_s)
            if self._pace.speed and self._is_watched():
                return FRAME_PERIOD_S, view.stamp_s + FRAME_PERIOD_S * self._pace.speed
            return max(FRAME_PERIOD_S, self._due_s - time.monotonic()), math.inf

    def is_due(self) -> bool:
        """Whether it is time for the next view."""
        return time.monotonic() >= self._due_s

    def show(self, view: View) -> None:
        """Keeps a view for the pages."""
        begin_s = time.monotonic()
        frame = json.dumps(
            frame_of(view, self._mountings[view.sensor]), ensure_ascii=False, separators=(",", ":")
        )
        with self._changed:
            self._history.add(frame.encode())
            self._changed.notify_all()
        now_s = time.monotonic()
        # What the core does for a view takes about as long as what is done here.
        self._due_s = now_s + max(FRAME_PERIOD_S, 2.0 * (now_s - begin_s) / SHARE)

    def set_pace(self, pace: Pace) -> None:
        """What a page asks for."""
        with self._changed:
            self._pace, self._since = pace, None
            self._version += 1
            self._changed.notify_all()

    def end(self) -> None:
        """Nothing more comes."""
        with self._changed:
            self._ended = True
            self._version += 1
            self._changed.notify_all()

    def enter(self) -> bool:
        """A page opens; whether there is room for it."""
        with self._changed:
            self._pages += 1
            self._changed.notify_all()
            return self._pages <= 8

    def leave(self) -> None:
        """A page has closed."""
        with self._changed:
            self._pages -= 1
            self._left_s = time.monotonic()
            self._changed.notify_all()

    def news(
        self, number: int, version: int, *, wait_s: float
    ) -> tuple[list[tuple[int, bytes]], int, dict[str, Any]]:
        """Frames newer than those a page has, and how the run goes on; waits where there is nothing new."""
        with self._changed:
            self._changed.wait_for(
                lambda: self._version != version or bool(self._history.after(number)), timeout=wait_s
            )
            state: dict[str, Any] = {
                "paused": self._pace.paused,
                "speed": self._pace.speed,
                "ended": self._ended,
            }
            if self._learning:
                state["learning"] = self._learning
            return self._history.after(number), self._version, state

    @property
    def was_watched(self) -> bool:
        """Whether a page is or was open."""
        with self._changed:
            return self._pages > 0 or self._left_s > -math.inf

    def wait_for_page(self, longest_s: float) -> None:
        """Returns when a page is open, or when nobody has opened one for so long."""
        with self._changed:
            self._changed.wait_for(lambda: self._pages > 0, timeout=longest_s)

    def _is_watched(self) -> bool:
        return self._pages > 0 or time.monotonic() < self._left_s + GRACE_S

    def _hold(self, stamp_s: float) -> None:
        """Waits while a page holds the run, or until a step is due at the pace that it asks for."""
        while self._is_watched():
            pace = self._pace
            if self._since is None and not pace.paused:
                self._since = (time.monotonic(), stamp_s)
            if not pace.paused and (not pace.speed or self._since is None):
                return
            left_s = 0.2
            if self._since is not None and not pace.paused:
                left_s = self._since[0] + (stamp_s - self._since[1]) / pace.speed - time.monotonic()
            if left_s <= 0.0:
                return
            self._changed.wait(min(left_s, 0.2))

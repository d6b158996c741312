"""A robot on a live stream that is looked for in a kept map while it drives."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from . import _core
from .config import Config
from .filter import core_errors, landmark_map
from .localisation import FIRST_WINDOW_S, LONGEST_WINDOW_S, WINDOW_GROWTH, Mode, Search, start_of
from .log import Floats
from .maps import Map, Start
from .placement import composed, inverse
from .rows import Row


@dataclass
class RobotSearch:
    """The rows of a robot since the search began, and what its own map says of where it is."""

    chart: Map
    config: Config
    rows: list[Row] = field(default_factory=list)
    window_s: float = FIRST_WINDOW_S
    found: tuple[Mode, ...] = ()
    """Where it may have been when the search began."""
    was_lost_s: float | None = None
    """Stamp since which it was lost in the map, where that is why it is searched for."""
    _search: Search | None = None

    def is_due(self, stamp_s: float) -> bool:
        """Whether the robot's own map, computed so far, has grown enough to be looked at."""
        return bool(self.rows) and stamp_s - self._begin_s >= self.window_s

    @property
    def has_given_up(self) -> bool:
        """Whether the rows are too many: then the search begins anew where the robot is."""
        return self.window_s > LONGEST_WINDOW_S

    def look(self, stream: _core.Stream, names: tuple[tuple[str, ...], tuple[str, ...]]) -> Start | None:
        """Where the robot was when the search began, where that is sure now; the stream is not changed.

        `names` are those of identities and of classes.
        """
        self.window_s *= WINDOW_GROWTH
        if self._search is None:
            self._search = Search(self.chart, self.config)
        with core_errors():
            copy = _core.Stream.load(stream.save(""))[0]
            # What the rows so far say, as a run over them would.
            copy.end()
            while copy.step() is not None:
                pass
            copy.finish()
        sure = self._search.look(landmark_map(copy.map(), *names), copy.smoothed()[1], self._ranges_m())
        self.found = self._search.modes
        return start_of(self.found[0]) if sure else None

    def now(self, T_own_robot: Floats) -> tuple[Mode, ...]:
        """Where it may be now, `T_own_robot` (3,) being where it is in its own map."""
        start = self.config["initial_pose"]
        begun = np.array([start["x_m"], start["y_m"], start["heading_rad"]])
        return tuple(
            Mode(
                composed(composed(mode.T_map_robot, inverse(begun)), T_own_robot),
                mode.covariance,
                mode.probability,
                mode.matched,
            )
            for mode in self.found
        )

    def to_json(self) -> dict[str, Any]:
        """What a snapshot needs to go on, but for the map."""
        rows = [row.to_json() for row in self.rows]
        return {"rows": rows, "window_s": self.window_s, "was_lost_s": self.was_lost_s}

    @property
    def _begin_s(self) -> float:
        return min(row.stamp_s for row in self.rows[:50])

    def _ranges_m(self) -> Floats:
        ranges = [row.values[0] for row in self.rows if row.kind == "sightings"]
        return np.concatenate(ranges) if ranges else np.empty(0)


def chart_to_json(chart: Map) -> dict[str, Any]:
    """A map as lists and numbers, for a snapshot."""
    landmarks = chart.landmarks
    columns: dict[str, Any] = {
        "ids": landmarks.ids,
        "mean_m": landmarks.mean_m.tolist(),
        "covariance_m2": landmarks.covariance_m2.tolist(),
        "sightings": landmarks.sightings.tolist(),
        "class": [landmarks.class_name(row) for row in range(len(landmarks.ids))],
        "signature": None if landmarks.signature is None else landmarks.signature.tolist(),
    }
    return (
        columns
        | {"role": chart.role, "existence": chart.existence.tolist(), "name": chart.name}
        | {
            "note": chart.note,
            "frame": chart.frame,
            "made_from": chart.made_from,
        }
    )


def chart_of_json(kept: dict[str, Any]) -> Map:
    """The inverse of `chart_to_json`."""
    from .result import LandmarkMap

    count = len(kept["ids"])
    class_names = tuple(dict.fromkeys(filter(None, kept["class"])))
    index_of = {name: index for index, name in enumerate(class_names)}
    landmarks = LandmarkMap(
        ids=tuple(kept["ids"]),
        mean_m=np.array(kept["mean_m"], dtype=np.float64).reshape(count, 2),
        covariance_m2=np.array(kept["covariance_m2"], dtype=np.float64).reshape(count, 2, 2),
        sightings=np.array(kept["sightings"], dtype=np.int64),
        class_index=np.array([index_of.get(name, -1) for name in kept["class"]], dtype=np.int64)
        if class_names
        else None,
        signature=None if kept["signature"] is None else np.array(kept["signature"], dtype=np.float64),
        class_names=class_names,
    )
    existence = np.array(kept["existence"], dtype=np.float64)
    # Snapshots of older versions leave out the last three.
    note, frame = tuple(kept.get("note", ("",) * count)), kept.get("frame", "map")
    made_from = kept.get("made_from", {})
    return Map(landmarks, tuple(kept["role"]), existence, note, kept["name"], frame, made_from)


def search_of_json(kept: dict[str, Any], chart: Map, config: Config) -> RobotSearch:
    """The search that a snapshot holds."""
    rows, was_lost_s = [Row.of_json(row) for row in kept["rows"]], kept.get("was_lost_s")
    return RobotSearch(chart, config, rows, kept["window_s"], was_lost_s=was_lost_s)


def note(**facts: Any) -> str:
    """What a snapshot of a robot says beside the core's state."""
    return json.dumps({key: value for key, value in facts.items() if value is not None})

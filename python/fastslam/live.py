"""Lines of JSON in, estimates out: a robot that drives, over standard input or TCP."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from ._given import shown
from .errors import DataError
from .identity import nobody_knows
from .log import Floats
from .result import LandmarkMap
from .robot import Robot
from .scan_call import UnknownClassError
from .window import Step

if TYPE_CHECKING:
    from .localisation import Mode

SEARCHING = "searching"
"""Health of a robot that is searched for in its map."""
LEAST_PROBABILITY = 1e-3
MOST_MODES = 20
"""Places that are less likely, or more of them, are not told."""
KEYS = {"odom": ("cov",), "see": ("sensor",), "scan": ("echo",)}
"""What a line may tell at `t`, and what may stand beside each."""
LONGEST_LINE = 1_000_000
"""Characters; a longer line is no event."""


@dataclass(frozen=True)
class Estimate:
    """What is known at a moment: the pose at the newest row, its health, and which landmarks changed.

    While the robot is searched for in its map, `health` is `searching`, there is no pose, and `modes` are the
    places where it may be now.
    """

    stamp_s: float
    T_world_robot: Floats | None
    covariance: Floats | None
    health: str
    why: tuple[str, ...]
    changed: tuple[dict[str, Any], ...]
    """Landmarks that are new or have moved since the last estimate: name, x_m, y_m, standard deviations."""
    gone: tuple[str, ...]
    modes: tuple[Mode, ...] = ()
    verdict: tuple[str, ...] = ()
    """What speaks against the drive so far: `Robot.recent_verdict`."""

    def to_line(self) -> str:
        """One JSON object, as `fastslam live` writes it."""
        facts: dict[str, Any] = {"t": self.stamp_s, "pose": None, "cov": None, "health": self.health}
        if self.T_world_robot is not None and self.covariance is not None:
            facts["pose"] = _rounded(self.T_world_robot)
            facts["cov"] = [float(f"{value:.6g}") for value in self.covariance.ravel()]
        facts |= {
            "why": self.why,
            "verdict": self.verdict,
            "map": {"changed": self.changed, "gone": self.gone},
        }
        if self.health == SEARCHING:
            facts["modes"] = [
                {"pose": _rounded(mode.T_map_robot), "p": round(mode.probability, 4)} for mode in self.modes
            ]
        return json.dumps(facts, ensure_ascii=False)


def _rounded(pose: Floats) -> list[float]:
    return [round(float(value), 6) for value in pose]


@dataclass
class Faults:
    """What was passed over: how many, and the first few with the number of their line."""

    count: int = 0
    shown: list[str] = field(default_factory=list)

    def add(self, number: int, why: str) -> str:
        """Counts a line; returns what is wrong with it."""
        self.count += 1
        message = f"line {number}: {why}"
        if len(self.shown) < 10:
            self.shown.append(message)
        return message


@dataclass
class Session:
    """A robot with what was said of it so far; `live` and the program go through here."""

    robot: Robot
    rate_hz: float = 20.0
    faults: Faults = field(default_factory=Faults)
    left_out: Faults = field(default_factory=Faults)
    """Sightings of a class that is not configured."""
    lines: int = 0
    step: Step | None = None
    told_s: float = -math.inf
    told: dict[str, tuple[float, float]] = field(default_factory=dict)

    def take(self, line: str) -> Estimate | None:
        """Takes a line; the estimate where one is due, in time of the stamps.

        Errors: `DataError`, with the number of the line, for one that is no event; it is counted.
        """
        self.lines += 1
        unknown: list[str] = []
        try:
            steps = tell(self.robot, line, unknown)
        except DataError as error:
            raise DataError(self.faults.add(self.lines, str(error))) from None
        for why in unknown:
            self.left_out.add(self.lines, why)
        if steps:
            self.step = steps[-1]
        stamp_s = self.robot.stamp_s
        known = self.step is not None or self.robot.searching
        if stamp_s is None or not known or stamp_s < self.told_s + 1.0 / self.rate_hz:
            return None
        return self.estimate()

    def end(self) -> Estimate | None:
        """The last estimate, when nothing more comes; none where nothing was computed."""
        steps = self.robot.end()
        if steps:
            self.step = steps[-1]
        known = self.step is not None or (self.robot.searching and self.robot.stamp_s is not None)
        return self.estimate() if known else None

    def estimate(self) -> Estimate:
        """What is known now."""
        if self.robot.searching:
            return self._searching()
        stamp_s, mean, covariance = self.robot.pose
        changed, gone = self._map_changes(self.robot.landmarks)
        self.told_s = stamp_s
        info = None if self.step is None else self.step.info
        return Estimate(
            stamp_s=stamp_s,
            T_world_robot=mean,
            covariance=covariance,
            health="initializing" if info is None else info.health,
            why=() if info is None else info.health_reasons,
            changed=tuple(changed),
            gone=gone,
            verdict=self.robot.recent_verdict,
        )

    def _searching(self) -> Estimate:
        """What is known of a robot that is searched for."""
        self.told_s = self.robot.stamp_s or 0.0
        likely = tuple(mode for mode in self.robot.modes if mode.probability >= LEAST_PROBABILITY)
        return Estimate(self.told_s, None, None, SEARCHING, (), (), (), likely[:MOST_MODES])

    def _map_changes(self, landmarks: LandmarkMap) -> tuple[list[dict[str, Any]], tuple[str, ...]]:
        """Landmarks that are new or moved by more than a centimetre since they were last told."""
        changed: list[dict[str, Any]] = []
        places = {
            name: (float(x), float(y)) for name, (x, y) in zip(landmarks.ids, landmarks.mean_m, strict=True)
        }
        for row, (name, place) in enumerate(places.items()):
            before = self.told.get(name)
            if before is not None and math.dist(before, place) < 0.01:
                continue
            self.told[name] = place
            std = [math.sqrt(max(float(landmarks.covariance_m2[row, k, k]), 0.0)) for k in (0, 1)]
            entry: dict[str, Any] = {"id": name, "at": [round(value, 4) for value in place]}
            entry["std"] = [round(value, 4) for value in std]
            if landmarks.class_index is not None and landmarks.class_index[row] >= 0:
                entry["class"] = landmarks.class_names[int(landmarks.class_index[row])]
            changed.append(entry)
        gone = tuple(name for name in self.told if name not in places)
        for name in gone:
            del self.told[name]
        return changed, gone


def live(source: Iterable[str], robot: Robot | None = None, *, rate_hz: float = 20.0) -> Iterator[Estimate]:
    """Estimates of a robot from lines of JSON, at most `rate_hz` of them per second of the stamps.

    >>> lines = ['{"t": 0.0, "odom": [1.0, 0.0]}', '{"t": 0.1, "see": [[2.0, 0.5, "oak"]]}']
    >>> [round(float(estimate.T_world_robot[0]), 1) for estimate in live(lines)]
    [0.1]

    Lines that are no events are passed over; use `Session` to be told which. Errors: `DataError` for a rate
    that is none.
    """
    session = session_of(robot or Robot(), rate_hz=rate_hz)
    for line in source:
        try:
            estimate = session.take(line)
        except DataError:
            continue
        if estimate is not None:
            yield estimate
    last = session.end()
    if last is not None:
        yield last


def session_of(robot: Robot, *, rate_hz: float) -> Session:
    """A session at its start. Errors: `DataError` for a rate that is none."""
    if not 0.0 < rate_hz < math.inf:
        raise DataError(f"rate_hz: got {rate_hz}, expected a number above 0")
    return Session(robot, rate_hz)


def tell(robot: Robot, line: str, left_out: list[str] | None = None) -> tuple[Step, ...]:
    """Tells a robot one line: `{"t": 12.3, "odom": [...]}`, `{"t": 12.2, "see": [[r, b, "name"], ...]}`
    (with `"sensor": "rear"` where it has several), or a turn of its laser, `{"t": 12.2, "scan": [r, ...]}`.

    Sightings of a class that is not among those configured are left out, and said in `left_out`. Errors:
    `DataError` for a line that is no event; the robot is as it was.
    """
    if not line.strip():
        return ()
    event = _event(line)
    stamp_s = event["t"]
    if "odom" in event:
        return robot.odometry(stamp_s, _list("odom", event["odom"]), covariance=event.get("cov"))
    if "scan" in event:
        echoes = _beams("echo", event["echo"]) if "echo" in event else None
        return robot.scan(stamp_s, _beams("scan", event["scan"]), intensities=echoes)
    seen = [_sighting(entry) for entry in _list("see", event["see"])]
    sensor = _sensor(event.get("sensor"))
    try:
        return _seen(robot, stamp_s, seen, sensor)
    except UnknownClassError as error:
        if left_out is not None:
            left_out += [str(error)] * len(error.rows)
        known = [one for row, one in enumerate(seen) if row not in error.rows]
        return _seen(robot, stamp_s, known, sensor)


def _seen(robot: Robot, stamp_s: float, seen: list[_Seen], sensor: str | None) -> tuple[Step, ...]:
    labels = [label for _, _, label in seen]
    named = robot.config["association"]["classes"] is None
    return robot.sightings(
        stamp_s,
        range_m=[range_m for range_m, _, _ in seen],
        bearing_rad=[bearing_rad for _, bearing_rad, _ in seen],
        identity=labels if named else None,
        class_name=None if named else labels,
        sensor=sensor,
    )


def _event(line: str) -> dict[str, Any]:
    if len(line) > LONGEST_LINE:
        raise DataError(f"{len(line):,} characters, expected at most {LONGEST_LINE:,}")
    try:
        event = json.loads(line)
    except (ValueError, RecursionError) as error:
        raise DataError(f"no JSON ({error})") from None
    kinds = [kind for kind in KEYS if kind in event] if isinstance(event, dict) and "t" in event else []
    if not isinstance(event, dict) or len(kinds) != 1:
        known = ", ".join(f'"{kind}"' for kind in KEYS)
        raise DataError(f'got {shown(event)}, expected an object with "t" and one of {known}')
    unknown = sorted(set(event) - {"t", kinds[0], *KEYS[kinds[0]]})
    if unknown:
        raise DataError(f"unknown key {shown(unknown[0])}")
    if isinstance(event["t"], bool) or not isinstance(event["t"], int | float):
        raise DataError(f"t: got {shown(event['t'])}, expected seconds")
    return event


def _list(key: str, value: object) -> list[Any]:
    if not isinstance(value, list):
        raise DataError(f"{key}: got {shown(value)}, expected a list")
    return value


def _sensor(value: object) -> str | None:
    if value is not None and not isinstance(value, str):
        raise DataError(f"sensor: got {shown(value)}, expected a name")
    return value


def _beams(key: str, value: object) -> list[float]:
    """One number per beam, NaN where nothing is known."""
    turn = [math.nan if one is None else one for one in _list(key, value)]
    for one in turn:
        if isinstance(one, bool) or not isinstance(one, int | float):
            raise DataError(f"{key}: got {shown(one)}, expected a number or null for each beam")
    return turn


_Seen = tuple[float, float, str | None]
"""Range, bearing, and name or class of a sighting."""


def _sighting(entry: object) -> _Seen:
    numbers_of = entry[:2] if isinstance(entry, list) and len(entry) in (2, 3) else None
    if numbers_of is None or not all(map(_is_number_or_none, numbers_of)) or numbers_of == [None, None]:
        expected = "[range_m, bearing_rad] (null: not measured) or with a name or class"
        raise DataError(f"see: got {shown(entry)}, expected {expected}")
    label = entry[2] if isinstance(entry, list) and len(entry) == 3 else None
    if isinstance(label, int | float) and nobody_knows(str(label)):
        label = None
    if label is not None and not isinstance(label, str):
        raise DataError(f"see: got {shown(label)}, expected a name or class as text")
    range_m, bearing_rad = (math.nan if value is None else float(value) for value in numbers_of)
    return range_m, bearing_rad, label


def _is_number_or_none(value: object) -> bool:
    return value is None or (isinstance(value, int | float) and not isinstance(value, bool))

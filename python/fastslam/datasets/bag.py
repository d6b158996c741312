"""Bags of ROS 1 and ROS 2 (sqlite3 and MCAP), read by the package `rosbags` (extra `bags`), without ROS.

Topics are taken by what their messages hold. Stamps are those of the headers. Static transforms say where the
sensor stands on the robot.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import DataError
from ..log import BeamGeometry, Controls, Floats, Log, Problem, Scans, Sightings, TruthTrajectory
from .bag_messages import (
    constants_of,
    detections_in,
    drive_in,
    frame_of,
    planar,
    pose_in,
    stamp_of,
    transform_of,
    twist_in,
)
from .bag_topics import TRANSFORMS, Topic, chosen_from, messages_on, opened, topics_of
from .bag_transforms import path_of_frame
from .clean import clean_controls, clean_sightings, no_sightings
from .native_settings import place_on_axle
from .options import LoadOptions
from .planar import wrap_to_pi
from .text import children

if TYPE_CHECKING:
    from rosbags.highlevel import AnyReader

SUFFIXES = (".bag", ".db3", ".mcap")
STANDS_M, STANDS_RAD = 1e-9, 1e-9
"""Poses that change by less have not changed."""
BASES = ("base_link", "base_footprint", "base", "vehicle", "car")
"""What robots call their own frame."""
GLOBAL_FRAMES = ("map", "odom", "world", "earth")


def matches(path: Path) -> bool:
    """A file with the suffix of a bag, or the folder of a ROS 2 bag."""
    if path.is_dir():
        return (path / "metadata.yaml").is_file() and any(
            child.suffix in (*SUFFIXES, ".zstd") for child in children(path)
        )
    return path.suffix in SUFFIXES and path.is_file()


def load(path: Path, options: LoadOptions) -> Log:
    """Reads a bag. Errors: DataError for one that cannot be read or holds no odometry or no landmarks."""
    with opened(path) as reader:
        chosen = chosen_from(topics_of(reader), dict(options.topics or ()), path)
        bag = _Bag(path, reader, _Frames.of(reader))
        controls, motion, problems = bag.odometry(chosen.topics["odometry"])
        log = Log(
            name=path.stem,
            source=str(path),
            format="bag",
            controls=controls,
            sightings=no_sightings(),
            config={"motion": motion},
            problems=problems,
            notes=(*(f"{role}: {topic.name}" for role, topic in chosen.topics.items()), *chosen.notes),
        )
        if "detections" in chosen.topics:
            log = bag.with_detections(log, chosen.topics["detections"])
        elif "scan" in chosen.topics:
            log = bag.with_scans(log, chosen.topics["scan"])
        if "truth" in chosen.topics:
            truth = bag.truth(chosen.topics["truth"], chosen.truth_frame)
            log = replace(log, truth_trajectory=truth)
        return replace(log, problems=(*log.problems, *bag.problems()), notes=(*log.notes, *bag.notes))


def list_topics(path: Path) -> list[Topic]:
    """The topics of a bag, and what each may serve for. Errors: DataError for one that cannot be read."""
    with opened(path) as reader:
        return topics_of(reader)


@dataclass
class _Frames:
    """Static transforms: the parent of each frame, and its pose (4, 4) there."""

    above: dict[str, tuple[str, Floats]]
    moving: frozenset[str]
    """Frames whose transform changes."""

    @classmethod
    def of(cls, reader: AnyReader) -> _Frames:
        """Those of the topics of transforms; a transform that never changes is static, whoever sends it."""
        above: dict[str, tuple[str, Floats]] = {}
        moving: set[str] = set()
        for name, about in reader.topics.items():
            if about.msgtype not in TRANSFORMS:
                continue
            for _, message in messages_on(reader, name):
                for entry in message.transforms:
                    child = entry.child_frame_id.lstrip("/")
                    matrix = transform_of(entry.transform.translation, entry.transform.rotation)
                    before = above.setdefault(child, (frame_of(entry), matrix))
                    if not np.allclose(before[1], matrix, atol=1e-6):
                        moving.add(child)
        return cls(above, frozenset(moving))

    def chain(self, frame: str) -> list[str]:
        """The frame and those it is fixed to, upwards."""
        frames = [frame]
        while frame in self.above and frame not in self.moving and self.above[frame][0] not in frames:
            frame = self.above[frame][0]
            frames.append(frame)
        return frames

    def base(self, frame: str, said: str) -> str | None:
        """The robot's frame above a sensor's: what odometry calls it, or a usual name."""
        chain = self.chain(frame)
        return next((name for name in (said, *BASES) if name in chain), None)

    def pose(self, frame: str, base: str) -> Floats:
        """The matrix (4, 4) that takes points of a frame to the robot's."""
        matrix = np.eye(4)
        while frame != base:
            frame, above = self.above[frame]
            matrix = above @ matrix
        return matrix


class _Bag:
    """A bag that is being read."""

    def __init__(self, path: Path, reader: AnyReader, frames: _Frames) -> None:
        self.path, self.reader, self.frames = path, reader, frames
        self.notes: list[str] = []
        self._unstamped = 0
        self._base = ""

    def problems(self) -> Iterator[Problem]:
        """What was repaired on the way."""
        if self._unstamped:
            yield Problem("messages without a stamp: taken at the time of recording", self._unstamped)

    def odometry(self, topic: Topic) -> tuple[Controls, dict[str, Any], tuple[Problem, ...]]:
        """Rows of odometry, and the motion model that they are for."""
        messages = list(self._messages(topic))
        stamp_s = np.array([stamp for stamp, _ in messages])
        first = messages[0][1]
        self._base = str(getattr(first, "child_frame_id", "")).lstrip("/")
        if drive_in(first) is not None:
            values = np.array([drive_in(message) for _, message in messages], dtype=np.float64)
            controls, problems = clean_controls(stamp_s, values, path=self.path)
            motion: dict[str, Any] = {"model": "ackermann"}
            self.notes += place_on_axle(motion)
            return controls, motion, problems
        twists = [twist_in(message) for _, message in messages]
        if pose_in(first) is None:
            values = np.array(twists, dtype=np.float64)
            controls, problems = clean_controls(stamp_s, values, path=self.path)
            return controls, {"model": "velocity"}, problems
        poses = np.array([planar(pose_in(message)) for _, message in messages])
        if (
            np.ptp(poses[:, :2], axis=0).max() <= STANDS_M
            and np.ptp(poses[:, 2]) <= STANDS_RAD
            and any(twist is not None and any(twist) for twist in twists)
        ):
            controls, problems = clean_controls(stamp_s, np.array(twists, dtype=np.float64), path=self.path)
            return controls, {"model": "velocity"}, problems
        controls, problems = clean_controls(stamp_s, poses, path=self.path)
        return replace(controls, values=_steps(controls.values)), {"model": "odometry"}, problems

    def with_detections(self, log: Log, topic: Topic) -> Log:
        """The log with sightings as seen from where the sensor stands."""
        constants = constants_of(self.reader.typestore.fielddefs)
        names: dict[str, int] = {}
        classes: dict[str, int] = {}
        rows: list[tuple[float, float, float, int, int]] = []
        mounting: _Mounting | None = None
        for stamp_s, message in self._messages(topic):
            if mounting is None:
                mounting = self._mounting(frame_of(message), topic)
            for found in detections_in(message, constants) or ():
                range_m, bearing_rad = mounting.polar(found.point_m)
                name = names.setdefault(found.identity, len(names)) if found.identity else -1
                kind = classes.setdefault(found.class_name, len(classes)) if found.class_name else -1
                rows.append((stamp_s, range_m, bearing_rad, name, kind))
        if mounting is None or not rows:
            raise DataError(f"{topic.name} holds no detection", self.path)
        table = np.array(rows, dtype=np.float64)
        sightings, problems = clean_sightings(
            Sightings(
                stamp_s=table[:, 0],
                range_m=table[:, 1],
                bearing_rad=table[:, 2],
                identity=table[:, 3].astype(np.int64),
                class_index=table[:, 4].astype(np.int64),
                signature=np.full(len(table), np.nan),
            ),
            path=self.path,
        )
        sensor = {"model": "range_bearing", "mounting": mounting.settings()}
        config: dict[str, Any] = {**log.config, "sensor": sensor}
        if len(classes) > 1:
            config["association"] = {"classes": {"number": len(classes)}}
        return replace(
            log,
            sightings=sightings,
            identity_names=tuple(names),
            class_names=tuple(classes),
            config=config,
            problems=(*log.problems, *problems),
        )

    def with_scans(self, log: Log, topic: Topic) -> Log:
        """The log with laser scans, in which landmarks are detected before a run."""
        first: Any = None
        stamps: list[float] = []
        ranges: list[Floats] = []
        odd = 0
        for stamp_s, message in self._messages(topic):
            first = message if first is None else first
            if len(message.ranges) != len(first.ranges) or message.angle_min != first.angle_min:
                odd += 1
                continue
            stamps.append(stamp_s)
            ranges.append(np.asarray(message.ranges, dtype=np.float64))
        mounting = self._mounting(frame_of(first), topic)
        order = np.unique(np.array(stamps), return_index=True)[1]
        values = np.array(ranges, dtype=np.float32)[order]
        begin, step = float(first.angle_min), float(first.angle_increment)
        if mounting.is_upside_down:
            begin, values = -(begin + step * (values.shape[1] - 1)), values[:, ::-1]
        period_s = float(first.time_increment)
        geometry = BeamGeometry(
            begin,
            step,
            float(first.range_min),
            float(first.range_max),
            period_s if period_s > 0.0 and not mounting.is_upside_down else None,
        )
        settings = mounting.settings()
        place = (settings["x_m"], settings["y_m"], settings["yaw_rad"])
        dropped = odd + len(stamps) - len(order)
        problems = (Problem("scans of another size or with a stamp that was there: dropped", dropped),)
        scans = Scans(np.array(stamps)[order], np.ascontiguousarray(values), geometry, mounting=place)
        config = {**log.config, "sensor": {"model": "range_bearing"}}
        return replace(
            log, scans=scans, config=config, problems=(*log.problems, *(problems if dropped else ()))
        )

    def truth(self, topic: Topic, frame: str) -> TruthTrajectory:
        """The true path that a topic of poses holds, or that of a frame by transforms."""
        if topic.type in TRANSFORMS:
            usual = (self._base, *BASES)
            found, note = path_of_frame(self.reader, self.path, frame=frame, usual=usual)
            self.notes.append(note)
            return found
        rows = [(stamp, *planar(pose_in(message))) for stamp, message in self._messages(topic)]
        table = np.array(rows, dtype=np.float64)
        table = table[np.isfinite(table).all(axis=1)]
        _, first = np.unique(table[:, 0], return_index=True)
        return TruthTrajectory(table[first, 0], table[first, 1:])

    def _messages(self, topic: Topic) -> Iterable[tuple[float, Any]]:
        """The messages with their own stamps; that of the recording where they have none."""
        for recorded_s, message in messages_on(self.reader, topic.name):
            stamp_s = stamp_of(message)
            if math.isnan(stamp_s):
                self._unstamped += 1
                stamp_s = recorded_s
            yield stamp_s, message

    def _mounting(self, frame: str, topic: Topic) -> _Mounting:
        if frame in GLOBAL_FRAMES and frame != self._base:
            raise DataError(
                f"{topic.name} is in the frame {frame}: what was seen from the robot is needed",
                self.path,
            )
        base = self.frames.base(frame, self._base)
        if base is not None:
            return _Mounting(self.frames.pose(frame, base))
        matrix = np.eye(4)
        axes = ""
        if "optical" in frame:
            matrix[:3, :3] = [[0, 0, 1], [-1, 0, 0], [0, -1, 0]]
            axes = ", its z axis ahead"
        named = frame or f"the frame of {topic.name}"
        self.notes.append(
            f"no static transform from {self._base or BASES[0]} to {named}: the "
            f"sensor is taken to stand at the robot's origin{axes}; sensor.mounting says otherwise"
        )
        return _Mounting(matrix)


@dataclass(frozen=True)
class _Mounting:
    """Where a sensor stands on the robot, as a matrix (4, 4)."""

    T_robot_sensor: Floats

    @property
    def yaw_rad(self) -> float:
        """Where the sensor's x axis points; 0 for one that points up or down, as in cameras."""
        ahead = self.T_robot_sensor[:3, 0]
        return math.atan2(ahead[1], ahead[0]) if abs(ahead[2]) < 0.5 and self._is_level else 0.0

    @property
    def is_upside_down(self) -> bool:
        """Whether the sensor turns the other way round."""
        return bool(self.T_robot_sensor[2, 2] < -0.5)

    @property
    def _is_level(self) -> bool:
        return bool(abs(self.T_robot_sensor[2, 2]) > 0.5)

    def settings(self) -> dict[str, float]:
        """`sensor.mounting` of the configuration."""
        x_m, y_m = self.T_robot_sensor[:2, 3]
        return {"x_m": float(x_m), "y_m": float(y_m), "yaw_rad": self.yaw_rad}

    def polar(self, point_m: tuple[float, float, float]) -> tuple[float, float]:
        """Range and bearing, in the plane, of a point of the sensor's frame."""
        x_m, y_m = self.T_robot_sensor[:2, :3] @ np.array(point_m)
        return math.hypot(x_m, y_m), math.remainder(math.atan2(y_m, x_m) - self.yaw_rad, 2.0 * math.pi)


def _steps(poses: Floats) -> Floats:
    """Each pose in the frame of the one before; the first row stands."""
    apart = np.diff(poses, axis=0, prepend=poses[:1])
    heading = np.concatenate([poses[:1, 2], poses[:-1, 2]])
    cosine, sine = np.cos(heading), np.sin(heading)
    return np.column_stack(
        [
            cosine * apart[:, 0] + sine * apart[:, 1],
            -sine * apart[:, 0] + cosine * apart[:, 1],
            wrap_to_pi(apart[:, 2]),
        ]
    )

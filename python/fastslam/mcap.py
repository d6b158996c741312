"""Results as an MCAP file of ROS 2 messages, which viewers open; written by `rosbags`, without ROS.

| topic | message | holds |
|---|---|---|
| `/pose` | geometry_msgs/PoseWithCovarianceStamped | what the filter knew at each stamp |
| `/tf` | tf2_msgs/TFMessage | the same, from `map` to `base_link` |
| `/path` | nav_msgs/Path | the best path there is, once, at the first stamp |
| `/landmarks` | visualization_msgs/MarkerArray | the map, once, at the first stamp |

The markers are in three namespaces: `landmarks` (a post, in the colour of the class), `ellipses` (two
standard deviations) and `names`. The number of a marker is the row of its landmark in `landmarks.csv`.
"""

from __future__ import annotations

import math
import os
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from .charts.palette import LANDMARK, class_color
from .errors import DataError
from .log import Floats
from .result import LandmarkMap, RunResult, Trajectory

if TYPE_CHECKING:
    from rosbags.typesys.store import Typestore

WORLD, ROBOT = "map", "base_link"
"""The frames, by the names that ROS has for them (REP 105)."""
SIGMAS = 2.0
_POST_M, _HEIGHT_M = 0.2, 0.5
_FLAT_M = 0.02
_LAST_S = 2.0**31
"""Stamps of ROS 2 have 31 bits of seconds."""

Message = tuple[str, int, Any]
"""Topic, time in nanoseconds, and what is said."""


def write_mcap(result: RunResult, path: Path | str) -> Path:
    """Writes the file, whole or not at all, in the place of an older one.

    Errors: `DataError` without `rosbags`, for a run without poses, for stamps that ROS cannot say (before
    1970, after 2038), and where it cannot be written.
    """
    target = Path(path)
    try:
        from rosbags.rosbag2 import StoragePlugin, Writer
        from rosbags.typesys import Stores, get_typestore
    except ImportError:
        raise DataError("is a bag: `pip install 'rosbags>=0.11,<0.12'` lets it be written", target) from None
    stamp_s = result.trajectory.stamp_s
    if len(stamp_s) == 0:
        raise DataError("the run has no pose to write", target)
    if not (stamp_s[0] >= 0.0 and stamp_s[-1] < _LAST_S):
        raise DataError(f"stamps of ROS are from 0 to {_LAST_S:.0f} s, got {stamp_s[0]:.0f} s", target)
    store = get_typestore(Stores.ROS2_HUMBLE)
    try:
        with tempfile.TemporaryDirectory(dir=target.parent, prefix=".mcap-") as folder:
            bag = Path(folder) / "bag"
            with Writer(bag, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
                open_for: dict[str, Any] = {}
                for topic, stamp_ns, message in _messages(result, store):
                    kind = message.__msgtype__
                    if topic not in open_for:
                        open_for[topic] = writer.add_connection(topic, kind, typestore=store)
                    writer.write(open_for[topic], stamp_ns, store.serialize_cdr(message, kind))
            os.replace(bag / "bag.mcap", target)
    except OSError as error:
        raise DataError(f"cannot write: {error.strerror or error}", target) from None
    return target


def _messages(result: RunResult, store: Typestore) -> Iterator[Message]:
    say = _Speaker(store)
    live, first = result.trajectory, float(result.trajectory.stamp_s[0])
    yield "/landmarks", _nanoseconds(first), say.markers(first, result.landmarks)
    yield "/path", _nanoseconds(first), say.path(first, result.path)
    for row, stamp_s in enumerate(live.stamp_s.tolist()):
        pose, stamp_ns = live.T_world_robot[row], _nanoseconds(stamp_s)
        yield "/pose", stamp_ns, say.estimate(stamp_s, pose, _covariance(live, row))
        yield "/tf", stamp_ns, say.transform(stamp_s, pose)


class _Speaker:
    """Says things in the messages of ROS 2."""

    def __init__(self, store: Typestore) -> None:
        types = store.types
        self._type = types
        self._point = types["geometry_msgs/msg/Point"]
        self._vector = types["geometry_msgs/msg/Vector3"]
        self._color = types["std_msgs/msg/ColorRGBA"]

    def header(self, stamp_s: float) -> Any:
        seconds, rest = divmod(_nanoseconds(stamp_s), 10**9)
        stamp = self._type["builtin_interfaces/msg/Time"](seconds, rest)
        return self._type["std_msgs/msg/Header"](stamp, WORLD)

    def pose(self, x_m: float, y_m: float, yaw_rad: float, z_m: float = 0.0) -> Any:
        return self._type["geometry_msgs/msg/Pose"](self._point(x_m, y_m, z_m), self._turn(yaw_rad))

    def estimate(self, stamp_s: float, pose: Floats, covariance: Floats) -> Any:
        about = self._type["geometry_msgs/msg/PoseWithCovariance"](self.pose(*pose.tolist()), covariance)
        return self._type["geometry_msgs/msg/PoseWithCovarianceStamped"](self.header(stamp_s), about)

    def transform(self, stamp_s: float, pose: Floats) -> Any:
        x_m, y_m, yaw_rad = pose.tolist()
        moved = self._type["geometry_msgs/msg/Transform"](self._vector(x_m, y_m, 0.0), self._turn(yaw_rad))
        stamped = self._type["geometry_msgs/msg/TransformStamped"](self.header(stamp_s), ROBOT, moved)
        return self._type["tf2_msgs/msg/TFMessage"]([stamped])

    def path(self, stamp_s: float, path: Trajectory) -> Any:
        stamped = self._type["geometry_msgs/msg/PoseStamped"]
        rows = zip(path.stamp_s.tolist(), path.T_world_robot.tolist(), strict=True)
        poses = [stamped(self.header(at_s), self.pose(*pose)) for at_s, pose in rows]
        return self._type["nav_msgs/msg/Path"](self.header(stamp_s), poses)

    def markers(self, stamp_s: float, landmarks: LandmarkMap) -> Any:
        """Those of all landmarks."""
        axes_m, angle_rad = _ellipses(landmarks.covariance_m2)
        found = []
        for row, (x_m, y_m) in enumerate(landmarks.mean_m.tolist()):
            color = _color_of(landmarks, row)
            faint = (*color[:3], 0.3 * color[3])
            post, top = self.pose(x_m, y_m, 0.0, 0.5 * _HEIGHT_M), self.pose(x_m, y_m, 0.0, 1.5 * _HEIGHT_M)
            flat = self.pose(x_m, y_m, float(angle_rad[row]))
            long_m, short_m = axes_m[row].tolist()
            marks = (
                _Mark("landmarks", _CYLINDER, post, (_POST_M, _POST_M, _HEIGHT_M), color),
                _Mark("ellipses", _SPHERE, flat, (long_m, short_m, _FLAT_M), faint),
                _Mark("names", _TEXT, top, (0.0, 0.0, _HEIGHT_M), color, landmarks.ids[row]),
            )
            found += [self._marker(stamp_s, row, mark) for mark in marks]
        return self._type["visualization_msgs/msg/MarkerArray"](found)

    def _marker(self, stamp_s: float, row: int, mark: _Mark) -> Any:
        nothing = np.zeros(0, dtype=np.uint8)
        add, forever = 0, self._type["builtin_interfaces/msg/Duration"](0, 0)
        texture = self._type["sensor_msgs/msg/CompressedImage"](self.header(stamp_s), "", nothing)
        mesh = self._type["visualization_msgs/msg/MeshFile"]("", nothing)
        return self._type["visualization_msgs/msg/Marker"](
            self.header(stamp_s),
            *(mark.namespace, row, mark.kind, add, mark.pose),
            *(self._vector(*mark.size_m), self._color(*mark.color), forever, False),
            *([], [], "", texture, [], mark.text, "", mesh, False),
        )

    def _turn(self, yaw_rad: float) -> Any:
        half = 0.5 * yaw_rad
        return self._type["geometry_msgs/msg/Quaternion"](0.0, 0.0, math.sin(half), math.cos(half))


_SPHERE, _CYLINDER, _TEXT = 2, 3, 9
"""Kinds of markers."""


@dataclass(frozen=True)
class _Mark:
    namespace: str
    kind: int
    pose: Any
    size_m: tuple[float, float, float]
    color: tuple[float, float, float, float]
    text: str = ""


def _color_of(landmarks: LandmarkMap, row: int) -> tuple[float, float, float, float]:
    """That of the class, as on the map of the report; faint where the landmark is not yet believed."""
    index = -1 if landmarks.class_index is None else int(landmarks.class_index[row])
    color = class_color(landmarks.class_name(row), index) if index >= 0 else LANDMARK
    red, green, blue = (int(color[at : at + 2], 16) / 255.0 for at in (1, 3, 5))
    is_believed = landmarks.confirmed is None or bool(landmarks.confirmed[row])
    return red, green, blue, 1.0 if is_believed else 0.3


def _ellipses(covariance_m2: Floats) -> tuple[Floats, Floats]:
    """Full lengths of the axes, the longer one first, and where that points. Shapes: (K, 2), (K,)."""
    values, vectors = np.linalg.eigh(covariance_m2.reshape(-1, 2, 2))
    lengths_m = 2.0 * SIGMAS * np.sqrt(np.maximum(values[:, ::-1], 0.0))
    return lengths_m, np.arctan2(vectors[:, 1, 1], vectors[:, 0, 1])


def _covariance(live: Trajectory, row: int) -> Floats:
    """The 36 numbers of ROS (x, y, z, and turns about them), row by row; zeros where nothing is known."""
    whole = np.zeros((6, 6))
    if live.covariance is not None:
        planar = np.array([0, 1, 5])
        whole[np.ix_(planar, planar)] = live.covariance[row]
    return whole.reshape(-1)


def _nanoseconds(stamp_s: float) -> int:
    return round(1e9 * stamp_s)

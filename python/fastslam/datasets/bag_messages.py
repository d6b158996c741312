"""Messages of bags by what they hold: odometry, detections and poses, whatever their types are called."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..identity import NOBODY_KNOWS
from ..log import Floats

POINTS = (
    ("location",),
    ("position",),
    ("point",),
    ("pose", "pose", "position"),
    ("pose", "position"),
    ("pose", "pose", "pose", "position"),
    ("tracking_from_landmark_transform", "position"),
    ("results", 0, "pose", "pose", "position"),
    ("bbox", "center", "position"),
    (),
)
"""Where a detection may say its place; the first that is there, and not all zero, counts."""
RANGES = ("range", "distance", "range_m")
BEARINGS = ("bearing", "yaw", "angle", "bearing_rad")
CLASSES = ("color", "colour", "class_id", "class_name", "label", "type")
IDENTITIES = ("id", "landmark_id", "tag_id", "marker_id", "identity")
COLOURS = ("blue", "yellow", "orange", "big_orange", "small_orange", "unknown", "red", "green", "white")
NOBODY = NOBODY_KNOWS | {"other"}


@dataclass(frozen=True)
class Detection:
    """One detection in the frame of its message: a point, and its class and identity where they are said."""

    point_m: tuple[float, float, float]
    class_name: str = ""
    identity: str = ""


def stamp_of(message: Any) -> float:
    """Seconds of the header's stamp; NaN where there is none, or where it was never set."""
    stamp = getattr(getattr(message, "header", message), "stamp", None)
    if stamp is None:
        return math.nan
    seconds = float(getattr(stamp, "sec", 0)) + 1e-9 * float(getattr(stamp, "nanosec", 0))
    return seconds if seconds > 0.0 else math.nan


def frame_of(message: Any) -> str:
    """The header's frame, without a leading slash."""
    return str(getattr(getattr(message, "header", None), "frame_id", "")).lstrip("/")


def pose_in(message: Any) -> Any:
    """The pose (position and orientation) of an Odometry or a PoseStamped, if there is one."""
    for path in (("pose", "pose"), ("pose",), ("transform",)):
        found = _follow(message, path)
        if found is not None and hasattr(found, "orientation") and hasattr(found, "position"):
            return found
    return None


def planar(pose: Any) -> tuple[float, float, float]:
    """x, y and heading of a pose."""
    rotation = matrix_of(pose.orientation)
    return float(pose.position.x), float(pose.position.y), math.atan2(rotation[1, 0], rotation[0, 0])


def twist_in(message: Any) -> tuple[float, float] | None:
    """Forward speed and yaw rate of a Twist, TwistStamped or Odometry."""
    for path in (("twist", "twist"), ("twist",), ()):
        found = _follow(message, path)
        if found is not None and hasattr(found, "linear") and hasattr(found, "angular"):
            return float(found.linear.x), float(found.angular.z)
    return None


def drive_in(message: Any) -> tuple[float, float] | None:
    """Speed and steering angle of an AckermannDrive."""
    for path in (("drive",), ()):
        found = _follow(message, path)
        if found is not None and hasattr(found, "speed") and hasattr(found, "steering_angle"):
            return float(found.speed), float(found.steering_angle)
    return None


def detections_in(message: Any, constants: Mapping[str, Mapping[int, str]]) -> list[Detection] | None:
    """The detections of a message, from all its lists of things that have a place; None where it has none.

    A list may say the class of what is in it by its name (`blue_cones`). `constants` are those of each type
    of message, by value.
    """
    found: list[Detection] = []
    lists = 0
    for name, things in _lists(message):
        of_list = _class_in_name(name)
        lists += 1
        for thing in things:
            point = _point(thing)
            if point is None:
                return None
            label = of_list or _class(thing, constants.get(getattr(thing, "__msgtype__", ""), {}))
            found.append(Detection(point, label, _identity(thing)))
    return found if lists else None


def _lists(message: Any) -> Iterator[tuple[str, Sequence[Any]]]:
    """Fields that are lists of messages, also one level down."""
    for name, value in vars(message).items():
        if isinstance(value, list) and all(hasattr(thing, "__msgtype__") for thing in value):
            yield name, value


def _point(thing: Any) -> tuple[float, float, float] | None:
    for range_name in RANGES:
        for bearing_name in BEARINGS:
            if hasattr(thing, range_name) and hasattr(thing, bearing_name):
                range_m, bearing = float(getattr(thing, range_name)), float(getattr(thing, bearing_name))
                return range_m * math.cos(bearing), range_m * math.sin(bearing), 0.0
    zero = None
    for path in POINTS:
        place = _follow(thing, path)
        if place is None or not (hasattr(place, "x") and hasattr(place, "y")):
            continue
        point = (float(place.x), float(place.y), float(getattr(place, "z", 0.0)))
        if any(point):
            return point
        zero = point
    return zero


def _class(thing: Any, constants: Mapping[int, str]) -> str:
    hypothesis = _follow(thing, ("results", 0, "hypothesis")) or _follow(thing, ("results", 0))
    for holder in (thing, hypothesis):
        for name in CLASSES:
            value = getattr(holder, name, None)
            if isinstance(value, str):
                return "" if value.lower() in NOBODY else value
            if isinstance(value, int | np.integer) and not isinstance(value, bool):
                known = constants.get(int(value), str(int(value))).lower()
                return "" if known in NOBODY else known
    return ""


def _identity(thing: Any) -> str:
    for name in IDENTITIES:
        value = getattr(thing, name, None)
        if isinstance(value, np.ndarray | list | tuple):
            value = value[0] if len(value) == 1 else None
        if isinstance(value, str) and value.lower() not in NOBODY:
            return value
        if isinstance(value, int | np.integer) and not isinstance(value, bool) and value >= 0:
            return str(int(value))
    return ""


def _class_in_name(name: str) -> str:
    """`blue` of `blue_cones`, the longest colour that begins the name; empty where none does."""
    fitting = [colour for colour in COLOURS if name.lower().startswith(colour + "_")]
    best = max(fitting, key=len, default="")
    return "" if best in NOBODY else best


def _follow(thing: Any, path: Sequence[str | int]) -> Any:
    for step in path:
        if isinstance(step, int):
            thing = thing[step] if isinstance(thing, list) and len(thing) > step else None
        else:
            thing = getattr(thing, step, None)
        if thing is None:
            return None
    return thing


def matrix_of(quaternion: Any) -> Floats:
    """The rotation (3, 3) of a quaternion; one that is all zero was never set and turns nothing."""
    x, y, z, w = (float(getattr(quaternion, name)) for name in "xyzw")
    size = math.sqrt(x * x + y * y + z * z + w * w)
    if not size > 0.0:
        return np.eye(3)
    x, y, z, w = x / size, y / size, z / size, w / size
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def transform_of(translation: Any, rotation: Any) -> Floats:
    """The matrix (4, 4) of a transform."""
    matrix = np.eye(4)
    matrix[:3, :3] = matrix_of(rotation)
    matrix[:3, 3] = [float(translation.x), float(translation.y), float(translation.z)]
    return matrix


def constants_of(fields: Mapping[str, tuple[Any, Any]]) -> dict[str, dict[int, str]]:
    """The integer constants of each type of message, by value: what a colour's number means."""
    return {
        kind: {int(value): name for name, _, value in constants if isinstance(value, int)}
        for kind, (constants, _) in fields.items()
    }

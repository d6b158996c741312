"""What is in a bag: its topics, what each may serve for, and which are taken."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..errors import ConfigError, DataError
from .bag_messages import constants_of, detections_in, drive_in, pose_in, twist_in

if TYPE_CHECKING:
    from rosbags.highlevel import AnyReader

ROLES = ("odometry", "detections", "scan", "truth")
TRUTH_WORDS = ("ground_truth", "groundtruth", "ground-truth", "truth", "mocap", "vicon", "optitrack")
"""A topic of poses with one of these in its name is taken for the truth."""
LOOKED_AT = 50
"""So many messages of a topic are looked at to say what it holds."""
TRANSFORMS = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
STATIC = "tf_static"
"""Topics of transforms that are called so hold nothing that moves."""
SCAN = "sensor_msgs/msg/LaserScan"


@dataclass(frozen=True)
class Topic:
    """A topic of a bag: what it may serve for, and otherwise why for nothing."""

    name: str
    type: str
    messages: int
    uses: tuple[str, ...] = ()
    holds: str = ""


@dataclass(frozen=True)
class Chosen:
    """The topics that are taken, by role, and what was taken for granted in choosing."""

    topics: Mapping[str, Topic]
    notes: tuple[str, ...]
    truth_frame: str = ""
    """The frame whose way is the truth, where the topic is one of transforms."""


@contextmanager
def opened(path: Path) -> Iterator[AnyReader]:
    """A reader of a bag. Errors: DataError for one that cannot be read, or without the extra `bags`."""
    try:
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore
    except ImportError:
        raise DataError("is a bag: `pip install 'rosbags>=0.11,<0.12'` lets it be read", path) from None
    with ExitStack() as stack:
        with _told_of(path):
            # Older bags hold no definitions of their messages.
            reader = AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE))
            stack.enter_context(reader)
            # The table of topics is made when it is asked for, of what the folder's description says.
            list(reader.topics)
        yield reader


@contextmanager
def _told_of(path: Path) -> Iterator[None]:
    """Whatever the readers of other formats raise on bytes that are none is one error here."""
    try:
        yield
    except Exception as error:
        said = str(error) or type(error).__name__
        raise DataError(f"cannot be read as a bag: {said}", path) from None


def topics_of(reader: AnyReader) -> list[Topic]:
    """All topics, with what the first messages of each say."""
    constants = constants_of(reader.typestore.fielddefs)
    found = []
    for name, about in sorted(reader.topics.items()):
        kind = about.msgtype or ""
        uses, holds = _use_of(reader, name, kind, constants)
        found.append(Topic(name, kind, about.msgcount, uses, holds))
    return found


def messages_on(reader: AnyReader, name: str) -> Iterator[tuple[float, Any]]:
    """The messages of a topic, with when each was recorded, in seconds.

    Errors: DataError for a message that cannot be read.
    """
    connections = [connection for connection in reader.connections if connection.topic == name]
    path = Path(str(reader.paths[0]))
    with _told_of(path):
        rows = iter(reader.messages(connections=connections) if connections else ())
    while True:
        with _told_of(path):
            row = next(rows, None)
            if row is None:
                return
            connection, recorded_ns, raw = row
            message = reader.deserialize(raw, connection.msgtype)
        yield 1e-9 * recorded_ns, message


def chosen_from(topics: list[Topic], named: Mapping[str, str], path: Path) -> Chosen:
    """A topic for each role: the one that is named, else the one with most messages.

    Errors: ConfigError for a role or a topic that is none; DataError where there is no odometry, or nothing
    that shows landmarks.
    """
    name, _, frame = named.get("truth", "").partition(":")
    named = {**named, "truth": name} if frame else named
    for role, name in named.items():
        if role not in ROLES:
            raise ConfigError(f"--topic {role}={name}: the roles are {', '.join(ROLES)}")
        fitting = [topic for topic in topics if topic.name == name]
        if not fitting:
            known = ", ".join(topic.name for topic in topics if role in topic.uses) or "none"
            raise ConfigError(f"--topic {role}={name}: no such topic; for {role} there are: {known}")
        if role not in fitting[0].uses:
            why = fitting[0].holds or fitting[0].type
            raise ConfigError(f"--topic {role}={name}: does not serve as {role} ({why})")
    taken, notes = {}, []
    truth = _truth(topics, named)
    for role in ROLES:
        usable = [topic for topic in topics if role in topic.uses]
        if role in named:
            taken[role] = next(topic for topic in usable if topic.name == named[role])
        elif role == "truth":
            if truth is not None:
                taken[role] = truth
        elif usable := [topic for topic in usable if topic != truth or role == "scan"]:
            taken[role] = max(usable, key=lambda topic: (_preference(topic, role), topic.messages))
            if len(usable) > 1:
                others = ", ".join(topic.name for topic in usable if topic != taken[role])
                notes.append(f"{role} is {taken[role].name}, not {others}: --topic {role}=NAME names another")
    if "detections" in taken and "scan" in taken and "scan" not in named:
        del taken["scan"]
    if "odometry" not in taken:
        raise DataError(
            f"no topic holds odometry; `fastslam info` lists what there is ({len(topics)} topics)", path
        )
    if not {"detections", "scan"} & set(taken):
        raise DataError(
            "no topic holds detections of landmarks or laser scans; `fastslam info` lists all", path
        )
    return Chosen(taken, tuple(notes), frame)


def _truth(topics: list[Topic], named: Mapping[str, str]) -> Topic | None:
    """What the name of a topic of poses says is the truth."""
    others = {name for role, name in named.items() if role != "truth"}
    told = [
        topic
        for topic in topics
        if "truth" in topic.uses
        and topic.type not in TRANSFORMS
        and topic.name not in others
        and any(word in topic.name.lower() for word in TRUTH_WORDS)
    ]
    return max(told, key=lambda topic: topic.messages, default=None)


def _preference(topic: Topic, role: str) -> int:
    """Of several topics of odometry, which comes first: what measures most of the motion."""
    if role != "odometry":
        return 0
    order = ("poses and twists", "twists", "speed and steering", "poses")
    return -order.index(topic.holds) if topic.holds in order else -len(order)


def _use_of(
    reader: AnyReader, name: str, kind: str, constants: Mapping[str, Mapping[int, str]]
) -> tuple[tuple[str, ...], str]:
    if kind in TRANSFORMS:
        if name.endswith(STATIC):
            return (), "static transforms: they give the mounting"
        return ("truth",), "transforms: static ones give the mounting, moving ones may be named as the truth"
    if kind.endswith("/Path"):
        # A plan or what another program estimated; its poses are no landmarks.
        return (), "a path"
    if kind == SCAN:
        return ("scan",), "laser scans"
    first = None
    for number, (_, message) in enumerate(_readable(reader, name)):
        first = message if first is None else first
        found = detections_in(message, constants)
        if found:
            return ("detections",), _said(found)
        if number >= LOOKED_AT or found is None:
            break
    if first is None:
        return (), "empty, or of a type that cannot be read"
    if drive_in(first) is not None:
        return ("odometry",), "speed and steering"
    has_pose, has_twist = pose_in(first) is not None, twist_in(first) is not None
    if has_pose or has_twist:
        holds = "poses and twists" if has_pose and has_twist else "poses" if has_pose else "twists"
        return ("odometry", "truth") if has_pose else ("odometry",), holds
    if type(first).__name__.startswith("apriltag_msgs"):
        return (), "tags in pixels, without their places"
    return (), ""


def _said(found: Any) -> str:
    extras = [
        word
        for word, there in (
            ("classes", any(detection.class_name for detection in found)),
            ("identities", any(detection.identity for detection in found)),
        )
        if there
    ]
    return "detections" + (f" with {' and '.join(extras)}" if extras else "")


def _readable(reader: AnyReader, name: str) -> Iterator[tuple[float, Any]]:
    """The messages of a topic, none where their type is not known."""
    known = reader.typestore.fielddefs
    if all(c.msgtype in known for c in reader.connections if c.topic == name):
        yield from messages_on(reader, name)

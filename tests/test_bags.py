"""Bags, written here by `rosbags` and read back; ROS 1, sqlite3 and MCAP."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import fastslam as package
import numpy as np
import pytest
from cli_runner import fastslam
from fastslam import Map
from fastslam.datasets import load
from fastslam.datasets.bag import list_topics
from fastslam.datasets.bag_messages import planar
from fastslam.datasets.native_settings import REAR_AXLE
from fastslam.errors import ConfigError, DataError
from fastslam.resultfiles import read_result
from fastslam.runner import configure
from small_log import LANDMARKS_M, make_small_log, write_small_log

pytest.importorskip("rosbags", reason="the extra `bags` is not installed")

from rosbags.highlevel import AnyReader
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

STORE = get_typestore(Stores.ROS2_HUMBLE)
STORE1 = get_typestore(Stores.ROS1_NOETIC)
CONE = """uint8 BLUE=0
uint8 YELLOW=1
uint8 UNKNOWN=4
geometry_msgs/Point location
uint8 color
"""
CUSTOM = {
    "fs_msgs/msg/Cone": CONE,
    "fs_msgs/msg/Track": "std_msgs/Header header\nfs_msgs/Cone[] cones\n",
    "eufs_msgs/msg/Cone": "geometry_msgs/Point point\nfloat64[4] covariance\n",
    "eufs_msgs/msg/Cones": "std_msgs/Header header\neufs_msgs/Cone[] blue_cones\n"
    "eufs_msgs/Cone[] yellow_cones\neufs_msgs/Cone[] unknown_color_cones\n",
    "mrpt_msgs/msg/Single": "float64 range\nfloat64 yaw\nfloat64 pitch\nint32 id\n",
    "mrpt_msgs/msg/ObservationRangeBearing": "std_msgs/Header header\nmrpt_msgs/Single[] sensed_data\n",
    "vision_msgs/msg/ObjectHypothesis": "string class_id\nfloat64 score\n",
    "vision_msgs/msg/ObjectHypothesisWithPose": "vision_msgs/ObjectHypothesis hypothesis\n"
    "geometry_msgs/PoseWithCovariance pose\n",
    "vision_msgs/msg/Detection3D": "std_msgs/Header header\nvision_msgs/ObjectHypothesisWithPose[] results\n"
    "string id\n",
    "vision_msgs/msg/Detection3DArray": "std_msgs/Header header\nvision_msgs/Detection3D[] detections\n",
    "apriltag_ros/msg/AprilTagDetection": "int32[] id\nfloat64[] size\n"
    "geometry_msgs/PoseWithCovarianceStamped pose\n",
    "apriltag_ros/msg/AprilTagDetectionArray": "std_msgs/Header header\n"
    "apriltag_ros/AprilTagDetection[] detections\n",
    "ackermann_msgs/msg/AckermannDrive": "float32 steering_angle\nfloat32 speed\n",
    "ackermann_msgs/msg/AckermannDriveStamped": "std_msgs/Header header\n"
    "ackermann_msgs/AckermannDrive drive\n",
}
for kind, text in CUSTOM.items():
    STORE.register(get_types_from_msg(text, kind))
    STORE1.register(get_types_from_msg(text, kind))

STORE1.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms\n", "tf2_msgs/msg/TFMessage"))

T = {name: STORE.types[name] for name in STORE.types}
LOG = make_small_log(steps=60)
MOUNTING = (0.8, 0.1, 0.3)


def header(stamp_s: float, frame: str) -> Any:
    stamp = T["builtin_interfaces/msg/Time"](int(stamp_s), round(1e9 * (stamp_s % 1.0)))
    made = T["std_msgs/msg/Header"](stamp, frame)
    # Those of ROS 1 have a number too.
    object.__setattr__(made, "seq", 0)
    return made


def point(x: float, y: float, z: float = 0.0) -> Any:
    return T["geometry_msgs/msg/Point"](x, y, z)


def quaternion(yaw: float = 0.0, roll: float = 0.0) -> Any:
    half, other = 0.5 * yaw, 0.5 * roll
    return T["geometry_msgs/msg/Quaternion"](
        math.cos(half) * math.sin(other),
        math.sin(half) * math.sin(other),
        math.sin(half) * math.cos(other),
        math.cos(half) * math.cos(other),
    )


def pose(x: float = 0.0, y: float = 0.0, yaw: float = 0.0, z: float = 0.0) -> Any:
    return T["geometry_msgs/msg/Pose"](point(x, y, z), quaternion(yaw))


def with_covariance(kind: str, value: Any) -> Any:
    return T[f"geometry_msgs/msg/{kind}WithCovariance"](value, np.zeros(36))


def twist(speed: float = 0.0, rate: float = 0.0) -> Any:
    vector = T["geometry_msgs/msg/Vector3"]
    return T["geometry_msgs/msg/Twist"](vector(speed, 0.0, 0.0), vector(0.0, 0.0, rate))


def odometry(stamp_s: float, place: Any, speed: float = 0.0, rate: float = 0.0) -> Any:
    return T["nav_msgs/msg/Odometry"](
        header(stamp_s, "odom"),
        "base_link",
        with_covariance("Pose", place),
        with_covariance("Twist", twist(speed, rate)),
    )


def static(frame: str, x: float, y: float, yaw: float, *, roll: float = 0.0) -> Any:
    transform = T["geometry_msgs/msg/Transform"](
        T["geometry_msgs/msg/Vector3"](x, y, 0.5), quaternion(yaw, roll)
    )
    entry = T["geometry_msgs/msg/TransformStamped"](header(0.0, "base_link"), frame, transform)
    return T["tf2_msgs/msg/TFMessage"]([entry])


Messages = list[tuple[str, float, Any]]


def write(path: Path, messages: Messages, how: str = "mcap") -> Path:
    """A bag of messages on topics; recorded a second after their stamps."""
    if how == "ros1":
        path = path.with_suffix(".bag")
        writer: Any = Writer1(path)
    else:
        plugin = StoragePlugin.MCAP if how == "mcap" else StoragePlugin.SQLITE3
        writer = Writer2(path, version=9, storage_plugin=plugin)
    store = STORE1 if how == "ros1" else STORE
    with writer:
        connections: dict[str, Any] = {}
        for topic, stamp_s, message in messages:
            kind = message.__msgtype__
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=store)
            raw = store.serialize_ros1(message, kind) if how == "ros1" else store.serialize_cdr(message, kind)
            writer.write(connections[topic], round(1e9 * (stamp_s + 1.0)), raw)
    return path


def twists() -> Messages:
    kind = T["geometry_msgs/msg/TwistStamped"]
    rows = zip(LOG.controls.stamp_s.tolist(), LOG.controls.values.tolist(), strict=True)
    return [("/wheels", 10.0 + s, kind(header(10.0 + s, "base_link"), twist(*values))) for s, values in rows]


def scans_seen() -> Iterator[tuple[float, list[tuple[int, float, float]]]]:
    """Stamp, and number, range and bearing of each sighting in the sensor's frame."""
    seen = LOG.sightings
    for stamp_s in np.unique(seen.stamp_s):
        at = np.flatnonzero(seen.stamp_s == stamp_s)
        yield (
            float(10.0 + stamp_s),
            [(int(seen.identity[i]), float(seen.range_m[i]), float(seen.bearing_rad[i])) for i in at],
        )


def track(stamp_s: float, seen: list[tuple[int, float, float]]) -> Any:
    cones = [
        T["fs_msgs/msg/Cone"](point(r * math.cos(b), r * math.sin(b)), (0, 1, 4)[number % 3])
        for number, r, b in seen
    ]
    return T["fs_msgs/msg/Track"](header(stamp_s, "lidar"), cones)


def eufs(stamp_s: float, seen: list[tuple[int, float, float]]) -> Any:
    lists: list[list[Any]] = [[], [], []]
    for number, r, b in seen:
        cone = T["eufs_msgs/msg/Cone"](point(r * math.cos(b), r * math.sin(b)), np.zeros(4))
        lists[number % 3].append(cone)
    return T["eufs_msgs/msg/Cones"](header(stamp_s, "lidar"), *lists)


def mrpt(stamp_s: float, seen: list[tuple[int, float, float]]) -> Any:
    single = T["mrpt_msgs/msg/Single"]
    return T["mrpt_msgs/msg/ObservationRangeBearing"](
        header(stamp_s, "lidar"), [single(r, b, 0.0, number) for number, r, b in seen]
    )


def vision(stamp_s: float, seen: list[tuple[int, float, float]]) -> Any:
    detections = []
    for number, r, b in seen:
        hypothesis = T["vision_msgs/msg/ObjectHypothesis"](("blue", "yellow", "unknown")[number % 3], 0.9)
        place = with_covariance("Pose", pose(r * math.cos(b), r * math.sin(b)))
        result = T["vision_msgs/msg/ObjectHypothesisWithPose"](hypothesis, place)
        detections.append(T["vision_msgs/msg/Detection3D"](header(stamp_s, "lidar"), [result], ""))
    return T["vision_msgs/msg/Detection3DArray"](header(stamp_s, "lidar"), detections)


def tags(stamp_s: float, seen: list[tuple[int, float, float]]) -> Any:
    """Of a camera: x right, y down, z ahead."""
    detections = []
    for number, r, b in seen:
        place = T["geometry_msgs/msg/Pose"](point(-r * math.sin(b), 0.4, r * math.cos(b)), quaternion())
        stamped = T["geometry_msgs/msg/PoseWithCovarianceStamped"](
            header(stamp_s, "camera_optical"), with_covariance("Pose", place)
        )
        ids = np.array([number], dtype=np.int32)
        detections.append(T["apriltag_ros/msg/AprilTagDetection"](ids, np.array([0.1]), stamped))
    return T["apriltag_ros/msg/AprilTagDetectionArray"](header(stamp_s, "camera_optical"), detections)


def detections(make: Callable[..., Any]) -> Messages:
    return [("/detections", stamp_s, make(stamp_s, seen)) for stamp_s, seen in scans_seen()]


@pytest.mark.parametrize("how", ["mcap", "sqlite3", "ros1"])
def test_a_bag_holds_what_was_written_whatever_its_container(how: str, tmp_path: Path) -> None:
    x, y, yaw = MOUNTING
    messages = [("/tf_static", 0.0, static("lidar", x, y, yaw)), *twists(), *detections(mrpt)]
    log = load(write(tmp_path / "drive", messages, how))
    assert log.format == "bag" and log.config["motion"]["model"] == "velocity"
    np.testing.assert_allclose(log.controls.stamp_s, 10.0 + LOG.controls.stamp_s, atol=1e-6)
    np.testing.assert_allclose(log.controls.values, LOG.controls.values)
    np.testing.assert_allclose(log.sightings.stamp_s, 10.0 + LOG.sightings.stamp_s, atol=1e-6)
    np.testing.assert_allclose(log.sightings.range_m, LOG.sightings.range_m)
    np.testing.assert_allclose(log.sightings.bearing_rad, LOG.sightings.bearing_rad, atol=1e-12)
    assert [log.identity_names[i] for i in log.sightings.identity] == [str(i) for i in LOG.sightings.identity]
    mounting = log.config["sensor"]["mounting"]
    assert [mounting[key] for key in ("x_m", "y_m", "yaw_rad")] == pytest.approx([x, y, yaw])


@pytest.mark.parametrize("make", [track, eufs, vision])
def test_cones_have_classes_by_number_list_and_text(make: Callable[..., Any], tmp_path: Path) -> None:
    messages = [("/tf_static", 0.0, static("lidar", 0.0, 0.0, 0.0)), *twists(), *detections(make)]
    log = load(write(tmp_path / "drive", messages))
    assert sorted(log.class_names) == ["blue", "yellow"] and log.identity_names == ()
    assert log.config["association"]["classes"]["number"] == 2
    order = np.lexsort((log.sightings.range_m, log.sightings.stamp_s))
    expected = np.lexsort((LOG.sightings.range_m, LOG.sightings.stamp_s))
    np.testing.assert_allclose(log.sightings.range_m[order], LOG.sightings.range_m[expected])
    np.testing.assert_allclose(
        log.sightings.bearing_rad[order], LOG.sightings.bearing_rad[expected], atol=1e-9
    )
    said = ["" if c < 0 else log.class_names[c] for c in log.sightings.class_index[order]]
    assert said == [("blue", "yellow", "")[i % 3] for i in LOG.sightings.identity[expected]]


def test_tags_of_a_camera_are_turned_into_the_plane(tmp_path: Path) -> None:
    log = load(write(tmp_path / "drive", [*twists(), *detections(tags)]))
    np.testing.assert_allclose(log.sightings.range_m, LOG.sightings.range_m)
    np.testing.assert_allclose(log.sightings.bearing_rad, LOG.sightings.bearing_rad, atol=1e-9)
    assert set(log.identity_names) == {str(k) for k in range(len(LANDMARKS_M))}
    assert any("no static transform" in note and "z axis ahead" in note for note in log.notes)


def test_odometry_by_poses_twists_and_steering_and_a_path_that_is_the_truth(tmp_path: Path) -> None:
    truth = LOG.truth_trajectory
    assert truth is not None
    rows = list(zip(truth.stamp_s.tolist(), truth.T_world_robot.tolist(), strict=True))
    poses: Messages = [("/odom", s, odometry(s, pose(*place), 1.0, 0.25)) for s, place in rows]
    stamped = T["geometry_msgs/msg/PoseStamped"]
    true: Messages = [("/ground_truth/pose", s, stamped(header(s, "map"), pose(*place))) for s, place in rows]
    see: Messages = [("/detections", s - 10.0, mrpt(s - 10.0, seen)) for s, seen in scans_seen()]
    log = load(write(tmp_path / "poses", [*poses, *true, *see]))
    assert log.config["motion"]["model"] == "odometry" and log.truth_trajectory is not None
    np.testing.assert_allclose(log.truth_trajectory.T_world_robot, truth.T_world_robot, atol=1e-9)
    step = log.controls.values[5]
    assert step == pytest.approx([0.1, 0.00125, 0.025], abs=1e-4) and not log.controls.values[0].any()
    still: Messages = [("/odom", s, odometry(s, pose(), 1.0, 0.25)) for s, _ in rows]
    log = load(write(tmp_path / "still", [*still, *see]))
    assert log.config["motion"]["model"] == "velocity" and log.controls.values[3] == pytest.approx(
        [1.0, 0.25]
    )
    drive, stamped_drive = (
        T["ackermann_msgs/msg/AckermannDrive"],
        T["ackermann_msgs/msg/AckermannDriveStamped"],
    )
    car: Messages = [("/car", s, stamped_drive(header(s, ""), drive(0.1, 2.0))) for s, _ in rows]
    log = load(write(tmp_path / "car", [*car, *see]))
    assert log.config["motion"] == {"model": "ackermann"} | REAR_AXLE
    assert any("rear axle" in note for note in log.notes)
    assert log.controls.values[0] == pytest.approx([2.0, 0.1])


def moved(stamp_s: float, parent: str, frame: str, place: Any) -> Any:
    about = T["geometry_msgs/msg/Transform"](
        T["geometry_msgs/msg/Vector3"](float(place[0]), float(place[1]), 0.0), quaternion(float(place[2]))
    )
    entry = T["geometry_msgs/msg/TransformStamped"](header(stamp_s, parent), frame, about)
    return T["tf2_msgs/msg/TFMessage"]([entry])


def test_transforms_that_are_named_give_the_truth(tmp_path: Path) -> None:
    truth = LOG.truth_trajectory
    assert truth is not None
    rows = [(10.0 + s, p) for s, p in zip(truth.stamp_s.tolist(), truth.T_world_robot.tolist(), strict=True)]
    # A room that stands in the world turned by 90 degrees, with a table in it that is pushed once.
    room: Messages = [
        ("/tf_static", 0.0, moved(0.0, "world", "room", (1.0, 2.0, 0.5 * math.pi))),
        ("/tf", rows[0][0], moved(rows[0][0], "room", "table", (0.0, 0.0, 0.0))),
        ("/tf", rows[20][0], moved(rows[20][0], "room", "table", (0.5, 0.0, 0.0))),
    ]
    captured = [("/tf", s, moved(s, "table", "base_link", p)) for s, p in rows]
    drifted = [("/tf", s, moved(s, "odom", "wheels", (0.1 * s, 0.0, 0.0))) for s, _ in rows]
    bag = write(tmp_path / "drive", [*room, *captured, *drifted, *twists(), *detections(mrpt)])
    assert load(bag).truth_trajectory is None, "transforms may be those of odometry"
    uses = {topic.name: topic.uses for topic in list_topics(bag)}
    assert (uses["/tf"], uses["/tf_static"]) == (("truth",), ()), "nothing moves in the latter"
    log = load(bag, topics={"truth": "/tf"})
    found = log.truth_trajectory
    assert found is not None and any("truth is base_link in world" in note for note in log.notes)
    np.testing.assert_allclose(found.stamp_s, 10.0 + truth.stamp_s, atol=1e-6)
    x, y, heading = truth.T_world_robot.T
    x = x + np.where(np.arange(len(x)) >= 20, 0.5, 0.0)
    np.testing.assert_allclose(found.T_world_robot[:, :2], np.column_stack([1.0 - y, 2.0 + x]), atol=1e-9)
    turned = np.remainder(found.T_world_robot[:, 2] - heading, 2.0 * math.pi)
    np.testing.assert_allclose(turned, 0.5 * math.pi, atol=1e-9)
    other = load(bag, topics={"truth": "/tf:wheels"}).truth_trajectory
    assert other is not None
    np.testing.assert_allclose(other.T_world_robot[:, 0], 0.1 * other.stamp_s, atol=1e-9)
    for named in ("/tf:room", "/tf:nosuch"):
        with pytest.raises(ConfigError, match="those that move are: base_link, table, wheels"):
            load(bag, topics={"truth": named})
    outcome = fastslam("run", bag, "--topic", "truth=/tf", "--out", tmp_path / "out", "--no-report")
    assert outcome.exit_code == 0, outcome.stderr
    assert "ate_rmse_m" in json.loads((tmp_path / "out" / "metrics.json").read_text())


def test_a_path_is_no_sight_of_landmarks(tmp_path: Path) -> None:
    stamped = T["geometry_msgs/msg/PoseStamped"]
    plan = [stamped(header(10.0, "map"), pose(float(k), 0.0)) for k in range(9)]
    message = T["nav_msgs/msg/Path"](header(10.0, "map"), plan)
    bag = write(tmp_path / "drive", [*twists(), *detections(mrpt), *[("/plan", 10.0, message)] * 99])
    assert len(load(bag).sightings.stamp_s) == len(LOG.sightings.stamp_s)


def read_messages(bag: Path) -> dict[str, list[tuple[int, Any]]]:
    """All messages by topic, with when they were recorded, in nanoseconds."""
    found: dict[str, list[tuple[int, Any]]] = {}
    with AnyReader([bag]) as reader:
        for connection, stamp_ns, raw in reader.messages():
            message = reader.deserialize(raw, connection.msgtype)
            found.setdefault(connection.topic, []).append((stamp_ns, message))
    return found


def test_results_are_a_bag_that_viewers_read(tmp_path: Path) -> None:
    log = load(write(tmp_path / "drive", [*twists(), *detections(vision)]))
    few = {"filter": {"particles": 20}, "association": {"mode": "unknown"}}
    result = package.run(log, few)
    file = result.to_mcap(tmp_path / "run.mcap")
    assert [path.name for path in tmp_path.iterdir() if "mcap" in path.name] == ["run.mcap"]
    found = read_messages(file)
    assert {topic: len(messages) for topic, messages in found.items()} == {
        **dict.fromkeys(("/landmarks", "/path"), 1),
        **dict.fromkeys(("/pose", "/tf"), len(result.trajectory.stamp_s)),
    }
    live = result.trajectory
    assert live.covariance is not None
    for row, (stamp_ns, message) in enumerate(found["/pose"]):
        assert stamp_ns == round(1e9 * live.stamp_s[row]) and message.header.frame_id == "map"
        assert planar(message.pose.pose) == pytest.approx(live.T_world_robot[row], abs=1e-9)
        covariance = message.pose.covariance.reshape(6, 6)[np.ix_([0, 1, 5], [0, 1, 5])]
        np.testing.assert_array_equal(covariance, live.covariance[row])
    path = found["/path"][0][1].poses
    np.testing.assert_allclose([planar(p.pose) for p in path], result.path.T_world_robot, atol=1e-9)
    marks = {(mark.ns, mark.id): mark for mark in found["/landmarks"][0][1].markers}
    assert len(marks) == 3 * len(result.landmarks.ids) > 9
    for row, name in enumerate(result.landmarks.ids):
        post, ellipse = marks["landmarks", row], marks["ellipses", row]
        assert (post.pose.position.x, post.pose.position.y) == tuple(result.landmarks.mean_m[row])
        turn = planar(ellipse.pose)[2]
        axes = np.array([[math.cos(turn), -math.sin(turn)], [math.sin(turn), math.cos(turn)]])
        half = np.diag([ellipse.scale.x, ellipse.scale.y]) / 4.0
        np.testing.assert_allclose(axes @ half**2 @ axes.T, result.landmarks.covariance_m2[row], atol=1e-12)
        assert marks["names", row].text == name
    colors = {(mark.color.r, mark.color.g, mark.color.b) for mark in marks.values()}
    assert len(colors) == 3, "blue, yellow, and those of which nobody says"
    # What is written can be the odometry or the truth of another run.
    says = fastslam("info", file, "--json")
    assert {t["name"]: t["uses"] for t in json.loads(says.stdout)["topics"]}["/pose"] == ["odometry", "truth"]
    early = replace(live, stamp_s=live.stamp_s - 100.0)
    with pytest.raises(DataError, match="stamps of ROS are from 0"):
        replace(result, trajectory=early).to_mcap(file)
    with pytest.raises(DataError, match="cannot write"):
        result.to_mcap(tmp_path / "nosuch" / "run.mcap")


def test_another_reader_finds_the_same_in_results(tmp_path: Path) -> None:
    """That of the format's own project, which shares no code with the writer."""
    reader = pytest.importorskip("mcap.reader", reason="needs mcap-ros2-support")
    decoder = pytest.importorskip("mcap_ros2.decoder", reason="needs mcap-ros2-support")
    result = package.run(make_small_log(steps=60), {"filter": {"particles": 10}})
    file = result.to_mcap(tmp_path / "run.mcap")
    with file.open("rb") as stream:
        whole = reader.make_reader(stream, decoder_factories=[decoder.DecoderFactory()], validate_crcs=True)
        assert whole.get_header().profile == "ros2"
        found: dict[str, list[tuple[Any, Any]]] = {}
        for schema, channel, message, said in whole.iter_decoded_messages():
            assert (schema.encoding, channel.message_encoding) == ("ros2msg", "cdr")
            found.setdefault(channel.topic, []).append((message.log_time, said))
    live = result.trajectory
    assert live.covariance is not None and len(live.stamp_s) == 12
    assert [stamp_ns for stamp_ns, _ in found["/pose"]] == [round(1e9 * stamp_s) for stamp_s in live.stamp_s]
    for row, ((_, said), (_, moved)) in enumerate(zip(found["/pose"], found["/tf"], strict=True)):
        assert planar(said.pose.pose) == pytest.approx(live.T_world_robot[row], abs=1e-9)
        covariance = np.reshape(said.pose.covariance, (6, 6))[np.ix_([0, 1, 5], [0, 1, 5])]
        np.testing.assert_array_equal(covariance, live.covariance[row])
        (transform,) = moved.transforms
        assert (transform.header.frame_id, transform.child_frame_id) == ("map", "base_link")
        shift = transform.transform.translation
        assert (shift.x, shift.y) == tuple(live.T_world_robot[row, :2])
    poses = [planar(stamped.pose) for stamped in found["/path"][0][1].poses]
    np.testing.assert_allclose(poses, result.path.T_world_robot, atol=1e-9)
    names = [mark for mark in found["/landmarks"][0][1].markers if mark.ns == "names"]
    assert [mark.text for mark in names] == list(result.landmarks.ids)
    at = [(mark.pose.position.x, mark.pose.position.y) for mark in names]
    np.testing.assert_array_equal(at, result.landmarks.mean_m)


def test_export_writes_what_the_name_says(tmp_path: Path) -> None:
    log = write_small_log(tmp_path / "log", steps=60)
    out = tmp_path / "out"
    assert fastslam("run", log, "--out", out, "--no-report", "--particles", 10).exit_code == 0
    for name, says in (
        ("a.mcap", "poses, "),
        ("a.tum", "12 poses"),
        ("a.csv", "12 poses"),
        ("a.geojson", "in metres"),
    ):
        outcome = fastslam("export", out, tmp_path / name)
        assert outcome.exit_code == 0 and says in outcome.stdout, outcome.stdout + outcome.stderr
    assert (tmp_path / "a.tum").read_text() == (out / "smoothed.tum").read_text()
    header, *lines = (tmp_path / "a.csv").read_text().splitlines()
    assert header == "stamp_s,x_m,y_m,heading_rad" and len(lines) == 12
    table = np.array([line.split(",") for line in lines], dtype=float)
    smoothed = read_result(out).smoothed
    np.testing.assert_allclose(table, np.column_stack([smoothed.stamp_s, smoothed.T_world_robot]), rtol=1e-8)
    assert fastslam("export", out, tmp_path / "l.csv", "--path", "live").exit_code == 0
    assert (tmp_path / "l.csv").read_text() != (tmp_path / "a.csv").read_text()
    assert fastslam("export", out, tmp_path / "l.csv", "--path", "best").exit_code == 2
    outcome = fastslam("export", out, tmp_path / "Trees_Map.csv")
    chart = read_result(out).map
    assert f"{len(chart.role)} landmarks; --path" in outcome.stdout
    assert Map.load(tmp_path / "Trees_Map.csv").landmarks.ids == chart.landmarks.ids
    fastslam("export", out, tmp_path / "map.csv", "--path", "live")
    assert (tmp_path / "map.csv").read_text() == (tmp_path / "l.csv").read_text()
    chart.save(tmp_path / "yard.map")
    for source in ("yard.map", "Trees_Map.csv"):
        fastslam("export", tmp_path / source, tmp_path / "b.csv").assert_one_line_error(
            exit_code=1, contains="`fastslam map export` is for maps"
        )
    assert len(read_messages(tmp_path / "a.mcap")["/pose"]) > 10
    shapes = json.loads((tmp_path / "a.geojson").read_text())["features"]
    assert [shape["geometry"]["type"] for shape in shapes].count("LineString") == 1


@pytest.mark.parametrize("roll", [0.0, math.pi])
def test_scans_keep_their_geometry_also_upside_down(roll: float, tmp_path: Path) -> None:
    scan = T["sensor_msgs/msg/LaserScan"]
    ranges = np.linspace(1.0, 4.0, 31, dtype=np.float32)
    messages: Messages = [("/tf_static", 0.0, static("laser", 0.2, 0.0, 0.0, roll=roll)), *twists()]
    for k in range(3):
        s = 10.0 + k
        message = scan(
            header(s, "laser"), -1.5, 1.5, 0.1, 0.0, 1.0, 0.1, 8.0, ranges, np.array([], np.float32)
        )
        messages.append(("/scan", s, message))
    log = load(write(tmp_path / "drive", messages))
    assert log.scans is not None and log.scans.ranges_m.shape == (3, 31)
    geometry = log.scans.geometry
    assert (geometry.first_angle_rad, geometry.angle_step_rad) == pytest.approx((-1.5, 0.1), abs=1e-6)
    expected = ranges if roll == 0.0 else ranges[::-1]
    np.testing.assert_array_equal(log.scans.ranges_m[0], expected)
    assert log.scans.mounting == pytest.approx((0.2, 0.0, 0.0))
    # What a run is told before anything is detected is what it needs afterwards.
    settings = configure(log)
    assert settings["association"]["mode"] == "unknown"
    assert settings["sensor"]["mounting"]["x_m"] == pytest.approx(0.2)
    # Eight metres to a surface, and half of the largest trunk.
    reach = settings["sensor"]["max_range_m"], settings["sensor"]["field_of_view_rad"]
    assert reach == pytest.approx((9.0, 3.0), abs=1e-5)
    done = fastslam("convert", tmp_path / "drive", tmp_path / "log")
    assert done.exit_code == 0 and "3 scans" in done.stdout
    again = load(tmp_path / "log")
    assert again.scans is not None and configure(again) == settings
    np.testing.assert_array_equal(again.scans.ranges_m, log.scans.ranges_m)


def test_one_command_runs_a_bag_and_eval_finds_it_again(tmp_path: Path) -> None:
    bag = write(tmp_path / "drive", [*twists(), *detections(mrpt), *detections_elsewhere()])
    out = tmp_path / "out"
    topic = ("--topic", "detections=/detections")
    outcome = fastslam("run", bag, "--out", out, "--no-report", "--particles", 10, *topic)
    assert outcome.exit_code == 0, outcome.stderr
    assert json.loads((out / "metrics.json").read_text())["landmarks"] == len(LANDMARKS_M)
    assert fastslam("eval", out).exit_code == 0
    outcome = fastslam("info", bag, "--json")
    topics = json.loads(outcome.stdout)["topics"]
    assert {topic["name"]: topic["uses"] for topic in topics} == {
        "/wheels": ["odometry"],
        "/detections": ["detections"],
        "/elsewhere": ["detections"],
    }
    shown = fastslam("info", bag).stdout
    assert "/elsewhere" in shown and "serves for" in shown and "no problems found" in shown
    assert fastslam("convert", bag, tmp_path / "log", *topic).exit_code == 0
    assert load(tmp_path / "log").sightings.range_m.shape == LOG.sightings.range_m.shape


def detections_elsewhere() -> Messages:
    return [("/elsewhere", s, message) for _, s, message in detections(mrpt)[:3]]


def test_what_cannot_be_used_is_said_in_one_line(tmp_path: Path) -> None:
    bag = write(tmp_path / "drive", [*twists(), *detections(mrpt)])
    for named, says in (
        ({"odometry": "/nothing"}, "for odometry there are: /wheels"),
        ({"odometry": "/detections"}, "does not serve as odometry"),
        ({"wheels": "/wheels"}, "the roles are odometry"),
    ):
        with pytest.raises(ConfigError, match=says):
            load(bag, topics=named)
    with pytest.raises(DataError, match="no topic holds odometry"):
        load(write(tmp_path / "seen", detections(mrpt)))
    with pytest.raises(DataError, match="no topic holds detections"):
        load(write(tmp_path / "driven", twists()))
    outcome = fastslam("run", bag, "--topic", "odometry")
    outcome.assert_one_line_error(exit_code=2, contains="expected role=name")
    # What holds no odometry is listed all the same.
    assert "/detections" in fastslam("info", tmp_path / "seen").stdout


@pytest.mark.parametrize("how", ["mcap", "sqlite3", "ros1"])
def test_a_bag_that_is_cut_off_is_a_one_line_error(how: str, tmp_path: Path) -> None:
    bag = write(tmp_path / "drive", [*twists(), *detections(mrpt)], how)
    file = bag if bag.is_file() else next(child for child in bag.iterdir() if child.suffix != ".yaml")
    whole = file.read_bytes()
    for share in (0.05, 0.3, 0.6, 0.95):
        file.write_bytes(whole[: int(share * len(whole))])
        outcome = fastslam("run", bag, "--out", tmp_path / "out", "--no-report", "--particles", 5)
        if outcome.exit_code != 0:
            outcome.assert_one_line_error(exit_code=1, contains="drive")
    assert outcome.exit_code in (0, 1)
    file.write_bytes(b"#ROSBAG V2.0\n" + b"\xff" * 400)
    outcome = fastslam("info", file if how == "ros1" else bag)
    outcome.assert_one_line_error(exit_code=1, contains="drive")


def test_a_count_that_is_a_word_is_a_one_line_error(tmp_path: Path) -> None:
    bag = write(tmp_path / "drive", [*twists(), *detections(mrpt)], "mcap")
    about = bag / "metadata.yaml"
    about.write_text(re.sub(r"message_count: \d+", "message_count: many", about.read_text()))
    fastslam("info", bag).assert_one_line_error(exit_code=1, contains="drive")

"""A log written in another format and read again says the same."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cli_runner import fastslam
from fastslam import convert, load
from fastslam.config import without_detector
from fastslam.datasets import write_native
from fastslam.dead_reckoning import path_of_odometry
from fastslam.detection import detect
from fastslam.errors import DataError
from fastslam.events import event_lines
from fastslam.live import tell
from fastslam.log import Controls, Log, Sightings
from fastslam.robot import Robot
from fastslam.runner import configure, run
from fastslam.scanner import Scanner
from small_log import make_small_log
from test_detection import log_of_posts

UPPER = np.triu_indices(3)


def random_covariances(rng: np.random.Generator, count: int, size: int) -> Any:
    """Well-conditioned ones, as upper triangles."""
    roots = rng.normal(0.0, 0.1, (count, size, size)) + 0.2 * np.eye(size)
    rows, columns = np.triu_indices(size)
    return (roots @ roots.swapaxes(1, 2))[:, rows, columns]


def graph_like_log(seed: int, *, with_covariances: bool) -> Log:
    """Displacements with sightings from their ends, and from the start; stamps are not evenly spaced."""
    rng = np.random.default_rng(seed)
    steps, seen = 40, 90
    stamps = np.cumsum(rng.uniform(0.1, 2.0, steps + 1))
    values = np.column_stack(
        [rng.normal(1, 0.3, steps), rng.normal(0, 0.1, steps), rng.uniform(-3, 3, steps)]
    )
    place = np.sort(np.concatenate([[0], rng.integers(0, steps + 1, seen - 1)]))
    identity = rng.integers(0, 5, seen)
    order = {who: index for index, who in enumerate(dict.fromkeys(identity.tolist()))}
    sightings = Sightings(
        stamp_s=stamps[place],
        range_m=rng.uniform(0.5, 20, seen),
        bearing_rad=rng.uniform(-np.pi, np.pi, seen),
        identity=np.array([order[who] for who in identity.tolist()]),
        class_index=np.full(seen, -1, dtype=np.int64),
        signature=np.full(seen, np.nan),
        covariance=random_covariances(rng, seen, 2) if with_covariances else None,
    )
    motion = {"model": "increments", "x_std_m": 0.05, "y_std_m": 0.04, "heading_std_rad": 0.03}
    sensor = {"model": "range_bearing", "range_std_m": 0.1, "bearing_std_rad": 0.02}
    return Log(
        name="graph",
        source="made by a test",
        format="native",
        controls=Controls(
            stamps[1:], values, covariance=random_covariances(rng, steps, 3) if with_covariances else None
        ),
        sightings=sightings,
        identity_names=("post a", "7", "#3", "12", "b")[: len(order)],
        config={
            "motion": motion,
            "sensor": sensor,
            "initial_pose": {"x_m": 3.0, "y_m": -2.0, "heading_rad": 1.0},
        },
    )


@pytest.mark.parametrize("with_covariances", [False, True])
def test_native_to_g2o_to_native_is_the_same_log(tmp_path: Path, with_covariances: bool) -> None:
    """To rounding: products and inverses of well-conditioned matrices lose a few digits of sixteen."""
    for seed in range(5):
        log = graph_like_log(seed, with_covariances=with_covariances)
        native = write_native(log, tmp_path / f"in{seed}")
        graph = convert(native, tmp_path / f"graph{seed}.g2o")
        back = load(convert(graph, tmp_path / f"out{seed}"))
        np.testing.assert_array_equal(back.controls.stamp_s, log.controls.stamp_s)
        np.testing.assert_array_equal(back.controls.values, log.controls.values)
        np.testing.assert_array_equal(back.sightings.stamp_s, log.sightings.stamp_s)
        np.testing.assert_allclose(back.sightings.range_m, log.sightings.range_m, rtol=1e-14)
        np.testing.assert_allclose(back.sightings.bearing_rad, log.sightings.bearing_rad, atol=1e-14)
        names = [log.identity_names[index] for index in log.sightings.identity]
        assert [back.identity_names[index] for index in back.sightings.identity] == names
        assert back.config["initial_pose"] == log.config["initial_pose"]
        assert back.controls.covariance is not None and back.sightings.covariance is not None
        if with_covariances:
            np.testing.assert_allclose(back.controls.covariance, log.controls.covariance, atol=1e-11)
            np.testing.assert_allclose(back.sightings.covariance, log.sightings.covariance, atol=1e-9)
        else:
            assert back.config["motion"] == log.config["motion"]
            assert back.config["sensor"] == log.config["sensor"]


def test_mounting_of_the_sensor_goes_into_the_points(tmp_path: Path) -> None:
    log = graph_like_log(7, with_covariances=False)
    mounted = {
        **log.config,
        "sensor": {**log.config["sensor"], "mounting": {"x_m": 0.5, "y_m": -0.2, "yaw_rad": 2.0}},
    }
    back = load(convert(replace(log, config=mounted), tmp_path / "mounted.g2o"))
    direction = log.sightings.bearing_rad + 2.0
    x = 0.5 + log.sightings.range_m * np.cos(direction)
    y = -0.2 + log.sightings.range_m * np.sin(direction)
    np.testing.assert_allclose(back.sightings.range_m, np.hypot(x, y), rtol=1e-13)
    np.testing.assert_allclose(
        np.exp(1j * back.sightings.bearing_rad), np.exp(1j * np.arctan2(y, x)), atol=1e-13
    )


def straight(*, seen_s: tuple[float, ...]) -> Log:
    """1 m/s straight ahead for 10 s in rows of 0.1 s; white noise of 0.1 m/s held for a second."""
    log = make_small_log(steps=10)
    stamps = 0.1 * np.arange(101)
    one = np.zeros(len(seen_s), dtype=np.int64)
    seen = np.array(seen_s)
    sightings = Sightings(
        seen, np.ones(len(seen)), np.zeros(len(seen)), one, one - 1, np.full(len(seen), np.nan)
    )
    motion = {
        "model": "velocity",
        "speed_std_m_per_s": 0.1,
        "yaw_rate_std_rad_per_s": 0.05,
        "noise_period_s": 1.0,
    }
    return replace(
        log,
        controls=Controls(stamps, np.tile([1.0, 0.0], (101, 1))),
        sightings=sightings,
        identity_names=("post0",),
        config={**log.config, "motion": motion},
        truth_trajectory=None,
    )


def test_controls_between_sightings_become_one_edge_with_their_noise(tmp_path: Path) -> None:
    """In t seconds white noise makes a variance of 0.1² t along, 0.05² t in heading, 0.05² t³ / 3 across."""
    log = straight(seen_s=(2.0, 6.0))
    path = path_of_odometry(log)
    np.testing.assert_allclose(path.stamp_s, [0.0, 2.0, 6.0, 10.0])
    np.testing.assert_allclose(path.increments, [[2, 0, 0], [4, 0, 0], [4, 0, 0]], atol=1e-12)
    assert path.covariance is not None
    for row, duration_s in enumerate((2.0, 4.0, 4.0)):
        along, across, heading = path.covariance[row, [0, 3, 5]]
        assert along == pytest.approx(0.01 * duration_s, rel=1e-9)
        assert heading == pytest.approx(0.0025 * duration_s, rel=1e-9)
        # Rows of 0.1 s, whose turn comes before or after their way: within one row of the integral.
        assert across == pytest.approx(0.0025 * duration_s**3 / 3, rel=2 * 0.1 / duration_s)
    back = load(convert(log, tmp_path / "straight.g2o"))
    np.testing.assert_allclose(back.controls.values, path.increments, atol=1e-12)
    np.testing.assert_allclose(back.controls.covariance, path.covariance, rtol=1e-6, atol=1e-12)


def test_tum_is_the_true_path_or_that_of_odometry(tmp_path: Path) -> None:
    log = make_small_log(steps=50)
    assert log.truth_trajectory is not None
    rows = np.loadtxt(convert(log, tmp_path / "truth.tum"))
    np.testing.assert_array_equal(
        rows[:, :3],
        np.column_stack([log.truth_trajectory.stamp_s, log.truth_trajectory.T_world_robot[:, :2]]),
    )
    rows = np.loadtxt(convert(straight(seen_s=(2.0, 6.0)), tmp_path / "odometry.tum"))
    np.testing.assert_allclose(rows[:, :3], [[0, 0, 0], [2, 2, 0], [6, 6, 0], [10, 10, 0]], atol=1e-12)


def test_what_a_format_cannot_hold_is_refused(tmp_path: Path) -> None:
    log = graph_like_log(1, with_covariances=False)
    nobody = replace(log.sightings, identity=np.where(np.arange(90) < 3, -1, log.sightings.identity))
    with pytest.raises(DataError, match="3 of 90 sightings name no landmark, and a graph needs names"):
        convert(replace(log, sightings=nobody), tmp_path / "a.g2o")
    assert not (tmp_path / "a.g2o").exists()
    with pytest.raises(DataError, match=r"suffix \.csv stands for no format: name one of native, g2o, tum"):
        convert(log, tmp_path / "a.csv")
    with pytest.raises(DataError, match=r"cannot write the format las; written are native, g2o, tum"):
        convert(log, tmp_path / "a", to="las")
    convert(log, tmp_path / "a.txt", to="tum")
    with pytest.raises(DataError, match=r"a\.txt: exists already: choose another"):
        convert(log, tmp_path / "a.txt", to="g2o")
    with pytest.raises(DataError, match="has no motion model"):
        convert(replace(log, config={}), tmp_path / "b.tum")


def test_covariances_of_motion_are_checked_by_row(tmp_path: Path) -> None:
    folder = write_native(graph_like_log(2, with_covariances=True), tmp_path / "log")
    lines = (folder / "odometry.csv").read_text().splitlines()
    cells = lines[4].split(",")
    for spoilt, pattern in (
        ([*cells[:4], "-1", *cells[5:]], r"odometry\.csv:5: covariance: got .*positive definite"),
        ([*cells[:4], "", *cells[5:]], r"odometry\.csv:5: covariance: got .*six empty cells"),
    ):
        (folder / "odometry.csv").write_text("\n".join([*lines[:4], ",".join(spoilt), *lines[5:]]) + "\n")
        with pytest.raises(DataError, match=pattern):
            load(folder)
    (folder / "odometry.csv").write_text("\n".join(",".join(line.split(",")[:-1]) for line in lines) + "\n")
    with pytest.raises(DataError, match=r"odometry\.csv:1: has x_variance_m2 but not heading_variance_rad2"):
        load(folder)


def test_command_converts_and_says_what_it_wrote(tmp_path: Path) -> None:
    folder = write_native(graph_like_log(4, with_covariances=True), tmp_path / "log")
    done = fastslam("convert", folder, tmp_path / "graph.g2o")
    assert done.exit_code == 0 and "graph.g2o: 90 sightings; no truth" in done.stdout
    done = fastslam("convert", tmp_path / "graph.g2o", tmp_path / "again", "--to", "native")
    assert done.exit_code == 0 and "again: 40 controls, 90 sightings" in done.stdout
    fastslam("convert", folder, tmp_path / "graph.g2o").assert_one_line_error(
        exit_code=1, contains="exists already"
    )


def test_events_of_a_log_drive_a_robot_to_the_bits_of_a_run(tmp_path: Path) -> None:
    log = make_small_log(steps=80)
    write_native(log, tmp_path / "log")
    outcome = fastslam("convert", tmp_path / "log", tmp_path / "events.jsonl")
    assert outcome.exit_code == 0 and "81 controls, 96 sightings; without truth" in outcome.stdout
    lines = (tmp_path / "events.jsonl").read_text().splitlines()
    assert len(lines) == 81 + 16
    robot = Robot(configure(log), identities="all")
    for line in lines:
        tell(robot, line)
    robot.end()
    result = run(log, robot.config)
    assert set(robot.landmarks.ids) == set(log.identity_names)
    np.testing.assert_array_equal(robot.path.T_world_robot, result.smoothed.T_world_robot)
    again = fastslam("convert", tmp_path / "log", tmp_path / "events.jsonl")
    assert again.exit_code == 1 and "exists" in again.stderr


def test_events_tell_classes_sensors_and_covariances() -> None:
    log = make_small_log(steps=20)
    rng = np.random.default_rng(2)
    count = len(log.sightings.stamp_s)
    index = np.arange(count) % 2
    seen = replace(log.sightings, sensor_index=index, class_index=rng.integers(-1, 2, count))
    covariance = random_covariances(rng, len(log.controls.stamp_s), 3)
    log = replace(
        log,
        sightings=seen,
        sensor_names=("rear", "front"),
        class_names=("blue", "yellow"),
        controls=replace(log.controls, covariance=covariance),
        config={
            "motion": log.config["motion"],
            "sensors": {"rear": {"mounting": {"yaw_rad": 3.0}}, "front": {}},
            "association": {"mode": "unknown", "classes": {"number": 2}},
        },
    )
    events = [json.loads(line) for line in event_lines(log, configure(log))]
    assert [event["t"] for event in events] == sorted(event["t"] for event in events)
    told = [event for event in events if "see" in event]
    assert [event["sensor"] for event in told] == ["front", "rear"] * 4 and len(told) == 8
    labels = {sighting[2] for event in told for sighting in event["see"] if len(sighting) == 3}
    assert labels == {"blue", "yellow"} and sum(len(event["see"]) for event in told) == count
    covariances = np.array([event["cov"] for event in events if "cov" in event])
    np.testing.assert_array_equal(covariances[:, UPPER[0], UPPER[1]], covariance)
    np.testing.assert_array_equal(covariances, covariances.swapaxes(1, 2))
    robot = Robot(configure(log), classes=log.class_names)
    assert not any(isinstance(tell(robot, json.dumps(event)), str) for event in events)
    ranges = replace(log, config={"sensor": {"model": "range"}}, sensor_names=())
    with pytest.raises(DataError, match="have a range and a bearing"):
        list(event_lines(ranges, configure(ranges)))


def test_events_of_a_laser_are_its_turns() -> None:
    log = log_of_posts()
    assert log.scans is not None
    events = [json.loads(line) for line in event_lines(log, configure(log))]
    turns = [event for event in events if "scan" in event]
    assert len(turns) == len(log.scans.stamp_s) > 0
    robot = Robot(without_detector(configure(log)), identities="none", scanner=Scanner.of(log))
    for event in events:
        tell(robot, json.dumps(event))
    robot.end()
    assert robot.landmarks.sightings.sum() == len(detect(log).sightings.stamp_s)

"""Live calls: one wrong call leaves the filter as it was, and several threads may use one filter."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from fastslam import FastSlam, _core
from fastslam.errors import DataError
from fastslam.filter import landmark_map
from fastslam.scan_call import checked_scan

ALGORITHMS = ("fastslam1", "fastslam2", "ekf")


def started(algorithm: str = "fastslam2", *, updated: bool = True) -> FastSlam:
    robot = FastSlam({"algorithm": algorithm, "filter": {"particles": 20}})
    for step in range(1, 4):
        robot.predict([1.0, 0.1], dt_s=0.1)
        robot.update(0.1 * step, range_m=[3.0, 5.0], bearing_rad=[0.3, -0.4], identity=["oak", None])
    if not updated:
        robot.predict([1.0, 0.1], dt_s=0.1)
    return robot


def state(robot: FastSlam) -> dict[str, Any]:
    """Everything that can be seen of a filter."""
    found = robot.landmarks
    return {
        "pose": robot.pose[0],
        "covariance": robot.pose[1],
        "particles": robot.particles[0],
        "weights": robot.particles[1],
        "ids": np.array(found.ids),
        "mean_m": found.mean_m,
        "covariance_m2": found.covariance_m2,
        "sightings": found.sightings,
        "path": robot.path.T_world_robot,
        "path_stamp_s": robot.path.stamp_s,
    }


SCAN: dict[str, Any] = {"range_m": [3.0], "bearing_rad": [0.3]}
WRONG: dict[str, tuple[Callable[[FastSlam], object], str]] = {
    "duration beyond reason": (lambda r: r.predict([1.0, 0.0], dt_s=1e308), "dt_s from 0 to 1e9"),
    "negative duration": (lambda r: r.predict([1.0, 0.0], dt_s=-0.1), "dt_s from 0"),
    "duration that is text": (lambda r: r.predict([1.0, 0.0], dt_s="soon"), "dt_s: got 'soon'"),  # type: ignore[arg-type]
    "control beyond reason": (lambda r: r.predict([1e300, 0.0], dt_s=0.1), "at most 1e6"),
    "control that is text": (lambda r: r.predict(["a", "b"], dt_s=0.1), "control: expected numbers"),
    "control of another model": (lambda r: r.predict([1.0], dt_s=0.1), "expected speed_m_per_s"),
    "bearing in degrees": (lambda r: r.update(1.0, range_m=[3.0], bearing_rad=[45.0]), "degrees?"),
    "bearing that is text": (
        lambda r: r.update(1.0, range_m=[3.0], bearing_rad=["left"]),
        "bearing_rad: expected numbers, got",
    ),
    "table for a column": (lambda r: r.update(1.0, range_m=[[3.0]], bearing_rad=[0.1]), "got shape"),
    "class without configuration": (lambda r: r.update(1.0, **SCAN, class_index=[1]), "not configured"),
    "class as text": (lambda r: r.update(1.0, **SCAN, class_index=["tree"]), "class_index: expected numbers"),
    "half a class": (lambda r: r.update(1.0, **SCAN, class_index=[0.5]), "expected whole numbers"),
    "covariance that is none": (
        lambda r: r.update(1.0, **SCAN, covariance=[[0.01, 0.02, 0.01]]),
        "positive definite",
    ),
    "covariance of another shape": (lambda r: r.update(1.0, **SCAN, covariance=[1.0, 2.0]), "n x 3"),
    "identity as one text": (lambda r: r.update(1.0, **SCAN, identity="oak"), "expected one name"),
    "identity of another kind": (lambda r: r.update(1.0, **SCAN, identity=[2.5]), "identity: got 2.5"),  # type: ignore[list-item]
    "new name in a bad scan": (
        lambda r: r.update(1.0, range_m=[3.0], bearing_rad=[0.3, 0.4], identity=["birch"]),
        "equal numbers",
    ),
    "stamp before the last scan": (lambda r: r.update(0.1, **SCAN), "not before"),
    "stamp in nanoseconds": (lambda r: r.update(1764313200500000000, **SCAN), "nanoseconds?"),
    "stamp that is text": (lambda r: r.update("now", **SCAN), "stamp_s: got 'now'"),  # type: ignore[arg-type]
    "step with a bad scan": (
        lambda r: r.step([1.0, 0.0], dt_s=0.1, range_m=[3.0], bearing_rad=[0.1, 0.2]),
        "equal numbers",
    ),
    "step with a bearing in degrees": (
        lambda r: r.step([1.0, 0.0], dt_s=0.1, range_m=[3.0], bearing_rad=[45.0]),
        "degrees?",
    ),
    "step with a bad control": (lambda r: r.step([math.nan, 0.0], dt_s=0.1, **SCAN), "finite"),
}


@pytest.mark.parametrize("algorithm", ALGORITHMS)
@pytest.mark.parametrize("case", WRONG)
def test_a_wrong_call_is_one_line_and_changes_nothing(algorithm: str, case: str) -> None:
    call, says = WRONG[case]
    robot, untouched = started(algorithm), started(algorithm)
    before = state(robot)
    with pytest.raises(DataError) as raised:
        call(robot)
    assert says in str(raised.value) and "\n" not in str(raised.value)
    after = state(robot)
    for name, value in before.items():
        np.testing.assert_array_equal(after[name], value, err_msg=name)
    # Nor is anything changed that cannot be seen: both go on alike.
    for each in (robot, untouched):
        each.step([1.0, 0.1], dt_s=0.1, range_m=[4.0, 2.0], bearing_rad=[0.1, 1.0], identity=["oak", "elm"])
    for name, value in state(untouched).items():
        np.testing.assert_array_equal(state(robot)[name], value, err_msg=name)
    assert np.isfinite(robot.pose[0]).all()


def test_a_scan_from_before_the_last_control_is_refused() -> None:
    robot = started(updated=False)
    with pytest.raises(DataError, match=r"got 0\.35, but the robot has been moved up to 0\.4"):
        robot.update(0.35, **SCAN)
    robot.update(0.4, **SCAN)
    fresh = FastSlam()
    fresh.predict([1.0, 0.0], dt_s=1.0)
    with pytest.raises(DataError, match="predict only up to the scan"):
        fresh.update(0.5, **SCAN)


def test_rounding_of_many_small_durations_is_no_fault() -> None:
    robot = FastSlam({"filter": {"particles": 5}})
    for step in range(1, 2001):
        robot.predict([1.0, 0.0], dt_s=0.1)
        if step % 100 == 0:
            robot.update(step / 10, range_m=[], bearing_rad=[])
    assert len(robot.path.stamp_s) > 0


def test_a_class_beyond_those_configured_changes_nothing() -> None:
    settings = {"filter": {"particles": 10}, "association": {"classes": {"number": 3}}}
    robot = FastSlam(settings)
    robot.step([1.0, 0.0], dt_s=0.1)
    before = robot.pose[0]
    scan = checked_scan(robot.config, (np.array([3.0]), np.array([0.1])), ["oak"], class_index=[3])
    with pytest.raises(ValueError, match=r"class 3 of a sighting: expected 0 to 2"):
        robot._filter.step([1.0, 0.0, 0.0], 1.0, 2.0, scan.columns({"oak": 0}))
    np.testing.assert_array_equal(robot.pose[0], before)
    with pytest.raises(DataError, match="expected 0 to 2"):
        robot.update(1.0, range_m=[3.0], bearing_rad=[0.1], identity=["oak"], class_index=[3])
    assert robot.landmarks.ids == ()
    robot.update(1.0, range_m=[3.0], bearing_rad=[0.1], identity=["elm"], class_index=[2])
    assert robot.landmarks.ids == ("elm",)


def test_no_two_landmarks_share_an_id() -> None:
    def columns(births: list[int], identities: list[int]) -> dict[str, np.ndarray]:
        count = len(births)
        return {
            "birth": np.array(births),
            "identity": np.array(identities),
            "mean_m": np.zeros((count, 2)),
            "covariance_m2": np.zeros((count, 2, 2)),
            "sightings": np.ones(count, dtype=np.int64),
            "confirmed": np.ones(count, dtype=np.bool_),
            "class_index": np.full(count, -1),
            "signature": np.full(count, np.nan),
        }

    names = ("L1", "L1#2", "oak")
    found = landmark_map(columns([0, 1, 2, 3, 4], [2, -1, 0, 2, 1]), names)
    assert found.ids == ("oak", "L1#3", "L1", "oak#2", "L1#2")
    robot = FastSlam({"filter": {"particles": 10}}, identities="some")
    robot.update(0.0, range_m=[3.0, 6.0], bearing_rad=[0.0, 2.0], identity=["L1", None])
    assert sorted(robot.landmarks.ids) == ["L1", "L1#2"]


def feed(robot: FastSlam, steps: int) -> list[Any]:
    infos = []
    for step in range(steps):
        angle = 0.3 + 0.001 * step
        scan = {"range_m": [3.0, 5.0, 7.0], "bearing_rad": [angle, -angle, 2.0]}
        infos.append(robot.step([0.1, 0.01], dt_s=0.1, **scan, identity=[f"a{step % 7}", "b", None]))
    return infos


def test_four_threads_read_while_one_feeds_and_nothing_is_lost_or_torn() -> None:
    settings = {"filter": {"particles": 50}, "seed": 3}
    alone, shared = FastSlam(settings), FastSlam(settings)
    steps = 600
    expected = feed(alone, steps)
    # Every pose with its covariance that a reader may see is one after a whole step.
    replay = FastSlam(settings)
    whole = {replay.pose[0].tobytes() + replay.pose[1].tobytes()}
    replay_step, seen_by = replay.step, whole
    for step in range(steps):
        angle = 0.3 + 0.001 * step
        scan = {"range_m": [3.0, 5.0, 7.0], "bearing_rad": [angle, -angle, 2.0]}
        replay_step([0.1, 0.01], dt_s=0.1, **scan, identity=[f"a{step % 7}", "b", None])
        seen_by.add(replay.pose[0].tobytes() + replay.pose[1].tobytes())
    done = threading.Event()
    faults: list[str] = []
    reads = [0] * 4

    def read(which: int) -> None:
        last = 0
        while not done.is_set():
            try:
                mean, covariance = shared.pose
                weights = shared.particles[1]
                landmarks = shared.landmarks
                path = shared.path
            except BaseException as error:
                faults.append(f"{type(error).__name__}: {error}")
                return
            if mean.tobytes() + covariance.tobytes() not in whole:
                faults.append(f"a pose that no step left: {mean}")
            if abs(weights.sum() - 1.0) > 1e-9 or len(set(landmarks.ids)) < len(landmarks.ids):
                faults.append("torn weights or map")
            if len(path.stamp_s) < last:
                faults.append("the path became shorter")
            last = len(path.stamp_s)
            reads[which] += 1

    threads = [threading.Thread(target=read, args=(which,)) for which in range(4)]
    for thread in threads:
        thread.start()
    infos = feed(shared, steps)
    deadline = time.monotonic() + 20.0
    while min(reads) == 0 and not faults and time.monotonic() < deadline:
        time.sleep(0.01)
    done.set()
    for thread in threads:
        thread.join()
    assert faults == []
    assert min(reads) > 0, reads
    assert infos == expected and len(infos) == steps
    for name, value in state(alone).items():
        np.testing.assert_array_equal(state(shared)[name], value, err_msg=name)


def test_the_core_alone_may_be_shared_too() -> None:
    robot = FastSlam({"filter": {"particles": 300}})
    core: _core.Filter = robot._filter
    failures: list[BaseException] = []

    def call(work: Callable[[], object]) -> None:
        try:
            for _ in range(200):
                work()
        except BaseException as error:
            failures.append(error)

    works: list[Callable[[], object]] = [core.pose, core.particles, core.map, core.best_path]
    works.append(lambda: core.predict([1.0, 0.1, 0.0], 0.01))
    threads = [threading.Thread(target=call, args=(work,)) for work in works]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert failures == []
    assert core.pose()[0][0] > 1.0

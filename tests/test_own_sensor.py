"""A sensor of one's own, in Python: it gives what the built-in model gives, and its faults have names."""

from __future__ import annotations

import copy
import pickle
import runpy
from collections.abc import Callable
from pathlib import Path
from typing import Any

import fastslam
import numpy as np
import pytest
from doc_pages import ROOT
from fastslam import FastSlam, Robot
from fastslam.checkpoint import Checkpoints
from fastslam.errors import DataError, FastSlamError, ModelError
from fastslam.log import Floats, Log
from fastslam.sensors import Adapter, check
from fastslam.simulation import simulate

STD_M = 0.2
SENSOR = {"model": "range", "range_std_m": STD_M, "max_range_m": 100.0}
FEW = {"filter": {"particles": 20}}


class Beacons:
    """Ranges, without derivatives; counts its calls and the rows of each."""

    measures: Any = ("range_m",)
    noise: Any = ((STD_M**2,),)

    def __init__(self) -> None:
        self.rows: list[int] = []

    def expected(self, poses: Floats, landmarks: Floats) -> Any:
        self.rows.append(len(poses))
        return np.sqrt(((landmarks - poses[:, :2]) ** 2).sum(axis=1))[:, None]


class Exact(Beacons):
    def jacobian(self, poses: Floats, landmarks: Floats) -> Any:
        offset = landmarks - poses[:, :2]
        towards = (offset / np.linalg.norm(offset, axis=1)[:, None])[:, None]
        return towards, np.concatenate([-towards, np.zeros((len(poses), 1, 1))], axis=2)


class Posts:
    """Range and bearing with a correlation, births of its own."""

    measures = ("range_m", "bearing_rad")
    noise = ((0.01, 0.0004), (0.0004, 0.0004))

    def expected(self, poses: Floats, landmarks: Floats) -> Any:
        dx, dy = (landmarks - poses[:, :2]).T
        return np.column_stack([np.hypot(dx, dy), np.arctan2(dy, dx) - poses[:, 2]])

    def births(self, poses: Floats, measured: Floats) -> Any:
        angle, r = poses[:, 2] + measured[:, 1], measured[:, 0]
        c, s = np.cos(angle), np.sin(angle)
        by = np.stack([np.stack([c, -r * s], axis=1), np.stack([s, r * c], axis=1)], axis=1)
        covariance = by @ np.array(self.noise) @ np.swapaxes(by, 1, 2)
        mean = poses[:, :2] + r[:, None] * np.column_stack([c, s])
        return np.ones((len(poses), 1)), mean[:, None], covariance[:, None]


@pytest.fixture(scope="module")
def log() -> Log:
    return simulate({"seed": 3, "world": {"count": 6}, "sensor": SENSOR, "scan": {"period_s": 1.0}})


def drive(robot: FastSlam, steps: range) -> None:
    """A circle around a mast, heard at every step."""
    for k in steps:
        robot.predict([1.0, 0.1], dt_s=1.0)
        x, y = np.sin(0.1 * (k + 1)) / 0.1, (1.0 - np.cos(0.1 * (k + 1))) / 0.1
        robot.update(k + 1.0, range_m=[np.hypot(20.0 - x, 5.0 - y)], identity=["mast"])


@pytest.mark.parametrize(("sensor", "most_m"), [(Exact(), 1e-9), (Beacons(), 1e-5)], ids=["exact", "slopes"])
def test_it_gives_what_the_built_in_model_gives(log: Log, sensor: Beacons, most_m: float) -> None:
    # Rounding grows with the steps; differences are right to some 1e-9.
    own, built_in = fastslam.run(log, FEW, sensor=sensor), fastslam.run(log, FEW)
    assert own.config["sensor"]["model"] == "own" and len(own.steps.stamp_s) > 100
    for ours, theirs in (
        (own.trajectory.T_world_robot, built_in.trajectory.T_world_robot),
        (own.smoothed.T_world_robot, built_in.smoothed.T_world_robot),
        (own.landmarks.mean_m, built_in.landmarks.mean_m),
    ):
        np.testing.assert_allclose(ours, theirs, rtol=0.0, atol=most_m)
    assert own.landmarks.ids == built_in.landmarks.ids and sum(sensor.rows) > 10_000


def test_it_is_asked_once_per_scan_and_pass() -> None:
    sensor = Exact()
    known = {"range_scale_std": 0, "range_bias_std_m": 0}
    settings = {"sensor": known, "filter": {"particles": 300, "rejuvenation": {"every_steps": 0}}}
    robot = FastSlam(settings, sensor=sensor)
    drive(robot, range(60))
    sensor.rows.clear()
    drive(robot, range(60, 61))
    # Once to propose, for the particles that have the mast placed, and once to correct all.
    assert len(sensor.rows) == 2
    assert sensor.rows[0] > 100 and sensor.rows[1] >= 300


def test_a_sensor_of_two_numbers() -> None:
    assert check(Posts()) == 300
    world = simulate(
        {"seed": 5, "world": {"count": 12}, "sensor": {"range_std_m": 0.1, "bearing_std_rad": 0.02}}
    )
    result = fastslam.run(world, FEW, sensor=Posts())
    truth = world.truth_landmarks
    assert truth is not None and len(result.landmarks.ids) == len(np.unique(world.sightings.identity)) > 8
    places = {name: place for name, place in zip(truth.names, truth.position_m, strict=True)}
    off_m = [
        np.hypot(*(mean - places[name]))
        for name, mean in zip(result.landmarks.ids, result.landmarks.mean_m, strict=True)
    ]
    assert max(off_m) < 0.5


class Radio:
    """-log10 of received power, which grows with the distance; a ring of its own."""

    measures: Any = ("range_m",)
    noise: Any = ((0.05**2,),)

    def expected(self, poses: Floats, landmarks: Floats) -> Any:
        return (4.0 + 2.1 * np.log10(np.linalg.norm(landmarks - poses[:, :2], axis=1)))[:, None]

    def births(self, poses: Floats, measured: Floats) -> Any:
        r = 10 ** ((measured[:, 0] - 4.0) / 2.1)
        angle = 2 * np.pi * np.arange(32) / 32
        out = np.column_stack([np.cos(angle), np.sin(angle)])
        aside = np.column_stack([-np.sin(angle), np.cos(angle)])
        across = r * np.log(10) * 0.05 / 2.1
        covariance = (across**2)[:, None, None, None] * np.einsum("ki,kj->kij", out, out)
        covariance += (r * across)[:, None, None, None] * np.einsum("ki,kj->kij", aside, aside)
        return np.full((len(r), 32), 1 / 32), poses[:, None, :2] + r[:, None, None] * out, covariance


def test_what_a_run_would_skip_is_refused() -> None:
    assert check(Radio()) == 300
    power = class_of(
        expected=lambda self, p, q: -Radio.expected(Radio(), p, q),
        births=lambda self, p, z: Radio.births(Radio(), p, -z),
    )
    with pytest.raises(
        ModelError, match=r"Mine\.expected: row 0 is -.* in the column range_m, of which a run skips"
    ):
        check(power)
    with pytest.raises(ModelError, match=r"above sensor\.max_range_m = 100: .*or check where it sees"):
        check(Beacons(), range_m=(50.0, 150.0))


def test_two_arrays_say_what_they_need() -> None:
    with pytest.raises(DataError, match=r'got 2 arrays, .*ranges alone: config=.*"model": "range"'):
        Log.from_arrays(([0.0, 1.0], [[1.0, 0.0], [1.0, 0.0]]), ([0.5], [4.0]))


def test_nothing_but_skipped_sightings_is_said_live() -> None:
    robot, live = FastSlam(FEW, sensor=Beacons()), Robot(FEW, sensor=Beacons())
    longest_s = robot.config["health"]["longest_blindness_s"]
    said: dict[str, list[tuple[float, tuple[str, ...]]]] = {"filter": [], "robot": []}
    for k in range(40):
        # Used up to 5 s, then too far, and one without a name.
        seen: Any = {
            "range_m": [9.0 if k <= 5 else 900.0, 8.0],
            "identity": ["mast", "mast" if k <= 5 else None],
        }
        said["filter"].append((k, robot.update(float(k), **seen).warnings))
        robot.predict([0.0, 0.0], dt_s=1.0)
        for step in live.odometry(float(k), [0.0, 0.0]) + live.sightings(float(k), **seen):
            said["robot"].append((step.stamp_s, step.info.warnings))
        if k == 20:
            robot, live = copy.deepcopy(robot), pickle.loads(pickle.dumps(live))
    for who, steps in said.items():
        words = dict(steps)
        assert len(words) > 30, who
        assert all((len(words[k]) == 1) == (k - 5 > longest_s) for k in words), who
        assert words[30.0][0].startswith("no sighting was used for 25 s, and 50 were skipped: "), who
        assert "above sensor.max_range_m = 100" in words[30.0][0], who
    assert robot.update(40.0, range_m=[9.0], identity=["mast"]).warnings == ()


class Failing(Beacons):
    """As told, from the call on."""

    def __init__(self, fault: Callable[[Floats], Any], call: int = 0) -> None:
        super().__init__()
        self.fault, self.call = fault, call

    def expected(self, poses: Floats, landmarks: Floats) -> Any:
        answer = super().expected(poses, landmarks)
        return self.fault(answer) if len(self.rows) > self.call else answer


def raised(_: Floats) -> Any:
    raise KeyError("no\nsuch beacon")


FAULTS: dict[str, tuple[Callable[[Floats], Any], str]] = {
    "shape": (lambda z: z[:, 0], r"Failing\.expected: got shape \(\d+,\), expected \(\d+, 1\)"),
    "text": (lambda z: [["far"]] * len(z), r"Failing\.expected: got what is no array of numbers"),
    "nan": (lambda z: z * np.nan, r"Failing\.expected: row 0 \(pose \[.*\], landmark \[.*\]\) is not finite"),
    "raises": (raised, r"Failing\.expected: KeyError: 'no\\nsuch beacon'"),
    "none": (lambda z: None, r"Failing\.expected: got"),
}


@pytest.mark.parametrize("name", FAULTS)
def test_a_fault_has_a_name_and_changes_nothing(name: str) -> None:
    fault, message = FAULTS[name]
    for steps in (1, 9, 30):
        sensor = Failing(fault, call=10**9)
        robot = FastSlam(FEW, sensor=sensor)
        drive(robot, range(steps))
        robot.predict([1.0, 0.1], dt_s=1.0)
        before = robot._snapshot()
        sensor.call = 0
        with pytest.raises(ModelError, match=message) as caught:
            robot.update(steps + 1.0, range_m=[9.0, 4.0], identity=["mast", "other"])
        assert "\n" not in str(caught.value)
        assert robot._snapshot() == before
        sensor.call = 10**9
        robot.update(steps + 1.0, range_m=[15.0], identity=["mast"])
    assert steps == 30


def test_a_draw_that_fails_leaves_the_state_before_the_scan() -> None:
    # The draw asks for the whole past in one call: fail where more rows come than the particles have.
    sensor = Failing(raised, call=10**9)
    robot = FastSlam({"filter": {"particles": 2}}, sensor=sensor)
    failed = 0
    for k in range(60):
        robot.predict([1.0, 0.1], dt_s=1.0)
        before = robot._snapshot()
        x, y = np.sin(0.1 * (k + 1)) / 0.1, (1.0 - np.cos(0.1 * (k + 1))) / 0.1
        scan: dict[str, Any] = {"range_m": [np.hypot(20.0 - x, 5.0 - y)], "identity": ["mast"]}
        probe = copy.deepcopy(robot)
        assert probe._adapter is not None
        seen = probe._adapter.sensor
        assert isinstance(seen, Failing)
        seen.rows.clear()
        try:
            probe.update(k + 1.0, **scan)
        finally:
            calls = list(seen.rows)
        if len(calls) > 3:
            sensor.rows.clear()
            sensor.call = 3
            with pytest.raises(ModelError):
                robot.update(k + 1.0, **scan)
            assert robot._snapshot() == before
            failed += 1
            sensor.call = 10**9
        robot.update(k + 1.0, **scan)
        assert robot._snapshot() == probe._snapshot()
    assert failed >= 2


def test_a_run_stops_with_the_fault_and_its_cause(log: Log) -> None:
    with pytest.raises(ModelError, match=r"Failing\.expected: KeyError") as caught:
        fastslam.run(log, FEW, sensor=Failing(raised, call=30))
    assert isinstance(caught.value.__cause__, KeyError)


def class_of(**members: Any) -> Any:
    return type("Mine", (Beacons,), members)()


WRONG: dict[str, tuple[Any, str]] = {
    "no noise": (type("Mine", (), {"measures": ("range_m",)})(), r"Mine\.noise is missing"),
    "noise of one number": (class_of(noise=0.2), r"Mine\.noise: got shape \(\), expected \(1, 1\)"),
    "noise that is none": (
        class_of(noise=[[-1.0]]),
        r"Mine\.noise: got \[\[-1\.0\]\], expected a covariance",
    ),
    "unknown column": (class_of(measures=("height_px",)), r"Mine\.measures: got \('height_px',\), expected"),
    "no births": (class_of(measures=("bearing_rad",)), r"Mine\.births is missing"),
    "no distance": (
        class_of(expected=lambda self, p, q: 2.0 * np.linalg.norm(q - p[:, :2], axis=1)[:, None]),
        r"Mine\.births: is missing, and the ring of a range does not do",
    ),
    "wrong derivative": (
        class_of(jacobian=lambda self, p, q: (np.ones((len(p), 1, 2)), np.zeros((len(p), 1, 3)))),
        r"Mine\.jacobian: number 0 by x of the pose in row \d+: got 0, differences give",
    ),
    "one derivative": (
        class_of(jacobian=lambda self, p, q: np.ones((len(p), 1, 2))),
        r"Mine\.jacobian: expected 2 arrays, \(300, 1, 2\) and \(300, 1, 3\)",
    ),
    "rows that depend on others": (
        class_of(expected=lambda self, p, q: np.linalg.norm(q - p[:, :2], axis=1)[:, None] + len(p)),
        r"Mine\.expected: row 0 alone gives",
    ),
    "an input that is changed": (
        class_of(expected=lambda self, p, q: p.__isub__(1.0)[:, :1]),
        r"Mine\.expected: ValueError: .*read-only",
    ),
    "an innovation with the wrong sign": (
        class_of(innovation=lambda self, z, e: e - z),
        r"Mine\.innovation: of a measurement 0\.0002 more than expected in number 0 is -0\.0002: expected",
    ),
    "a class": (Beacons, r"Beacons: got the class, expected an instance of it"),
    "nothing for some": (
        class_of(expected=lambda self, p, q: np.where(p[:, :1] > 0.0, np.nan, 5.0)),
        r"Mine\.expected: row \d+ \(pose \[.*\], landmark \[.*\]\) is not finite",
    ),
    "an innovation that is not wrapped": (
        type("Mine", (Posts,), {"innovation": lambda self, z, e: z - e})(),
        r"Mine\.innovation: a turn of 2π changes row",
    ),
    "shares": (
        type(
            "Mine",
            (Posts,),
            {"births": lambda self, p, z: (0.5 * Posts.births(self, p, z)[0], *Posts.births(self, p, z)[1:])},
        )(),
        r"Mine\.births: the shares of row 0 sum to 0\.5",
    ),
    "births elsewhere": (
        type("Mine", (Posts,), {"births": lambda self, p, z: Posts.births(self, p + 0.4, z)})(),
        r"Mine\.births: the landmark of row \d+ is .* standard deviations from the nearest",
    ),
}


@pytest.mark.parametrize("name", WRONG)
def test_the_suite_names_what_is_wrong(name: str) -> None:
    sensor, message = WRONG[name]
    with pytest.raises(ModelError, match=message) as caught:
        check(sensor)
    assert "\n" not in str(caught.value)


AT_ONCE: dict[str, tuple[Any, str]] = {
    "class": (Radio, r"Radio: got the class"),
    "shape": (Failing(lambda z: z[:, 0]), r"Failing\.expected: got shape \(16,\), expected \(16, 1\)"),
    "sign": (class_of(innovation=lambda self, z, e: e - z), r"Mine\.innovation: of a measurement"),
    "no births": (
        class_of(expected=Radio.expected),
        r"Mine\.births: is missing, and the ring of a range does not do",
    ),
    "shares": (
        type(
            "Mine",
            (Radio,),
            {"births": lambda self, p, z: (2.0 * Radio.births(self, p, z)[0], *Radio.births(self, p, z)[1:])},
        )(),
        r"Mine\.births: the shares of row 0 sum to 2",
    ),
    "births in the robot's frame": (
        type("Mine", (Radio,), {"births": lambda self, p, z: Radio.births(self, 0.0 * p, z)})(),
        r"Mine\.births: the landmark of row \d+ is .* expected means in the world",
    ),
    "derivatives with the wrong sign": (
        type("Mine", (Exact,), {"jacobian": lambda self, p, q: [-d for d in Exact.jacobian(self, p, q)]})(),
        r"Mine\.jacobian: by the landmark in row \d+: got \[\[.*\]\], differences give",
    ),
    "derivatives in the robot's frame": (
        type(
            "Mine",
            (Exact,),
            {"jacobian": lambda self, p, q: Exact.jacobian(self, 0.0 * p, 0.5 * q + 20.0)},
        )(),
        r"Mine\.jacobian: by the landmark",
    ),
}


@pytest.mark.parametrize("name", AT_ONCE)
def test_a_run_begins_with_what_is_cheap(log: Log, name: str) -> None:
    sensor, message = AT_ONCE[name]
    for begin in (
        lambda: fastslam.run(log, FEW, sensor=sensor),
        lambda: FastSlam(FEW, sensor=sensor),
        lambda: Robot(FEW, sensor=sensor),
    ):
        with pytest.raises(ModelError, match=message) as caught:
            begin()
        assert "\n" not in str(caught.value)


def test_a_run_refuses_no_sensor_that_is_sound_where_it_sees() -> None:
    # Numbers of 32 bits; a scale that is learned; nothing seen of what is far; coarse derivatives.
    far = class_of(expected=lambda self, p, q: np.minimum(Beacons.expected(self, p, q), 25.0))
    single = type(
        "Mine", (Radio,), {"births": lambda self, p, z: [np.float32(a) for a in Radio.births(self, p, z)]}
    )()
    scaled = class_of(expected=lambda self, p, q: 1.07 * Beacons.expected(self, p, q) + 0.3)
    coarse = type(
        "Mine", (Exact,), {"jacobian": lambda s, p, q: [1.1 * d for d in Exact.jacobian(s, p, q)]}
    )()
    for sensor in (far, single, scaled, coarse, Radio(), Posts(), Exact(), Beacons()):
        seen: Any = {"bearing_rad": [0.1]} if len(sensor.measures) == 2 else {}
        assert FastSlam(FEW, sensor=sensor).update(0.0, range_m=[6.0], identity=["a"], **seen).sightings == 1


def test_what_conforms_is_counted() -> None:
    assert check(Beacons()) == check(Exact()) == 300 == check(Posts(), range_m=(2.0, 30.0))


def test_it_is_kept_with_the_filter(tmp_path: Path) -> None:
    sensor = Beacons()
    robot = FastSlam(FEW, sensor=sensor)
    drive(robot, range(25))
    file = robot.save(tmp_path / "state.fslam")
    others = (
        FastSlam.load(file, sensor=Beacons()),
        copy.deepcopy(robot),
        pickle.loads(pickle.dumps(robot)),
    )
    drive(robot, range(25, 40))
    for other in others:
        drive(other, range(25, 40))
        np.testing.assert_array_equal(other.particles[0], robot.particles[0])
    with pytest.raises(DataError, match=r"sensor\.model: got own, expected"):
        FastSlam.load(file)


def test_a_robot_and_a_run_that_is_resumed_give_the_same(log: Log, tmp_path: Path) -> None:
    whole = fastslam.run(log, FEW, sensor=Beacons())
    done = []

    def stop(steps: int, _: int) -> None:
        done.append(steps)
        raise KeyboardInterrupt

    path = tmp_path / "checkpoint.fslam"
    cut = fastslam.run(log, FEW, sensor=Beacons(), progress=stop, checkpoints=Checkpoints(path))
    assert cut.interrupted and 0 < len(cut.steps.stamp_s) < len(whole.steps.stamp_s)
    resumed = fastslam.run(log, FEW, sensor=Beacons(), checkpoints=Checkpoints(path, resume=True))
    np.testing.assert_array_equal(resumed.trajectory.T_world_robot, whole.trajectory.T_world_robot)
    robot = Robot({**log.config, **FEW}, identities="all", sensor=Beacons())
    seen, scans = log.sightings, np.unique(log.sightings.stamp_s)
    rows = [(stamp, 0, k) for k, stamp in enumerate(log.controls.stamp_s)]
    steps: list[Any] = []
    for stamp, kind, k in sorted(rows + [(stamp, 1, 0) for stamp in scans]):
        if kind == 0:
            steps += robot.odometry(stamp, log.controls.values[k])
        else:
            scan = np.flatnonzero(seen.stamp_s == stamp)
            names = [log.identity_names[i] for i in seen.identity[scan]]
            steps += robot.sightings(stamp, range_m=seen.range_m[scan], identity=names)
    steps += robot.end()
    poses = np.array([step.T_world_robot for step in steps])
    np.testing.assert_array_equal(poses, whole.trajectory.T_world_robot)


def test_a_filter_cannot_be_called_from_within_its_sensor() -> None:
    class Curious(Beacons):
        def expected(self, poses: Floats, landmarks: Floats) -> Any:
            if robots:
                assert robots[0].pose is not None
            return super().expected(poses, landmarks)

    robots: list[FastSlam] = []
    robots.append(FastSlam(FEW, sensor=Curious()))
    robots[0].update(1.0, range_m=[5.0], identity=["mast"])
    with pytest.raises(ModelError, match="a filter cannot be called from within its sensor"):
        robots[0].update(2.0, range_m=[5.0], identity=["mast"])


def test_what_it_needs_is_said_in_one_line(log: Log) -> None:
    for call, message in (
        (lambda: fastslam.run(log, {"sensor": {"model": "own"}}), r"sensor\.model: got own, expected"),
        (
            lambda: FastSlam(FEW, sensor=Beacons(), identities="none"),
            r"sensor\.model: got own.*known identities",
        ),
        (lambda: FastSlam({"algorithm": "ekf"}, sensor=Beacons()), "algorithm: got ekf"),
        (lambda: FastSlam(sensor=Posts()).update(1.0, range_m=[2.0]), "bearing_rad: got none"),
        (lambda: simulate({"sensor": {"model": "own"}}), r"sensor\.model: got own"),
    ):
        with pytest.raises(FastSlamError, match=message) as caught:
            call()
        assert "\n" not in str(caught.value)


def test_slopes_are_those_of_the_closed_form() -> None:
    rng = np.random.default_rng(4)
    poses, landmarks = rng.uniform(-50.0, 50.0, (200, 3)), rng.uniform(-50.0, 50.0, (200, 2))
    for ours, theirs in zip(
        Adapter(Beacons()).linearized(poses, landmarks),
        Adapter(Exact()).linearized(poses, landmarks),
        strict=True,
    ):
        np.testing.assert_allclose(ours, theirs, rtol=0.0, atol=1e-8)


def test_plaza_with_the_sensor_of_the_example(data_dir: Path) -> None:
    beacons = runpy.run_path(str(ROOT / "examples" / "05_own_sensor.py"))["Beacons"]
    plaza = fastslam.load(data_dir / "plaza1")
    few = {"filter": {"particles": 10}}
    own, built_in = fastslam.run(plaza, few, sensor=beacons(0.55)), fastslam.run(plaza, few)
    apart_m = np.abs(own.trajectory.T_world_robot - built_in.trajectory.T_world_robot).max()
    assert apart_m < 1e-6 and len(own.landmarks.ids) == 4

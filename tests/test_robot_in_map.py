"""A robot on a live stream in a map that was kept: from a known start, or from anywhere."""

from __future__ import annotations

import json
import math
import pickle
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from cli_runner import fastslam
from fastslam import Anywhere, Map, Start, localize, run
from fastslam.datasets.native_write import write_native
from fastslam.errors import DataError
from fastslam.health import HealthStatus, health_summary
from fastslam.live import live
from fastslam.localisation import between
from fastslam.log import Log
from fastslam.lost import Lost
from fastslam.resultfiles import read_result
from fastslam.robot import Robot, Step
from fastslam.simulation import simulate

UNKNOWN = {"association": {"mode": "unknown"}, "filter": {"particles": 30}}
WORLD = {"seed": 5, "world": {"count": 30}, "max_duration_s": 40.0}


@pytest.fixture(scope="module")
def log() -> Log:
    return anonymous(simulate(WORLD))


def anonymous(log: Log) -> Log:
    """The log without the names of landmarks."""
    nobody = np.full(len(log.sightings.stamp_s), -1, dtype=np.int64)
    return replace(log, sightings=replace(log.sightings, identity=nobody), identity_names=())


@pytest.fixture(scope="module")
def chart(log: Log) -> Map:
    return run(log, {**UNKNOWN, "seed": 9}).map


def events(log: Log) -> list[str]:
    rows = [
        (float(stamp), json.dumps({"t": float(stamp), "odom": values.tolist()}))
        for stamp, values in zip(log.controls.stamp_s, log.controls.values, strict=True)
    ]
    seen = log.sightings
    for stamp in np.unique(seen.stamp_s):
        at = np.flatnonzero(seen.stamp_s == stamp)
        see = [[float(seen.range_m[i]), float(seen.bearing_rad[i])] for i in at]
        rows.append((float(stamp), json.dumps({"t": float(stamp), "see": see})))
    return [line for _, line in sorted(rows, key=lambda row: row[0])]


def driven(robot: Robot, log: Log, *, until_s: float = math.inf) -> list[Step]:
    """The steps of a robot that is told a log."""
    steps: list[Step] = []
    rows = [(float(stamp), 0, row) for row, stamp in enumerate(log.controls.stamp_s)]
    rows += [(float(stamp), 1, 0) for stamp in np.unique(log.sightings.stamp_s)]
    for stamp_s, kind, row in sorted(rows):
        if stamp_s > until_s:
            return steps
        if kind == 0:
            steps += robot.odometry(stamp_s, log.controls.values[row])
            continue
        at = log.sightings.stamp_s == stamp_s
        seen = log.sightings
        steps += robot.sightings(stamp_s, range_m=seen.range_m[at], bearing_rad=seen.bearing_rad[at])
    return [*steps, *robot.end()]


def configured(log: Log) -> dict[str, object]:
    from fastslam.runner import configure

    return dict(configure(log, UNKNOWN))


def test_a_robot_in_a_map_gives_the_bits_of_a_run_in_it(log: Log, chart: Map) -> None:
    start = Start(0.1, -0.1, 0.02, std=(0.2, 0.2, 0.05))
    fixed = chart.with_role("fixed")
    result = run(log, UNKNOWN, map=fixed, start=start)
    robot = Robot(configured(log), identities="none", map=fixed, start=start)
    stamp_s, mean, covariance = robot.pose
    assert stamp_s == 0.0 and np.hypot(*(mean[:2] - [0.1, -0.1])) < 0.2
    assert 0.1 < math.sqrt(covariance[0, 0]) < 0.3
    assert robot.landmarks.ids == chart.landmarks.ids
    steps = driven(robot, log)
    np.testing.assert_array_equal([s.T_world_robot for s in steps], result.trajectory.T_world_robot)
    np.testing.assert_array_equal(robot.landmarks.mean_m, result.landmarks.mean_m)
    assert robot.landmarks.ids == result.landmarks.ids and robot.changes == result.changes
    # Fixed ones have not moved, and nothing stands twice.
    np.testing.assert_allclose(robot.landmarks.mean_m[: len(chart.role)], chart.landmarks.mean_m, atol=1e-9)
    again = pickle.loads(pickle.dumps(robot))
    assert again.landmarks.ids == robot.landmarks.ids and again.changes == robot.changes


def test_a_robot_keeps_its_map_when_asked(log: Log, chart: Map) -> None:
    # One tree is missing from the map, and another one stands half a metre from where the map has it.
    moved_m = chart.landmarks.mean_m.copy()
    moved_m[1] += [0.4, -0.3]
    altered = replace(chart, landmarks=replace(chart.landmarks, mean_m=moved_m))
    altered = altered.rows(np.arange(len(chart.role)) != 0)
    altered = replace(altered, note=("gate", *altered.note[1:]), frame="yard", made_from={"log": "x"})
    assert set(altered.role) == {"prior"}
    start = Start(std=(0.1, 0.1, 0.02))
    robot = Robot(configured(log), identities="none", map=altered, start=start, keep=True)
    steps = driven(robot, log, until_s=30.0)
    robot = pickle.loads(pickle.dumps(robot))
    driven(robot, later(log, 30.0))
    count = len(altered.role)
    np.testing.assert_allclose(robot.landmarks.mean_m[:count], altered.landmarks.mean_m, rtol=0.0, atol=1e-9)
    assert robot.changes is not None and len(robot.changes.new) >= 1, "it is found all the same"
    assert robot.map.landmarks.ids == altered.landmarks.ids and robot.map.role == altered.role
    np.testing.assert_array_equal(robot.map.landmarks.mean_m, altered.landmarks.mean_m)
    assert (robot.map.note, robot.map.frame) == (altered.note, "yard") and robot.map.made_from == {"log": "x"}
    # The same as a map of fixed landmarks, and not as one of what it knows.
    fixed = Robot(configured(log), identities="none", map=altered.with_role("fixed"), start=start)
    same = driven(fixed, log, until_s=30.0)
    np.testing.assert_array_equal([s.T_world_robot for s in steps], [s.T_world_robot for s in same])
    free = Robot(configured(log), identities="none", map=altered, start=start)
    driven(free, log)
    assert not np.allclose(free.landmarks.mean_m[:count], altered.landmarks.mean_m, rtol=0.0, atol=1e-3)
    assert len(free.map.role) > count
    with pytest.raises(DataError, match="keep: needs a map"):
        Robot(keep=True)


def test_live_keeps_a_map_when_asked(log: Log, chart: Map, tmp_path: Path) -> None:
    folder = chart.save(tmp_path / "lap-1.map")
    fastslam("live", "--keep").assert_one_line_error(exit_code=2, contains="--keep: say with --map")
    fastslam("live", "--map", folder, "--keep", "--map-out", tmp_path / "m").assert_one_line_error(
        exit_code=2, contains="--map-out: only --extend changes a map"
    )
    config = tmp_path / "robot.yaml"
    config.write_text(json.dumps(configured(log)))
    options = ["--config", config, "--identities", "none", "--keep", "--map", folder, "--start", "0,0,0"]
    done = subprocess.run(
        [sys.executable, "-m", "fastslam", "live", *map(str, options)],
        input="\n".join(events(log)[:400]),
        capture_output=True,
        text=True,
        timeout=60,
    )
    said = done.stderr.splitlines()
    assert done.returncode == 0 and said[0] == "health at the end: ok" and len(said) == 2, done.stderr
    robot = Robot(configured(log), identities="none", map=folder, start=Start(0.0, 0.0, 0.0), keep=True)
    told = [estimate.to_line() for estimate in live(events(log)[:400], robot)]
    assert done.stdout.splitlines() == told and len(told) > 10
    # Without a start it says where it begins, which is nobody's guess.
    done = subprocess.run(
        [sys.executable, "-m", "fastslam", "live", "--map", str(folder)],
        input="",
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert done.stderr.startswith("start: anywhere") and done.returncode == 0


def test_a_robot_that_is_itself_again_at_the_last_of_several_steps_is_not_lost() -> None:
    def step(stamp_s: float, health: str) -> Any:
        return SimpleNamespace(
            stamp_s=stamp_s, info=SimpleNamespace(health=health, health_reasons=("innovations_too_large",))
        )

    away = [step(second, "lost") for second in (1.0, 2.0, 3.5)]
    assert Lost().is_settled(away)
    # Rows that waited for others give several steps at once.
    lost = Lost()
    assert not lost.is_settled([*away, step(4.0, "ok")]) and lost.since_s is None
    assert not lost.is_settled([step(4.5, "lost")]) and lost.is_settled([step(6.5, "lost")])


def test_a_robot_that_was_never_found_says_so_when_the_drive_is_over(chart: Map) -> None:
    robot = Robot(UNKNOWN, map=chart, start=Anywhere())
    robot.odometry(0.0, [0.0, 0.0])
    robot.sightings(0.1, range_m=[2.0], bearing_rad=[0.3])
    robot.end()
    with pytest.raises(DataError, match="the robot was not found in its map"):
        _ = robot.pose


def test_a_robot_finds_itself_and_is_silent_until_then(log: Log, chart: Map) -> None:
    # The log starts at the origin of its own frame; the map is kept in another one.
    moved = moved_map(chart, 20.0, -7.0, 2.0)
    robot = Robot(configured(log), identities="none", map=moved.with_role("fixed"), start=Anywhere())
    half = driven(robot, log, until_s=4.0)
    assert half == [] and robot.searching and robot.modes == ()
    for needs_a_place in ("pose", "landmarks", "path", "particles", "changes"):
        with pytest.raises(DataError, match="still searched for"):
            getattr(robot, needs_a_place)
    assert robot.last_step is not None and robot.last_step.info.health == "searching"
    # What it knows of itself is kept.
    for one in (robot, pickle.loads(pickle.dumps(robot))):
        steps = driven(one, later(log, 4.0))
        assert not one.searching and one.modes == ()
        assert steps[0].stamp_s < 1.0, "the way so far is driven anew in the map"
        truth = log.truth_trajectory
        assert truth is not None
        true = in_frame(truth.T_world_robot[-1], 20.0, -7.0, 2.0)
        assert np.hypot(*(one.pose[1][:2] - true[:2])) < 0.5
        assert abs(math.remainder(one.pose[1][2] - true[2], 2 * math.pi)) < 0.1
        assert one.landmarks.ids[: len(moved.role)] == moved.landmarks.ids


def test_in_another_map_it_goes_on_searching(log: Log) -> None:
    other = run(simulate({**WORLD, "seed": 77, "max_duration_s": 15.0}), UNKNOWN).map
    robot = Robot(configured(log), identities="none", map=other, start=Anywhere())
    assert driven(robot, log, until_s=11.0) == [] and robot.searching
    assert all(mode.probability < 0.999 for mode in robot.modes)


def test_where_nobody_says_where_it_begins_it_is_searched_for(log: Log, chart: Map) -> None:
    told = configured(log)
    untold = {key: value for key, value in told.items() if key != "initial_pose"}
    assert Robot(untold, identities="none", map=chart).searching
    assert not Robot(told, identities="none", map=chart).searching
    assert not Robot(untold, identities="none", map=chart, start=Start(0.0, 0.0, 0.0)).searching
    assert not Robot(untold, identities="none").searching


def test_a_symmetric_map_keeps_both_places() -> None:
    here = np.array([[2.0, 1.0], [4.0, -1.5], [6.0, 2.0], [3.0, 3.0], [5.0, -3.0]])
    places = {f"a{k}": tuple(place) for k, place in enumerate(here)}
    places |= {f"b{k}": (-x, -y) for k, (x, y) in enumerate(here)}
    robot = Robot(UNKNOWN, identities="none", map=Map.at(places, std_m=0.05), start=Anywhere())
    for number in range(120):
        robot.odometry(0.1 * number, [0.2, 0.0])
        offset = here - [0.02 * number, 0.0]
        robot.sightings(
            0.1 * number, range_m=np.hypot(*offset.T), bearing_rad=np.arctan2(offset[:, 1], offset[:, 0])
        )
    assert robot.searching and len(robot.modes) >= 2
    first, second = robot.modes[:2]
    assert first.probability == pytest.approx(second.probability, abs=0.02)
    np.testing.assert_allclose(first.T_map_robot[:2], -second.T_map_robot[:2], atol=0.05)
    assert abs(first.T_map_robot[0]) == pytest.approx(0.02 * 119, abs=0.1)


def test_lines_say_searching_and_where_it_may_be(log: Log, chart: Map) -> None:
    robot = Robot(configured(log), identities="none", map=chart, start=Anywhere())
    told = [json.loads(estimate.to_line()) for estimate in live(events(log), robot, rate_hz=5.0)]
    searching = [one for one in told if one["health"] == "searching"]
    assert len(searching) > 20 and all(one["pose"] is None and one["cov"] is None for one in searching)
    assert any(one["modes"] for one in searching)
    found = told[len(searching) :]
    assert found and all(len(one["pose"]) == 3 and "modes" not in one for one in found)


def test_anywhere_without_a_map_is_refused() -> None:
    with pytest.raises(DataError, match="needs a map"):
        Robot(start=Anywhere())


def test_live_drives_in_a_map_that_is_named(log: Log, chart: Map, tmp_path: Path) -> None:
    folder = chart.with_role("fixed").save(tmp_path / "lap-1.map")
    config = tmp_path / "robot.yaml"
    config.write_text(json.dumps(configured(log)))
    options = ["--config", config, "--identities", "none", "--map", folder, "--start", "0.1,0,0"]
    done = subprocess.run(
        [sys.executable, "-m", "fastslam", "live", *map(str, options), "--start-std", "0.2,0.2,0.05"],
        input="\n".join(events(log)),
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert done.returncode == 0, done.stderr
    start = Start(0.1, 0.0, 0.0, std=(0.2, 0.2, 0.05))
    robot = Robot(configured(log), identities="none", map=folder, start=start)
    assert done.stdout.splitlines() == [estimate.to_line() for estimate in live(events(log), robot)]
    told = json.loads(done.stdout.splitlines()[0])
    assert {entry["id"] for entry in told["map"]["changed"]} >= set(chart.landmarks.ids)


def in_frame(pose: np.ndarray, x_m: float, y_m: float, turn_rad: float) -> np.ndarray:
    cosine, sine = math.cos(turn_rad), math.sin(turn_rad)
    x, y = pose[:2]
    return np.array([x_m + cosine * x - sine * y, y_m + sine * x + cosine * y, pose[2] + turn_rad])


def moved_map(chart: Map, x_m: float, y_m: float, turn_rad: float) -> Map:
    rotation = np.array([[math.cos(turn_rad), -math.sin(turn_rad)], [math.sin(turn_rad), math.cos(turn_rad)]])
    landmarks = chart.landmarks
    return replace(
        chart,
        landmarks=replace(
            landmarks,
            mean_m=landmarks.mean_m @ rotation.T + [x_m, y_m],
            covariance_m2=rotation @ landmarks.covariance_m2 @ rotation.T,
        ),
    )


def later(log: Log, begin_s: float) -> Log:
    def rows(columns: object) -> object:
        kept = columns.stamp_s > begin_s  # type: ignore[attr-defined]
        fields = {name: None if value is None else value[kept] for name, value in vars(columns).items()}
        return replace(columns, **fields)  # type: ignore[type-var]

    return replace(log, controls=rows(log.controls), sightings=rows(log.sightings))  # type: ignore[arg-type]


def carried(log: Log, from_s: float, until_s: float) -> Log:
    """The log of a robot that was carried away: what lies between two moments did not happen."""

    def cut(columns: Any) -> Any:
        kept = (columns.stamp_s < from_s) | (columns.stamp_s >= until_s)
        picked = {name: None if value is None else value[kept] for name, value in vars(columns).items()}
        later = picked["stamp_s"] >= until_s
        picked["stamp_s"] = picked["stamp_s"] - np.where(later, until_s - from_s, 0.0)
        return replace(columns, **picked)

    return replace(log, controls=cut(log.controls), sightings=cut(log.sightings))


@pytest.mark.parametrize("seed", [5, 6])
def test_a_robot_that_is_carried_away_is_searched_for_again(seed: int) -> None:
    log = anonymous(simulate({"seed": seed, "world": {"count": 40}, "max_duration_s": 70.0}))
    chart = run(log, {**UNKNOWN, "seed": 9}).map
    robot = Robot(configured(log), identities="none", map=chart, start=Start(std=(0.1, 0.1, 0.02)))
    away = carried(log, 20.0, 45.0)
    first = driven(robot, away, until_s=23.0)
    assert robot.searching and first[-1].info.health == "lost" and first[-1].stamp_s < 23.0
    robot = pickle.loads(pickle.dumps(robot))
    with pytest.raises(DataError, match=r"lost since stamp 20\.\d\d s and searched for in its map again"):
        _ = robot.pose
    later = driven(robot, between(away, 23.0, math.inf))
    assert not robot.searching and later[-1].info.health == "ok"
    truth = log.truth_trajectory
    assert truth is not None
    for step in (*first, *later):
        moved = step.stamp_s + (25.0 if step.stamp_s >= 20.0 else 0.0)
        row = min(int(np.searchsorted(truth.stamp_s, moved)), len(truth.stamp_s) - 1)
        off_m = np.hypot(*(step.T_world_robot[:2] - truth.T_world_robot[row, :2]))
        assert off_m < 0.6 or step.info.health in ("degraded", "lost")
    assert later[0].stamp_s < 24.0


@pytest.mark.parametrize("seed", [5, 6])
def test_a_robot_that_starts_beside_its_start_does_not_map_all_anew(seed: int) -> None:
    log = anonymous(simulate({"seed": seed, "world": {"count": 40}, "max_duration_s": 40.0}))
    kept = run(log, {**UNKNOWN, "seed": 9}).map
    beside = Start(0.0, 2.5, 0.0, std=(0.2, 0.2, 0.03))
    robot = Robot(configured(log), identities="none", map=kept, start=beside)
    health = [(step.stamp_s, step.info.health) for step in driven(robot, log)]
    assert not robot.searching and health[-1][1] == "ok"
    assert 1.0 < min(stamp_s for stamp_s, status in health if status == "lost") < 12.0
    result_m, truth = robot.pose[1], log.truth_trajectory
    assert truth is not None
    assert np.hypot(*(result_m[:2] - truth.T_world_robot[-1, :2])) < 0.6
    assert len(robot.changes.gone) <= 2
    # A run over the log is not searched for; it says so. A draw may find that all of the map lies elsewhere.
    lost = run(log, UNKNOWN, map=kept, start=beside)
    assert any(sentence.startswith("the filter was lost") for sentence in lost.verdict), lost.verdict
    is_off = np.hypot(*(lost.trajectory.T_world_robot[-1, :2] - truth.T_world_robot[-1, :2])) > 0.6
    assert any("among those of the kept map are none of it" in text for text in lost.verdict) == is_off
    sound = run(log, UNKNOWN, map=kept, start=Start(std=(0.2, 0.2, 0.03)))
    assert sound.verdict == () and not (sound.steps.health == HealthStatus.LOST).any()


@pytest.mark.parametrize("seed", [5, 6])
def test_a_log_whose_robot_is_carried_away_is_searched_again(seed: int) -> None:
    log = anonymous(simulate({"seed": seed, "world": {"count": 40}, "max_duration_s": 70.0}))
    chart = run(log, {**UNKNOWN, "seed": 9}).map
    away = carried(log, 20.0, 45.0)
    found = localize(away, chart, start=Start(std=(0.1, 0.1, 0.02)), config=UNKNOWN)
    (again,), result = found.again, found.result
    assert (found.status, found.start, again.status) == ("found", "given", "found") and result is not None
    assert 20.0 < again.lost_s < 22.0 and 5.0 <= again.searched_s < 15.0
    assert result.verdict == (
        f"the filter was lost after {again.lost_s:.1f} s; searching the map from there on found the robot "
        f"{again.searched_s:.1f} s later",
    )
    # One path over the whole log, right but for the moment in which nobody could know.
    truth, steps = log.truth_trajectory, result.steps
    assert truth is not None and (np.diff(steps.stamp_s) > 0.0).all() and steps.stamp_s[-1] > 40.0
    np.testing.assert_array_equal(steps.stamp_s, result.trajectory.stamp_s)
    np.testing.assert_array_equal(steps.step, np.arange(len(steps.step)))
    for path in (result.trajectory, result.smoothed):
        moved = path.stamp_s + np.where(path.stamp_s >= 20.0, 25.0, 0.0)
        rows = np.clip(np.searchsorted(truth.stamp_s, moved), 0, len(truth.stamp_s) - 1)
        off_m = np.linalg.norm(path.T_world_robot[:, :2] - truth.T_world_robot[rows, :2], axis=1)
        unknown = (path.stamp_s >= 20.0) & (path.stamp_s < again.lost_s)
        assert (off_m[~unknown] < 0.6).all() and 2 <= unknown.sum() < 10
    within = (steps.stamp_s >= again.lost_s) & (steps.stamp_s <= again.lost_s + again.searched_s)
    np.testing.assert_array_equal(steps.health == HealthStatus.SEARCHING, within)
    assert (steps.health != HealthStatus.LOST).all() and health_summary(steps).lost == 0.0
    assert result.changes is not None and result.changes.gone == ()


def test_a_log_whose_robot_is_carried_out_of_the_map_goes_on_searching(log: Log, tmp_path: Path) -> None:
    chart = run(log, {**UNKNOWN, "seed": 9}).map
    elsewhere = anonymous(simulate({**WORLD, "seed": 77}))
    first, second = between(log, -math.inf, 15.0).sightings, later(elsewhere, 15.0).sightings
    both = {
        name: None if value is None else np.concatenate([value, getattr(second, name)])
        for name, value in vars(first).items()
    }
    away = replace(log, sightings=replace(log.sightings, **both))
    config = {**UNKNOWN, "seed": 2}
    found = localize(away, chart, start=Start(std=(0.1, 0.1, 0.02)), config=config)
    assert found.status == "searching" and found.result is not None and found.start == "given"
    assert found.again[-1].status == "searching" and found.modes == found.again[-1].modes
    lost_s, steps = found.again[-1].lost_s, found.result.steps
    assert 15.0 < lost_s < 20.0 and steps.stamp_s[-1] > 35.0, "the path goes to the end, and is not believed"
    np.testing.assert_array_equal(steps.health == HealthStatus.SEARCHING, steps.stamp_s >= lost_s)
    assert "searching the map from there on is not over" in found.result.verdict[0]
    # The command says so, keeps what it has and leaves no map.
    write_native(away, tmp_path / "log")
    folder = chart.save(tmp_path / "yard.map")
    common = (
        "localize",
        tmp_path / "log",
        "--map",
        folder,
        "--start",
        "0,0,0",
        "--start-std",
        "0.1,0.1,0.02",
    )
    given = ("--association", "unknown", "--set", "filter.particles=30", "--seed", "2", "--extend", "--json")
    out, kept = tmp_path / "out", tmp_path / "new.map"
    done = fastslam(*common, *given, "--out", out, "--map-out", kept)
    assert done.exit_code == 1 and not kept.exists(), done.stderr
    facts = json.loads(done.stdout)
    assert facts["status"] == "searching" and facts["again"][-1]["status"] == "searching"
    assert "is not over" in facts["verdict"][0] and (out / "report.html").is_file()
    assert "searching" in (out / "steps.csv").read_text()
    assert (read_result(out).steps.health == HealthStatus.SEARCHING).any()


def test_a_robot_is_searched_for_when_asked(log: Log, chart: Map) -> None:
    robot = Robot(configured(log), identities="none", map=chart, start=Start(3.0, 4.0, 1.0))
    driven(robot, log, until_s=5.0)
    robot.relocalize()
    assert robot.searching and robot.modes == ()
    driven(robot, between(log, 5.0, math.inf))
    assert not robot.searching
    stamp_s, mean, _ = robot.pose
    truth = log.truth_trajectory
    assert truth is not None
    row = min(int(np.searchsorted(truth.stamp_s, stamp_s)), len(truth.stamp_s) - 1)
    assert np.hypot(*(mean[:2] - truth.T_world_robot[row, :2])) < 0.6
    with pytest.raises(DataError, match="needs a map"):
        Robot(configured(log)).relocalize()


def test_a_robot_that_was_given_a_wide_start_is_not_searched_for(log: Log, chart: Map) -> None:
    robot = Robot(configured(log), identities="none", map=chart, start=Start(std=(2.0, 2.0, 0.5)))
    driven(robot, log, until_s=20.0)
    assert not robot.searching

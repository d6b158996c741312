"""A robot that is told raw turns of a laser is the robot of a run over the scans."""

from __future__ import annotations

import pickle
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from fastslam import Anywhere, Robot, run
from fastslam.detection import detect, sensor_twists
from fastslam.errors import ConfigError, DataError
from fastslam.log import Log, Scans
from fastslam.robot import Step, Window
from fastslam.scanner import Scanner
from fastslam.simulation import resolve_simulation, simulate

FEW = {"filter": {"particles": 15}, "seed": 4}
LATE = Window(late_s=0.7, wait_s=20.0)


def rover(motion: str, *, beam_period_s: float | None, delay_s: float = 0.0) -> tuple[Log, Scans]:
    """A rover among rocks, its laser on the left, every fifth turn of which shows nothing."""
    settings = {"seed": 7, "max_duration_s": 20.0, "motion": {"model": motion}}
    log = simulate(resolve_simulation(settings, preset="rover"))
    assert log.scans is not None
    ranges = np.array(log.scans.ranges_m)
    ranges[2::5] = np.inf
    geometry = replace(log.scans.geometry, beam_period_s=beam_period_s)
    scans = replace(log.scans, ranges_m=ranges, geometry=geometry, mounting=(0.1, 0.2, 0.05))
    config = {**log.config, "sensor": {**log.config.get("sensor", {}), "delay_s": delay_s}}
    return replace(log, scans=scans, config=config), scans


def told(robot: Robot, log: Log, scans: Scans, *, seed: int) -> tuple[list[Step], Robot]:
    """Steps of a robot that is told all in the order of a network with delays, and pickled on the way."""
    random = np.random.default_rng(seed)
    rows = [("odometry", i, stamp_s) for i, stamp_s in enumerate(log.controls.stamp_s)]
    # A delay that the settings name counts as part of the window.
    delay_s = robot.config["sensor"]["delay_s"]
    rows += [("scan", i, stamp_s - delay_s) for i, stamp_s in enumerate(scans.stamp_s)]
    rows.sort(key=lambda row: row[2] + random.uniform(0.0, LATE.late_s))
    steps: list[Step] = []
    for count, (kind, i, _) in enumerate(rows):
        if kind == "odometry":
            steps += robot.odometry(log.controls.stamp_s[i], log.controls.values[i])
        else:
            steps += robot.scan(scans.stamp_s[i], scans.ranges_m[i])
        if count == len(rows) // 2:
            robot = pickle.loads(pickle.dumps(robot))
    return [*steps, *robot.end()], robot


@pytest.mark.parametrize("motion", ["velocity", "increments"])
@pytest.mark.parametrize(("beam_period_s", "delay_s"), [(None, 0.0), (0.0004, 0.0), (0.0004, 0.13)])
def test_turns_in_any_order_of_the_window_give_the_bits_of_a_run(
    motion: str, beam_period_s: float | None, delay_s: float
) -> None:
    log, scans = rover(motion, beam_period_s=beam_period_s, delay_s=delay_s)
    expected = run(log, FEW)
    assert len(expected.landmarks.ids) > 5
    config = {**expected.config}
    robot = Robot(config, identities="none", window=LATE, scanner=Scanner.of(log))
    steps, robot = told(robot, log, scans, seed=3)
    assert [step.stamp_s for step in steps] == expected.trajectory.stamp_s.tolist()
    poses = np.array([step.T_world_robot for step in steps])
    assert poses.tobytes() == expected.trajectory.T_world_robot.tobytes()
    assert robot.landmarks.mean_m.tobytes() == expected.landmarks.mean_m.tobytes()
    assert robot.path.T_world_robot.tobytes() == expected.smoothed.T_world_robot.tobytes()
    refused = {"late": 0, "repeated": 0, "ahead": 0, "unexplained": 0, "waiting": 0}
    assert robot.counts == refused


def test_the_motion_within_a_turn_and_the_delay_count() -> None:
    log, _ = rover("velocity", beam_period_s=0.0004)
    later, _ = rover("velocity", beam_period_s=0.0004, delay_s=0.13)
    still, _ = rover("velocity", beam_period_s=None)
    twists, delayed = sensor_twists(log), sensor_twists(later)
    assert twists is not None and delayed is not None and sensor_twists(still) is None
    assert np.ptp(twists[:, 2]) > 0.05 and (twists != delayed).any()
    assert (detect(log).sightings.bearing_rad[:50] != detect(still).sightings.bearing_rad[:50]).any()


def test_what_was_told_is_a_log_with_scans(tmp_path: Path) -> None:
    log, scans = rover("velocity", beam_period_s=0.0004)
    whole = run(log, FEW)
    robot = Robot({**whole.config}, identities="none", scanner=Scanner.of(log))
    robot.keep_result()
    for i, stamp_s in enumerate(log.controls.stamp_s):
        robot.odometry(stamp_s, log.controls.values[i])
    for stamp_s, turn in zip(scans.stamp_s, scans.ranges_m, strict=True):
        if stamp_s > log.controls.stamp_s[-1] - 0.2:
            robot.scan(stamp_s, turn)
    robot.end()
    result, told_log = robot.result()
    assert told_log.scans is not None and len(told_log.scans.stamp_s) > 0
    assert told_log.scans.mounting == scans.mounting and told_log.scans.geometry == scans.geometry
    again = run(told_log, {**whole.config})
    assert again.landmarks.mean_m.tobytes() == result.landmarks.mean_m.tobytes()


def test_turns_that_do_not_fit_are_errors_that_change_nothing() -> None:
    log, scans = rover("velocity", beam_period_s=None)
    robot = Robot(detect(log).config, identities="none", scanner=Scanner.of(log))
    with pytest.raises(DataError, match="ranges_m: got shape"):
        robot.scan(0.0, scans.ranges_m[:2])
    with pytest.raises(DataError, match="2 intensities for"):
        robot.scan(0.0, scans.ranges_m[0], intensities=[1.0, 2.0])
    with pytest.raises(DataError, match="stamp_s"):
        robot.scan(float("nan"), scans.ranges_m[0])
    assert robot.counts["waiting"] == 0 and robot.stamp_s is None
    with pytest.raises(DataError, match="scans need a scanner"):
        Robot(detect(log).config).scan(0.0, scans.ranges_m[0])
    with pytest.raises(ConfigError, match="detector"):
        Robot(scanner=Scanner(scans.geometry, {"detector": 3}))
    with pytest.raises(DataError, match=r"geometry\.max_range_m"):
        Robot(scanner=Scanner(replace(scans.geometry, max_range_m=-1.0)))
    with pytest.raises(DataError, match="the log holds no laser scans"):
        Scanner.of(replace(log, scans=None))
    with pytest.raises(DataError, match="anywhere needs"):
        Robot(detect(log).config, start=Anywhere(), scanner=Scanner.of(log))

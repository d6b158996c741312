"""`fastslam live` over standard input and TCP, as real processes."""

from __future__ import annotations

import json
import signal
import socket
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fastslam import Map, run
from fastslam.config import merge
from fastslam.errors import DataError
from fastslam.live import Session, live, session_of
from fastslam.resultfiles import read_result
from fastslam.robot import Robot
from fastslam.watching import frame_of
from small_log import events, make_small_log, tell

LOG = make_small_log(steps=120)
SETTINGS = ["--set", "filter.particles=15", "--set", "sensor.range_std_m=0.05"]
SETTINGS += ["--set", "sensor.bearing_std_rad=0.02"]


def event_lines() -> list[str]:
    rows: list[tuple[float, dict[str, Any]]] = [
        (float(stamp), {"t": float(stamp), "odom": values.tolist()})
        for stamp, values in zip(LOG.controls.stamp_s, LOG.controls.values, strict=True)
    ]
    seen = LOG.sightings
    for stamp in np.unique(seen.stamp_s):
        at = np.flatnonzero(seen.stamp_s == stamp)
        entries = [
            [float(seen.range_m[i]), float(seen.bearing_rad[i]), LOG.identity_names[seen.identity[i]]]
            for i in at
        ]
        # Sightings come 0.15 s late.
        rows.append((float(stamp) + 0.15, {"t": float(stamp), "see": entries}))
    return [json.dumps(event) for _, event in sorted(rows, key=lambda row: row[0])]


def final_pose() -> np.ndarray:
    """Of a robot that is told the same, after the paths were drawn anew at the end."""
    robot = Robot({**LOG.config, "filter": {"particles": 15}}, identities="all")
    for row in sorted(events(LOG)):
        tell(robot, LOG, row)
    robot.end()
    return robot.pose[1]


def program(*arguments: str) -> list[str]:
    return [sys.executable, "-m", "fastslam", "live", "--identities", "all", *SETTINGS, *arguments]


def estimates(text: str) -> list[dict[str, Any]]:
    return [json.loads(line) for line in text.splitlines()]


def test_events_on_standard_input_end_at_the_pose_of_a_run(tmp_path: Path) -> None:
    lines = event_lines()
    lines[50:50] = ["{", '{"t": 1}', '{"t": 1, "odom": 3}', "\xff", '{"t": "x", "odom": [1, 0]}']
    out = tmp_path / "out"
    command = program("--out", str(out), "--no-report", "--map-out", str(tmp_path / "map"))
    done = subprocess.run(command, input="\n".join(lines), capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
    told = estimates(done.stdout)
    assert len(told) > 50
    np.testing.assert_allclose(told[-1]["pose"], final_pose(), atol=2e-6)
    assert told[-1]["health"] == "ok" and len(told[-1]["cov"]) == 9
    assert {entry["id"] for one in told for entry in one["map"]["changed"]} == set(LOG.identity_names)
    assert "passed over: line 51: no JSON" in done.stderr and "Traceback" not in done.stderr
    assert "5 lines that are no events" in done.stderr
    assert set(Map.load(tmp_path / "map").landmarks.ids) == set(LOG.identity_names)
    # The files of a run, and what came as a log that gives them again.
    result = run(LOG, {"filter": {"particles": 15}})
    kept = read_result(out)
    np.testing.assert_allclose(kept.trajectory.T_world_robot, result.trajectory.T_world_robot, atol=1e-5)
    assert set(kept.landmarks.ids) == set(LOG.identity_names)
    again = run(out / "log")
    np.testing.assert_allclose(again.trajectory.T_world_robot, result.trajectory.T_world_robot, atol=1e-5)


def test_events_over_tcp_and_a_state_that_sigterm_keeps(tmp_path: Path) -> None:
    lines, state = event_lines(), tmp_path / "state.fslam"
    # After a row of odometry, whose estimate says that all lines before were taken.
    cut = next(at + 1 for at in range(60, 90) if "odom" in lines[at])
    out = ""
    for part, stop in ((lines[:cut], True), (lines[cut:], False)):
        with subprocess.Popen(
            program("--in", "tcp:0", "--checkpoint", str(state)),
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        ) as process:
            assert process.stdout is not None and process.stderr is not None
            port = int(process.stderr.readline().rsplit(":", 1)[1])
            with socket.create_connection(("127.0.0.1", port), timeout=20) as sender:
                sender.sendall("".join(line + "\n" for line in part).encode())
                if stop:
                    while json.loads(process.stdout.readline())["t"] < json.loads(part[-1])["t"]:
                        pass
                    process.send_signal(signal.SIGTERM)
                    process.wait(30)
            out = process.communicate(timeout=60)[0]
            assert process.returncode == (130 if stop else 0)
        assert state.exists()
    np.testing.assert_allclose(estimates(out)[-1]["pose"], final_pose(), atol=2e-6)


def test_bad_options_are_one_line() -> None:
    for arguments in (["--in", "udp:1"], ["--in", "tcp:99999"], ["--rate-hz", "0"], ["--late-s", "-1"]):
        done = subprocess.run(program(*arguments), input="", capture_output=True, text=True, timeout=60)
        assert done.returncode in (1, 2) and done.stderr.startswith("error: ")
        assert len(done.stderr.strip().splitlines()) == 1


def test_estimates_come_at_the_rate_and_say_what_changed() -> None:
    told = list(live(event_lines(), Robot(LOG.config), rate_hz=2.0))
    gaps = np.diff([estimate.stamp_s for estimate in told])
    assert len(told) > 15 and (gaps[:-1] >= 0.5 - 1e-9).all()
    assert sum(len(estimate.changed) for estimate in told) >= 6
    assert all(json.loads(estimate.to_line())["verdict"] == [] for estimate in told)


def test_estimates_say_what_speaks_against_the_drive_and_pages_show_it() -> None:
    robot = Robot(merge(LOG.config, {"sensor": {"max_range_m": 4.0}}))
    session = session_of(robot, rate_hz=20.0)
    lines = [session.take(line) for line in event_lines()]
    told = [json.loads(estimate.to_line())["verdict"] for estimate in lines if estimate is not None]
    first = next(number for number, verdict in enumerate(told) if verdict)
    assert 0 < first < 0.9 * len(told) and all(told[first:]), "after a hundred sightings, and from then on"
    assert "lie beyond" in told[-1][0]
    assert robot.last_step is not None
    frame = frame_of(robot.view(robot.last_step), (0.0, 0.0, 0.0))
    assert frame["verdict"] == robot.verdict


def test_of_a_scan_only_the_sighting_of_an_unknown_class_is_left_out(tmp_path: Path) -> None:
    settings = {"association": {"mode": "unknown", "classes": {"number": 2}}}
    session = session_of(Robot(settings, identities="none", classes=("blue", "yellow")), rate_hz=10.0)
    see = '[[3, 0.5, "blue"], [4, -0.5, "orange"], [5, 0.1, "unknown"], [6, 0.9, null], [7, -0.9, -1]]'
    for line in ('{"t": 0, "odom": [1, 0]}', f'{{"t": 0.1, "see": {see}}}', '{"t": 0.2, "odom": [1, 0]}'):
        session.take(line)
    session.end()
    assert session.faults.count == 0 and session.left_out.count == 1
    assert session.left_out.shown[0].startswith("line 2: class_name: got 'orange', expected one of blue, yel")
    landmarks = session.robot.landmarks
    assert landmarks.class_index is not None and sorted(landmarks.class_index.tolist()) == [-1, -1, -1, 0]


@pytest.mark.parametrize(
    "line", ["[]", '{"t": 1, "see": [[1]]}', '{"t": 1, "see": [[1, 0.1, 3]]}', "[" * 9000]
)
def test_a_line_that_is_no_event_is_counted_with_its_number(line: str) -> None:
    session: Session = session_of(Robot(), rate_hz=10.0)
    session.take('{"t": 0, "odom": [1, 0]}')
    with pytest.raises(DataError, match=r"^line 2: "):
        session.take(line)
    assert session.faults.count == 1 and session.robot.counts["waiting"] == 1


def test_a_robot_that_keeps_what_came_has_the_result_of_a_run() -> None:
    robot = Robot(LOG.config | {"filter": {"particles": 15}}, identities="all")
    with pytest.raises(DataError, match="nothing was kept"):
        robot.result()
    robot.keep_result()
    list(live(event_lines(), robot))
    result, log = robot.result(name="circle")
    expected = run(LOG, {"filter": {"particles": 15}})
    np.testing.assert_array_equal(result.trajectory.T_world_robot, expected.trajectory.T_world_robot)
    np.testing.assert_array_equal(result.smoothed.T_world_robot, expected.smoothed.T_world_robot)
    np.testing.assert_array_equal(result.steps.matched, expected.steps.matched)
    assert result.verdict == expected.verdict and result.counts == expected.counts
    assert len(log.sightings.stamp_s) == len(LOG.sightings.stamp_s)
    assert sorted(log.identity_names) == sorted(LOG.identity_names) and result.steps.latency_us.min() > 0.0


def test_the_log_of_a_robot_runs_to_what_the_robot_found() -> None:
    config = LOG.config | {"filter": {"particles": 15}}
    config["sensor"] = {**config["sensor"], "delay_s": 0.07}
    robot = Robot(config, identities="all")
    robot.keep_result()
    noise = np.diag([0.04, 0.0025])
    for k in range(12):
        robot.odometry(0.5 * k, [1.0, 0.2])
        covariance = [[noise[0, 0], 0.0, noise[1, 1]]] if k % 2 else None
        robot.sightings(
            0.5 * k + 0.3, range_m=[5.0 - 0.3 * k], bearing_rad=[0.1], identity=["a"], covariance=covariance
        )
    robot.end()
    result, log = robot.result()
    np.testing.assert_allclose(log.sightings.stamp_s, 0.5 * np.arange(12) + 0.3, rtol=0, atol=1e-12)
    stated = log.sightings.covariance
    assert stated is not None and np.isnan(stated[::2]).all() and (stated[1::2] == [0.04, 0.0, 0.0025]).all()
    again = run(log)
    np.testing.assert_allclose(result.trajectory.T_world_robot, again.trajectory.T_world_robot, atol=1e-9)


def test_the_log_of_a_robot_keeps_what_its_odometry_says_of_itself() -> None:
    robot = Robot({"motion": {"model": "odometry"}}, identities="all")
    robot.keep_result()
    covariance = np.diag([0.01, 0.02, 0.003]) + 0.001
    robot.odometry(0.0, [0.0, 0.0, 0.0])
    robot.odometry(1.0, [1.0, 0.0, 0.1], covariance=covariance)
    robot.sightings(1.0, range_m=[5.0], bearing_rad=[0.1], identity=["a"])
    robot.end()
    stated = robot.result()[1].controls.covariance
    assert stated is not None and np.isnan(stated[0]).all()
    np.testing.assert_array_equal(stated[1], covariance[np.triu_indices(3)])


def test_what_steps_warn_of_is_said_once() -> None:
    lines = event_lines()
    nameless = [json.dumps({**json.loads(line), "see": [[2.0, 0.1]]}) for line in lines if '"see"' in line]
    told = sorted(
        [*nameless, *(line for line in lines if '"odom"' in line)], key=lambda x: json.loads(x)["t"]
    )
    options = [*SETTINGS, "--set", "health.longest_blindness_s=3", "--identities", "all"]
    done = subprocess.run(
        program(*options), input="\n".join(told), capture_output=True, text=True, timeout=60, check=False
    )
    assert done.returncode == 0
    warning, health, verdict = done.stderr.splitlines()
    assert health.startswith("health at the end: ") and verdict.startswith("verdict: nothing speaks against")
    assert warning.startswith("warning: at ") and "s: no sighting was used for 3." in warning
    assert "without the identity that all should have" in warning

"""`fastslam live` takes turns of a laser: as a real process, and what is no turn."""

from __future__ import annotations

import json
import math
import subprocess
import sys
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest
from fastslam import run
from fastslam._yaml import write_yaml
from fastslam.detection import configure_detector, detect
from fastslam.errors import ConfigError, DataError
from fastslam.live import session_of
from fastslam.log import Log
from fastslam.resultfiles import read_result
from fastslam.robot import Robot
from fastslam.scanner import Scanner
from fastslam.simulation import resolve_simulation, simulate


def rover() -> Log:
    """A rover among rocks; the motion within its turns counts."""
    log = simulate(resolve_simulation({"seed": 7, "max_duration_s": 8.0}, preset="rover"))
    assert log.scans is not None
    geometry = replace(log.scans.geometry, beam_period_s=0.0004)
    return replace(log, scans=replace(log.scans, geometry=geometry))


def described(log: Log, folder: Path) -> Path:
    """The laser of a log as a file."""
    assert log.scans is not None
    file = folder / "laser.yaml"
    file.write_text(write_yaml({**asdict(log.scans.geometry), "detector": dict(log.scans.detector)}))
    return file


def lines_of(log: Log) -> list[str]:
    """Rows and turns in time order; no beam that tells nothing is a number."""
    assert log.scans is not None
    rows = [
        (stamp, {"t": stamp, "odom": values})
        for stamp, values in zip(log.controls.stamp_s.tolist(), log.controls.values.tolist(), strict=True)
    ]
    rows += [
        (stamp, {"t": stamp, "scan": [None if math.isnan(one) else one for one in turn]})
        for stamp, turn in zip(log.scans.stamp_s.tolist(), log.scans.ranges_m.tolist(), strict=True)
    ]
    return [json.dumps(event) for _, event in sorted(rows, key=lambda row: row[0])]


def test_turns_told_to_a_process_end_where_a_run_over_the_scans_does(tmp_path: Path) -> None:
    log = rover()
    expected = run(log, {"filter": {"particles": 15}})
    assert len(expected.landmarks.ids) > 5
    config = tmp_path / "rover.yaml"
    config.write_text(write_yaml({**detect(log).config, "filter": {"particles": 15}}))
    lines = lines_of(log)
    bad = ['{"t": 1, "scan": 3}', '{"t": 1, "scan": [1, "x"]}', '{"t": 1, "scan": [1], "cov": 2}']
    lines[30:30] = [*bad, '{"t": 1, "scan": [1], "see": []}']
    scanner, out = described(log, tmp_path), tmp_path / "out"
    command = [sys.executable, "-m", "fastslam", "live", "--identities", "none", "--config", str(config)]
    command += ["--scanner", str(scanner), "--out", str(out), "--no-report"]
    done = subprocess.run(command, input="\n".join(lines), capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    told = [json.loads(line) for line in done.stdout.splitlines()]
    assert len(told) > 20
    np.testing.assert_allclose(told[-1]["pose"], expected.trajectory.T_world_robot[-1], atol=0.05)
    kept = read_result(out)
    np.testing.assert_allclose(kept.landmarks.mean_m, expected.landmarks.mean_m, atol=1e-5)
    assert "passed over: line 31: scan: got 3, expected a list" in done.stderr
    assert "line 32: scan: got 'x', expected a number or null for each beam" in done.stderr
    assert "4 lines that are no events" in done.stderr and "Traceback" not in done.stderr


def test_a_turn_without_a_scanner_or_with_too_many_beams_is_counted(tmp_path: Path) -> None:
    session = session_of(Robot(), rate_hz=10.0)
    with pytest.raises(DataError, match="line 1: scans need a scanner"):
        session.take('{"t": 0, "scan": [1.0, 2.0]}')
    log = rover()
    scanner = Scanner.load(described(log, tmp_path))
    assert (
        scanner == Scanner.of(log)
        and scanner.to_json()[0] == configure_detector(log.scans.detector).to_json()
    )
    session = session_of(Robot(detect(log).config, identities="none", scanner=scanner), rate_hz=10.0)
    many = json.dumps({"t": 0, "scan": [1.0] * 5000})
    with pytest.raises(DataError, match=r"line 1: .*at most one turn"):
        session.take(many)
    with pytest.raises(DataError, match=r"line 2: .*intensities"):
        session.take('{"t": 0, "scan": [1.0, 2.0], "echo": [1.0]}')
    assert session.faults.count == 2 and session.robot.counts["waiting"] == 0
    session.take('{"t": 0, "scan": [1.0, null, 1e9], "echo": [5, null, 0]}')
    assert session.faults.count == 2 and session.robot.counts["waiting"] == 1


@pytest.mark.parametrize(
    ("text", "wrong"),
    [
        ("[1]", "expected lines of"),
        ("first_angle_rad: [", r"laser\.yaml:\d"),
        ("first_angle_rad: 0.0", "angle_step_rad: got None, expected a number"),
        ("beams: 3", "beams: unknown key"),
        ("detector: 3", "detector: got 3"),
        (
            "{first_angle_rad: 0, angle_step_rad: 1, min_range_m: 0, max_range_m: 9, detector: {kind: cats}}",
            "detector: ",
        ),
    ],
)
def test_a_file_that_describes_no_laser_says_why(tmp_path: Path, text: str, wrong: str) -> None:
    file = tmp_path / "laser.yaml"
    with pytest.raises(ConfigError, match="No such file"):
        Scanner.load(file)
    file.write_text(text)
    with pytest.raises(ConfigError, match=wrong):
        Scanner.load(file)


def test_settings_of_a_robot_go_over_those_of_its_scanner() -> None:
    log = rover()
    scanner = Scanner.of(log)
    near = {"trunks": {"max_range_m": 4.0}}
    robots = (
        Robot({"detector": near}, identities="none", scanner=scanner),
        Robot(identities="none", scanner=scanner.with_detector(near)),
        Robot(identities="none", scanner=scanner),
    )
    assert log.scans is not None
    seen = []
    for robot in robots:
        for stamp_s, turn in zip(log.scans.stamp_s[:20], log.scans.ranges_m[:20], strict=True):
            robot.odometry(stamp_s, np.zeros(2))
            robot.scan(stamp_s, turn)
        robot.end()
        seen.append(robot.landmarks.sightings.sum())
    assert seen[0] == seen[1] < seen[2]

"""States in files: filters that are saved, pickled and copied, and runs that go on where they were cut."""

from __future__ import annotations

import copy
import json
import os
import pickle
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cli_runner import fastslam as call
from fastslam import FastSlam, run
from fastslam.checkpoint import CHECKPOINT_FILE, Checkpoints
from fastslam.datasets.native_write import write_native
from fastslam.errors import ConfigError, DataError
from fastslam.log import Log
from fastslam.result import RunResult
from fastslam.simulation import simulate

KILLS = int(os.environ.get("FASTSLAM_KILLS", "12"))
"""How many processes the test of killed processes kills."""


def _fed(robot: FastSlam, first: int, last: int) -> FastSlam:
    """The filter after some steps of a drive along trees."""
    for step in range(first, last):
        robot.predict([1.0, 0.1], 0.2)
        bearing = [0.5 - 0.02 * step, -0.4 + 0.01 * step]
        names = ["oak", f"t{step // 3}"]
        robot.update(0.2 * (step + 1), range_m=[4.0, 6.0], bearing_rad=bearing, identity=names)
    return robot


def _said(robot: FastSlam) -> list[Any]:
    """All that a filter says, as bytes and names."""
    arrays = [*robot.pose, *robot.particles, robot.landmarks.mean_m, robot.landmarks.covariance_m2]
    arrays += [robot.path.stamp_s, robot.path.T_world_robot]
    return [*(array.tobytes() for array in arrays), robot.landmarks.ids]


@pytest.mark.parametrize("algorithm", ["fastslam1", "fastslam2", "ekf"])
def test_a_filter_goes_on_from_a_file_or_a_copy_to_the_same_bits(algorithm: str, tmp_path: Path) -> None:
    config = {"algorithm": algorithm, "filter": {"particles": 20}, "seed": 4}
    robot = _fed(FastSlam(config), 0, 7)
    file = robot.save(tmp_path / "night" / "robot.fastslam")
    copies = [FastSlam.load(file), pickle.loads(pickle.dumps(robot)), copy.deepcopy(robot)]
    expected = _said(_fed(robot, 7, 15))
    assert len(robot.landmarks.ids) == 6
    for other in copies:
        assert other.config == robot.config
        assert _said(_fed(other, 7, 15)) == expected


def test_a_file_that_is_no_snapshot_or_damaged_is_refused_with_its_name(tmp_path: Path) -> None:
    robot = _fed(FastSlam({"filter": {"particles": 5}}), 0, 3)
    file = robot.save(tmp_path / "robot.fastslam")
    whole = file.read_bytes()
    for content, reason in [
        (b"PK\x03\x04", "no snapshot of fastslam"),
        (whole[:200], "cut off"),
        (whole[:300] + bytes([whole[300] ^ 1]) + whole[301:], "damaged"),
        (whole[:8] + b"\xff" + whole[9:], "newer format"),
    ]:
        file.write_bytes(content)
        with pytest.raises(DataError, match=f"robot.fastslam: .*{reason}"):
            FastSlam.load(file)
    with pytest.raises(DataError, match=r"none.fastslam: cannot read: No such file"):
        FastSlam.load(tmp_path / "none.fastslam")


STORED = Path(__file__).parent / "snapshots"
KINDS: dict[str, dict[str, Any]] = {
    "fastslam1": {"algorithm": "fastslam1", "filter": {"particles": 5, "store": "tree"}},
    "fastslam2": {"algorithm": "fastslam2", "filter": {"particles": 5, "rejuvenation": {"every_steps": 4}}},
    "ekf": {"algorithm": "ekf"},
}


def _sketch(robot: FastSlam) -> dict[str, list[float]]:
    return {"pose": robot.pose[0].tolist(), "landmarks_m": robot.landmarks.mean_m.ravel().tolist()}


@pytest.mark.parametrize("kind", KINDS)
def test_files_of_this_format_are_read_and_older_ones_refused_with_the_reason(kind: str) -> None:
    """Files of older formats stay: they are read, or refused.

    Whoever changes what is stored raises `snapshot::FORMAT` of the core, and adds files of the new format
    with `FASTSLAM_REFRESH_GOLDEN=1`.
    """
    if os.environ.get("FASTSLAM_REFRESH_GOLDEN"):
        robot = _fed(FastSlam({**KINDS[kind], "seed": 4}), 0, 9)
        number = int.from_bytes(robot.__getstate__()[8:12], "little")
        robot.save(STORED / f"format-{number}-{kind}.fastslam")
        (STORED / f"format-{number}-{kind}.json").write_text(json.dumps(_sketch(robot)) + "\n")
    read = 0
    for file in STORED.glob(f"format-*-{kind}.fastslam"):
        try:
            robot = FastSlam.load(file)
        except DataError as error:
            assert "an older format" in str(error), error
            continue
        expected = json.loads(file.with_suffix(".json").read_text())
        for name, values in _sketch(robot).items():
            np.testing.assert_allclose(values, expected[name], rtol=0.0, atol=1e-9)
        assert len(expected["landmarks_m"]) == 8 and robot.landmarks.ids[0] == "oak"
        _fed(robot, 9, 12)
        read += 1
    assert read == 10


def _log() -> Log:
    return simulate({"seed": 3, "world": {"count": 15}})


FEW = {"filter": {"particles": 15}, "association": {"mode": "unknown"}, "seed": 6}


def _bits(result: RunResult) -> list[bytes]:
    """All that a run computed, but for computing times."""
    steps = {name: column for name, column in vars(result.steps).items() if name != "latency_us"}
    arrays = [result.trajectory.T_world_robot, result.trajectory.covariance, result.smoothed.T_world_robot]
    arrays += [result.landmarks.mean_m, result.landmarks.covariance_m2, *steps.values()]
    return [np.asarray(array).tobytes() for array in arrays]


def _stop_after(steps: int) -> Any:
    def stop(done: int, _total: int) -> None:
        if done >= steps:
            raise KeyboardInterrupt

    return stop


@pytest.mark.parametrize("algorithm", ["fastslam1", "fastslam2", "ekf"])
def test_a_stopped_run_goes_on_to_the_same_bits(algorithm: str, tmp_path: Path) -> None:
    log, config = _log(), {**FEW, "algorithm": algorithm}
    whole = run(log, config)
    place = tmp_path / CHECKPOINT_FILE
    cut = run(log, config, progress=_stop_after(1), checkpoints=Checkpoints(place))
    assert cut.interrupted and 0 < len(cut.steps.stamp_s) < len(whole.steps.stamp_s)
    resumed = run(log, config, checkpoints=Checkpoints(place, resume=True))
    assert _bits(resumed) == _bits(whole)
    assert not place.exists()
    again = run(log, config, checkpoints=Checkpoints(place, resume=True))
    assert _bits(again) == _bits(whole)


def test_a_checkpoint_of_another_configuration_log_or_kind_is_refused(tmp_path: Path) -> None:
    log, place = _log(), tmp_path / CHECKPOINT_FILE
    run(log, FEW, progress=_stop_after(1), checkpoints=Checkpoints(place))
    resume = Checkpoints(place, resume=True)
    with pytest.raises(DataError, match=r"made with filter.particles = 15, not 16"):
        run(log, {**FEW, "filter": {"particles": 16}}, checkpoints=resume)
    other = simulate({"seed": 4, "world": {"count": 15}})
    with pytest.raises(DataError, match="another log"):
        run(other, FEW, checkpoints=resume)
    FastSlam(FEW).save(place)
    with pytest.raises(DataError, match="of a filter, not of a run"):
        run(log, FEW, checkpoints=resume)
    with pytest.raises(ConfigError, match="a time above 0"):
        Checkpoints(place, 0.0)


def test_a_checkpoint_that_cannot_be_written_costs_no_result(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object, **__: object) -> None:
        raise DataError("cannot write: No space left on device")

    monkeypatch.setattr("fastslam.checkpoint.write_atomically", full)
    log = _log()
    result = run(log, FEW, checkpoints=Checkpoints(tmp_path / "x", every_s=0.01))
    assert _bits(result) == _bits(run(log, FEW))
    assert any("could not be written; the last: cannot write: No space" in line for line in result.warnings)
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(DataError, match="checkpoint: Not a directory"):
        run(log, FEW, checkpoints=Checkpoints(tmp_path / "file" / "x"))


def test_the_command_resumes_and_says_what_it_needs(tmp_path: Path) -> None:
    folder = write_native(_log(), tmp_path / "log")
    common = ["run", str(folder), "--no-report", "--particles", "10"]
    missing = call(*common, "--resume")
    missing.assert_one_line_error(exit_code=2, contains="--out")
    several = call(*common, "--runs", "2", "--checkpoint-every", "1", "--out", tmp_path / "out")
    several.assert_one_line_error(exit_code=2, contains="of one run, not of 2")
    done = call(*common, "--checkpoint-every", "0.01", "--resume", "--out", tmp_path / "out")
    assert done.exit_code == 0, done.stderr
    assert not (tmp_path / "out" / CHECKPOINT_FILE).exists()


@pytest.mark.slow
def test_runs_that_are_killed_again_and_again_end_with_the_same_bits_and_tear_no_file() -> None:
    """In a process of its own, which forks: threads of this one would not be copied."""
    arguments = [sys.executable, "-m", "tests.kills", "--count", str(KILLS), "--seed", "5"]
    done = subprocess.run(
        arguments, cwd=Path(__file__).parent.parent, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    told = json.loads(done.stdout)
    assert told["kills"] == KILLS and told["ended"] > 0
    assert (told["torn"], told["different"], told["failed"]) == (0, 0, 0)

"""Kills a checkpointed run again and again, at random moments, and says what became of it.

    python -m tests.kills --count 1000 --seed 5

A run leaves its state every two milliseconds and its results at the end; a process that does so is killed
(SIGKILL), and the next one goes on from what is there. After each kill the state must be one that was written
as a whole, and so must every file of results; a run that comes to its end must have the bits of one that
nobody killed. Exits with 1 where that is not so. Needs a system that can fork.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import random
import signal
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

import numpy as np
from fastslam import FastSlam, run
from fastslam.checkpoint import CHECKPOINT_FILE, Checkpoints
from fastslam.errors import DataError
from fastslam.log import Log
from fastslam.resultfiles import OWN_FILES, STEPS_FILE, write_atomically, write_result
from fastslam.simulation import simulate

CONFIG = {"filter": {"particles": 40}, "association": {"mode": "unknown"}, "seed": 6}
EVERY_S = 0.002
SHARE = 0.3
"""Processes are killed within this share of the time that a run takes."""
BITS = "bits"
"""What a run writes last: a digest of all that it computed, but for computing times."""
COUNTED = ("kills", "while_writing", "resumed", "ended", "torn", "different", "failed")


def kill_again_and_again(folder: Path, count: int, seed: int) -> dict[str, int]:
    """Kills `count` processes; returns the numbers of COUNTED, of which the last three are faults."""
    log, moment = simulate({"seed": 3, "world": {"count": 15}, "max_duration_s": 60.0}), random.Random(seed)
    whole, cut = folder / "whole", folder / "cut"
    cut.mkdir()
    lasted_s = min(_lasted_s(log, whole) for _ in range(3))
    told: Counter[str] = Counter(dict.fromkeys(COUNTED, 0))
    while told["kills"] < count:
        told["resumed"] += (cut / CHECKPOINT_FILE).exists()
        child = _started(log, cut)
        time.sleep(moment.uniform(0.0, SHARE * lasted_s))
        os.kill(child, signal.SIGKILL)
        _look(_exit_code(child), whole, cut, told)
    ended = told["ended"]
    while told["ended"] == ended and not told["failed"]:
        _look(_exit_code(_started(log, cut)), whole, cut, told)
    return dict(told)


def _lasted_s(log: Log, whole: Path) -> float:
    """How long a run takes that nobody kills."""
    begun_s = time.monotonic()
    if _exit_code(_started(log, whole)) != 0:
        raise RuntimeError("a run that nobody kills fails")
    return time.monotonic() - begun_s


def _started(log: Log, folder: Path) -> int:
    """A process that runs the log, from where its state in the folder says."""
    child = os.fork()
    if child:
        return child
    code = 1
    try:
        checkpoints = Checkpoints(folder / CHECKPOINT_FILE, every_s=EVERY_S, resume=True)
        result = run(log, CONFIG, checkpoints=checkpoints)
        write_result(result, log, folder)
        steps = [column for name, column in vars(result.steps).items() if name != "latency_us"]
        arrays = [result.trajectory.T_world_robot, result.smoothed.T_world_robot, result.landmarks.mean_m]
        arrays += [result.landmarks.covariance_m2, *steps]
        digest = hashlib.sha256(b"".join(np.ascontiguousarray(array).tobytes() for array in arrays))
        write_atomically(folder / BITS, digest.hexdigest())
        code = 1 if checkpoints.failures else 0
    finally:
        # Not `sys.exit`: what the parent has open is the parent's.
        os._exit(code)


def _exit_code(child: int) -> int:
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


def _look(code: int, whole: Path, cut: Path, told: Counter[str]) -> None:
    """Counts what a process left behind; one that came to its end is followed by one that begins anew."""
    told["kills"] += code == -signal.SIGKILL
    told["failed"] += code not in (0, -signal.SIGKILL)
    unfinished = [path for path in cut.iterdir() if path.name.startswith(".")]
    told["while_writing"] += bool(unfinished)
    told["torn"] += _torn(cut / CHECKPOINT_FILE) + sum(
        not _same(cut / name, whole / name) for name in OWN_FILES if (cut / name).exists()
    )
    for path in unfinished:
        # The state's own are removed by the next run, which a test of its own sees.
        if not path.name.startswith(f".{CHECKPOINT_FILE}."):
            path.unlink()
    if (cut / BITS).exists():
        told["ended"] += 1
        told["different"] += (cut / BITS).read_bytes() != (whole / BITS).read_bytes()
        (cut / BITS).unlink()


def _torn(checkpoint: Path) -> bool:
    """Whether a state is not whole: its length and checksum are in it."""
    if not checkpoint.exists():
        return False
    try:
        FastSlam.load(checkpoint)
    except DataError as error:
        # Read as a whole, and found to be of a run.
        return "of a run over a log" not in str(error)
    return True


def _same(path: Path, whole: Path) -> bool:
    """Whether a file of results is whole; computing times may differ."""
    if path.suffix == ".json":
        return bool(json.loads(path.read_text()).keys() == json.loads(whole.read_text()).keys())
    if path.name == STEPS_FILE:
        return path.read_text().count("\n") == whole.read_text().count("\n")
    return path.read_bytes() == whole.read_bytes()


def main() -> int:
    """The program; 1 where a file was torn, a process failed or bits differ."""
    parser = argparse.ArgumentParser(prog="python -m tests.kills", description=__doc__)
    parser.add_argument("--count", type=int, default=1000, help="how many processes to kill")
    parser.add_argument("--seed", type=int, default=0, help="another seed, other moments")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        told = kill_again_and_again(Path(folder), options.count, options.seed)
    print(json.dumps(told))
    return 1 if told["torn"] or told["different"] or told["failed"] else 0


if __name__ == "__main__":
    sys.exit(main())

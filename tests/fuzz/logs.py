"""Logs of every format with changes in their files, read, examined, run and converted."""

from __future__ import annotations

import shutil
import tempfile
from collections import Counter
from dataclasses import dataclass, replace
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from random import Random

import numpy as np
from cli_runner import fastslam
from fastslam import run
from fastslam.conversion import convert
from fastslam.datasets import FORMATS, load, write_native
from fastslam.errors import FastSlamError
from fastslam.examination import examine
from fastslam.log import Log
from small_log import make_small_log
from test_csv_dialects import ODOMETRY, YAML
from test_datasets_formats import MAKERS
from test_datasets_layouts import layout
from test_graph_formats import G2O

from .case import FaultError, check_finite, check_log, check_message, check_result
from .draws import changed

EXAMINED, RUN, CONVERTED, COMMANDED = 0.25, 0.5, 0.1, 0.02
"""Shares of the logs to which each is done."""
MOST_STEPS = 500
"""Steps that fill gaps in a run."""
BINARY = (".mat", ".npz")
LONGEST_S = 1e6
"""Gaps are as long as a file says; runs are tried with few steps in them."""


@dataclass(frozen=True)
class LogCase:
    """The files of a log, where it lies among them, and what is done with it."""

    content: dict[str, bytes]
    root: str
    format: str | None
    robot: int | None
    draw: int

    def files(self) -> dict[str, bytes]:
        """The files."""
        return self.content

    def exercise(self, folder: Path) -> Counter[str]:
        """Reads the log and works with it."""
        base = folder / "log"
        _write(base, self.content)
        path = base / self.root
        told = Counter({"mutated": 1})
        rng = Random(self.draw)
        if rng.random() < COMMANDED:
            _command(rng, path, folder)
            told["commands"] += 1
        try:
            log = load(path, format=self.format, robot=self.robot)
        except FastSlamError as error:
            check_message(error)
            told["logs refused"] += 1
            return told
        told["logs read"] += 1
        check_log(log)
        for name, share in (("examined", EXAMINED), ("run", RUN), ("converted", CONVERTED)):
            if rng.random() < share:
                told[_worked(name, log, folder)] += 1
        return told


def make(rng: Random) -> LogCase:
    """A small log with one to three changes in its files."""
    name = rng.choice(sorted(bases()))
    content, root, robot = bases()[name]
    content = dict(content)
    for _ in range(rng.choice((1, 1, 1, 2))):
        file = rng.choice(sorted(content))
        kind = rng.random()
        if kind < 0.02:
            del content[file]
        elif kind < 0.03:
            content[file] = content[rng.choice(sorted(content))]
        elif kind < 0.04:
            content[f"{file}.gz"] = changed(rng, content.pop(file))
        else:
            content[file] = changed(rng, content[file], binary=file.endswith(BINARY))
        if not content:
            break
    guess = rng.random()
    format = None if guess < 0.7 else name.partition(":")[0] if guess < 0.98 else rng.choice(sorted(FORMATS))
    return LogCase(content, root, format, robot, rng.getrandbits(32))


@cache
def bases() -> dict[str, tuple[dict[str, bytes], str, int | None]]:
    """Sound small logs by format and variant: files, where the log lies among them, the robot to ask for."""
    found: dict[str, tuple[dict[str, bytes], str, int | None]] = {}
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        for name, maker in MAKERS.items():
            if name == "bag" and find_spec("rosbags") is None:
                continue
            path = maker(folder / name)
            found[name] = (
                _files(folder / name),
                str(path.relative_to(folder / name)),
                2 if name == "utias" else None,
            )
        for name, log in _native_logs().items():
            write_native(log, folder / "own" / name)
            found[f"native:{name}"] = (_files(folder / "own" / name), ".", None)
    for name, (yaml, odometry) in TABLES.items():
        texts = {"log.yaml": yaml, "odometry.csv": odometry, "sightings.csv": SIGHTINGS}
        found[f"native:{name}"] = (_encoded(texts), ".", None)
    found["g2o:whole"] = (_encoded({"small.g2o": G2O}), "small.g2o", None)
    found["utias:course"] = (_encoded(layout("ds1_{}.dat")), ".", None)
    return found


SIGHTINGS = (
    "stamp_s,range_m,bearing_rad,landmark_id\n0.5,2.25,0.5,a\n0.5,3.5,-0.25,b\n1.5,2,-0.5,a\n2.5,1.5,0.25,b\n"
)
WHEELS = "wheels: {track_width_m: 0.5, radius_m: 0.1, ticks_per_turn: 100, counter_bits: 16}\n"
QUATERNIONS = "stamp_s,x,y,z,qx,qy,qz,qw\n0,0,0,0,0,0,0,1\n1,1,0,0,0,0,0.1,0.995\n2,2,0,0,0,0,0.2,0.98\n"
TABLES: dict[str, tuple[str, str]] = {
    "table": (YAML, ODOMETRY),
    "wheels": (YAML + WHEELS, "stamp_s,left_m_per_s,right_m_per_s\n0,1,1.1\n1,1,0.9\n2,1,1\n3,1,1\n"),
    "ticks": (YAML + WHEELS, "stamp_s,left_ticks,right_ticks\n0,0,0\n1,100,110\n2,65500,220\n3,20,300\n"),
    "pose": (YAML.replace("velocity, speed_std_m_per_s: 0.1", "increments"), QUATERNIONS),
    "heading": (
        YAML.replace("velocity, speed_std_m_per_s: 0.1", "odometry"),
        "t,x_m,y_m,heading_rad\n0,0,0,0\n1,1,0,0.1\n2,2,0.1,0\n",
    ),
    "twist": (YAML, "stamp,linear.x,angular.z\n0,1,0.1\n1,1,0\n2,1,0\n"),
}


def _native_logs() -> dict[str, Log]:
    small = make_small_log(steps=12)
    rng = np.random.default_rng(1)
    count = len(small.sightings.stamp_s)
    looks = replace(
        small.sightings,
        class_index=rng.integers(-1, 2, count),
        signature=np.where(rng.random(count) < 0.5, np.nan, 0.3),
        covariance=np.tile([0.01, 0.0, 0.001], (count, 1)),
    )
    steps = replace(
        small,
        controls=replace(
            small.controls,
            values=np.tile([0.1, 0.0, 0.02], (13, 1)),
            covariance=np.tile([1e-3, 0.0, 0.0, 1e-3, 0.0, 1e-4], (13, 1)),
        ),
        config={**small.config, "motion": {"model": "increments"}},
    )
    return {
        "small": small,
        "looks": replace(
            small,
            sightings=looks,
            class_names=("oak", "elm"),
            config={**small.config, "association": {"mode": "unknown"}},
        ),
        "steps": steps,
        "truthless": replace(small, truth_trajectory=None, truth_landmarks=None),
    }


def _files(folder: Path) -> dict[str, bytes]:
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


def _encoded(texts: dict[str, str]) -> dict[str, bytes]:
    return {name: text.encode() for name, text in texts.items()}


def _write(base: Path, content: dict[str, bytes]) -> None:
    shutil.rmtree(base, ignore_errors=True)
    base.mkdir(parents=True)
    for name, data in content.items():
        path = base / name
        if path.parent != base:
            path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(data)


def _worked(name: str, log: Log, folder: Path) -> str:
    """Examines, runs or converts; what became of it."""
    try:
        if name == "examined":
            for finding in examine(log):
                if not finding.message or "nan" in finding.message.split() or "\n" in finding.message:
                    raise FaultError(f"finding {finding.code}: {finding.message!r}")
        elif name == "run":
            check_result(run(log, {"filter": {"particles": 3, "path_period_s": _period_s(log)}}))
        else:
            _converted(log, folder)
    except FastSlamError as error:
        check_message(error)
        return f"logs refused when {name}"
    return f"logs {name}"


def _period_s(log: Log) -> float:
    stamps = np.concatenate([log.controls.stamp_s, log.sightings.stamp_s])
    return max(0.5, float(np.ptp(stamps)) / MOST_STEPS) if len(stamps) else 0.5


def _converted(log: Log, folder: Path) -> None:
    """What a log is written as reads back."""
    for target in (folder / "copy", folder / "copy.g2o", folder / "copy.tum"):
        shutil.rmtree(target, ignore_errors=True)
        target.unlink(missing_ok=True)
        convert(log, target)
        if target.suffix == ".tum":
            check_finite("tum", np.loadtxt(target, ndmin=2))
        else:
            check_log(load(target))


def _command(rng: Random, path: Path, folder: Path) -> None:
    """A command on the log ends with one of the documented codes."""
    shutil.rmtree(folder / "out", ignore_errors=True)
    quick = ("--no-report", "--particles", "3", "--out", folder / "out")
    outcome = fastslam(
        *rng.choice(
            (("info", path), ("run", path, *quick), ("run", path, *quick, "--association", "unknown"))
        )
    )
    if outcome.exit_code not in (0, 1, 2) or "Traceback" in outcome.stderr + outcome.stdout:
        raise FaultError(f"exit code {outcome.exit_code}: {outcome.stderr[-500:]}")
    if outcome.exit_code and not outcome.stderr.strip():
        raise FaultError(f"exit code {outcome.exit_code} and not a word")

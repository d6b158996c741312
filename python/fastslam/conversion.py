"""Writes a log in another format."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from .config import sensor_of
from .datasets.g2o_write import g2o_text, write_text
from .datasets.native_write import tum_text, write_native
from .datasets.planar import chain_increments, to_world, wrap_to_pi
from .datasets.registry import load
from .dead_reckoning import path_of_odometry, start_pose
from .detection import with_sightings
from .errors import DataError
from .events import event_lines
from .log import Log, TruthTrajectory
from .runner import configure
from .several import refuse_several


def convert(source: Log | Path | str, target: Path | str, *, to: str | None = None) -> Path:
    """Write a log as `native` (a folder), `g2o`, `tum` or `jsonl` (files) and return the path.

    Without `to` the suffix of `target` decides: `.g2o`, `.tum`, `.jsonl`, none for `native`. `g2o` holds
    odometry and sightings with their noise, no truth; `tum` the true path, or that of odometry where there is
    no truth; `jsonl` odometry and sightings, or scans, as the events that `fastslam live` reads.

    Errors: DataError for a log that the format cannot hold, a target that exists, or an unknown format.
    """
    target = Path(target)
    name = format_of(target) if to is None else to
    if name not in WRITERS:
        raise DataError(f"cannot write the format {name}; written are {', '.join(WRITERS)}", target)
    WRITERS[name](source if isinstance(source, Log) else load(source), target)
    return target


def format_of(target: Path) -> str:
    """The format that a suffix stands for. Errors: DataError for a suffix of none."""
    suffix = target.suffix.lower()
    if not suffix or target.is_dir():
        return "native"
    if suffix[1:] in WRITERS:
        return suffix[1:]
    raise DataError(f"the suffix {suffix} stands for no format: name one of {', '.join(WRITERS)}", target)


def _write_g2o(log: Log, target: Path) -> None:
    log = with_sightings(log)
    config = configure(log)
    refuse_several(config, "g2o")
    mounting = config["sensor"]["mounting"]
    text = g2o_text(
        log,
        path_of_odometry(log),
        start=start_pose(log),
        sensor=sensor_of(config),
        mounting=np.array([mounting["x_m"], mounting["y_m"], mounting["yaw_rad"]]),
    )
    write_text(target, text)


def _write_tum(log: Log, target: Path) -> None:
    truth = log.truth_trajectory
    if truth is None:
        path = path_of_odometry(log)
        start = start_pose(log)
        poses = chain_increments(path.increments)
        positions = to_world(np.tile(start, (len(poses), 1)), poses[:, :2])
        poses = np.column_stack([positions, wrap_to_pi(start[2] + poses[:, 2])])
        truth = TruthTrajectory(path.stamp_s, poses)
    write_text(target, tum_text(truth))


def _write_events(log: Log, target: Path) -> None:
    write_text(target, "".join(f"{line}\n" for line in event_lines(log, configure(log))))


def _write_native(log: Log, target: Path) -> None:
    write_native(log, target)


WRITERS: dict[str, Callable[[Log, Path], None]] = {
    "native": _write_native,
    "g2o": _write_g2o,
    "tum": _write_tum,
    "jsonl": _write_events,
}

"""Writes a log as a g2o file: its odometry as edges, its sightings as points seen from poses.

Comments keep what g2o has no place for: stamps of poses, names of landmarks. The reader takes them back.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from ..errors import DataError
from ..log import Floats, Log
from .graph import UPPER_2, GraphPath
from .graph_noise import from_covariance
from .graph_rows import NAME_COMMENT, STAMP_COMMENT
from .planar import chain_increments, to_world, wrap_to_pi

SMALLEST_VARIANCE = 1e-12
"""Stands for less, which has no inverse: in m² or rad²."""


def g2o_text(log: Log, path: GraphPath, *, start: Floats, sensor: dict[str, float], mounting: Floats) -> str:
    """The text of a g2o file.

    `start` is the first pose, `sensor` has the noise of sightings without their own (`range_std_m`,
    `bearing_std_rad`), `mounting` is the pose of the sensor on the robot (x, y, yaw). Errors: DataError where
    a sighting names no landmark.
    """
    unnamed = int(np.sum(log.sightings.identity < 0))
    if unnamed:
        message = (
            f"{unnamed} of {len(log.sightings.identity)} sightings name no landmark, and a graph needs names"
        )
        raise DataError(message, log.source)
    poses = _compose(start, chain_increments(path.increments))
    points, information = _points(log, sensor, mounting)
    seen_from = np.searchsorted(path.stamp_s, log.sightings.stamp_s)
    first = {int(who): row for row, who in reversed(list(enumerate(log.sightings.identity.tolist())))}
    guesses = to_world(poses[seen_from], points)
    lines = list(_vertices(path, poses))
    for identity, name in enumerate(log.identity_names):
        if identity in first:
            x, y = guesses[first[identity]].tolist()
            lines += [f"{NAME_COMMENT}{name}", f"VERTEX_XY {len(poses) + identity} {x!r} {y!r}"]
    lines += _motions(path)
    for place, who, point, noise in zip(seen_from, log.sightings.identity, points, information, strict=True):
        lines.append(f"EDGE_SE2_XY {place} {len(poses) + who} {_text(point)} {_text(noise)}")
    return "\n".join(lines) + "\n"


def _vertices(path: GraphPath, poses: Floats) -> Iterator[str]:
    for index, (stamp_s, pose) in enumerate(zip(path.stamp_s.tolist(), poses, strict=True)):
        yield f"{STAMP_COMMENT}{stamp_s!r}"
        yield f"VERTEX_SE2 {index} {_text(pose)}"
    yield "FIX 0"


def _motions(path: GraphPath) -> Iterator[str]:
    if path.covariance is None:
        noises = [""] * len(path.increments)
    else:
        noises = [f" {_text(noise)}" for noise in _information(path.covariance)]
    for index, (step, noise) in enumerate(zip(path.increments, noises, strict=True)):
        yield f"EDGE_SE2 {index} {index + 1} {_text(step)}{noise}"


def _information(triangle: Floats) -> Floats:
    """Upper triangles of the inverses; a variance too small for one is made larger."""
    matrices = from_covariance(triangle)
    values, vectors = np.linalg.eigh(matrices)
    inverse = (vectors / np.maximum(values, SMALLEST_VARIANCE)[:, None, :]) @ vectors.swapaxes(1, 2)
    rows, columns = np.triu_indices(matrices.shape[1])
    upper: Floats = inverse[:, rows, columns]
    return upper


def _points(log: Log, sensor: dict[str, float], mounting: Floats) -> tuple[Floats, Floats]:
    """What was seen as points in the robot's frame, with the upper triangle of their information."""
    range_m, bearing_rad = log.sightings.range_m, log.sightings.bearing_rad
    polar = np.tile([sensor["range_std_m"] ** 2, 0.0, sensor["bearing_std_rad"] ** 2], (len(range_m), 1))
    if log.sightings.covariance is not None:
        known = ~np.isnan(log.sightings.covariance).any(axis=1)
        polar[known] = log.sightings.covariance[known]
    direction = bearing_rad + mounting[2]
    cosine, sine = np.cos(direction), np.sin(direction)
    by_polar = np.stack([np.stack([cosine, -range_m * sine]), np.stack([sine, range_m * cosine])])
    by_polar = by_polar.transpose(2, 0, 1)
    covariance = by_polar @ from_covariance(polar) @ by_polar.swapaxes(1, 2)
    points = np.column_stack([mounting[0] + range_m * cosine, mounting[1] + range_m * sine])
    return points, _information(covariance[:, UPPER_2[0], UPPER_2[1]])


def _compose(start: Floats, poses: Floats) -> Floats:
    positions = to_world(np.tile(start, (len(poses), 1)), poses[:, :2])
    return np.column_stack([positions, wrap_to_pi(start[2] + poses[:, 2])])


def _text(values: Floats) -> str:
    return " ".join(repr(float(value)) for value in values)


def write_text(path: Path, text: str) -> None:
    """Write a new file as a whole or not at all. Errors: DataError where it exists or cannot be written."""
    if path.exists():
        raise DataError("exists already: choose another", path)
    temporary = path.with_name(f".{path.name}.part")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        temporary.write_text(text, encoding="utf-8")
        temporary.replace(path)
    except OSError as error:
        temporary.unlink(missing_ok=True)
        raise DataError(f"cannot be written ({error.strerror})", path) from error

"""How far path and map of a run in space lie from the truth, as they are and after a rigid motion."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..log import Floats
from .log import SpaceLog, SpaceTruth
from .result import SpaceMap, SpacePath, SpaceResult

Metrics = dict[str, float | int | None]
LARGEST_GAP_S = 0.5
"""Poses that lie further apart are not interpolated between."""


def evaluate(result: SpaceResult, log: SpaceLog) -> Metrics:
    """Metrics by name with their unit; those that need a truth only where there is one.

    `aligned` are those after the rigid motion that brings the positions (of path or map, each by itself) to
    the true ones best: where a run's frame lies is not for the sightings to say.
    """
    metrics: Metrics = {
        "landmarks.count": len(result.landmarks.ids),
        "sightings.used": int(np.sum(result.steps["sightings"])),
        "innovation_ratio": result.innovation_ratio,
        "log_evidence_nats": result.log_evidence,
        "filter_seconds": result.filter_seconds,
    }
    truth = log.truth
    if truth is None:
        return metrics
    if len(truth.stamp_s):
        metrics |= _path("path.live", result.trajectory, truth)
        metrics |= _path("path.smoothed", result.smoothed, truth)
    if truth.names:
        metrics |= _map(result.landmarks, truth)
    return metrics


def _path(name: str, path: SpacePath, truth: SpaceTruth) -> Metrics:
    stamp_s, poses = at_stamps(path, truth.stamp_s)
    if len(stamp_s) < 3:
        return {}
    true = truth.T_world_robot[np.isin(truth.stamp_s, stamp_s)]
    turn, shift = alignment(poses[:, :3], true[:, :3])
    aligned = poses[:, :3] @ matrices(turn[None])[0].T + shift
    turned = compose(np.broadcast_to(turn, (len(poses), 4)), poses[:, 3:])
    return {
        f"{name}.position_rmse_m": rms(poses[:, :3] - true[:, :3]),
        f"{name}.rotation_rmse_rad": _angle(poses[:, 3:], true[:, 3:]),
        f"{name}.aligned.position_rmse_m": rms(aligned - true[:, :3]),
        f"{name}.aligned.rotation_rmse_rad": _angle(turned, true[:, 3:]),
        f"{name}.poses": len(stamp_s),
    }


def _map(found: SpaceMap, truth: SpaceTruth) -> Metrics:
    pairs = [(i, truth.names.index(name)) for i, name in enumerate(found.ids) if name in truth.names]
    if len(pairs) < 3:
        return {"map.matched": len(pairs)}
    ours, theirs = (list(indices) for indices in zip(*pairs, strict=True))
    points, true = found.mean_m[ours], truth.position_m[theirs]
    turn, shift = alignment(points, true)
    off = points - true
    squared = np.einsum("ki,ki->k", off, np.linalg.solve(found.covariance_m2[ours], off[..., None])[..., 0])
    return {
        "map.matched": len(pairs),
        "map.of": len(truth.names),
        "map.rmse_m": rms(off),
        "map.aligned.rmse_m": rms(points @ matrices(turn[None])[0].T + shift - true),
        "map.nees_per_number": float(np.mean(squared) / 3.0),
    }


def at_stamps(path: SpacePath, stamps_s: Floats) -> tuple[Floats, Floats]:
    """The stamps that lie on the path, and its poses there: straight lines between positions and turns."""
    known = path.stamp_s
    if len(known) < 2:
        return np.empty(0), np.empty((0, 7))
    after = np.clip(np.searchsorted(known, stamps_s, side="left"), 1, len(known) - 1)
    gap = known[after] - known[after - 1]
    inside = (stamps_s >= known[0]) & (stamps_s <= known[-1]) & (gap <= LARGEST_GAP_S)
    after, stamp_s, gap = after[inside], stamps_s[inside], gap[inside]
    share = ((stamp_s - known[after - 1]) / gap)[:, None]
    first, second = path.T_world_robot[after - 1], path.T_world_robot[after]
    side = np.where(np.sum(first[:, 3:] * second[:, 3:], axis=1, keepdims=True) < 0, -1.0, 1.0)
    # Between neighbours the chord is as good as the arc: a tenth of a radian errs by 1e-5.
    quaternion = (1.0 - share) * first[:, 3:] + share * side * second[:, 3:]
    quaternion /= np.linalg.norm(quaternion, axis=1, keepdims=True)
    return stamp_s, np.column_stack([(1.0 - share) * first[:, :3] + share * second[:, :3], quaternion])


def alignment(source_m: Floats, target_m: Floats) -> tuple[Floats, Floats]:
    """Quaternion and shift of the rigid motion that brings points (N, 3) nearest to others (Horn)."""
    middle, aim = source_m.mean(axis=0), target_m.mean(axis=0)
    s = (source_m - middle).T @ (target_m - aim)
    trace, z = np.trace(s), np.array([s[1, 2] - s[2, 1], s[2, 0] - s[0, 2], s[0, 1] - s[1, 0]])
    form = np.empty((4, 4))
    form[0, 0], form[0, 1:], form[1:, 0] = trace, z, z
    form[1:, 1:] = s + s.T - trace * np.eye(3)
    turn = np.linalg.eigh(form)[1][:, -1]
    return turn, aim - matrices(turn[None])[0] @ middle


def matrices(quaternions: Floats) -> Floats:
    """Rotation matrices (N, 3, 3) of quaternions (N, 4) w, x, y, z."""
    w, x, y, z = quaternions.T
    rows = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )
    return np.moveaxis(np.array(rows), -1, 0)


def quaternions(rotations: Floats) -> Floats:
    """Quaternions (N, 4) w, x, y, z of rotation matrices (N, 3, 3), w not negative."""
    m = rotations
    trace = np.trace(m, axis1=1, axis2=2)
    # The largest of the four is found first, so that nothing is divided by zero.
    diagonal = np.column_stack([trace, m[:, 0, 0], m[:, 1, 1], m[:, 2, 2]])
    signs = 1.0 + 2.0 * diagonal - np.column_stack([trace, trace, trace, trace])
    signs[:, 0] = 1.0 + trace
    largest = np.argmax(signs, axis=1)
    off = np.column_stack([m[:, 2, 1] - m[:, 1, 2], m[:, 0, 2] - m[:, 2, 0], m[:, 1, 0] - m[:, 0, 1]])
    products = np.empty((len(m), 4, 4))
    products[:, 0, 0] = signs[:, 0]
    products[:, 0, 1:] = products[:, 1:, 0] = off
    for i in range(3):
        for j in range(3):
            products[:, 1 + i, 1 + j] = signs[:, 1 + i] if i == j else m[:, i, j] + m[:, j, i]
    chosen = products[np.arange(len(m)), largest]
    chosen /= np.linalg.norm(chosen, axis=1, keepdims=True)
    return np.asarray(np.where(chosen[:, :1] < 0, -chosen, chosen))


def compose(first: Floats, second: Floats) -> Floats:
    """Products of quaternions (N, 4)."""
    w, v, u, q = first[:, :1], first[:, 1:], second[:, :1], second[:, 1:]
    scalar = w * u - np.sum(v * q, axis=1, keepdims=True)
    return np.hstack([scalar, w * q + u * v + np.cross(v, q)])


def _angle(ours: Floats, theirs: Floats) -> float:
    between = compose(ours * np.array([1.0, -1.0, -1.0, -1.0]), theirs)
    angle = 2.0 * np.arctan2(np.linalg.norm(between[:, 1:], axis=1), np.abs(between[:, 0]))
    return float(np.sqrt(np.mean(angle**2)))


def rms(off: Floats) -> float:
    """Root of the mean squared length of rows."""
    return float(np.sqrt(np.mean(np.sum(off**2, axis=1))))


def shown(metrics: Metrics) -> list[tuple[str, str, str]]:
    """Name, value and unit of each metric, for a table; angles in degrees."""
    rows = []
    for name, value in metrics.items():
        unit = next((unit for unit in ("_rad", "_m", "_nats") if name.endswith(unit)), "")
        number: Any = value
        if unit == "_rad" and value is not None:
            number = float(np.degrees(value))
        text = "-" if number is None else f"{number:,}" if isinstance(number, int) else f"{number:.4g}"
        rows.append(
            (name.removesuffix(unit), text, {"_rad": "deg", "_m": "m", "_nats": "nats"}.get(unit, ""))
        )
    return rows

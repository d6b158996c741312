"""A batch solution beside the filter: poses, landmarks, scale and bias by sparse Gauss-Newton.

It shares no code with the filter. Motions are those of the log with their noise, the first pose is held where
the guess has it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from fastslam.log import Log
from scipy.sparse import coo_matrix, csr_matrix
from scipy.sparse.linalg import spsolve

Floats = npt.NDArray[np.float64]
ITERATIONS = 50
STILL_M = 1e-6
USUAL_STD = (0.05, 0.5)
"""Standard deviations of scale and bias of ranges: what a run takes where nothing is told."""
FLOOR = 1e-4
"""Least standard deviation of a motion, metres and radians: what stands still is held this well."""


@dataclass(frozen=True)
class Solution:
    """Shapes: `stamp_s` (P,), `poses` (P, 3), `landmarks` (K, 2)."""

    stamp_s: Floats
    poses: Floats
    landmarks: Floats
    calibration: Floats


def wrapped(angle: Floats) -> Floats:
    return np.arctan2(np.sin(angle), np.cos(angle))


def motions(log: Log, config: dict[str, Any]) -> tuple[Floats, Floats, Floats]:
    """Stamps of the poses, increments between them, and their standard deviations: a pose for each row."""
    stamp_s, values, motion = log.controls.stamp_s, log.controls.values, config["motion"]
    if motion["model"] == "increments":
        stamps = np.concatenate([[stamp_s[0] - np.median(np.diff(stamp_s))], stamp_s])
        if log.controls.covariance is not None:
            return stamps, values, np.sqrt(log.controls.covariance[:, [0, 3, 5]])
        std = [motion[key] for key in ("x_std_m", "y_std_m", "heading_std_rad")]
        return stamps, values, np.tile(std, (len(values), 1))
    dt_s = np.diff(stamp_s)[:, None]
    speed, rate = (values[:-1, :1], values[:-1, 1:])
    turn = rate * dt_s
    ahead = speed * dt_s * np.sinc(turn / np.pi)
    left = speed * dt_s * np.sinc(turn / (2 * np.pi)) * np.sin(turn / 2)
    std_of = (motion["speed_std_m_per_s"], 0.0, motion["yaw_rate_std_rad_per_s"])
    # White noise that is this large over one period.
    held_s = np.sqrt(dt_s * motion["noise_period_s"])
    return stamp_s, np.hstack([ahead, left, turn]), np.maximum(held_s * np.array(std_of), FLOOR)


def spread_of(config: dict[str, Any]) -> tuple[float, float]:
    """Standard deviations of scale and bias."""
    told = (config["sensor"].get(key) for key in ("range_scale_std", "range_bias_std_m"))
    scale, bias = (usual if own is None else own for own, usual in zip(told, USUAL_STD, strict=True))
    return scale, bias


def solve(log: Log, config: dict[str, Any], poses: Floats, landmarks: Floats) -> Solution:
    """The mode near a guess; ranges with scale and bias, bearings without."""
    stamp_s, increments, std = motions(log, config)
    seen, ranges = log.sightings, config["sensor"]["model"] == "range"
    at = np.abs(stamp_s[:, None] - seen.stamp_s[None, :]).argmin(axis=0)
    value = seen.range_m if ranges else seen.bearing_rad
    noise = np.full(len(at), config["sensor"]["range_std_m" if ranges else "bearing_std_rad"])
    if seen.covariance is not None:
        noise = np.sqrt(seen.covariance[:, 0 if ranges else 2])
    state = np.concatenate([poses[1:].ravel(), landmarks.ravel(), [1.0, 0.0]])
    first, count = poses[0], len(poses)

    def parts(state: Floats) -> tuple[Floats, Floats, Floats]:
        own = np.vstack([first, state[: 3 * (count - 1)].reshape(-1, 3)])
        return own, state[3 * (count - 1) : -2].reshape(-1, 2), state[-2:]

    def linear(state: Floats) -> tuple[Floats, csr_matrix]:
        own, map_, calibration = parts(state)
        blocks = [moved(own, increments, std)]
        blocks.append(looked(own, map_, calibration, (at, seen.identity, value, noise, ranges)))
        mean, spread = np.array([1.0, 0.0]), np.array(spread_of(config) if ranges else (1e-9, 1e-9))
        columns = len(state) - 2 + np.arange(2)
        blocks.append(((calibration - mean) / spread, np.arange(2), columns, 1.0 / spread))
        residual = np.concatenate([block[0] for block in blocks])
        shift = np.cumsum([0, *(len(block[0]) for block in blocks[:-1])])
        rows = np.concatenate([block[1] + s for block, s in zip(blocks, shift, strict=True)])
        cols = np.concatenate([block[2] for block in blocks])
        entries = np.concatenate([block[3] for block in blocks])
        free = cols >= 0
        shape = (len(residual), len(state))
        return residual, coo_matrix((entries[free], (rows[free], cols[free])), shape=shape).tocsr()

    residual, jacobian = linear(state)
    damping = 1e-6
    for _ in range(ITERATIONS):
        normal = (jacobian.T @ jacobian).tocsc()
        damped = normal.copy()
        damped.setdiag(normal.diagonal() * (1.0 + damping))
        step = spsolve(damped, -(jacobian.T @ residual))
        new, new_jacobian = linear(state + step)
        if new @ new <= residual @ residual:
            state, residual, jacobian, damping = state + step, new, new_jacobian, 0.3 * damping
            if np.abs(step).max() < STILL_M:
                break
        else:
            damping = max(10.0 * damping, 1e-6)
    own, map_, calibration = parts(state)
    return Solution(stamp_s, own, map_, calibration)


def moved(poses: Floats, increments: Floats, std: Floats) -> tuple[Floats, Floats, Floats, Floats]:
    """Residuals of motions over their standard deviations; rows, columns, entries of derivatives."""
    before, step = poses[:-1], np.diff(poses, axis=0)
    c, s = np.cos(before[:, 2]), np.sin(before[:, 2])
    x, y = c * step[:, 0] + s * step[:, 1], -s * step[:, 0] + c * step[:, 1]
    off = np.column_stack(
        [x - increments[:, 0], y - increments[:, 1], wrapped(step[:, 2] - increments[:, 2])]
    )
    zero, one = np.zeros_like(c), np.ones_like(c)
    by_after = np.array([[c, s, zero], [-s, c, zero], [zero, zero, one]])
    by_before = np.array([[-c, -s, y], [s, -c, -x], [zero, zero, -one]])
    number = np.arange(len(c))
    rows, cols, entries = [], [], []
    for a in range(3):
        for b in range(3):
            for derivative, pose in ((by_before, number - 1), (by_after, number)):
                rows.append(3 * number + a)
                cols.append(np.where(pose >= 0, 3 * pose + b, -1))
                entries.append(derivative[a, b] / std[:, a])
    return (off / std).ravel(), np.concatenate(rows), np.concatenate(cols), np.concatenate(entries)


def looked(
    poses: Floats, landmarks: Floats, calibration: Floats, seen: tuple[Any, Any, Floats, Floats, bool]
) -> tuple[Floats, Floats, Floats, Floats]:
    """The same of sightings (pose, landmark, value, noise, whether it is a range)."""
    at, which, value, noise, ranges = seen
    dx, dy = (landmarks[which] - poses[at, :2]).T
    distance = np.hypot(dx, dy)
    if ranges:
        scale, bias = calibration
        residual = scale * distance + bias - value
        bx, by, bh = scale * dx / distance, scale * dy / distance, np.zeros_like(dx)
    else:
        residual = wrapped(np.arctan2(dy, dx) - poses[at, 2] - value)
        bx, by, bh = -dy / distance**2, dx / distance**2, -np.ones_like(dx)
    number = np.arange(len(at))
    own, border = 3 * (at - 1), 3 * (len(poses) - 1)
    last = border + 2 * len(landmarks)
    table = [(own, -bx), (own + 1, -by), (own + 2, bh)]
    table += [(border + 2 * which, bx), (border + 2 * which + 1, by)]
    if ranges:
        table += [(np.full_like(at, last), distance), (np.full_like(at, last + 1), np.ones_like(dx))]
    cols = np.concatenate([np.where(column >= 0, column, -1) for column, _ in table])
    entries = np.concatenate([entry / noise for _, entry in table])
    return residual / noise, np.tile(number, len(table)), cols, entries

"""Planar rigid transforms as arrays (x_m, y_m, heading_rad), for turning poses into increments and back."""

from __future__ import annotations

import numpy as np

from ..log import Floats


def wrap_to_pi(angle_rad: Floats) -> Floats:
    """Angles in [-pi, pi]; values that lie there already keep their bits."""
    wrapped = angle_rad - 2 * np.pi * np.round(angle_rad / (2 * np.pi))
    return np.where(np.abs(angle_rad) > np.pi, wrapped, angle_rad)


def increments_between(T_world_robot: Floats) -> Floats:
    """Each pose in the frame of the one before. Shapes: (N, 3) gives (N - 1, 3)."""
    step = np.diff(T_world_robot, axis=0)
    cos, sin = np.cos(T_world_robot[:-1, 2]), np.sin(T_world_robot[:-1, 2])
    return np.column_stack(
        [
            cos * step[:, 0] + sin * step[:, 1],
            cos * step[:, 1] - sin * step[:, 0],
            wrap_to_pi(step[:, 2]),
        ]
    )


def chain_increments(increments: Floats) -> Floats:
    """Poses from increments, starting at the origin. Shapes: (N, 3) gives (N + 1, 3); headings unwrapped."""
    heading = np.concatenate([[0.0], np.cumsum(increments[:, 2])])
    cos, sin = np.cos(heading[:-1]), np.sin(heading[:-1])
    x = np.cumsum(cos * increments[:, 0] - sin * increments[:, 1])
    y = np.cumsum(sin * increments[:, 0] + cos * increments[:, 1])
    return np.column_stack([np.concatenate([[0.0], x]), np.concatenate([[0.0], y]), heading])


def to_world(T_world_robot: Floats, point_in_robot: Floats) -> Floats:
    """Points given in the frame of their own pose, in the world. Shapes: (N, 3) and (N, 2) give (N, 2)."""
    cos, sin = np.cos(T_world_robot[:, 2]), np.sin(T_world_robot[:, 2])
    x, y = point_in_robot[:, 0], point_in_robot[:, 1]
    return np.column_stack([T_world_robot[:, 0] + cos * x - sin * y, T_world_robot[:, 1] + sin * x + cos * y])


def heading_of_quaternion(quaternion: Floats) -> Floats:
    """Heading of orientations (qx, qy, qz, qw) of any length but zero. Shapes: (N, 4) gives (N,)."""
    qx, qy, qz, qw = quaternion.T
    heading: Floats = np.arctan2(2 * (qw * qz + qx * qy), qw**2 + qx**2 - qy**2 - qz**2)
    return heading


def polar_covariance(x: Floats, y: Floats, covariance: Floats) -> Floats:
    """Covariance of range and bearing from that of x and y, to first order.

    Shapes: (N,), (N,) and (N, 3) as (xx, xy, yy) give (N, 3) as (m², m·rad, rad²).
    """
    squared = x**2 + y**2
    with np.errstate(divide="ignore", invalid="ignore"):
        range_m = np.sqrt(squared)
        rx, ry, bx, by = x / range_m, y / range_m, -y / squared, x / squared
        xx, xy, yy = covariance.T
        return np.column_stack(
            [
                rx * rx * xx + 2 * rx * ry * xy + ry * ry * yy,
                rx * bx * xx + (rx * by + ry * bx) * xy + ry * by * yy,
                bx * bx * xx + 2 * bx * by * xy + by * by * yy,
            ]
        )

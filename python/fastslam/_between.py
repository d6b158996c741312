"""How far the odometry leads from one stamp to another, with the noise that gathers on the way."""

from __future__ import annotations

import numpy as np

from .log import Controls, Floats


def motion_between(
    controls: Controls, twists: Floats, stamp_s: Floats, density: Floats
) -> tuple[Floats, Floats]:
    """Motion from each stamp to the next, and integrals of densities of noise over the same time.

    Shapes: `twists` (C, 3) as `arc_twists` gives them, `density` (C, P), both held from the stamp
    of a control until the next; returns (K - 1, 3), ahead, left and turn in the frame of the earlier pose,
    and (K - 1, P). Before the first control the robot stands.
    """
    edges = np.unique(np.concatenate([stamp_s, controls.stamp_s]))
    edges = edges[(edges >= stamp_s[0]) & (edges <= stamp_s[-1])]
    dt_s = np.diff(edges)
    held = np.clip(np.searchsorted(controls.stamp_s, edges[:-1], side="right") - 1, 0, len(twists) - 1)
    moving = edges[:-1] >= controls.stamp_s[0]
    twist = twists[held] * moving[:, None]
    turn = np.concatenate([[0.0], np.cumsum(twist[:, 2] * dt_s)])
    middle = turn[:-1] + 0.5 * twist[:, 2] * dt_s
    chord = np.sinc(0.5 * twist[:, 2] * dt_s / np.pi) * dt_s
    ahead, left = twist[:, 0] * chord, twist[:, 1] * chord
    step = np.column_stack(
        [np.cos(middle) * ahead - np.sin(middle) * left, np.sin(middle) * ahead + np.cos(middle) * left]
    )
    place = np.vstack([np.zeros(2), np.cumsum(step, axis=0)])
    gathered = np.vstack([np.zeros(density.shape[1]), np.cumsum(density[held] * dt_s[:, None], axis=0)])
    at = np.searchsorted(edges, stamp_s)
    apart = np.diff(place[at], axis=0)
    cosine, sine = np.cos(turn[at[:-1]]), np.sin(turn[at[:-1]])
    moved = np.column_stack(
        [
            cosine * apart[:, 0] + sine * apart[:, 1],
            cosine * apart[:, 1] - sine * apart[:, 0],
            np.diff(turn[at]),
        ]
    )
    return moved, np.diff(gathered[at], axis=0)

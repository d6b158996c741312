"""How far the odometry leads from one stamp to another, with the noise that gathers on the way."""

from __future__ import annotations

import numpy as np

from .log import Controls, Floats


class Between:
    """Which rows of the odometry lead from each stamp (K,) to the next: one analysis for many readings.

    A row counts from its stamp until the next; before the first one the robot stands.
    """

    def __init__(self, controls: Controls, stamp_s: Floats) -> None:
        edges = np.concatenate([stamp_s, controls.stamp_s])
        # Two runs in order: a stable sort merges them, where np.unique sorts anew.
        edges.sort(kind="stable")
        edges = edges[np.diff(edges, prepend=-np.inf) > 0.0]
        edges = edges[(edges >= stamp_s[0]) & (edges <= stamp_s[-1])]
        rows = len(controls.stamp_s)
        self._dt_s = np.diff(edges)
        self._held = np.clip(np.searchsorted(controls.stamp_s, edges[:-1], side="right") - 1, 0, rows - 1)
        self._moving = edges[:-1] >= controls.stamp_s[0]
        self._at = np.searchsorted(edges, stamp_s)

    def motion(self, twists: Floats) -> Floats:
        """Ahead, left and turn (K - 1, 3) in the frame of the earlier pose; `twists` (C, 3): `arc_twists`."""
        dt_s, at = self._dt_s, self._at
        speed, aside, rate = (column[self._held] * self._moving for column in twists.T)
        turned = rate * dt_s
        turn = _summed(turned)
        middle = turn[:-1] + 0.5 * rate * dt_s
        chord = np.sinc(0.5 * rate * dt_s / np.pi) * dt_s
        ahead, left = speed * chord, aside * chord
        cosine, sine = np.cos(middle), np.sin(middle)
        apart_x = np.diff(_summed(cosine * ahead - sine * left)[at])
        apart_y = np.diff(_summed(sine * ahead + cosine * left)[at])
        cosine, sine = np.cos(turn[at[:-1]]), np.sin(turn[at[:-1]])
        return np.column_stack(
            [cosine * apart_x + sine * apart_y, cosine * apart_y - sine * apart_x, np.diff(turn[at])]
        )

    def gathered(self, density: Floats) -> Floats:
        """Integrals (K - 1, P) of densities (C, P) of noise."""
        sums = (_summed(column[self._held] * self._dt_s)[self._at] for column in density.T)
        return np.column_stack([np.diff(total) for total in sums])


def motion_between(
    controls: Controls, twists: Floats, stamp_s: Floats, density: Floats
) -> tuple[Floats, Floats]:
    """The motion from each stamp to the next, and the integrals of densities of noise: see `Between`."""
    between = Between(controls, stamp_s)
    return between.motion(twists), between.gathered(density)


def _summed(steps: Floats) -> Floats:
    """Sums of all steps before each edge, from zero on."""
    total: Floats = np.concatenate([[0.0], np.cumsum(steps)])
    return total

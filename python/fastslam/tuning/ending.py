"""Ends a run of the filter whose map has grown so far beyond the best one's that it can hardly be kept."""

from __future__ import annotations

import numpy as np

from ..result import RunResult
from ..watching import View

OPEN_LOOP = 2.0
"""While a loop is open, a right map holds all that was seen until then twice at most."""
LOOKS = 50
"""So often a run is looked at."""


class Growth:
    """Watches a run: ends it where its map is far larger than that of the best one at that time of the log.

    Up to 1 / `share` times as many landmarks as the best map has in all are never too many. All count, those
    too that are not confirmed: where noise is far too narrow hardly one ever is.
    """

    def __init__(self, best: RunResult, share: float) -> None:
        steps = best.steps
        self._stamp_s, self._until_then = steps.stamp_s, np.maximum.accumulate(steps.landmarks)
        self._most = float(self._until_then[-1]) / share
        self._period_s = float(np.ptp(steps.stamp_s)) / LOOKS
        self.has_ended = False

    def __call__(self, view: View) -> tuple[float, float]:
        """A `Watch`."""
        row = max(int(np.searchsorted(self._stamp_s, view.stamp_s, side="right")) - 1, 0)
        if view.info.landmarks > max(self._most, OPEN_LOOP * self._until_then[row]):
            self.has_ended = True
            raise KeyboardInterrupt
        return np.inf, view.stamp_s + self._period_s

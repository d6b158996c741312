"""Landmarks that stand for two things: scans show both beside each other, and the map has one of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from .config import merge
from .laid import Laid, explained_apart, laid_on_map, wide_noise
from .log import Bools, Ints, Log
from .result import RunResult
from .standing import more_by_chance

SURE = 1e-3
"""So rarely a right map has one landmark that is taken for two things."""
USUAL = 0.5
"""What this share of the landmarks has least of is had by chance: clutter beside them, things seen double."""


def crowded(result: RunResult, log: Log, laid: Laid) -> list[int]:
    """The landmarks (rows of the map that was laid on) beside which scans show one more thing too often.

    Held against each other under the noise told, `laid`, or one that is wide for its kind, where that is
    less: under a wider one every landmark explains what stands beside it. Clutter falls beside all landmarks,
    and a detector that sees things double sees all of them so.
    """
    sensor = result.config["sensor"]
    wide = dict(zip(("range_std_m", "bearing_std_rad"), wide_noise(log, result.config).tolist(), strict=True))
    if any(std < sensor[name] for name, std in wide.items()):
        narrower = {name: min(std, sensor[name]) for name, std in wide.items()}
        config = merge(result.config, {"sensor": narrower})
        relaid = laid_on_map(replace(result, config=config), log)
        if relaid is None:
            return []
        laid, sensor = relaid, config["sensor"]
    left_over = laid.explained & ~explained_apart(laid, log, sensor)
    looks, crowds = _looks(laid, laid.explained), _looks(laid, left_over)
    order = np.argsort(crowds / np.maximum(looks, 1), kind="stable")
    usual = order[: int(np.ceil(USUAL * len(order)))]
    # One more than there were in all: that none was seen says that they are rare.
    rate = crowds[usual].sum() / max(int(looks[usual].sum()), 1) + 1 / max(int(looks.sum()), 1)
    return [
        landmark
        for landmark in np.flatnonzero(crowds).tolist()
        if more_by_chance(int(crowds[landmark]), rate * int(looks[landmark])) < SURE / len(looks)
    ]


def _looks(laid: Laid, chosen: Bools) -> Ints:
    """In how many looks each landmark (K,) is the nearest one of a chosen sighting."""
    pairs = np.unique(np.column_stack([laid.landmark[chosen], laid.look[chosen]]), axis=0)
    return np.asarray(np.bincount(pairs[:, 0], minlength=len(laid.mean_m)))

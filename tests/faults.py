"""Faults put into simulated logs, to see whether the filter notices."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from fastslam.log import Bools, Controls, Floats, Log, Sightings


def kidnapped(log: Log, *, at_s: float, for_s: float) -> Log:
    """The robot is carried along its path for a while: neither odometry nor sightings tell of it."""

    def cut(stamp_s: Floats) -> Bools:
        return (stamp_s < at_s) | (stamp_s >= at_s + for_s)

    def shifted(stamp_s: Floats) -> Floats:
        return np.where(stamp_s < at_s, stamp_s, stamp_s - for_s)

    controls, sightings = log.controls, log.sightings
    keep = cut(controls.stamp_s)
    moved = _chosen(sightings, cut(sightings.stamp_s))
    return replace(
        log,
        controls=Controls(shifted(controls.stamp_s[keep]), controls.values[keep]),
        sightings=replace(moved, stamp_s=shifted(moved.stamp_s)),
        truth_trajectory=None,
    )


def with_swapped_wheels(log: Log, *, at_s: float) -> Log:
    """From a moment on the yaw rate of the odometry has the wrong sign."""
    values = log.controls.values.copy()
    values[log.controls.stamp_s >= at_s, 1] *= -1.0
    return replace(log, controls=Controls(log.controls.stamp_s, values))


def blinded(log: Log, *, at_s: float) -> Log:
    """From a moment on nothing is sighted."""
    return replace(log, sightings=_chosen(log.sightings, log.sightings.stamp_s < at_s))


def with_moved_landmarks(log: Log, *, at_s: float, by_m: float, seed: int) -> Log:
    """From a moment on every landmark stands `by_m` from where it stood, each in a direction of its own."""
    assert log.truth_trajectory is not None and log.truth_landmarks is not None
    angle = np.random.default_rng(seed).uniform(-np.pi, np.pi, len(log.truth_landmarks.names))
    shift_m = by_m * np.column_stack([np.cos(angle), np.sin(angle)])
    sightings, truth = log.sightings, log.truth_trajectory
    poses = truth.T_world_robot[np.searchsorted(truth.stamp_s, sightings.stamp_s - 1e-9)]
    # Clutter has no landmark; it stays where it is.
    moved = (sightings.stamp_s >= at_s) & (sightings.identity >= 0)
    here_m = log.truth_landmarks.position_m[sightings.identity] - poses[:, :2]
    there_m = here_m + shift_m[sightings.identity]
    more_m = np.hypot(*there_m.T) - np.hypot(*here_m.T)
    turn = np.arctan2(there_m[:, 1], there_m[:, 0]) - np.arctan2(here_m[:, 1], here_m[:, 0])
    return replace(
        log,
        sightings=replace(
            sightings,
            range_m=np.where(moved, np.maximum(sightings.range_m + more_m, 0.05), sightings.range_m),
            bearing_rad=np.where(moved, sightings.bearing_rad + turn, sightings.bearing_rad),
        ),
    )


def _chosen(sightings: Sightings, keep: Bools) -> Sightings:
    return replace(
        sightings,
        stamp_s=sightings.stamp_s[keep],
        range_m=sightings.range_m[keep],
        bearing_rad=sightings.bearing_rad[keep],
        identity=sightings.identity[keep],
        class_index=sightings.class_index[keep],
        signature=sightings.signature[keep],
    )


def with_removed_landmarks(log: Log, *, at_s: float, fraction: float, seed: int) -> Log:
    """From a moment on a fraction of the landmarks is gone."""
    names = np.unique(log.sightings.identity)
    gone = np.random.default_rng(seed).choice(names, round(fraction * len(names)), replace=False)
    keep = (log.sightings.stamp_s < at_s) | ~np.isin(log.sightings.identity, gone)
    return replace(log, sightings=_chosen(log.sightings, keep))

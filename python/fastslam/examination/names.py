"""Names of landmarks that cannot all be right."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ..log import Bools, Floats, Ints
from .finding import Finding
from .hypotheses import places
from .stretches import names_are_unique, sighting_noise_m
from .subject import Subject

LEAST_AT_A_PLACE = 5
MOST_NAMES = 0.05
"""If more names than this share jump, it is not the names that are wrong."""
DRIFT = 0.1
"""An odometry is granted to be wrong by this share of the way, and by this angle for each radian turned."""


def two_places(subject: Subject) -> Iterator[Finding]:
    """A name that stands for two things: it jumps further than the odometry can be wrong, and stays there."""
    sightings = subject.log.sightings
    if not names_are_unique(sightings) or subject.explanation is not None or subject.as_is.found < 0.5:
        return
    moved_s = subject.log.controls.stamp_s
    order = np.lexsort((sightings.stamp_s, sightings.identity))
    inside = (sightings.stamp_s >= moved_s[0]) & (sightings.stamp_s <= moved_s[-1])
    order = order[((sightings.identity >= 0) & inside)[order]]
    jump, far_m = _jumps(subject, order)
    name = sightings.identity[order][1:]
    in_doubt = np.unique(name[jump])
    if len(in_doubt) > MOST_NAMES * len(np.unique(name)) + 1:
        return
    for index in in_doubt.tolist():
        mine = name == index
        lasting = np.diff(np.flatnonzero(np.concatenate([[True], jump[mine], [True]]))) >= LEAST_AT_A_PLACE
        if int(lasting.sum()) < 2:
            continue
        worst = int(np.argmax(np.where(mine & jump, far_m, -1.0)))
        wait_s = float(sightings.stamp_s[order[worst + 1]] - sightings.stamp_s[order[worst]])
        message = (
            f"landmark {subject.log.identity_names[index]} contradicts itself: of {int(mine.sum()) + 1:,} "
            f"sightings {int(jump[mine].sum())} are elsewhere than the one before, up to "
            f"{far_m[worst]:.3g} m off after {wait_s:.3g} s"
        )
        remedy = "give the two things two names, or set association.mode=unknown"
        yield Finding("name-two-places", "problem", message, remedy)


def _jumps(subject: Subject, order: Ints) -> tuple[Bools, Floats]:
    """Whether each sighting is further from the one before of its name than can be, and how far (N - 1)."""
    sightings = subject.log.sightings
    seen = places(sightings, subject.config["sensor"], subject.reckoning)
    along, across = sighting_noise_m(sightings, subject.config["sensor"])
    noise_m = np.hypot(along, across)[order]
    travelled_m, turned = subject.driven_at(sightings.stamp_s[order])
    far_m = np.hypot(*np.diff(seen.point_m[order], axis=0).T)
    way_m, turn = np.abs(np.diff(travelled_m)), np.abs(np.diff(turned))
    reach_m = np.maximum(sightings.range_m[order][1:], sightings.range_m[order][:-1]) + way_m
    allowed_m = (
        5.0 * np.hypot(noise_m[1:], noise_m[:-1]) + DRIFT * way_m + np.minimum(DRIFT * turn, 0.5) * reach_m
    )
    same = np.diff(sightings.identity[order]) == 0
    return same & (far_m > 2.0 * allowed_m), far_m

"""Whether displacements turn as the heading does."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ..datasets.planar import chain_increments
from ..log import Floats
from .hypotheses import DEGREE
from .subject import Subject

BLOCK = 50
"""Displacements that must agree; an odometer may forget whole turns from one block to the next."""
LEAST_BLOCKS = 5
TELLING_RAD = 1.0
SCATTERED, TOGETHER = 0.5, 0.9
"""Length of the mean direction (1: all the same) below and above which a reading is wrong and right."""
GAINS: dict[Literal["degrees", "clockwise"], float] = {"degrees": DEGREE, "clockwise": -1.0}


@dataclass(frozen=True)
class Course:
    """What the heading seems to be, how many blocks tell, how much displacements agree, before and then."""

    kind: Literal["degrees", "clockwise"]
    blocks: int
    as_is: float
    then: float


def read_course(subject: Subject) -> Course | None:
    """Compares the direction of travel with the heading; None where nothing is amiss.

    Only for displacements. A robot that drives sideways or backwards keeps the angle between the two, and
    one whose angle changes at will fits no reading.
    """
    if not subject.steps:
        return None
    path = chain_increments(subject.log.controls.values)
    for rows in (1, 3, 10):
        found = _read(path[::rows])
        if found is not None:
            return found
    return None


def _read(path: Floats) -> Course | None:
    step = np.diff(path[:, :2], axis=0)
    blocks = len(step) // BLOCK
    if blocks < LEAST_BLOCKS:
        return None
    shape = (blocks, BLOCK)
    # Doubled angles: a robot that backs up drives along its heading as well.
    travel = (step[:, 0] + 1j * step[:, 1])[: blocks * BLOCK].reshape(shape) ** 2
    heading = (0.5 * (path[1:, 2] + path[:-1, 2]))[: blocks * BLOCK].reshape(shape)
    as_is = _agreement(travel, heading)
    for kind, gain in GAINS.items():
        telling = np.ptp((1.0 - gain) * heading, axis=1) > TELLING_RAD
        telling &= np.abs(travel).sum(axis=1) > 0.0
        then = _agreement(travel, gain * heading)
        if int(telling.sum()) < LEAST_BLOCKS:
            continue
        before, after = float(np.median(as_is[telling])), float(np.median(then[telling]))
        if before < SCATTERED and after > TOGETHER:
            return Course(kind, int(telling.sum()), before, after)
    return None


def _agreement(travel: NDArray[np.complex128], heading: Floats) -> Floats:
    """Length of the mean of the doubled angles between travel and heading, of each block."""
    turned = travel * np.exp(-2j * heading)
    return np.asarray(np.abs(turned.sum(axis=1)) / np.maximum(np.abs(travel).sum(axis=1), 1e-300))

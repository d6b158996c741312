"""Conventions: bearings from ahead and to the left, headings counter-clockwise, speeds with a sign."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ..log import Bools
from .course import read_course
from .evidence import BAD_FIT
from .finding import Finding
from .hypotheses import Hypothesis
from .subject import Subject
from .units import fit

LEAST_REVERSING = 0.03
"""Share of the telling moments in which the robot must seem to go backwards."""


def sides(subject: Subject) -> Iterator[Finding]:
    """Bearings and odometry that turn opposite ways."""
    found = subject.explanation
    if found is not None and found.reading.kind in ("mirrored", "turn-sign"):
        message = (
            "bearings seem mirrored (clockwise) against the odometry, or the odometry turns the other way: "
            f"{fit(found)}"
        )
        remedy = "negate bearing_rad, or the turns of odometry.csv: both grow to the left"
        yield Finding("bearing-mirrored", "problem", message, remedy)


def facing(subject: Subject) -> Iterator[Finding]:
    """A sensor that does not look ahead, bearings from another axis, a speed of the wrong sign."""
    found = subject.explanation
    if found is None or found.reading.kind not in ("turned", "mirrored-turned", "speed-sign"):
        return
    degrees = round(float(np.degrees(found.reading.hypothesis.bearing_offset_rad))) % 360
    yaw_rad = subject.config["sensor"]["mounting"]["yaw_rad"] + found.reading.hypothesis.bearing_offset_rad
    remedy = f"sensor.mounting.yaw_rad={_wrapped(yaw_rad):.4f}"
    if found.reading.kind == "mirrored-turned":
        message = f"bearings seem to be clockwise and measured from {_axis(degrees)}"
        remedy = f"turn bearing_rad into {np.radians(degrees):.4f} - bearing_rad"
    elif degrees == 180 or found.reading.kind == "speed-sign":
        message = "the sensor seems to look the other way, backwards, or the speed has the wrong sign"
    elif degrees in (90, 270):
        message = (
            f"bearings (or headings) seem to be measured from {_axis(degrees)}, or the sensor is turned so"
        )
    else:
        message = f"the sensor seems to be turned by {degrees if degrees <= 180 else degrees - 360} degrees"
    yield Finding("sensor-turned", "problem", f"{message}: {fit(found)}", remedy)


def _axis(degrees: int) -> str:
    return {90: "the left (y)", 270: "the right (-y)", 180: "behind", 0: "ahead"}.get(
        degrees, f"{degrees} degrees"
    )


def _wrapped(angle_rad: float) -> float:
    return float(np.arctan2(np.sin(angle_rad), np.cos(angle_rad)))


def headings(subject: Subject) -> Iterator[Finding]:
    """An odometer whose heading grows clockwise while its positions are in the usual frame."""
    course = read_course(subject)
    if course is not None and course.kind == "clockwise":
        message = (
            f"displacements do not point along the heading: in {course.blocks} stretches with turns they "
            f"agree with it to {course.as_is:.0%}, to {course.then:.0%} if it grows clockwise"
        )
        yield Finding(
            "heading-clockwise", "problem", message, "negate heading_rad (or pi/2 - heading of a compass)"
        )


def reversing(subject: Subject) -> Iterator[Finding]:
    """Speeds without a sign: the robot seems to go backwards for a while, and no speed is below zero."""
    speed = subject.log.controls.values[:, 0]
    if subject.steps or len(speed) == 0 or float(np.min(speed)) < 0.0 or subject.explanation is not None:
        return
    forward, moments = subject.as_is, subject.bench.asked
    backward = subject.bench.trial(Hypothesis(speed_gain=-1.0))
    apart_m = np.hypot(*(forward.expected_m - backward.expected_m).T)
    telling = apart_m > 3.0 * forward.noise_m
    if int(telling.sum()) < 60:
        return
    _, moment = np.unique(moments.moment[telling], return_inverse=True)
    count = np.bincount(moment)
    ahead, behind = (np.bincount(moment, trial.cost[telling]) / count for trial in (forward, backward))
    seems = (behind < 0.5 * ahead) & (ahead > BAD_FIT)
    share = float(np.mean(seems))
    if share >= LEAST_REVERSING and int(seems.sum()) >= 10 and _in_runs(seems):
        message = (
            f"the robot seems to drive backwards in {share:.0%} of {len(seems):,} moments that tell, but no "
            "speed is below zero: speeds without a sign?"
        )
        yield Finding("speed-unsigned", "problem", message, "give speed_m_per_s its sign, negative backwards")


def _in_runs(seems: Bools) -> bool:
    """Whether most of the moments have a neighbour of their kind, as when a robot backs up for a while."""
    padded = np.concatenate([[False], seems, [False]])
    return float(np.mean((padded[:-2] | padded[2:])[seems])) > 0.6

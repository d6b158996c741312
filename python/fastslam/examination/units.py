"""Units: metres, radians, metres and radians a second."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from .course import read_course
from .evidence import FEET_M, MILES_PER_HOUR_M_PER_S, Explanation
from .finding import Finding
from .hypotheses import DEGREE
from .subject import Subject

RANGES_OF = {1e3: "millimetres", 1e2: "centimetres", 1 / FEET_M: "feet"}
"""Factor of the speed that fits and, where ranges rather than speeds are at fault, their unit."""
SPEEDS_OF = {
    1 / 3.6: ("km/h", "x = x / 3.6"),
    FEET_M: ("feet", "x = 0.3048 x"),
    MILES_PER_HOUR_M_PER_S: ("miles an hour", "x = 0.44704 x"),
    1e-2: ("cm", "x = x / 100"),
    1e-3: ("mm", "x = x / 1000"),
    3.6: ("a unit 3.6 times too large", "x = 3.6 x"),
}
BEYOND = 0.5
"""Share of ranges beyond the sensor's limit from which on the limit or the unit is wrong."""
STEEPEST_STEERING_RAD = 0.5 * np.pi


def fit(found: Explanation) -> str:
    """The evidence of the short stretches in words."""
    return (
        f"{found.found_as_is:.0%} of {found.questions:,} sightings are found again a moment later where the "
        f"odometry puts them, {found.found:.0%} then"
    )


def bearings(subject: Subject) -> Iterator[Finding]:
    """Bearings in degrees that are small enough to pass for radians."""
    found = subject.explanation
    if found is not None and found.reading.kind == "bearing-unit":
        message = f"bearings seem to be in degrees: {fit(found)}"
        yield Finding("bearing-unit", "error", message, "write bearing_rad in radians: bearing * pi / 180")


def turns(subject: Subject) -> Iterator[Finding]:
    """Yaw rates, steering angles or turns in degrees."""
    column = {"velocity": "yaw_rate_rad_per_s", "ackermann": "steering_rad"}.get(
        subject.motion_model, "dheading_rad"
    )
    found = subject.explanation
    if found is not None and found.reading.kind == "turn-unit":
        gain = found.reading.hypothesis.turn_gain
        what = "in degrees" if gain < 1 else "turned to radians twice"
        message = f"{column} seems to be {what}: {fit(found)}"
        yield Finding("turn-unit", "problem", message, f"multiply {column} of odometry.csv by {gain:.6g}")
    elif subject.motion_model == "ackermann":
        steep = np.abs(subject.log.controls.values[:, 1]) > STEEPEST_STEERING_RAD
        if float(np.mean(steep)) > 0.01:
            message = (
                f"{np.mean(steep):.0%} of the steering angles are beyond 90 degrees: steering_rad in degrees?"
            )
            yield Finding("turn-unit", "problem", message, f"multiply steering_rad by {DEGREE:.6g}")


def headings(subject: Subject) -> Iterator[Finding]:
    """The heading of an odometer in degrees: its displacements then point anywhere."""
    course = read_course(subject)
    if course is not None and course.kind == "degrees":
        message = (
            f"heading_rad seems to be in degrees: in {course.blocks} stretches with turns the displacements "
            f"agree with the heading to {course.as_is:.0%}, to {course.then:.0%} if it is"
        )
        yield Finding("heading-unit", "error", message, "write heading_rad in radians: heading * pi / 180")


def ranges(subject: Subject) -> Iterator[Finding]:
    """Ranges in millimetres, centimetres or feet; most of them beyond the sensor's limit."""
    range_m = subject.log.sightings.range_m
    limit_m = float(subject.config["sensor"]["max_range_m"])
    beyond = float(np.mean(range_m > limit_m)) if len(range_m) else 0.0
    found = subject.explanation
    gain = found.reading.hypothesis.speed_gain if found and found.reading.kind == "speed-unit" else 1.0
    evidence = []
    if beyond > BEYOND:
        of_all = f"{beyond:.0%} of the" if beyond < 1.0 else "all"
        median = f"median {np.median(range_m):.4g}"
        evidence.append(
            f"{of_all} {len(range_m):,} sightings lie beyond sensor.max_range_m = {limit_m:g} ({median})"
        )
    if found is not None and gain in RANGES_OF:
        evidence.append(f"the odometry fits when taken {gain:,.4g} times: {fit(found)}")
    if evidence:
        unit = RANGES_OF.get(gain) or _unit_below(float(np.median(range_m)), limit_m)
        message = f"{'; '.join(evidence)}: {f'ranges in {unit}' if unit else 'another unit'}?"
        yield Finding(
            "range-unit", "problem", message, "write range_m in metres, or raise sensor.max_range_m"
        )


def _unit_below(median_m: float, limit_m: float) -> str | None:
    """The unit that brings the ranges below the limit and not far below."""
    for factor, unit in sorted(RANGES_OF.items()):
        if 0.05 * limit_m < median_m / factor < limit_m:
            return unit
    return None


def speeds(subject: Subject) -> Iterator[Finding]:
    """Speeds or displacements in mm, cm, feet, km/h or miles an hour."""
    found = subject.explanation
    if found is None or found.reading.kind != "speed-unit":
        return
    gain = found.reading.hypothesis.speed_gain
    if gain in RANGES_OF or gain not in SPEEDS_OF:
        return
    unit, remedy = SPEEDS_OF[gain]
    suffix = "/s" if not subject.steps and unit in ("feet", "cm", "mm") else ""
    what, column = ("displacements", "dx_m, dy_m") if subject.steps else ("speeds", "speed_m_per_s")
    message = f"{what} seem to be in {unit}{suffix}: {fit(found)}"
    yield Finding("speed-unit", "problem", message, f"change {column} of odometry.csv: {remedy}")


def standing(subject: Subject) -> Iterator[Finding]:
    """An odometry that hardly moves among sightings that do: longitude and latitude, for instance."""
    if len(subject.as_is.cost) < 100 or subject.explanation is not None:
        return
    path_m, typical_m = subject.path_m, float(np.median(subject.log.sightings.range_m))
    if path_m < 0.1 * typical_m and subject.as_is.found < 0.5 and read_course(subject) is None:
        message = (
            f"the odometry moves {path_m:.3g} m in all, yet {subject.as_is.found:.0%} of the sightings are "
            f"found again a moment later where it puts them: longitude and latitude, or kilometres?"
        )
        yield Finding(
            "odometry-still", "problem", message, "write positions in metres (a projection such as UTM)"
        )

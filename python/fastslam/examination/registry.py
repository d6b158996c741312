"""All checks, and `examine`, which runs them over a log."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

from ..log import Log
from ..settings import Layer
from . import clocks, conventions, duplicates, names, units
from .finding import Finding
from .settings import own_settings, view
from .subject import Subject, prepare


@dataclass(frozen=True)
class Check:
    """One check: what it says (`code`), and for the documentation what it looks at and cannot decide."""

    code: str
    looks: Callable[[Subject], Iterator[Finding]]
    at: str
    cannot: str = ""


WITHOUT_BEARINGS = frozenset(("clock-coverage", "clock-gap", "clock-rounded"))
"""Checks that ask nothing of bearings: those that are done where a sensor measures ranges alone."""

CHECKS: tuple[Check, ...] = (
    Check("clock-coverage", clocks.coverage, "sightings whose stamps lie within the time of the odometry"),
    Check(
        "clock-unit",
        clocks.unit_of_both,
        "how far a row of velocities leads, against how far the sensor sees",
        "displacements in rows of another unit of time: nothing depends on it but noise",
    ),
    Check(
        "clock-gap",
        clocks.gaps,
        "times without a row of odometry, ten periods or longer, while the robot drove",
    ),
    Check(
        "clock-rounded",
        clocks.rounded,
        "rows of odometry of one stamp, names that are there twice at one stamp",
    ),
    Check(
        "clock-offset",
        clocks.offset,
        "whether sightings fit the odometry of another moment better; where the two tables start and end",
        "a delay while speed and yaw rate stay the same",
    ),
    Check("bearing-unit", units.bearings, "whether bearings fit as degrees", "sightings straight ahead"),
    Check("turn-unit", units.turns, "whether yaw rates, steering angles or turns fit as degrees"),
    Check(
        "heading-unit",
        units.headings,
        "whether displacements turn with the heading of the odometer, or with a hundredth or so of it",
        "a robot that drives straight",
    ),
    Check(
        "range-unit",
        units.ranges,
        "ranges beyond the sensor's limit; the factor that makes ranges and odometry fit",
        "ranges and odometry in one wrong unit",
    ),
    Check("speed-unit", units.speeds, "the factor that makes speeds and sightings fit"),
    Check("odometry-still", units.standing, "an odometry that stands among sightings that move"),
    Check(
        "bearing-mirrored",
        conventions.sides,
        "whether sightings and odometry turn the same way",
        "which of the two is wrong; a robot that drives straight",
    ),
    Check(
        "sensor-turned",
        conventions.facing,
        "whether sightings move against the direction of travel",
        "a sensor turned by less than 20 degrees (see `fastslam calibrate`); a robot that turns on the spot",
    ),
    Check(
        "heading-clockwise", conventions.headings, "whether displacements turn with the heading or against it"
    ),
    Check("speed-unsigned", conventions.reversing, "moments that fit only if the robot drove backwards"),
    Check("seen-twice", duplicates.twins, "sightings of one stamp that are closer than the sensor's noise"),
    Check(
        "name-two-places",
        names.two_places,
        "how far a name jumps from one sighting to the next, against the way driven in between",
        "places that are seen long after each other: the run says",
    ),
    Check("view-limit", view, "bearings outside the field of view of the settings"),
)
SETTINGS = "settings"
"""Code of the finding that the log's own settings do not fit the schema; nothing else is then looked at."""


def examine(log: Log, config: Layer | None = None) -> tuple[Finding, ...]:
    """Everything that is visibly wrong with a log, without running a filter; empty for a sound one.

    `config` is laid over the log's own settings: what it puts right is no finding. Errors: ConfigError for
    `config`; settings of the log that are at fault are a finding.
    """
    if broken := tuple(own_settings(log)):
        return broken
    if len(log.controls.stamp_s) < 2:
        return ()
    subject = prepare(log, config)
    checks = CHECKS
    several = bool(log.sensor_names) and not subject.log.sensor_names
    if several or subject.config["sensor"]["model"] != "range_bearing":
        checks = tuple(check for check in CHECKS if check.code in WITHOUT_BEARINGS)
    return tuple(finding for check in checks for finding in check.looks(subject))

"""Stamps: one clock, in seconds, that runs on."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ..log import REPEATED_STAMPS, Floats
from .evidence import can_tell
from .finding import Finding, Severity
from .hypotheses import Hypothesis
from .stretches import names_are_unique
from .subject import Subject

LEAST_COVERED = 0.98
"""Share of the sightings that must lie within the time of the odometry."""
MEANINGLESS = 0.01
"""With less of them there nothing of the map can be right."""
UNITS = {1e-3: "milliseconds", 1e-6: "microseconds", 1e-9: "nanoseconds"}
GAP_PERIODS = 10.0
ROUNDED = 0.3
"""Share of rows with the stamp of another row from which on stamps are rounded."""


def coverage(subject: Subject) -> Iterator[Finding]:
    """Sightings outside the time of the odometry: another unit or another clock."""
    seen_s, moved_s = subject.log.sightings.stamp_s, subject.log.controls.stamp_s
    if len(seen_s) == 0 or len(moved_s) < 2:
        return
    covered = _covered(seen_s, moved_s, subject)
    if covered >= LEAST_COVERED:
        return
    span = f"{seen_s[0]:.6g} to {seen_s[-1]:.6g} s"
    message = (
        f"{1 - covered:.1%} of the sightings ({span}) lie outside the odometry "
        f"({moved_s[0]:.6g} to {moved_s[-1]:.6g} s): {_why_outside(seen_s, moved_s)}"
    )
    severity: Severity = "error" if covered < MEANINGLESS else "problem"
    yield Finding("clock-coverage", severity, message, "give all tables the same clock, in seconds")


def _covered(seen_s: Floats, moved_s: Floats, subject: Subject) -> float:
    slack_s = 1.5 * max(subject.moment_period_s, subject.control_period_s)
    slack_s = min(slack_s, 0.02 * float(np.ptp(moved_s)))
    inside = (seen_s >= moved_s[0] - slack_s) & (seen_s <= moved_s[-1] + slack_s)
    return float(np.mean(inside))


def _why_outside(seen_s: Floats, moved_s: Floats) -> str:
    """The unit that makes both tables last equally long, or the shift that makes them start together."""
    seen_span_s, moved_span_s = float(np.ptp(seen_s)), float(np.ptp(moved_s))
    for factor, unit in UNITS.items():
        for table, ratio in (("sightings", seen_span_s), ("odometry", moved_span_s)):
            other = moved_span_s if table == "sightings" else seen_span_s
            if other > 0 and 0.5 < factor * ratio / other < 1.5:
                return f"stamps of the {table} in {unit}?"
    if moved_span_s > 0 and 0.5 < seen_span_s / moved_span_s < 1.5:
        return f"another clock, {seen_s[0] - moved_s[0]:.6g} s off?"
    return "another clock?"


def unit_of_both(subject: Subject) -> Iterator[Finding]:
    """Stamps of both tables in parts of a second: a row then seems to last minutes, and to lead far away."""
    if subject.steps or subject.control_period_s < 2.0 or len(subject.log.sightings.stamp_s) == 0:
        return
    period_s, reach_m = subject.control_period_s, float(np.max(subject.log.sightings.range_m))
    step_m = float(np.median(np.abs(subject.log.controls.values[:, 0]))) * period_s
    units = [unit for factor, unit in UNITS.items() if 1e-3 <= factor * period_s <= 2.0]
    if step_m > reach_m and units:
        message = (
            f"a row of odometry lasts {period_s:.6g} s and leads {step_m:.3g} m, when nothing further than "
            f"{reach_m:.3g} m is seen: stamps in {units[0]}?"
        )
        yield Finding("clock-unit", "problem", message, "write stamps in seconds")


def gaps(subject: Subject) -> Iterator[Finding]:
    """Times when nothing was recorded although the robot drove."""
    stamp_s = subject.log.controls.stamp_s
    if len(stamp_s) < GAP_PERIODS:
        return
    period_s = np.diff(stamp_s)
    usual_s = max(float(np.quantile(period_s, 0.99)), subject.moment_period_s, subject.control_period_s)
    rows = np.flatnonzero(period_s > GAP_PERIODS * usual_s)
    rows = rows[[_drove(subject, int(row)) for row in rows]] if len(rows) else rows
    if len(rows) == 0 or len(rows) > 0.01 * len(stamp_s):
        return
    worst = int(rows[np.argmax(period_s[rows])])
    message = (
        f"gap: nothing was recorded for {period_s[worst]:.6g} s from stamp {stamp_s[worst]:.6g} on, where "
        f"rows come every {subject.control_period_s:.3g} s while the robot drove: paused, or the clock "
        "set forward"
    )
    if len(rows) > 1:
        message += f" ({len(rows)} such gaps)"
    remedy = "cut the log there and run the parts, or give the stamps the time that passed"
    yield Finding("clock-gap", "problem", message, remedy)


def _drove(subject: Subject, row: int) -> bool:
    """Whether the robot moved before and after a gap and the odometry does not say how far within it."""
    controls, moved_m = subject.log.controls, subject.speed_m_per_s
    gap_s = float(controls.stamp_s[row + 1] - controls.stamp_s[row])
    before = float(np.median(moved_m[max(row - 10, 0) : row])) if row else 0.0
    after = float(np.median(moved_m[row + 2 : row + 12])) if row + 2 < len(moved_m) else before
    held_m = min(before, after) * gap_s
    if subject.steps:
        told_m = float(np.hypot(*controls.values[row + 1, :2]))
        return held_m > 1.0 and told_m < 0.5 * held_m
    return held_m > 1.0


def rounded(subject: Subject) -> Iterator[Finding]:
    """Stamps rounded so coarsely that several rows share one."""
    log = subject.log
    repeated = sum(problem.count for problem in log.problems if problem.code == REPEATED_STAMPS)
    share = repeated / max(repeated + len(log.controls.stamp_s), 1)
    tables = ["odometry"] if share > ROUNDED else []
    if _sightings_rounded(subject):
        tables.append("sightings")
    if not tables:
        return
    step_s = subject.control_period_s if share > ROUNDED else subject.moment_period_s
    message = f"stamps of {' and '.join(tables)} are rounded to {step_s:.3g} s: "
    message += f"{share:.0%} of the odometry had the stamp of another row" if share > ROUNDED else ""
    message += "" if share > ROUNDED else "most names appear several times at one stamp"
    yield Finding("clock-rounded", "problem", message, "write stamps with milliseconds")


def _sightings_rounded(subject: Subject) -> bool:
    """Whether most names are there several times at one stamp and stamps lie on a grid."""
    sightings = subject.log.sightings
    known = sightings.identity >= 0
    if int(known.sum()) < 100 or len(np.unique(sightings.identity[known])) < 3 or names_are_unique(sightings):
        return False
    rows = np.column_stack([sightings.stamp_s, sightings.identity])[known]
    repeated = 1.0 - len(np.unique(rows, axis=0)) / len(rows)
    step_s = subject.moment_period_s
    on_grid = (
        np.abs(subject.moment_s / step_s - np.round(subject.moment_s / step_s)) < 1e-6 if step_s else False
    )
    return bool(repeated > ROUNDED and np.all(on_grid) and step_s >= 2.0 * subject.control_period_s)


def offset(subject: Subject) -> Iterator[Finding]:
    """Sightings that belong to an earlier or later moment than their stamps say."""
    found = subject.explanation
    if found is not None and found.reading.kind == "delay":
        delay_s = found.reading.hypothesis.delay_s
        when = "earlier" if delay_s > 0 else "later"
        message = (
            f"sightings fit best {abs(delay_s):.2g} s {when}: {found.found_as_is:.0%} of {found.questions:,} "
            f"are found again where the odometry puts them, {found.found:.0%} then"
        )
        yield Finding(
            "clock-offset", "problem", message, f"add {-delay_s:.2g} s to the stamps of sightings.csv"
        )
    elif found is None:
        yield from _offset_of_ends(subject)


def _offset_of_ends(subject: Subject) -> Iterator[Finding]:
    """Both tables last equally long and one starts and ends later: a hint where the motion cannot tell."""
    seen_s, moved_s = subject.moment_s, subject.log.controls.stamp_s
    if len(seen_s) < 50 or len(moved_s) < 50:
        return
    first_s, last_s = float(seen_s[0] - moved_s[0]), float(seen_s[-1] - moved_s[-1])
    usual_s = subject.moment_period_s + subject.control_period_s
    least_s = min(first_s, last_s) if first_s > 0 else min(-first_s, -last_s)
    late_s = 0.5 * (first_s + last_s)
    if abs(first_s - last_s) > usual_s or least_s < 1.4 * subject.moment_period_s or abs(late_s) > 5.0:
        return
    if can_tell(subject.bench, Hypothesis(delay_s=late_s)):
        return
    when, relation = ("earlier", "after") if late_s > 0 else ("later", "before")
    first_s, last_s = abs(first_s), abs(last_s)
    message = (
        f"sightings fit best {min(first_s, last_s):.2g} to {max(first_s, last_s):.2g} s {when}, if both "
        f"tables were recorded together: they start {first_s:.2g} s {relation} the odometry and end "
        f"{last_s:.2g} s {relation} it"
    )
    yield Finding("clock-offset", "note", message, "make sure that all stamps are of one clock")

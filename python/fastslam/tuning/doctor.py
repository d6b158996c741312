"""Every reading of a log's numbers with its log-odds against the numbers as they stand, and the remedy."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from ..config import merge
from ..detection import detected_in_scans
from ..errors import DataError
from ..examination import examine
from ..examination.evidence import READINGS
from ..examination.finding import Finding
from ..examination.hypotheses import AS_IS, DEGREE, Hypothesis
from ..examination.stretches import Bench
from ..examination.subject import prepare
from ..laid import wide_noise
from ..log import Floats, Log
from ..settings import Layer
from ..several import refuse_several
from .begin import DELAYS_S, LEAST_GAIN, LEAST_QUESTIONS, SPEED_GAINS, TURN_GAINS, nats_by_part, nats_of
from .learn import SCALE, SIGNIFICANT, Value
from .motion import DELAY, DISTANCE
from .session import from_tracks

AGREE = 3.0
"""So many standard errors the parts of the log must gain on average.

Errors of the odometry last: what one turn gains in nats is no proof, nor is what a few sightings gain.
"""
FINER = 4
"""A gain or a delay is looked for four times halved between the values that are tried."""
LEARNED = {
    "turn-gain": ("motion.correction.turn_gain", "motion.steering_gain"),
    "distance-gain": (DISTANCE, SCALE),
    "delay": (DELAY,),
}
"""Of these `tune` finds how large they are and how surely."""


@dataclass(frozen=True)
class Verdict:
    """A reading of the numbers: what it says, log-odds against the log as it stands, and the remedy."""

    name: str
    log_odds: float
    remedy: str
    agreement: float
    """Mean gain of the parts of the log, by time, in standard errors."""
    kind: str = ""

    @property
    def is_clear(self) -> bool:
        """Whether the log prefers it by LEAST_GAIN nats, and all over: in parts that AGREE."""
        return self.log_odds > LEAST_GAIN and self.agreement > AGREE


@dataclass(frozen=True)
class Diagnosis:
    """What `diagnose` found: readings from the likeliest down, findings of the examination, comparisons.

    `verdicts` is empty where fewer than LEAST_QUESTIONS sightings can be held against each other.
    """

    verdicts: tuple[Verdict, ...]
    findings: tuple[Finding, ...]
    questions: int
    learned: tuple[Value, ...] | None = None
    """What `tune` begins with; None where it cannot, or another reading must be put right before."""

    @property
    def suspected(self) -> tuple[Verdict, ...]:
        """The readings that the log clearly prefers; a gain or a delay where `tune` takes it for real too."""
        return tuple(one for one in self.verdicts if self._is_suspected(one))

    @property
    def kept(self) -> tuple[Value, ...]:
        """What the log would rather have otherwise, by less than overrules what somebody wrote down."""
        keys = {key for keys in LEARNED.values() for key in keys}
        return tuple(
            value
            for value in self.learned or ()
            if value.key in keys and value.observable and not value.significant
            if abs(value.value - value.stated) > SIGNIFICANT * value.standard_error
        )

    def _is_suspected(self, one: Verdict) -> bool:
        if self.learned is None or one.kind not in LEARNED:
            return one.is_clear
        return one.log_odds > 0 and any(
            value.key in LEARNED[one.kind] and value.significant for value in self.learned
        )

    def to_dict(self) -> dict[str, Any]:
        """The members by name, for JSON."""
        return {
            "suspected": [asdict(verdict) for verdict in self.suspected],
            "readings": [asdict(verdict) for verdict in self.verdicts],
            "kept": [asdict(value) for value in self.kept],
            "findings": [finding.to_dict() for finding in self.findings],
            "sightings_compared": self.questions,
        }


def diagnose(log: Log, config: Layer | None = None) -> Diagnosis:
    """Holds a log against every reading of its numbers, without running a filter.

    `config` is laid over the log's own settings. The log-odds are those of the sightings of one moment, moved
    by the odometry, against what is seen a moment later; whether a gain or a delay is suspected is told as
    `tune` tells it, by what is followed from scan to scan. Errors: ConfigError for `config`.
    """
    refuse_several(merge(log.config, config or {}), "doctor")
    findings = examine(log, config)
    if any(finding.severity == "error" for finding in findings) or len(log.controls.stamp_s) < 2:
        return Diagnosis((), findings, 0)
    subject = prepare(log, config)
    ranges_alone = subject.config["sensor"]["model"] != "range_bearing"
    if len(subject.log.sightings.stamp_s) == 0 or ranges_alone:
        return Diagnosis((), findings, 0)
    bench = subject.bench
    questions = len(bench.asked.asked)
    if questions < LEAST_QUESTIONS:
        return Diagnosis((), findings, questions)
    wide = wide_noise(subject.log, subject.config)
    sensor = {**bench.sensor, "range_std_m": float(wide[0]), "bearing_std_rad": float(wide[1])}
    bench = replace(bench, sensor=sensor)
    as_is = nats_by_part(bench, AS_IS)
    ackermann = subject.config["motion"]["model"] == "ackermann"
    verdicts = []
    measured = "bearing-unit" if detected_in_scans(log) else ""
    for kind, name, reading in _tried(bench):
        if kind == measured:
            # A laser's bearings come from the geometry of its beams.
            continue
        gains = nats_by_part(bench, reading) - as_is
        remedy = _remedy(kind, reading, subject.config, ackermann=ackermann)
        verdicts.append(Verdict(name, float(gains.sum()), remedy, _agreement(gains), kind))
    verdicts.sort(key=lambda one: -one.log_odds)
    gross = any(one.is_clear and one.kind not in LEARNED for one in verdicts)
    learned = None if gross else _learned(log, config)
    if learned is not None:
        verdicts = [_as_learned(one, learned, subject.config, ackermann=ackermann) for one in verdicts]
    return Diagnosis(tuple(verdicts), findings, questions, learned)


def _learned(log: Log, config: Layer | None) -> tuple[Value, ...] | None:
    """The errors that short tracks tell, as `tune` begins with; None where it cannot."""
    try:
        values = from_tracks(log, config).values
    except (DataError, ArithmeticError, np.linalg.LinAlgError):
        return None
    return tuple(value for value in values if not np.isnan(value.standard_error))


def _as_learned(
    one: Verdict, values: tuple[Value, ...], config: Mapping[str, Any], *, ackermann: bool
) -> Verdict:
    """The reading with the size that `tune` finds, where it takes it for real."""
    keys = LEARNED.get(one.kind, ())
    value = next((value for value in values if value.key in keys and value.significant), None)
    if value is None:
        return one
    if value.key == SCALE:
        name = f"ranges {value.value / value.stated:.4g} times as long as they should be"
        return replace(one, name=name, remedy=f"--set {SCALE}={value.value:.4g}")
    ratio = value.value / value.stated if value.stated else 1.0
    reading = {
        "delay": Hypothesis(delay_s=value.value - value.stated),
        "turn-gain": Hypothesis(turn_gain=ratio),
        "distance-gain": Hypothesis(speed_gain=ratio),
    }[one.kind]
    return replace(
        one, name=_name(one.kind, reading), remedy=_remedy(one.kind, reading, config, ackermann=ackermann)
    )


def _agreement(gains: Floats) -> float:
    """Mean gain of the parts in standard errors; 0 where there are too few to say."""
    error = float(np.std(gains, ddof=1)) / np.sqrt(len(gains)) if len(gains) > 2 else np.inf
    return float(np.mean(gains) / error) if error > 0.0 else 0.0


def _tried(bench: Bench) -> Iterator[tuple[str, str, Hypothesis]]:
    """Kind, name and the best reading of each kind."""
    best: dict[str, tuple[Hypothesis, float]] = {}
    for reading in READINGS:
        if reading.kind == "delay":
            continue
        nats = nats_of(bench, reading.hypothesis)
        if reading.kind not in best or nats > best[reading.kind][1]:
            best[reading.kind] = reading.hypothesis, nats
    for kind, (hypothesis, _) in best.items():
        yield kind, _name(kind, hypothesis), hypothesis
    for kind, member, values in (
        ("turn-gain", "turn_gain", TURN_GAINS),
        ("distance-gain", "speed_gain", SPEED_GAINS),
        ("delay", "delay_s", DELAYS_S),
    ):
        hypothesis = _searched(bench, member, values)
        yield kind, _name(kind, hypothesis), hypothesis


def _searched(bench: Bench, member: str, values: tuple[float, ...]) -> Hypothesis:
    """The best value of a gain or a delay other than none, more finely around the best one tried."""

    def at(value: float) -> Hypothesis:
        changes: dict[str, Any] = {member: value}
        return replace(AS_IS, **changes)

    nats = {value: nats_of(bench, at(value)) for value in values if at(value) != AS_IS}
    best = max(nats, key=nats.__getitem__)
    apart = min(abs(other - best) for other in values if other != best)
    for _ in range(FINER):
        apart /= 2
        for value in (best - apart, best + apart):
            if at(value) != AS_IS:
                nats[value] = nats_of(bench, at(value))
        best = max(nats, key=nats.__getitem__)
    return at(best)


def _name(kind: str, reading: Hypothesis) -> str:
    degrees = round(reading.bearing_offset_rad / DEGREE)
    late = "late" if reading.delay_s > 0 else "early"
    return {
        "mirrored": "bearings mirrored",
        "turned": f"sensor or bearings turned by {degrees} degrees",
        "mirrored-turned": f"bearings mirrored and turned by {degrees} degrees",
        "turn-sign": "turns of the other sign",
        "turn-unit": "turns in degrees" if reading.turn_gain < 1 else "turns in radians taken for degrees",
        "speed-sign": "speeds of the other sign",
        "speed-unit": f"speeds or ways {1 / reading.speed_gain:.4g} times too large",
        "bearing-unit": "bearings in degrees",
        "turn-gain": f"turns {reading.turn_gain:.3g} of what the odometry says",
        "distance-gain": f"ways {reading.speed_gain:.3g} of what the odometry says",
        "delay": f"sightings {abs(reading.delay_s):.2g} s {late}",
    }[kind]


def _remedy(kind: str, reading: Hypothesis, config: Mapping[str, Any], *, ackermann: bool) -> str:
    """The line to paste, or what to change in the file where no setting does it."""
    motion, sensor = config["motion"], config["sensor"]
    gain = motion["correction"]["distance_gain"] * reading.speed_gain
    key, before = "motion.correction.turn_gain", motion["correction"]["turn_gain"]
    if ackermann:
        key, before = "motion.steering_gain", motion["steering_gain"]
    turn = f"--set {key}={before * reading.turn_gain:.6g}"
    yaw_rad = sensor["mounting"]["yaw_rad"] + reading.bearing_offset_rad
    remedies = {
        "mirrored": "negate bearing_rad",
        "mirrored-turned": f"turn bearing_rad into {reading.bearing_offset_rad:.4f} - bearing_rad",
        "bearing-unit": "write bearing_rad in radians, or call the column bearing_deg",
        "turned": f"--set sensor.mounting.yaw_rad={yaw_rad:.4f}",
        "delay": f"--set sensor.delay_s={sensor['delay_s'] + reading.delay_s:.3g}",
    }
    for name in ("turn-sign", "turn-unit", "turn-gain"):
        remedies[name] = turn
    for name in ("speed-sign", "speed-unit", "distance-gain"):
        remedies[name] = f"--set motion.correction.distance_gain={gain:.6g}"
    return remedies[kind]

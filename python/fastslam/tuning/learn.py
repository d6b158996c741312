"""What a stretch of a log says of its noise and systematic errors, given which sightings belong together."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from .._bordered import Batch, scattered
from ..config import merge
from ..datasets.clean import select_sightings
from ..dead_reckoning import DeadReckoning, arc_twists, turning_points
from ..errors import DataError
from ..laid import wide_noise
from ..log import Controls, Floats, Ints, Log, Sightings
from .motion import (
    DELAY,
    DISTANCE,
    Known,
    Links,
    Part,
    links,
    motion_parameters,
    nested,
    noise_parts,
    value_of,
)
from .noise import change_of, correlation_of, fitted_tail, learned_noise
from .problem import Noise, Problem, Rows, cost_of, linearised, moved_by

SCALE = "sensor.range_scale"
SENSOR_KNOWN = (
    Known(SCALE, "m/m", 0.0, 0.0),
    Known("sensor.range_bias_m", "m", 0.2, 0.0),
    Known("sensor.mounting.x_m", "m", 0.3, 0.0),
    Known("sensor.mounting.y_m", "m", 0.3, 0.0),
    Known("sensor.mounting.yaw_rad", "rad", 0.2, 0.0),
)
"""In the order of the batch. The scale of ranges and the gain of the distance are one thing: see `blamed`."""
SCALE_STD = 0.02
"""How far ranges are off in proportion, where they are: a tape, a camera or a marker's size, not a wheel.

Less where one reading is more exact than that: who sells a sensor that reads to 3 mm a metre scales it so.
"""
LASER_SCALE_STD = 0.001
"""The same of a laser, whose ranges are as long as its clock is right."""
MOST_SIGHTINGS = 12_000
WINDOWS = 6
LEAST_SIGHTINGS = 200
LEAST_PER_TRACK = 3
ITERATIONS = 18
TAIL_FROM = 8
ROBUST_TAIL = 4.0
WIDER = (1.0, 2.0, 3.0)
"""So many times as wide as what is wide for its kind is the noise of a sensor whose errors last, in turn."""
WIDER_MOTION = 3.0
"""So many times as wide as what learning begins with is the noise of a motion that loops are closed under."""
NOISES = ("range_std_m", "bearing_std_rad")
HALVINGS = 6
"""So often a step is made shorter that explains less."""
COSTS_NOTHING = 0.1
NEAR = 0.1
"""A step that takes away more than this share of the cost began far from the solution."""
SETTLED = 0.02
COARSE = 0.2
"""The tail is fitted from where a step of the noise changes less of its variance than this."""
STRAIGHT = 0.1
"""Steps within this share of a prior's deviation leave the motion as linear as it was,"""
LINEAR = 0.01
"""and within this one so near to it that nothing more is gained by integrating it anew."""
LEAST_GAIN = 0.25
WITHIN_A_ROW = 0.3
"""A delay is told to this share of a row of odometry at best: a shift by half a row averages the noise of two
rows, which looks like a better fit."""
SIGNIFICANT = 3.0
SLACK = {
    DISTANCE: 0.005,
    "motion.correction.turn_gain": 0.01,
    "motion.correction.yaw_rate_bias_rad_per_s": 0.002,
    "motion.steering_gain": 0.01,
    "motion.steering_bias_rad": 0.003,
    DELAY: 0.02,
    "sensor.range_scale": 0.005,
    "sensor.range_bias_m": 0.02,
    "sensor.mounting.x_m": 0.03,
    "sensor.mounting.y_m": 0.03,
    "sensor.mounting.yaw_rad": 0.01,
}
"""What a fact may seem to be off by though it is right, for models leave things out.

SIGNIFICANT times as much contradicts it.
"""
ONE = ("_gain", "_scale")
"""What is 1, not 0, where there is no error."""
FAST = 0.75
"""Share of the rows of odometry that are slower than what is called fast."""


@dataclass(frozen=True)
class Value:
    """One thing learned: dotted key, unit, what was stated, what the log says and how surely.

    `standard_error` is NaN for noise. `observable` is False where the log says hardly more than the prior;
    the value stated is then kept. `slack` is more than 0 for what somebody wrote down, a fact: what a model
    that leaves things out may take it to be off by.
    """

    key: str
    unit: str
    stated: float
    value: float
    standard_error: float = float("nan")
    observable: bool = True
    slack: float = 0.0

    @property
    def significant(self) -> bool:
        """Whether it is to be set: noise always, errors where they are SIGNIFICANT standard errors off.

        A fact must be off by more than its slack explains as well.
        """
        if np.isnan(self.standard_error):
            return True
        least = SIGNIFICANT * float(np.hypot(self.standard_error, self.slack))
        return self.observable and abs(self.value - self.stated) > least

    @property
    def contradicts(self) -> bool:
        """Whether the log says clearly that what somebody wrote down is wrong."""
        return self.slack > 0.0 and self.significant

    @property
    def interval95(self) -> tuple[float, float]:
        """The interval that holds the true value in 95 % of logs."""
        half = 2.26 * self.standard_error
        return self.value - half, self.value + half

    @property
    def log_odds(self) -> float:
        """How many nats the learned value explains the stretch better by than the stated one."""
        return float(0.5 * ((self.value - self.stated) / self.standard_error) ** 2)


@dataclass(frozen=True)
class Stated:
    """Complete settings `whole`, and the dotted keys of those that the log or the user wrote down."""

    whole: Mapping[str, Any]
    facts: frozenset[str] = frozenset()


@dataclass(frozen=True)
class Learned:
    """What a stretch of a log taught: the values, the partial settings that hold them, and from how much."""

    values: tuple[Value, ...]
    settings: dict[str, Any]
    sightings: int
    tracks: int
    correlation: float
    """So many sightings tell as much as one whose errors did not repeat."""
    noise: Noise
    """What the residuals say, whatever the settings make of it."""


@dataclass(frozen=True)
class Stretch:
    """Sightings to learn from, pose (K,) and track (S,) of each; `joined` (K - 1,) by odometry."""

    sightings: Sightings
    stamp_s: Floats
    pose: Ints
    track: Ints
    joined: Any


def usable_sightings(log: Log, until_s: float) -> tuple[Sightings, Ints]:
    """Sightings to learn from, up to a time, and the window of each: WINDOWS windows where there are many."""
    seen, controls = log.sightings, log.controls
    good = np.isfinite(seen.range_m) & np.isfinite(seen.bearing_rad) & (seen.range_m > 0)
    good &= (seen.stamp_s <= until_s) & (seen.stamp_s >= controls.stamp_s[0])
    rows = np.flatnonzero(good & (seen.stamp_s <= controls.stamp_s[-1]))
    window = np.zeros(len(rows), dtype=np.int64)
    if len(rows) > MOST_SIGHTINGS:
        place = np.arange(len(rows)) * WINDOWS / len(rows)
        inside = place % 1.0 < MOST_SIGHTINGS / len(rows)
        rows, window = rows[inside], place[inside].astype(np.int64)
        # A scan that a border cuts belongs to the earlier window.
        stamps, first = np.unique(seen.stamp_s[rows], return_index=True)
        window = window[first][np.searchsorted(stamps, seen.stamp_s[rows])]
    return select_sightings(seen, rows), window


def stretch_of(sightings: Sightings, window: Ints, track: Ints) -> Stretch:
    """The stretch with the sightings of tracks of LEAST_PER_TRACK or more. Errors: DataError for too few."""
    counts = np.bincount(track[track >= 0], minlength=1)
    kept = (track >= 0) & (counts[np.maximum(track, 0)] >= LEAST_PER_TRACK)
    if int(kept.sum()) < LEAST_SIGHTINGS:
        raise DataError(f"{LEAST_SIGHTINGS} sightings of things seen again are needed, got {kept.sum()}")
    chosen = select_sightings(sightings, kept)
    stamps, first, pose = np.unique(chosen.stamp_s, return_index=True, return_inverse=True)
    joined = np.diff(window[kept][first]) == 0
    return Stretch(chosen, stamps, pose, np.unique(track[kept], return_inverse=True)[1], joined)


def start_noise(parts: tuple[Part, ...], tied: Links, wide: Floats) -> Noise:
    """The noise to begin with: a tenth of the motion and a little more, shared by the parts of each axis."""
    typical = np.mean(np.abs(tied.motion), axis=0)
    way_m, turn_rad = np.hypot(typical[0], typical[1]), typical[2]
    target = np.array([0.1 * way_m + 1e-3, 0.05 * way_m + 5e-4, 0.1 * turn_rad + 2e-3]) ** 2
    axes = np.array([part.axis for part in parts])
    squares = target[axes] / np.mean(tied.share, axis=0) / np.bincount(axes, minlength=3)[axes]
    return Noise(squares, wide**2, ROBUST_TAIL)


def learn(
    log: Log,
    config: Mapping[str, Any],
    stretch: Stretch,
    places: tuple[Floats, Floats],
    *,
    stated: Stated,
    noise: Noise | None = None,
    until: float = SETTLED,
) -> Learned:
    """Learns from a stretch, beginning at complete settings `config`; `stated` are those that the user knows.

    `places` are the poses (K, 3) and the things seen (L, 2) to begin with, `noise` one that is known already.
    The noise is found to a share of `until`, which may be COARSE where it is not used.
    """
    parts = noise_parts(log.controls, config["motion"])
    known, before, problem = _begun(log, config, stretch, places, stated)
    slacks = slacks_of(log.controls, config["motion"], [one.key for one in known], stated.facts)
    now, problem, noise = _settled(log, config, stretch, problem, noise, until=COARSE)
    values, _ = _judged(log, (known, slacks), before, (problem, noise))
    # What is kept as stated must be so when the noise is learned, or it would be that of another robot.
    held = np.array([value.key for value in values if not value.significant])
    problem = _holding(problem, np.isin([one.key for one in known], held))
    _, problem, noise = _settled(log, now, stretch, problem, noise, until=until)
    found, rows = _judged(log, (known, slacks), before, (problem, noise))
    again = {value.key: value for value in found}
    values = blamed(
        tuple(value if value.key in held else again[value.key] for value in values),
        known,
        before,
        scale_std=_scale_std(log, stretch, noise),
        facts=stated.facts,
    )
    return _learned(stated.whole, parts, noise, values, (stretch, rows))


def _scale_std(log: Log, stretch: Stretch, noise: Noise) -> float:
    """How far ranges may be off in proportion: as far as one reading is; a laser, as far as its clock."""
    if log.scans is not None:
        return LASER_SCALE_STD
    reading = float(np.sqrt(noise.seen[0]) / np.median(stretch.sightings.range_m))
    return float(np.clip(reading, LASER_SCALE_STD, SCALE_STD))


@dataclass(frozen=True)
class Rough:
    """Noise and correlation of a stretch, found in a few steps: see `learn`."""

    noise: Noise
    correlation: float


def errors_of(
    log: Log,
    config: Mapping[str, Any],
    stretch: Stretch,
    places: tuple[Floats, Floats],
    *,
    stated: Stated,
) -> tuple[dict[str, Any], Rough]:
    """The settings with the systematic errors that a stretch tells, and its noise, all of it roughly."""
    known, before, problem = _begun(log, config, stretch, places, stated)
    _, problem, noise = _settled(log, config, stretch, problem, until=COARSE)
    found = zip(known, before - problem.prior + problem.parameters, problem.prior_std, strict=True)
    told = [nested(one.key, float(value)) for one, value, prior_std in found if prior_std > 0]
    rows = linearised(problem, noise)
    correlation = correlation_of(rows, stretch.track, stretch.sightings.stamp_s)
    return merge(config, *told), Rough(noise, correlation)


def _begun(
    log: Log,
    config: Mapping[str, Any],
    stretch: Stretch,
    places: tuple[Floats, Floats],
    stated: Stated,
) -> tuple[tuple[Known, ...], Floats, Problem]:
    """What may be off, its values as stated, to which the problem is drawn, and the problem to begin with."""
    known = (*motion_parameters(config["motion"]), *SENSOR_KNOWN)
    before = np.array([value_of(stated.whole, one.key) for one in known])
    problem = problem_of(log, config, stretch, places)
    prior = problem.prior + before - [value_of(config, one.key) for one in known]
    return known, before, replace(problem, prior=prior)


def blamed(
    values: tuple[Value, ...],
    known: tuple[Known, ...],
    before: Floats,
    *,
    scale_std: float = SCALE_STD,
    facts: frozenset[str] = frozenset(),
) -> tuple[Value, ...]:
    """The values with the scale of the ranges in place of the gain of the distance where that is likelier.

    A log tells only the ratio of the two. Where one of them is a fact it is the other. Else either is right
    and the other off, by `scale_std` for the ranges and by its prior for the distance: a ratio near 1 is the
    ranges', one further away the odometry's.
    """
    keys = [one.key for one in known]
    gain = next((value for value in values if value.key == DISTANCE), None)
    if gain is None or not gain.significant:
        return values
    ratio, prior_std = gain.value / gain.stated, known[keys.index(DISTANCE)].prior_std
    stds = np.hypot([scale_std, prior_std], gain.standard_error / gain.stated)
    nats = -0.5 * ((ratio - 1) / stds) ** 2 - np.log(stds)
    stated = (SCALE in facts) - (DISTANCE in facts)
    if (stated, nats[1]) > (0, nats[0]):
        return values
    scale = float(before[keys.index(SCALE)])
    error = gain.standard_error / gain.stated * scale
    kept = replace(gain, value=gain.stated)
    others = tuple(kept if value is gain else value for value in values)
    return (*others, Value(SCALE, "", scale, scale * ratio, error, slack=gain.slack))


def _judged(
    log: Log,
    asked: tuple[tuple[Known, ...], Floats],
    before: Floats,
    solution: tuple[Problem, Noise],
) -> tuple[tuple[Value, ...], Rows]:
    """The parameters of a solution with their standard errors, and the rows of the solution.

    `asked` are the parameters and their slacks (`slacks_of`).
    """
    (known, slacks), (problem, noise) = asked, solution
    rows = linearised(problem, noise)
    followed = rows.solver.followed(np.random.default_rng(0))
    error = np.sqrt(np.diag(rows.solver.covariance)) * _repeats(problem, rows, followed)
    delay = [one.key for one in known].index(DELAY)
    error[delay] = np.hypot(error[delay], WITHIN_A_ROW * float(np.median(np.diff(log.controls.stamp_s))))
    found = before - (problem.prior - problem.parameters)
    return _values(known, before, found, error, (problem.prior_std, slacks)), rows


def facts_in(settings: Mapping[str, Any], above: str = "") -> frozenset[str]:
    """The dotted keys of partial settings that something is learned of."""
    found: set[str] = set()
    for key, value in settings.items():
        found |= facts_in(value, f"{above}{key}.") if isinstance(value, Mapping) else {f"{above}{key}"}
    return frozenset(found & SLACK.keys() if not above else found)


def facts_told(own: Mapping[str, Any], layer: Mapping[str, Any]) -> frozenset[str]:
    """Keys that the settings over those of a log state, and of a log's `own` those that correct something.

    **Why:** a log that a program wrote holds all settings there are. That no error is corrected is what all
    begin with, and no statement that there is none; where a sensor is mounted somebody measured.
    """
    said = {
        key
        for key in facts_in(own)
        if key.startswith("sensor.mounting.") or value_of(own, key) != (1.0 if key.endswith(ONE) else 0.0)
    }
    return facts_in(layer) | said


def slacks_of(
    controls: Controls, motion: Mapping[str, Any], keys: Sequence[str], facts: frozenset[str]
) -> Floats:
    """What each of `keys` may seem to be off by though it is right (N + 5,); 0 for what is no fact.

    **Why:** what a model leaves out looks like an error of what it has. Odometry that was integrated row by
    row along the heading at the start of each is half a row aside where the robot turns: as if the sensor was
    mounted half a row further ahead, or saw half a row late. The gain of the distance is no fact where the
    scale of the ranges is none: that is blamed then (`blamed`).
    """
    twists = arc_twists(controls, motion)
    row_s = float(np.median(np.diff(controls.stamp_s)))
    way_m = row_s * float(np.quantile(np.hypot(twists[:, 0], twists[:, 1]), FAST))
    half = {DELAY: row_s / 2, "sensor.mounting.x_m": way_m / 2, "sensor.mounting.y_m": way_m / 2}
    told = facts if SCALE in facts else facts - {DISTANCE}
    return np.array([max(SLACK[key], half.get(key, 0.0)) if key in told else 0.0 for key in keys])


def _repeats(problem: Problem, rows: Rows, followed: Floats) -> Floats:
    """How many times as uncertain (N + 5,) the parameters are as if no error of a row repeated; 1 or more.

    By how much stretches of the log disagree, over how much they would: what the rows alone say, the prior
    left out.
    """
    solver, free = rows.solver, problem.prior_std > 0
    influence = solver.influence() * (solver.residuals / np.sqrt(np.maximum(1 - followed, 0.1)))[:, None]
    covariance = solver.covariance[np.ix_(free, free)]
    alone = np.diag(covariance) - np.sum((covariance / problem.weighed_std[free]) ** 2, axis=1)
    repeats = np.ones(len(free))
    repeats[free] = np.sqrt(np.maximum(scattered(problem.batch, influence)[free] / alone, 1.0))
    return repeats


def _holding(problem: Problem, held: Any) -> Problem:
    """The problem with some of its parameters held where they were stated."""
    count = len(problem.motion)
    parameters = np.where(held, problem.prior, problem.parameters)
    batch = replace(problem.batch, parameters=parameters[count:])
    prior_std = np.where(held, 0.0, problem.prior_std)
    return replace(problem, batch=batch, motion=parameters[:count], prior_std=prior_std)


def _settled(
    log: Log,
    config: Mapping[str, Any],
    stretch: Stretch,
    problem: Problem,
    noise: Noise | None = None,
    *,
    until: float = SETTLED,
) -> tuple[Mapping[str, Any], Problem, Noise]:
    """Gauss-Newton steps and steps of the noise in turn, until neither moves or ITERATIONS are over.

    The noise moves no more where it changes by less than `until`. The tail is fitted once the noise hardly
    moves, or from the first step on where a `noise` is known.
    """
    parts = noise_parts(log.controls, config["motion"])
    start = start_noise(parts, problem.links, wide_noise(log, config))
    noise, fitting = noise or start, noise is not None
    for iteration in range(ITERATIONS):
        rows = linearised(problem, noise)
        problem, near = _stepped(problem, noise, rows)
        followed = rows.solver.followed(np.random.default_rng(0))
        problem = replace(problem, repeats=_repeats(problem, rows, followed))
        newer = learned_noise(problem, rows, followed, noise, start) if near else noise
        newer = replace(newer, tail=fitted_tail(rows, followed)) if near and fitting else newer
        change = change_of(problem, rows, noise, newer)
        is_settled = near and fitting and change < until and newer.tail == noise.tail
        fitting = fitting or (near and change < COARSE) or iteration >= TAIL_FROM
        noise, std = newer, problem.prior_std[: len(problem.motion)]
        linear = LINEAR if is_settled and until == SETTLED else STRAIGHT
        if np.any(np.abs(problem.motion) > linear * std):
            config, problem = _relinked(log, config, problem, stretch)
        elif is_settled:
            break
    return *_relinked(log, config, problem, stretch), noise


def _stepped(problem: Problem, noise: Noise, rows: Rows) -> tuple[Problem, bool]:
    """The problem a step further, and whether it was near its solution before.

    All of a step is taken if it explains no less, or a half, and so on. Far from the solution residuals say
    nothing of noise.
    """
    unknowns, parameters = rows.solver.step()
    shorter = 1.0
    for _ in range(HALVINGS):
        moved = moved_by(problem, shorter * unknowns, shorter * parameters)
        if (cost := cost_of(moved, noise)) <= rows.cost + COSTS_NOTHING:
            return moved, shorter == 1.0 and cost > (1.0 - NEAR) * rows.cost
        shorter *= 0.5
    return moved_by(problem, shorter * unknowns, shorter * parameters), False


def problem_of(
    log: Log, config: Mapping[str, Any], stretch: Stretch, places: tuple[Floats, Floats]
) -> Problem:
    """The least-squares problem of a stretch under complete settings; `places` as for `learn`."""
    seen, sensor = stretch.sightings, config["sensor"]
    mounting = sensor["mounting"]
    parameters = np.array(
        [sensor["range_scale"], sensor["range_bias_m"], mounting["x_m"], mounting["y_m"], mounting["yaw_rad"]]
    )
    known = (*motion_parameters(config["motion"]), *SENSOR_KNOWN)
    prior_std = np.array([one.prior_std for one in known])
    tied = links(log.controls, config, stretch.stamp_s)
    batch = Batch(
        poses=places[0],
        landmarks_m=places[1],
        parameters=parameters,
        motion=tied.motion,
        pose=stretch.pose,
        landmark=stretch.track,
        range_m=seen.range_m,
        bearing_rad=seen.bearing_rad - sensor["bearing_bias_rad"],
        surveyed_m=np.full(places[1].shape, np.nan),
    )
    motion = np.zeros(len(known) - len(SENSOR_KNOWN))
    axes = np.array([part.axis for part in noise_parts(log.controls, config["motion"])])
    prior = np.concatenate([motion, parameters])
    return Problem(batch, tied, axes, stretch.joined, motion, prior, prior_std, np.ones(len(known)))


def _relinked(
    log: Log, config: Mapping[str, Any], problem: Problem, stretch: Stretch
) -> tuple[Mapping[str, Any], Problem]:
    """The odometry integrated anew under the motion parameters found so far, with its derivatives."""
    known = motion_parameters(config["motion"])
    moved = [
        nested(one.key, value_of(config, one.key) + float(change))
        for one, change in zip(known, problem.motion, strict=True)
    ]
    config = merge(config, *moved)
    tied = links(log.controls, config, stretch.stamp_s)
    prior = problem.prior.copy()
    prior[: len(known)] -= problem.motion
    batch = replace(problem.batch, motion=tied.motion)
    return config, replace(problem, batch=batch, links=tied, motion=0 * problem.motion, prior=prior)


def _values(
    known: tuple[Known, ...],
    stated: Floats,
    found: Floats,
    error: Floats,
    before: tuple[Floats, Floats],
) -> tuple[Value, ...]:
    """The values that were free; `before` are the deviations of the prior and the slacks of facts."""
    columns = zip(known, stated, found, error, *before, strict=True)
    return tuple(
        Value(
            one.key,
            one.unit,
            float(was),
            float(now),
            float(std),
            bool(std < LEAST_GAIN * prior),
            float(slack),
        )
        for one, was, now, std, prior, slack in columns
        if prior > 0
    )


def _learned(
    config: Mapping[str, Any],
    parts: tuple[Part, ...],
    noise: Noise,
    values: tuple[Value, ...],
    seen: tuple[Stretch, Rows],
) -> Learned:
    stretch, rows = seen
    settings = [nested(value.key, _short(value.value)) for value in values if value.significant]
    noises = []
    for part, square in zip(parts, noise.squares, strict=True):
        value = _short(square if part.squared else np.sqrt(square))
        settings.append(nested(part.key, value))
        noises.append(Value(part.key, "", value_of(config, part.key), value))
    for key, unit, variance in zip(NOISES, ("m", "rad"), noise.seen, strict=True):
        value = _short(np.sqrt(variance))
        settings.append(nested(f"sensor.{key}", value))
        noises.append(Value(f"sensor.{key}", unit, value_of(config, f"sensor.{key}"), value))
    settings.append(nested("sensor.tail_degrees_of_freedom", noise.tail))
    return Learned(
        values=(*values, *noises),
        settings=merge(*settings),
        sightings=len(stretch.track),
        tracks=int(stretch.track.max()) + 1,
        correlation=correlation_of(rows, stretch.track, stretch.sightings.stamp_s),
        noise=noise,
    )


def of_turns_and_delay(learned: Learned) -> Learned:
    """What was learned of turns and delay: without the sensor's mounting, bias and scale, and the way's gain.

    A wide noise covers these, and short tracks tell them badly: an error of the sensor that lasts as long as
    a track looks like a mounting, or like a longer way. Nothing covers turns that are off or a delay.
    """
    left = {DISTANCE, *(known.key for known in SENSOR_KNOWN)}
    values = tuple(value for value in learned.values if value.key not in left)
    told = [nested(value.key, _short(value.value)) for value in values if value.significant]
    return replace(learned, values=values, settings=merge(*told))


def without_noise(learned: Learned) -> Learned:
    """What was learned of errors alone: under them the noise is as it is stated."""
    values = tuple(value for value in learned.values if not np.isnan(value.standard_error))
    told = [nested(value.key, _short(value.value)) for value in values if value.significant]
    return replace(learned, values=values, settings=merge(*told))


def _short(value: float) -> float:
    """Four significant digits."""
    return float(f"{float(value):.4g}")


def reckoned(log: Log, config: Mapping[str, Any], stamp_s: Floats) -> Floats:
    """Poses (K, 3) by the odometry alone at stamps of sightings."""
    controls = turning_points(log.controls, config["motion"])
    return DeadReckoning(controls, config["motion"]).poses_at(stamp_s - config["sensor"]["delay_s"])


def widened(
    learned: Learned, config: Mapping[str, Any], parts: tuple[Part, ...], wide: tuple[Noise, float]
) -> Learned:
    """The same systematic errors under a noise that is wide for its kind, whatever the residuals say.

    `wide` is the noise that learning begins with, and how many times as wide that of the sensor is made.
    Errors that last longer than a track look like a place of what is tracked, and odometry that wanders over
    minutes runs true for seconds: what short tracks say of either is too narrow to close a loop by.
    """
    start, wider = wide
    squares = WIDER_MOTION**2 * start.squares
    found = {
        part.key: square if part.squared else np.sqrt(square)
        for part, square in zip(parts, squares, strict=True)
    }
    found |= {
        f"sensor.{name}": wider * np.sqrt(variance) for name, variance in zip(NOISES, start.seen, strict=True)
    }
    short = {key: _short(value) for key, value in found.items()}
    kept = tuple(value for value in learned.values if value.key not in short)
    noises = tuple(Value(key, "", value_of(config, key), value) for key, value in short.items())
    told = [nested(key, value) for key, value in short.items()]
    settings = merge(learned.settings, *told, nested("sensor.tail_degrees_of_freedom", ROBUST_TAIL))
    return replace(learned, values=(*kept, *noises), settings=settings)

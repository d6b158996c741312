"""Finds noise and systematic errors of a log, and keeps what explains unseen sightings better."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any, TypeAlias

import numpy as np

from ..config import Config, merge
from ..detection import own_settings, with_sightings
from ..errors import DataError, FastSlamError
from ..examination.hypotheses import AS_IS
from ..laid import wide_noise
from ..log import Floats, Ints, Log
from ..result import RunResult
from ..runner import configure, refuse_ranges_alone, run
from ..settings import Layer
from .begin import Beginning, Tried, beginning
from .ending import Growth
from .judge import SOUND, Judgement, ended, evidence, judged
from .learn import (
    COARSE,
    LEAST_PER_TRACK,
    SCALE,
    SETTLED,
    WIDER,
    Learned,
    Stated,
    Stretch,
    Value,
    errors_of,
    facts_told,
    learn,
    of_turns_and_delay,
    problem_of,
    reckoned,
    start_noise,
    stretch_of,
    usable_sightings,
    widened,
    without_noise,
)
from .motion import DISTANCE, nested, noise_parts, value_of
from .passes import Report, passes_of
from .problem import Noise, Problem
from .tracks import Scene, of_map, scene, short_tracks

Progress: TypeAlias = Callable[[int, int], None]
Tracked: TypeAlias = tuple[Stretch, tuple[Floats, Floats]]
"""Tracks, and the poses (K, 3) and places (L, 2) to begin with."""
LEARNED_SHARE = 0.7
"""Share of the sightings, the first ones, that teach; the others judge."""
LEAST_FOLLOWED = 0.5
"""Less of the sightings are followed from scan to scan only where they are noise or clutter; 0.88 in Victoria
Park, 0.24 where bearings are random."""
LEAST_NATS = 10.0
"""So many nats settings must gain on the sightings that judge, or the simpler ones are kept."""
MOST_RUNS = 7
AS_STATED = "as stated"
FOLLOWING = "learning from what is seen again"
_NAMES = dict(zip(WIDER, ("wide", "wider", "widest"), strict=True))
GATE = 2.0
"""Sightings are followed as if their noise was so many times what it is taken for at first."""
REPEATING = 1.5
"""From here on errors of neighbouring sightings are said to repeat."""


@dataclass(frozen=True)
class Attempt:
    """Settings that were tried: a name, the settings over the log's own, what they taught, the evidence."""

    name: str
    settings: dict[str, Any]
    learned: Learned | None
    result: RunResult
    evidence: float
    """NaN of a run that was ended early."""
    judgement: Judgement
    wider: float = 0.0
    """So many times as wide as what is wide is the noise; 0 where it is stated or learned."""
    was_ended: bool = False
    """Whether its map grew so far beyond that of the best run that it was ended."""
    least_nats: float = LEAST_NATS
    """So many nats it must gain over an earlier one to be kept for that."""

    @property
    def fault(self) -> str | None:
        """Why nothing is to be learned from this run."""
        return self.judgement.fault

    @property
    def is_sound(self) -> bool:
        """Whether nothing speaks against the map of this run."""
        return self.judgement.rank == SOUND


@dataclass(frozen=True)
class Tuning:
    """What was found: the settings to lay over those of the log, and how they came about."""

    settings: dict[str, Any]
    """Empty where the settings stated explain the log best."""
    values: tuple[Value, ...]
    evidence_gain: float
    """Nats gained on the sightings that judged, over the settings stated; NaN where that run was ended."""
    judged: int
    """How many sightings judged."""
    attempts: tuple[Attempt, ...]
    """First the one with the settings stated, the others as they were made."""
    hypotheses: tuple[Tried, ...]
    best: Attempt
    interrupted: bool = False
    """Whether the search was stopped: `best` is what it had then."""

    @property
    def result(self) -> RunResult:
        """The run with the settings found."""
        return replace(self.best.result, interrupted=True) if self.interrupted else self.best.result

    @property
    def doubt(self) -> str | None:
        """What still speaks against the map, though nothing does by its own sightings; None for a sound one.

        A robot that slips or was carried away has no right map under any noise, and under one that is wide
        enough nothing speaks against a wrong one. Where the first map was doubted, only one of fewer
        landmarks that explain as much is believed, or with names one that explains as much. How much one that
        was ended would have explained nobody knows.
        """
        first, best = self.attempts[0], self.best
        if best is first or first.is_sound:
            return None
        plain, found = first.judgement, best.judgement
        named = self.result.config["association"]["mode"] == "known"
        explains = first.was_ended or found.explains_as_much_as(plain)
        if (named or found.landmarks < plain.landmarks) and explains:
            return None
        return (
            f"with the settings as they are {plain.doubt}; with what the log teaches the map is no simpler, "
            "so that too may be wrong"
        )

    @property
    def conflicts(self) -> tuple[str, ...]:
        """A sentence for each setting that somebody wrote down and the log clearly contradicts."""
        return tuple(
            f"you said {value.key} = {value.stated:.4g}, the log says {value.value:.3g} +- "
            f"{value.interval95[1] - value.value:.1g} {value.unit}".rstrip()
            + ": the log's is taken; check yours"
            for value in self.values
            if value.contradicts
        )

    @property
    def ratio(self) -> float:
        """So many times as long as the odometry says the ranges are; 1 where the log shows no difference."""
        found = {value.key: value for value in self.values if value.significant}
        told = found.get(SCALE, found.get(DISTANCE))
        return 1.0 if told is None else told.value / told.stated

    @property
    def alternative(self) -> dict[str, Any]:
        """What to lay over `settings` where the other of ranges and odometry is off; empty where none is.

        A log tells the ratio of the two alone: where one of them is set, it may be the other one.
        """
        if self.ratio == 1.0:
            return {}
        stated = {value.key: value.stated for value in self.values}
        scale = stated.get(SCALE, value_of(self.result.config, SCALE))
        gain = stated[DISTANCE]
        if SCALE in stated:
            return merge(nested(SCALE, scale), nested(DISTANCE, round(gain * self.ratio, 4)))
        return merge(nested(SCALE, round(scale * self.ratio, 4)), nested(DISTANCE, gain))


def tune(log: Log, config: Layer | None = None, *, progress: Progress | None = None) -> Tuning:
    """Learns noise, gains, biases, mounting and delay from a log; keeps what explains its rest better.

    `config` is laid over the log's own settings, as for `run`; what it and the log state is where the search
    begins and what systematic errors are drawn to. At most MOST_RUNS runs of the filter are made. Errors:
    DataError for a log with too little in it, or where the best run was lost or mapped everything twice;
    ConfigError for the configuration.
    """
    found = searched(log, config, progress=progress)
    if found.interrupted:
        raise KeyboardInterrupt
    if found.best.fault is not None:
        reason = f"in the best run {found.best.fault}"
        raise DataError(f"nothing can be learned from this log: {reason}", log.source)
    return found


def searched(
    log: Log,
    config: Layer | None = None,
    *,
    progress: Progress | None = None,
    stated: RunResult | None = None,
    report: Report | None = None,
) -> Tuning:
    """As `tune`, but the best of all runs is the answer where none is sound; `best.fault` says why not.

    `stated` is the run with the settings stated, where it is there already; `report` hears of every pass. A
    KeyboardInterrupt ends the search with the best run until then, be it half a one, and is raised where
    there is none yet.
    """
    log = with_sightings(log, config)
    configuration = configure(log, config or {})
    refuse_ranges_alone(configuration, "tune")
    session = _Session(log, configuration, config or {}, progress, report)
    interrupted = False
    try:
        best = _search(session, stated)
    except KeyboardInterrupt:
        if not session.attempts:
            raise
        interrupted, best = True, _better(session.attempts)
    return Tuning(
        settings=best.settings,
        values=best.learned.values if best.learned is not None else (),
        evidence_gain=best.evidence - session.attempts[0].evidence,
        judged=int(np.sum(log.sightings.stamp_s > session.until_s)),
        attempts=tuple(session.attempts),
        hypotheses=session.hypotheses,
        best=best,
        interrupted=interrupted,
    )


def from_tracks(log: Log, config: Layer | None = None) -> Learned:
    """What all that is followed from scan to scan says of a log's noise and errors: no filter runs.

    `config` is laid over the log's own settings. Errors: DataError for a log with too little in it.
    """
    log = with_sightings(log, config)
    session = _Session(log, configure(log, config or {}), config or {}, None)
    return session.learned_from_tracks(session.begun())


def _search(session: _Session, stated: RunResult | None) -> Attempt:
    """Runs as short tracks teach or with wide noise, as stated, as the best map teaches: the best of them."""
    if stated is not None:
        session.attempt_as_stated(stated)
    tracked = session.learned_from_tracks(session.begun())
    repeating = tracked.correlation > REPEATING
    if not repeating:
        session.attempt("from short tracks", tracked.settings, tracked)
        repeating = session.errs_for_long()
    at_once = repeating and not session.named
    if at_once:
        _widen_at_once(session, tracked)
    if stated is None:
        session.attempt_as_stated()
    if not repeating:
        _try_errors_alone(session, tracked)
    if not at_once and (repeating or not _better(session.attempts).is_sound):
        _widen(session, tracked)
    best, teaches = _better(session.attempts), True
    while teaches and len(session.attempts) < MOST_RUNS and (best.fault is None or best.wider):
        relearned = session.learned_from_map(best)
        latest = None if relearned is None else session.attempt_again(best, relearned)
        if latest is None or _better(session.attempts) is not latest:
            break
        best, teaches = latest, _is_clearer(latest, best)
    session.finish()
    return best


def _try_errors_alone(session: _Session, tracked: Learned) -> None:
    """Runs with the turns and the delay of short tracks under the noise stated, where that is the better one.

    **Why:** a noise under which a loop is not closed says nothing against a delay. What the tracks say for
    sure is kept unless the rest of the log speaks against it.
    """
    told, best = without_noise(of_turns_and_delay(tracked)), _better(session.attempts)
    if told.settings and best.is_sound and best is session.attempts[0]:
        session.attempt("turns and delay from short tracks", told.settings, told, least_nats=0.0)


def _widen(session: _Session, tracked: Learned) -> None:
    """Runs under ever wider noise, until a wider one than that of a sound map is no better.

    Where sightings have names, a sound map under wide noise is enough: nothing is founded anew that a wider
    one would hold together.
    """
    tracked = of_turns_and_delay(tracked)
    for wider in WIDER:
        latest = session.attempt_wide(tracked, wider)
        best = _better(session.attempts)
        if best.is_sound and (session.named or best is not latest):
            break


def _widen_at_once(session: _Session, tracked: Learned) -> None:
    """Runs under wide noise where errors repeat: the width in the middle, then on the side that is likelier.

    Where the one in the middle is sound a narrower one may be as well, and tell more; where it is not, it is
    rather the wider one.
    """
    tracked = of_turns_and_delay(tracked)
    narrow, middle, widest = WIDER
    first = session.attempt_wide(tracked, middle)
    best = _better(session.attempts)
    if best.is_sound and best is not first:
        return
    for wider in (narrow, widest) if first.is_sound else (widest, narrow):
        if session.attempt_wide(tracked, wider) is _better(session.attempts):
            return


def _is_clearer(latest: Attempt, best: Attempt) -> bool:
    """Whether a map is the sounder or the simpler one, not just the likelier: only then it teaches more."""
    sounder = latest.judgement.rank > best.judgement.rank
    return sounder or latest.judgement.is_simpler(best.judgement)


def _better(attempts: list[Attempt]) -> Attempt:
    """The attempt against which least speaks, of several the simplest, of several the likeliest.

    **Why:** evidence alone prefers a map that is there many times over: under noise that is too narrow for
    errors which last, each copy explains the sightings of its time. An earlier attempt is kept unless it
    loses the `least_nats` of a later one. One that was ended is none; the first run never is.
    """
    whole = _explaining_most([attempt for attempt in attempts if not attempt.was_ended])
    best = whole[0]
    for other in whole[1:]:
        sounder = other.judgement.rank - best.judgement.rank
        simpler = other.judgement.is_simpler(best.judgement) - best.judgement.is_simpler(other.judgement)
        likelier = other.evidence > best.evidence + other.least_nats
        if (sounder, simpler, likelier) > (0, 0, False):
            best = other
    return best


def _explaining_most(attempts: list[Attempt]) -> list[Attempt]:
    """Attempts without the sound ones that explain less than another sound one does.

    **Why here:** each may be simpler than the last and explain a little less; what is missing adds up.
    """
    sound = [attempt.judgement for attempt in attempts if attempt.is_sound]
    return [
        attempt
        for attempt in attempts
        if not attempt.is_sound or all(attempt.judgement.explains_as_much_as(other) for other in sound)
    ]


class _Session:
    """A log under its stated settings, and the runs made over it so far."""

    def __init__(
        self,
        log: Log,
        config: Config,
        layer: Layer,
        progress: Progress | None,
        report: Report | None = None,
    ) -> None:
        self.log, self.config, self._layer, self._progress = log, config, layer, progress
        self._report = report
        if len(log.sightings.stamp_s) == 0:
            raise DataError("the log has no sightings to learn from", log.source)
        self._stated = Stated(config, facts_told(own_settings(log), merge(layer)))
        self.until_s = float(np.quantile(log.sightings.stamp_s, LEARNED_SHARE))
        self.named = config["association"]["mode"] == "known" and bool((log.sightings.identity >= 0).any())
        self.attempts: list[Attempt] = []
        self.hypotheses: tuple[Tried, ...] = ()
        self._first: Mapping[str, Any] = config
        """The settings that short tracks are followed under at first."""
        self._start: Noise | None = None
        self._noise: Noise | None = None
        """What short tracks taught."""
        self._gate = wide_noise(log, config)
        """Deviations (2,) of range and bearing by which sightings are followed."""
        self._tracks: list[tuple[Mapping[str, Any], Tracked]] = []
        """What was followed from scan to scan, by the settings that it was followed under."""
        wide = wide_noise(log, config)
        noise = {"range_std_m": float(wide[0]), "bearing_std_rad": float(wide[1])}
        self._common = merge(config, {"sensor": {**noise, "tail_degrees_of_freedom": None}})

    def attempt_again(self, best: Attempt, relearned: Learned) -> Attempt | None:
        """Runs the filter as the map of an attempt teaches: the errors alone where its noise was wide.

        None where another run was made with that, or where errors last that its noise takes for chance.
        """
        if relearned.correlation > REPEATING and not best.wider:
            return None
        name = f"from the map of run {[one is best for one in self.attempts].index(True) + 1}"
        if best.wider:
            name, relearned = f"{name}, {_NAMES[best.wider]} noise", self.widened(relearned, best.wider)
        if any(one.settings == relearned.settings for one in self.attempts):
            return None
        return self.attempt(name, relearned.settings, relearned, wider=best.wider)

    def attempt_wide(self, learned: Learned, wider: float) -> Attempt:
        """Runs the filter with the systematic errors that were learned, under a wide noise."""
        wide = self.widened(learned, wider)
        return self.attempt(f"with {_NAMES[wider]} noise", wide.settings, wide, wider=wider)

    def attempt(
        self,
        name: str,
        settings: dict[str, Any],
        learned: Learned | None,
        *,
        wider: float = 0.0,
        least_nats: float = LEAST_NATS,
    ) -> Attempt:
        """Runs the filter with settings over those stated.

        It is ended where its map grows far beyond the best one until then. An interrupted run counts if it is
        the first.
        """

        def advance(done: int, total: int, number: int = len(self.attempts)) -> None:
            if self._progress is not None:
                self._progress(number * total + done, MOST_RUNS * total)

        growth = self._growth()
        self._tell((name, learned))
        result = run(self.log, merge(self._layer, settings), progress=advance, watch=growth)
        if growth is not None and growth.has_ended:
            judgement = ended(result, _better(self.attempts).judgement)
            self.attempts.append(
                Attempt(name, settings, learned, result, np.nan, judgement, wider, was_ended=True)
            )
            return self.attempts[-1]
        if result.interrupted and self.attempts:
            raise KeyboardInterrupt
        made = self._judged(name, settings, learned, result, wider)
        self.attempts.append(replace(made, least_nats=least_nats))
        if result.interrupted:
            raise KeyboardInterrupt
        return self.attempts[-1]

    def errs_for_long(self) -> bool:
        """Whether the map of the latest run shows errors that last longer than a track; then it is worthless.

        **Why:** a path follows an error that all sightings of a time share, as where one thing is in view:
        along it they look more exact than they are, and the odometry worse. Only what comes back to them
        another way shows that they repeat; a map under such noise is bent.
        """
        latest = self.attempts[-1]
        relearned = self.learned_from_map(latest) if latest.fault is None else None
        if relearned is None or relearned.correlation <= REPEATING:
            return False
        reason = "its sightings err alike for longer than its noise explains"
        judgement = replace(latest.judgement, fault=reason, doubt=reason)
        self.attempts[-1] = replace(latest, judgement=judgement)
        return True

    def attempt_as_stated(self, made: RunResult | None = None) -> None:
        """Runs the filter with the settings stated, unless that run was `made`: the first of the attempts."""
        if made is not None:
            self.attempts.append(self._judged(AS_STATED, {}, None, made, 0.0))
            return
        self.attempt(AS_STATED, {}, None)
        self.attempts.insert(0, self.attempts.pop())

    def _judged(
        self, name: str, settings: dict[str, Any], learned: Learned | None, result: RunResult, wider: float
    ) -> Attempt:
        nats = evidence(result, self.until_s, self._common)
        judgement = judged(result, self.log, self._common, result.doubts)
        return Attempt(name, settings, learned, result, nats, judgement, wider)

    def _tell(self, running: tuple[str, Learned | None] | None) -> None:
        """Reports the passes, and the one that runs."""
        if self._report is not None:
            made = [attempt for attempt in self.attempts if not attempt.was_ended]
            self._report(passes_of(self.attempts, _better(made) if made else None, running))

    def _growth(self) -> Growth | None:
        """What ends a run whose map grows beyond the best one's; None where nothing is a measure of it."""
        if not self.attempts:
            return None
        best = _better(self.attempts)
        share = best.judgement.share
        return Growth(best.result, share) if share > 0.0 and not best.result.interrupted else None

    def begun(self) -> Beginning:
        """The hypothesis that a stretch of the log speaks for, by which short tracks are followed first."""
        teaching = replace(self.log, sightings=usable_sightings(self.log, self.until_s)[0])
        begin = beginning(teaching, self.config, wide_noise(self.log, self.config))
        self.hypotheses = begin.tried
        return begin

    def finish(self) -> None:
        """Tells the progress, and who watches, that no more runs are made."""
        self._tell(None)
        if self._progress is not None:
            self._progress(1, 1)

    def learned_from_tracks(self, begin: Beginning) -> Learned:
        """Learns from what is followed from scan to scan by an odometry that it has put right before."""
        self._tell((f"{FOLLOWING} from scan to scan", None))
        self._first = config = _begun(self.config, begin)
        config, rough = errors_of(self.log, config, *self._tracked(config), stated=self._stated)
        self._narrow(rough.noise)
        until = COARSE if rough.correlation > REPEATING and not self.named else SETTLED
        stretch, places = self._tracked(config)
        learned = learn(
            self.log, config, stretch, places, stated=self._stated, noise=rough.noise, until=until
        )
        self._noise = learned.noise
        return learned

    def _narrow(self, noise: Noise) -> None:
        """Follows sightings within GATE of the noise found from now on, where that is less than a wide one.

        **Why:** a thing that goes out of sight hands its track to one beside it, if that is inside the gate:
        two reflectors on both sides of a rack were one, and its errors repeated.
        """
        narrow = np.minimum(self._gate, GATE * np.sqrt(noise.seen))
        if np.any(narrow < self._gate):
            self._gate = narrow
            self._tracks.clear()

    def problem_from_tracks(self) -> tuple[Problem, Noise]:
        """The least-squares problem of the short tracks and its first noise, before anything was learned."""
        config = self._first
        stretch, places = self._tracked(config)
        problem = problem_of(self.log, config, stretch, places)
        parts = noise_parts(self.log.controls, config["motion"])
        return problem, start_noise(parts, problem.links, wide_noise(self.log, config))

    def widened(self, learned: Learned, wider: float) -> Learned:
        """What was learned, under a wide noise."""
        parts = noise_parts(self.log.controls, self.config["motion"])
        if self._start is None:
            self._start = self.problem_from_tracks()[1]
        return widened(learned, self.config, parts, (self._start, wider))

    def _tracked(self, config: Mapping[str, Any]) -> Tracked:
        found = next((tracked for under, tracked in self._tracks if under == config), None)
        if found is None:
            found = self._followed(config)
            self._tracks.append((config, found))
        return found

    def _followed(self, config: Mapping[str, Any]) -> Tracked:
        seen, window = usable_sightings(self.log, self.until_s)
        shown = self._scene(config, reckoned(self.log, config, seen.stamp_s))
        stretch = stretch_of(seen, window, track := short_tracks(shown))
        followed = len(stretch.track) / len(track)
        if followed < LEAST_FOLLOWED:
            message = f"only {followed:.0%} of the sightings are seen again from scan to scan"
            raise DataError(f"nothing can be learned from this log: {message}", self.log.source)
        return stretch, (reckoned(self.log, config, stretch.stamp_s), _middles(shown, stretch, track))

    def learned_from_map(self, attempt: Attempt) -> Learned | None:
        """Learns from the map and the path of a run; None where its landmarks are seen too rarely."""
        config, result = merge(self.config, attempt.settings), attempt.result
        self._tell((f"{FOLLOWING} in the map of the best run", None))
        seen, window = usable_sightings(self.log, self.until_s)
        landmarks = result.landmarks
        shown = self._scene(config, _path_at(result, seen.stamp_s - config["sensor"]["delay_s"]))
        if self.named:
            rows = {name: row for row, name in enumerate(landmarks.ids)}
            of_identity = np.array([rows.get(name, -1) for name in self.log.identity_names] + [-1])
            track = of_identity[seen.identity]
        else:
            spread = np.sqrt(np.maximum(np.trace(landmarks.covariance_m2, axis1=1, axis2=2) / 2, 1e-8))
            track = of_map(shown, landmarks.mean_m, spread)
        try:
            stretch = stretch_of(seen, window, track)
        except FastSlamError:
            return None
        counts = np.bincount(track[track >= 0], minlength=1)
        used = np.flatnonzero(counts >= LEAST_PER_TRACK)
        places = _path_at(result, stretch.stamp_s - config["sensor"]["delay_s"]), landmarks.mean_m[used]
        until = COARSE if attempt.wider else SETTLED
        return learn(self.log, config, stretch, places, stated=self._stated, noise=self._noise, until=until)

    def _scene(self, config: Mapping[str, Any], poses: Floats) -> Scene:
        seen, _ = usable_sightings(self.log, self.until_s)
        return scene(seen, config["sensor"], poses, self._gate, named=self.named)


def _begun(config: Mapping[str, Any], begin: Beginning) -> dict[str, Any]:
    """The settings with the hypothesis to begin with."""
    tried = begin.hypothesis
    if tried == AS_IS:
        return dict(config)
    turn = (
        "motion.steering_gain" if config["motion"]["model"] == "ackermann" else "motion.correction.turn_gain"
    )
    distance = "motion.correction.distance_gain"
    return merge(
        config,
        nested(turn, value_of(config, turn) * tried.turn_gain),
        nested(distance, value_of(config, distance) * tried.speed_gain),
        nested("sensor.delay_s", value_of(config, "sensor.delay_s") + tried.delay_s),
    )


def _middles(shown: Scene, stretch: Stretch, track: Ints) -> Floats:
    """Mean place (L, 2) of what each track saw."""
    counts = np.bincount(track[track >= 0], minlength=1)
    kept = (track >= 0) & (counts[np.maximum(track, 0)] >= LEAST_PER_TRACK)
    number = np.bincount(stretch.track)
    points = shown.point_m[kept]
    return np.column_stack([np.bincount(stretch.track, points[:, axis]) / number for axis in (0, 1)])


def _path_at(result: RunResult, stamp_s: Floats) -> Floats:
    path = result.path
    heading = np.unwrap(path.T_world_robot[:, 2])
    columns = (path.T_world_robot[:, 0], path.T_world_robot[:, 1], heading)
    return np.column_stack([np.interp(stamp_s, path.stamp_s, column) for column in columns])

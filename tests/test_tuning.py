"""Tuning finds what was put into a log, and keeps nothing that does not explain the log better."""

from __future__ import annotations

import json
from dataclasses import dataclass, field, replace
from itertools import combinations
from pathlib import Path
from typing import Any

import fastslam.verdict as verdict_module
import numpy as np
import pytest
from cli_runner import fastslam
from fastslam._between import Between
from fastslam._bordered import BLOCKS
from fastslam.automatic import Learning
from fastslam.cli.tune import facts_of, sentences_of, show_tuning
from fastslam.config import Config, load_config, merge
from fastslam.datasets import write_native
from fastslam.dead_reckoning import DeadReckoning, arc_twists, turning_points
from fastslam.errors import DataError
from fastslam.examination.hypotheses import Hypothesis
from fastslam.examination.stretches import Bench
from fastslam.laid import wide_noise
from fastslam.log import Controls, Log
from fastslam.result import RunResult
from fastslam.runner import configure, run
from fastslam.simulation import resolve_simulation, simulate
from fastslam.trust import Doubt, doubts
from fastslam.tuning import Attempt, Tuning, begin, judge, tune
from fastslam.tuning import learn as learning
from fastslam.tuning.begin import nats_of
from fastslam.tuning.ending import Growth
from fastslam.tuning.judge import SOUND, Judgement, evidence, judged, log_new_density
from fastslam.tuning.learn import (
    LASER_SCALE_STD,
    SCALE,
    SENSOR_KNOWN,
    WIDER,
    Learned,
    Value,
    _repeats,
    blamed,
    facts_in,
    facts_told,
    of_turns_and_delay,
)
from fastslam.tuning.motion import DISTANCE as DISTANCE_GAIN
from fastslam.tuning.motion import links, motion_parameters, nested, noise_parts
from fastslam.tuning.noise import _log_likelihood
from fastslam.tuning.problem import DRAWS, Noise, Problem, Rows, linearised, moved_by
from fastslam.tuning.session import (
    REPEATING,
    _better,
    _is_clearer,
    _Session,
    _widen,
    _widen_at_once,
    searched,
)

BIAS = "sensor.range_bias_m"
TURN, DISTANCE, DELAY_S = 0.65, 1.06, 0.3
REPORTS: list[list[dict[str, Any]]] = []
"""What was reported while the fixture `found` was made."""
UNKNOWN = {"association": {"mode": "unknown"}, "filter": {"particles": 15}}


def drive(seed: int = 5, *, seconds: float = 25.0) -> Log:
    """A short drive, its names removed."""
    log = simulate(resolve_simulation({"seed": seed, "max_duration_s": seconds}, preset="demo"))
    unnamed = np.full(len(log.sightings.stamp_s), -1, dtype=np.int64)
    return replace(log, sightings=replace(log.sightings, identity=unnamed))


def wrong(log: Log) -> Log:
    """The log with gains that are off and late sightings."""
    controls = replace(log.controls, values=log.controls.values / np.array([DISTANCE, TURN]))
    late = replace(log.sightings, stamp_s=log.sightings.stamp_s + DELAY_S)
    return replace(log, controls=controls, sightings=late)


@pytest.fixture(scope="module")
def sound() -> Log:
    return drive()


@pytest.fixture(scope="module")
def broken(sound: Log) -> Log:
    return wrong(sound)


@pytest.fixture(scope="module")
def found(broken: Log) -> Tuning:
    told = {"motion": {"correction": {"turn_gain": 1.0}}, "sensor": {"delay_s": 0.0}}
    return searched(broken, {**UNKNOWN, **told}, report=REPORTS.append)


@pytest.mark.slow
def test_gains_and_a_delay_are_found_without_identities(sound: Log, broken: Log, found: Tuning) -> None:
    value = {one.key: one for one in found.values}
    turn, distance = value["motion.correction.turn_gain"], value["motion.correction.distance_gain"]
    assert turn.value == pytest.approx(TURN, abs=0.02) and turn.significant
    assert distance.value == pytest.approx(DISTANCE, abs=0.02) and distance.significant
    assert value["sensor.delay_s"].value == pytest.approx(DELAY_S, abs=0.06)
    assert value["sensor.range_std_m"].value == pytest.approx(0.1, rel=0.15)
    assert found.judged > 100
    as_true = run(sound, UNKNOWN)
    assert abs(len(found.result.landmarks.ids) - len(as_true.landmarks.ids)) <= 1
    # What is found is what a run takes.
    again = run(broken, merge(UNKNOWN, found.settings))
    assert np.array_equal(again.landmarks.mean_m, found.result.landmarks.mean_m)


@pytest.mark.slow
def test_a_sound_log_with_its_noise_told_is_left_alone_or_gains(sound: Log) -> None:
    found = tune(sound, UNKNOWN)
    assert found.evidence_gain >= 0.0
    assert all(found.best.evidence >= attempt.evidence - 10.0 for attempt in found.attempts)
    gains = [one for one in found.values if one.key.startswith("motion.correction.")]
    assert not any(one.significant for one in gains)


def gain_of(value: float, error: float = 0.003) -> tuple[Value, ...]:
    return (Value(DISTANCE_GAIN, "", 1.0, value, error), Value("sensor.delay_s", "s", 0.0, 0.1, 0.01))


@pytest.mark.parametrize("gain", [1.02, 0.98])
def test_a_scale_near_one_is_taken_for_the_ranges(gain: float) -> None:
    known = (*motion_parameters({"model": "velocity"}), *SENSOR_KNOWN)
    stated = np.array([1.006 if one.key == SCALE else 1.0 for one in known])
    before = gain_of(gain)
    distance, delay, scale = blamed(before, known, stated)
    assert (distance.value, distance.significant, delay) == (1.0, False, before[1])
    # Ranges that are longer by a factor look like a way that is.
    assert scale.key == SCALE and scale.value == pytest.approx(1.006 * gain) and scale.significant


@pytest.mark.parametrize(("gain", "error"), [(1.06, 0.003), (0.94, 0.003), (1.02, 0.01)])
def test_one_further_away_is_the_odometrys_and_one_that_is_not_sure_nobodys(
    gain: float, error: float
) -> None:
    known = (*motion_parameters({"model": "velocity"}), *SENSOR_KNOWN)
    values = gain_of(gain, error)
    assert blamed(values, known, np.ones(len(known))) == values


@pytest.mark.parametrize(("ratio", "of_ranges"), [(1.01, False), (0.992, False), (1.002, True)])
def test_a_lasers_ranges_are_as_long_as_its_clock_is_right(ratio: float, of_ranges: bool) -> None:
    known = (*motion_parameters({"model": "velocity"}), *SENSOR_KNOWN)
    found = blamed(gain_of(ratio, 0.0003), known, np.ones(len(known)), scale_std=LASER_SCALE_STD)
    assert (found[-1].key == SCALE) == of_ranges
    assert found[0].significant != of_ranges


def test_a_scale_off_by_more_than_a_reading_is_the_odometrys() -> None:
    exact = {"sensor": {"range_std_m": 0.02, "bearing_std_rad": 0.004}, "motion": {"speed_std_m_per_s": 0.02}}
    log = simulate(resolve_simulation({"seed": 3, "max_duration_s": 60.0, **exact}))
    controls = replace(log.controls, values=log.controls.values / [1.02, 1.0])
    found = tune(replace(log, controls=controls), UNKNOWN)
    gain = next(value for value in found.values if value.key == DISTANCE_GAIN)
    # Ranges of 20 mm are not 2 % too long, wheels are. Four standard errors.
    assert gain.significant and not any(value.key == SCALE for value in found.values)
    assert gain.value == pytest.approx(1.02, abs=4 * gain.standard_error)
    assert found.alternative["sensor"]["range_scale"] == pytest.approx(gain.value, rel=1e-3)


@pytest.mark.parametrize("turn", [0.02, 0.1])
def test_the_noise_of_motion_is_found_where_the_sightings_say_much_more(turn: float) -> None:
    motion = {"speed_std_m_per_s": 0.05, "yaw_rate_std_rad_per_s": turn}
    told = {"motion": motion, "sensor": {"bearing_std_rad": 0.03}, "scan": {"identities": "none"}}
    log = simulate(resolve_simulation({"seed": 5, "max_duration_s": 60.0, **told}))
    session = _Session(log, configure(log, {}), {}, None)
    learned = session.learned_from_tracks(session.begun())
    found = noise_parts(log.controls, log.config["motion"])
    per_s = sum(
        square * float(np.mean(part.density))
        for part, square in zip(found, learned.noise.squares, strict=True)
        if part.axis == 2
    )
    row_s = float(np.median(np.diff(log.controls.stamp_s)))
    # Of some 600 links hardly a tenth of each is told: 60 of them, 9 % at one deviation of a variance's root.
    assert np.sqrt(per_s) == pytest.approx(turn * np.sqrt(row_s), rel=0.4)
    assert learned.correlation < REPEATING


@pytest.mark.slow
def test_ranges_that_are_long_are_put_right() -> None:
    log = drive(seconds=50.0)
    found = tune(
        replace(log, sightings=replace(log.sightings, range_m=1.025 * log.sightings.range_m)), UNKNOWN
    )
    scale = next(value for value in found.values if value.key == SCALE)
    # Four standard errors.
    assert scale.value == pytest.approx(1.025, abs=4 * scale.standard_error) and scale.standard_error < 0.01
    assert found.settings["sensor"]["range_scale"] == pytest.approx(scale.value, rel=1e-3)
    assert "distance_gain" not in found.settings["motion"].get("correction", {})
    assert any("does not tell which of the two" in sentence for sentence in sentences_of(found))
    assert found.alternative["sensor"]["range_scale"] == 1.0
    assert found.alternative["motion"]["correction"]["distance_gain"] == pytest.approx(scale.value, abs=1e-4)


def test_the_one_of_ranges_and_odometry_that_is_a_fact_is_not_blamed() -> None:
    known = (*motion_parameters({"model": "velocity"}), *SENSOR_KNOWN)
    for gain in (1.02, 1.06):
        values, one = gain_of(gain), np.ones(len(known))
        assert blamed(values, known, one, facts=frozenset([SCALE])) == values
        found = blamed(values, known, one, facts=frozenset([DISTANCE_GAIN]))
        assert (found[0].significant, found[2].key) == (False, SCALE)


def in_steps(log: Log) -> Log:
    """The log with odometry that goes ahead and then turns, row by row, and of which noise alone is told."""
    rows = log.controls.values[:-1] * np.diff(log.controls.stamp_s)[:, None]
    steps = np.column_stack([rows[:, 0], np.zeros(len(rows)), rows[:, 1]])
    motion = {"model": "increments", "x_std_m": 0.02, "y_std_m": 0.005, "heading_std_rad": 0.01}
    told = ("model", "range_std_m", "bearing_std_rad", "max_range_m")
    sensor = {key: log.config["sensor"][key] for key in told}
    config = {"motion": motion, "sensor": sensor}
    return replace(log, controls=Controls(log.controls.stamp_s[1:], steps), config=config)


def test_a_stated_mounting_is_kept_where_the_odometry_is_half_a_step_aside() -> None:
    log = in_steps(drive(seconds=75.0))
    half_m = 0.5 * float(np.median(log.controls.values[:, 0]))
    for mounting in ({}, {"x_m": 0.0}):
        settings = merge(UNKNOWN, {"sensor": {"mounting": mounting}} if mounting else {})
        session = _Session(log, configure(log, settings), settings, None)
        learned = session.learned_from_tracks(session.begun())
        ahead = next(value for value in learned.values if value.key == "sensor.mounting.x_m")
        assert ahead.value == pytest.approx(half_m, abs=0.06), "which is what the log says"
        assert ahead.value > 3.0 * ahead.standard_error, "and surely so"
        assert ahead.significant == (not mounting) and not ahead.contradicts
        assert ("mounting" in learned.settings["sensor"]) == (not mounting)


def test_what_the_log_clearly_contradicts_is_said(found: Tuning) -> None:
    said = "\n".join(found.conflicts)
    assert "you said sensor.delay_s = 0, the log says 0." in said
    assert "you said motion.correction.turn_gain = 1" in said and "mounting" not in said
    assert set(found.conflicts) <= set(Learning(found).warnings)


def test_whoever_watches_hears_of_every_pass(found: Tuning) -> None:
    names = [one.name for one in found.attempts]
    running = [passes[-1] for passes in REPORTS if passes[-1]["state"] == "running"]
    assert running[0]["name"].startswith("learning from") and running[0]["told"] == []
    assert set(names) <= {one["name"] for one in running}
    track = next(one for one in running if one["name"] == "from short tracks")
    turn = next(line for line in track["told"] if line.startswith("motion.correction.turn_gain 0.6"))
    assert " to " in turn and turn.endswith(", stated 1)")
    assert any(line.startswith("sensor.range_std_m ") and line.endswith(" m") for line in track["told"])
    last = REPORTS[-1]
    assert [one["name"] for one in last] == names and json.dumps(last)
    assert [one["name"] for one in last if one["state"] == "best"] == [found.best.name]
    assert {one["state"] for one in last} <= {"best", "sound", "doubted", "ended"}


def test_nothing_is_tried_twice(broken: Log, found: Tuning, monkeypatch: pytest.MonkeyPatch) -> None:
    tried: list[Hypothesis] = []

    def counted(bench: Bench, hypothesis: Hypothesis) -> float:
        tried.append(hypothesis)
        return nats_of(bench, hypothesis)

    monkeypatch.setattr(begin, "nats_of", counted)
    config = configure(broken, UNKNOWN)
    best = begin.beginning(broken, config, wide_noise(broken, config)).hypothesis
    assert len(tried) > 30 and len(set(tried)) == len(tried)
    assert best.turn_gain == TURN, "and what was tried decides"
    settings = [attempt.settings for attempt in found.attempts]
    assert len(settings) > 1
    assert not any(one == other for one, other in combinations(settings, 2))


def test_a_run_whose_map_grows_without_end_is_ended_and_not_kept(
    found: Tuning, capsys: pytest.CaptureFixture[str]
) -> None:
    stated, *others = found.attempts
    assert stated.name == "as stated" and stated.was_ended and np.isnan(found.evidence_gain)
    assert stated.judgement.landmarks > found.best.judgement.landmarks / found.best.judgement.share
    assert not found.best.was_ended and not any(one.was_ended or one.result.interrupted for one in others)
    assert [one.name for one in others] == ["from short tracks", "from the map of run 2"][: len(others)]
    # Of two runs and a part of one: all that is computed.
    steps = [len(one.result.steps.stamp_s) for one in found.attempts]
    assert steps[0] < 0.7 * steps[1] and sum(steps) < (len(others) + 0.7) * steps[1]
    # The map of the run that was ended is larger, and cannot explain more than everything.
    assert found.doubt is None
    facts = facts_of(found)
    assert facts["evidence_gain"] is None and facts["attempts"][0]["evidence"] is None
    show_tuning("log", found)
    assert "when it was ended" in " ".join(capsys.readouterr().out.split())


def test_what_speaks_against_a_map_is_looked_for_once(sound: Log, monkeypatch: pytest.MonkeyPatch) -> None:
    looked: list[RunResult] = []

    def counted(result: RunResult, log: Log) -> tuple[Doubt, ...]:
        looked.append(result)
        return doubts(result, log)

    for module in (verdict_module, judge):
        monkeypatch.setattr(module, "doubts", counted)
    found = tune(sound, UNKNOWN)
    whole = [attempt for attempt in found.attempts if not attempt.was_ended]
    assert len(looked) == len(whole) > 1
    for attempt in whole:
        assert attempt.result.doubts and attempt.result.doubts == doubts(attempt.result, sound)


def tried(name: str, judgement: Judgement, nats: float = 0.0) -> Attempt:
    return Attempt(name, {}, None, None, nats, judgement)  # type: ignore[arg-type]


@dataclass
class Widths:
    """A session whose runs under wide noise come out as told, by their width."""

    made: dict[float, Judgement]
    attempts: list[Attempt] = field(default_factory=list)
    named: bool = False

    def attempt_wide(self, learned: Learned, wider: float) -> Attempt:
        self.attempts.append(tried(f"{wider:g}", self.made[wider]))
        return self.attempts[-1]


SOUND_MAP = Judgement(None, None, 15, 0.99)
DOUBTED = Judgement(None, "there twice", 30, 0.99)


@pytest.mark.parametrize(
    ("narrow", "middle", "wide", "order", "kept"),
    [
        # Where errors last for minutes a wider noise is tried before a narrower one, and ends it if it helps.
        (DOUBTED, DOUBTED, SOUND_MAP, ["2", "3"], "3"),
        (DOUBTED, replace(DOUBTED, landmarks=20), DOUBTED, ["2", "3", "1"], "2"),
        (SOUND_MAP, DOUBTED, DOUBTED, ["2", "3", "1"], "1"),
        (DOUBTED, SOUND_MAP, SOUND_MAP, ["2", "1", "3"], "2"),
        (replace(SOUND_MAP, landmarks=12), SOUND_MAP, SOUND_MAP, ["2", "1"], "1"),
    ],
)
def test_the_middle_of_the_wide_noises_says_where_to_go_on(
    narrow: Judgement, middle: Judgement, wide: Judgement, order: list[str], kept: str
) -> None:
    session = Widths(dict(zip(WIDER, (narrow, middle, wide), strict=True)))
    learned = Learned((), {}, 900, 30, 2.0, Noise(np.ones(4), np.ones(2)))
    _widen_at_once(session, learned)  # type: ignore[arg-type]
    assert [one.name for one in session.attempts] == order
    assert _better(session.attempts).name == kept


def test_where_errors_do_not_repeat_the_narrowest_of_the_wide_noises_is_tried_first() -> None:
    session = Widths({1.0: SOUND_MAP, 2.0: replace(SOUND_MAP, landmarks=17), 3.0: DOUBTED})
    _widen(session, Learned((), {}, 900, 30, 1.0, Noise(np.ones(4), np.ones(2))))  # type: ignore[arg-type]
    assert [one.name for one in session.attempts] == ["1", "2"]
    assert _better(session.attempts).name == "1"


def test_a_map_teaches_again_where_it_became_sounder_or_simpler_and_not_just_likelier() -> None:
    sound, doubted = tried("sound", SOUND_MAP), tried("doubted", DOUBTED)
    assert _is_clearer(sound, doubted) and not _is_clearer(doubted, sound)
    assert not _is_clearer(replace(sound, evidence=1000.0), sound)
    assert _is_clearer(replace(sound, judgement=replace(SOUND_MAP, landmarks=12)), sound)


def test_learning_takes_few_steps(broken: Log, monkeypatch: pytest.MonkeyPatch) -> None:
    solved: list[Problem] = []

    def counted(problem: Problem, noise: Noise) -> Rows:
        solved.append(problem)
        return linearised(problem, noise)

    monkeypatch.setattr(learning, "linearised", counted)
    session = _Session(broken, configure(broken, UNKNOWN), UNKNOWN, None)
    session.learned_from_tracks(session.begun())
    # Three times until it settles, ITERATIONS at most each, and what is judged.
    assert 6 < len(solved) < 2 * learning.ITERATIONS


def test_rows_that_repeat_the_one_before_are_the_same_motion(sound: Log) -> None:
    values = np.repeat(sound.controls.values, 4, axis=0)
    stamp_s = np.linspace(0.0, sound.controls.stamp_s[-1], len(values))
    often = Controls(stamp_s, values)
    config = configure(sound, UNKNOWN)
    fewer = turning_points(often, config["motion"])
    assert len(fewer.stamp_s) < 0.3 * len(stamp_s) and fewer.stamp_s[-1] == stamp_s[-1]
    at_s = np.linspace(0.3, stamp_s[-1] - 0.3, 50)
    found = links(often, config, at_s)
    exact = Between(often, at_s - config["sensor"]["delay_s"]).motion(arc_twists(often, config["motion"]))
    assert np.allclose(found.motion, exact, atol=1e-10)
    poses = [DeadReckoning(rows, config["motion"]).poses_at(at_s) for rows in (often, fewer)]
    assert np.allclose(*poses, atol=1e-9)
    # What each row adds to the noise stays that of the rows as they are.
    parts = noise_parts(often, config["motion"])
    density = np.column_stack([part.density for part in parts])
    assert np.array_equal(found.share, Between(often, at_s).gathered(density))
    increments = {**config["motion"], "model": "increments"}
    assert turning_points(often, increments) is often, "the same step twice is twice as far"


def test_a_run_is_ended_only_far_beyond_the_best_one(sound: Log) -> None:
    best = run(sound, UNKNOWN)
    landmarks = int(best.steps.landmarks.max())
    watched = Growth(best, 2.0)
    same = run(sound, UNKNOWN, watch=watched)
    assert not same.interrupted and not watched.has_ended
    # Who watches changes nothing.
    assert np.array_equal(same.landmarks.mean_m, best.landmarks.mean_m)
    narrow = merge(UNKNOWN, {"sensor": {"range_std_m": 0.02, "bearing_std_rad": 0.005}})
    growth = Growth(best, 0.9)
    grown = run(sound, narrow, watch=growth)
    assert growth.has_ended and grown.interrupted
    assert landmarks / 0.9 < grown.steps.landmarks[-1] < 3 * landmarks, "it is looked at often"
    small = Growth(best, 0.1)
    assert not run(sound, narrow, watch=small).interrupted and not small.has_ended


def test_too_many_are_as_many_as_no_doubted_map_can_be_kept_with() -> None:
    best = Judgement("lost", "lost", landmarks=45, explained=0.96)
    most = int(45 / best.share)
    grown = Judgement(None, "there twice", landmarks=most + 1, explained=1.0)
    assert 45 / 0.9 < most < 2 * 45 and best.is_simpler(grown)
    assert not best.is_simpler(replace(grown, landmarks=most - 1))
    assert replace(best, explained=1.0).share == 0.9
    assert replace(best, explained=0.5).share == 0.0


def test_evidence_does_not_pay_for_new_landmarks(sound: Log) -> None:
    stated = configure(sound, UNKNOWN)
    narrow = merge(UNKNOWN, {"sensor": {"range_std_m": 0.02, "bearing_std_rad": 0.005}})
    right, too_narrow = run(sound, UNKNOWN), run(sound, narrow)
    assert len(too_narrow.landmarks.ids) > 2 * len(right.landmarks.ids)
    assert evidence(right, 10.0, stated) > evidence(too_narrow, 10.0, stated) + 100
    # Over all steps and by the run's own density it is what the filter summed.
    own = evidence(right, -1.0, configure(sound, UNKNOWN))
    assert own == pytest.approx(float(np.sum(right.steps.log_likelihood)))


def test_the_density_of_new_landmarks_is_that_of_the_gate() -> None:
    config = Config.resolve({"sensor": {"range_std_m": 0.1, "bearing_std_rad": 0.02}})
    # Two dimensions: exp(-d2 / 2) is one minus the gate; the covariance is twice the sensor's.
    expected = 1e-5 / (2 * np.pi * 2 * 0.1 * 0.02)
    assert np.exp(log_new_density(config)) == pytest.approx(expected, rel=1e-9)
    told = merge(config, {"association": {"new_landmark_density": 0.3, "clutter_density": 0.2}})
    assert np.exp(log_new_density(told)) == pytest.approx(0.5)


def test_draws_follow_the_rows_as_far_as_the_solution_does(sound: Log) -> None:
    session = _Session(sound, configure(sound, UNKNOWN), UNKNOWN, None)
    problem, noise = session.problem_from_tracks()
    assert np.sum(problem.prior_std > 0) == 8
    solver = linearised(problem, noise).solver
    generator = np.random.default_rng(1)
    times = 100
    shares = np.mean([solver.followed(generator) for _ in range(times)], axis=0)
    rows = np.linspace(0, len(shares) - 1, 40).astype(int)
    unknowns = 3 * len(problem.batch.poses) + 2 * len(problem.batch.landmarks_m)
    units = np.eye(len(shares), len(shares) + unknowns + len(solver.covariance))
    exact = np.array([-solver._core.response(units[row])[row] for row in rows])
    assert np.all(exact > 0) and np.all(exact < 1) and np.ptp(exact) > 0.1
    # The standard error of a variance from n draws is its root of 2 / n. Four of them: a false alarm in 400.
    assert np.all(np.abs(shares[rows] / exact - 1) < 4 * np.sqrt(2 / (times * DRAWS)))


@pytest.mark.parametrize("lasting", [False, True])
def test_errors_that_last_leave_parameters_less_sure(sound: Log, lasting: bool) -> None:
    """A bias of ranges that changes from tenth to tenth of the log, or none."""
    log = sound
    if lasting:
        seen = log.sightings
        tenth = (seen.stamp_s - seen.stamp_s[0]) / np.ptp(seen.stamp_s) * BLOCKS
        bias_m = 0.3 * np.where(tenth.astype(int) % 2, 1.0, -1.0)
        log = replace(log, sightings=replace(seen, range_m=seen.range_m + bias_m))
    session = _Session(log, configure(log, UNKNOWN), UNKNOWN, None)
    problem, noise = session.problem_from_tracks()
    rows = linearised(problem, noise)
    problem = moved_by(problem, *rows.solver.step())
    rows = linearised(problem, noise)
    repeats = _repeats(problem, rows, rows.solver.followed(np.random.default_rng(0)))
    bias = [one.key for one in (*motion_parameters(session.config["motion"]), *SENSOR_KNOWN)].index(BIAS)
    # Of noise that is told too large by half or more stretches disagree by less than rows would.
    assert (repeats[bias] > 1.5) == lasting
    assert problem.weighed_std[bias] == problem.prior_std[bias]
    assert replace(problem, repeats=repeats).weighed_std[bias] == problem.prior_std[bias] / repeats[bias]


def test_under_a_wide_noise_what_it_covers_is_as_stated() -> None:
    turn = "motion.correction.turn_gain"
    values = tuple(Value(key, "", 1.0, 1.2, 0.01) for key in (turn, "sensor.delay_s", BIAS, DISTANCE_GAIN))
    settings = merge(*(nested(value.key, 1.2) for value in values), {"sensor": {"range_std_m": 0.3}})
    learned = Learned(values, settings, 900, 30, 2.0, Noise(np.ones(4), np.ones(2)))
    left = of_turns_and_delay(learned)
    assert left.values == values[:2]
    assert left.settings == {
        "motion": {"correction": {"turn_gain": 1.2}},
        "sensor": {"delay_s": 1.2},
    }


def test_a_doubted_map_gives_way_to_a_far_simpler_one_and_a_sound_one_only_to_one_that_explains_as_much() -> (
    None
):
    small = Judgement(None, "there twice", landmarks=25, explained=0.965)
    doubted = Judgement(None, "there twice", landmarks=93, explained=0.994)
    sound = replace(doubted, doubt=None)
    assert small.is_simpler(doubted) and not doubted.is_simpler(small)
    assert not small.is_simpler(sound) and replace(small, explained=0.98).is_simpler(sound)
    assert not replace(small, explained=0.84).is_simpler(doubted)
    assert not small.explains_as_much_as(doubted)
    assert not replace(small, landmarks=84, explained=0.994).is_simpler(doubted)


def test_that_a_log_corrects_nothing_is_no_statement_and_what_a_user_says_is() -> None:
    nothing = {
        "motion": {"correction": {"distance_gain": 1.0, "turn_gain": 1.0}},
        "sensor": {"delay_s": 0.0, "range_scale": 1.0, "mounting": {"x_m": 0.0}},
    }
    assert facts_told(nothing, {}) == {"sensor.mounting.x_m"}
    said = merge(nothing, {"sensor": {"delay_s": 0.2, "range_scale": 0.99}})
    assert facts_told(said, {}) == {"sensor.mounting.x_m", "sensor.delay_s", "sensor.range_scale"}
    assert facts_told({}, nothing) == facts_in(nothing)


def test_of_sound_maps_each_simpler_than_the_last_none_is_kept_that_explains_less_than_the_first(
    sound: Log,
) -> None:
    result = run(sound, UNKNOWN)

    def attempt(landmarks: int, explained: float, doubt: str | None = None) -> Attempt:
        judgement = Judgement(None, doubt, landmarks, explained)
        return Attempt(str(landmarks), {}, None, result, 0.0, judgement)

    maps = [attempt(18, 0.999), attempt(15, 0.985), attempt(13, 0.970), attempt(11, 0.965)]
    assert _better(maps).name == "15"
    assert _better(maps[1:]).name == "13"
    # A doubted map explains what it likes.
    assert _better([attempt(40, 1.0, "there twice"), *maps[2:]]).name == "11"


def test_the_tail_likelihood_is_highest_at_the_true_degrees_of_freedom() -> None:
    generator = np.random.default_rng(2)
    normal = generator.normal(size=(4000, 2))
    heavy = normal / np.sqrt(generator.chisquare(4.0, size=4000) / 4.0)[:, None]
    likelihoods = {tail: _log_likelihood(np.sum(heavy**2, axis=1), tail) for tail in (None, 3.0, 4.0, 7.0)}
    assert max(likelihoods, key=lambda tail: likelihoods[tail]) == 4.0


def test_a_lost_run_is_refused_and_a_map_that_is_bent_or_there_twice_not_preferred(
    sound: Log, broken: Log
) -> None:
    result = run(sound, UNKNOWN)
    good = judged(result, sound, result.config)
    assert good.rank == SOUND and good.explained > 0.98
    doubled = replace(
        result.landmarks,
        ids=(*result.landmarks.ids, *(f"{name}b" for name in result.landmarks.ids)),
        mean_m=np.vstack([result.landmarks.mean_m, result.landmarks.mean_m + 0.05]),
        covariance_m2=np.tile(result.landmarks.covariance_m2, (2, 1, 1)),
        sightings=np.tile(result.landmarks.sightings, 2),
        confirmed=None,
    )
    twice = judged(replace(result, landmarks=doubled), sound, result.config)
    assert good.is_simpler(twice) and not twice.is_simpler(good)
    half = replace(
        result.landmarks,
        **{
            name: getattr(result.landmarks, name)[::2]
            for name in ("ids", "mean_m", "covariance_m2", "sightings")
        },
        confirmed=None,
    )
    assert not judged(replace(result, landmarks=half), sound, result.config).is_simpler(good)
    lost = replace(result.steps, health=np.full_like(result.steps.health, 3))
    assert "lost" in (judged(replace(result, steps=lost), sound, result.config).fault or "")
    bent = run(broken, UNKNOWN)
    assert good.is_simpler(judged(bent, broken, bent.config))


def test_noise_that_no_filter_survives_is_refused_with_the_reason(sound: Log) -> None:
    rng = np.random.default_rng(0)
    bearings = rng.uniform(-np.pi, np.pi, size=len(sound.sightings.stamp_s))
    nonsense = replace(sound, sightings=replace(sound.sightings, bearing_rad=bearings))
    with pytest.raises(DataError, match=r"learned|things seen again"):
        tune(nonsense, UNKNOWN)
    few = replace(sound, sightings=replace(sound.sightings, range_m=0 * sound.sightings.range_m))
    with pytest.raises(DataError, match="things seen again"):
        tune(few, UNKNOWN)


def test_a_delay_in_the_settings_moves_the_sightings(sound: Log) -> None:
    late = replace(sound, sightings=replace(sound.sightings, stamp_s=sound.sightings.stamp_s + 0.25))
    settings = merge(UNKNOWN, {"sensor": {"delay_s": 0.25}})
    told, exact = run(late, settings), run(sound, UNKNOWN)
    assert np.allclose(told.landmarks.mean_m, exact.landmarks.mean_m, atol=1e-6)
    simulated = simulate(resolve_simulation({"seed": 5, "sensor": {"delay_s": 0.25}}, preset="demo"))
    plain = simulate(resolve_simulation({"seed": 5}, preset="demo"))
    assert np.allclose(simulated.sightings.stamp_s - plain.sightings.stamp_s, 0.25)


def test_wide_noise_knows_the_scale_of_the_sensor(sound: Log) -> None:
    near = replace(sound, sightings=replace(sound.sightings, range_m=0.1 * sound.sightings.range_m))
    config = Config.resolve({"sensor": {"range_std_m": 1e-3}})
    assert wide_noise(near, config)[0] == pytest.approx(0.1 * wide_noise(sound, config)[0])


def test_the_command_writes_settings_that_a_run_takes(broken: Log, tmp_path: Path) -> None:
    folder, settings = tmp_path / "log", tmp_path / "found.yaml"
    write_native(broken, folder)
    arguments = ["--set", "association.mode=unknown", "--set", "filter.particles=20", "--out", str(settings)]
    printed = fastslam("tune", str(folder), *arguments, "--json")
    assert printed.exit_code == 0, printed.stderr
    facts = json.loads(printed.stdout)
    assert facts["settings"] == load_config(settings)
    assert facts["attempts"][1]["evidence"] > 100 and len(facts["attempts"]) >= 2
    # A run that tunes by itself leaves what it learned, and is the run with what was found.
    given = ["--auto", *arguments[:4], "--no-report", "--json", "--out", str(tmp_path / "run")]
    ran = fastslam("run", str(folder), *given)
    assert ran.exit_code == 0, ran.stderr
    learned = json.loads((tmp_path / "run" / "learned.json").read_text())
    assert learned["settings"] == facts["settings"]
    used = load_config(tmp_path / "run" / "config.yaml")
    assert (
        used["motion"]["correction"]["turn_gain"] == learned["settings"]["motion"]["correction"]["turn_gain"]
    )


def test_the_table_names_what_was_found_and_what_the_log_does_not_tell(
    found: Tuning, capsys: pytest.CaptureFixture[str]
) -> None:
    hidden = replace(found.values[0], observable=False)
    show_tuning("log", replace(found, values=(hidden, *found.values[1:])))
    printed = capsys.readouterr()
    assert "motion.correction.turn_gain" in printed.out and "from short tracks" in printed.out
    assert "kept: not told" in printed.out and f"does not tell {hidden.key}" in printed.err

"""A run of a log that states no noise learns it first; who states it is left alone."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import fastslam
import numpy as np
import pytest
import yaml
from cli_runner import fastslam as command
from fastslam.automatic import is_learning_due, learned_first, sounder_than, unstated_noise
from fastslam.config import merge
from fastslam.datasets import write_native
from fastslam.evaluation import evaluate
from fastslam.log import Log
from fastslam.simulation import resolve_simulation, simulate
from fastslam.tuning.session import MOST_RUNS, REPEATING
from faults import with_swapped_wheels
from small_log import write_small_log

NOISE = {"sensor": {"range_std_m": 0.3, "bearing_std_rad": 0.01}}
WORLD: dict[str, Any] = {"seed": 7, "max_duration_s": 40.0, **NOISE}
FEW = {"filter": {"particles": 20}, "association": {"mode": "unknown"}}


def untold(log: Log) -> Log:
    """The log with no word of its noise."""
    sensor = {key: value for key, value in log.config["sensor"].items() if "_std_" not in key}
    motion = {key: value for key, value in log.config["motion"].items() if "_std_" not in key}
    return replace(log, config={**log.config, "sensor": sensor, "motion": {"model": motion["model"]}})


@pytest.fixture(scope="module")
def silent() -> Log:
    return untold(simulate(WORLD))


def test_noise_is_stated_by_the_log_by_settings_or_by_the_rows(silent: Log) -> None:
    assert unstated_noise(simulate(WORLD)) == ()
    assert unstated_noise(silent) == ("motion", "sensor")
    assert unstated_noise(silent, {"sensor": {"range_std_m": 0.2}}) == ("motion",)
    proportional = {"motion": {"proportional": {"distance_std_m_per_sqrt_m": 0.1}}}
    assert unstated_noise(silent, proportional) == ("sensor",)
    assert unstated_noise(silent, {"motion": {"correction": {"turn_gain": 1.1}}}) == ("motion", "sensor")
    assert not is_learning_due(silent, {"algorithm": "ekf"})
    assert is_learning_due(silent)


def test_what_nobody_stated_is_found(silent: Log) -> None:
    result = fastslam.run(silent, FEW)
    assert result.config["sensor"]["range_std_m"] == pytest.approx(0.3, rel=0.25)
    assert result.config["sensor"]["bearing_std_rad"] == pytest.approx(0.01, rel=0.25)
    stated = fastslam.run(silent, FEW, auto=False)
    assert stated.config["sensor"]["range_std_m"] == pytest.approx(0.1)
    assert stated.log_evidence != result.log_evidence


def lasting(seed: int) -> Log:
    """A log of 25 trees whose ranges and bearings wander by 0.4 m and 0.06 rad, each tree's by itself."""
    preset = resolve_simulation({"seed": seed, "max_duration_s": 60.0, "world": {"count": 25}}, preset="demo")
    log = untold(simulate(preset))
    seen, random = log.sightings, np.random.default_rng(seed)
    phase = random.uniform(0.0, 2 * np.pi, (int(seen.identity.max()) + 1, 2))[seen.identity]
    swing = np.sin(2 * np.pi * seen.stamp_s[:, None] / 20.0 + phase)
    range_m = np.maximum(seen.range_m + 0.4 * swing[:, 0], 0.1)
    bearing_rad = seen.bearing_rad + 0.06 * swing[:, 1]
    unnamed = np.full(len(phase), -1, dtype=np.int64)
    return replace(log, sightings=replace(seen, range_m=range_m, bearing_rad=bearing_rad, identity=unnamed))


def test_where_errors_last_wide_noise_is_tried_and_what_is_stated_while_it_may_win() -> None:
    settings = {"association": {"mode": "unknown"}, "filter": {"particles": 30}}
    found = fastslam.tune(lasting(3), settings)
    stated, *others = found.attempts
    assert all(attempt.learned.correlation > REPEATING for attempt in others if attempt.learned is not None)
    assert stated.name == "as stated" and stated.was_ended and all(attempt.wider for attempt in others)
    whole = len(found.result.steps.stamp_s)
    steps = [len(attempt.result.steps.stamp_s) for attempt in found.attempts]
    assert steps[0] < 0.7 * whole and sum(steps) < 4 * whole


def test_errors_that_last_do_not_double_the_map() -> None:
    log, settings = lasting(3), {"association": {"mode": "unknown"}, "filter": {"particles": 30}}
    plain, result = fastslam.run(log, settings, auto=False), fastslam.run(log, settings)
    assert len(plain.landmarks.ids) > 50 and plain.verdict
    assert 24 <= len(result.landmarks.ids) <= 26
    assert evaluate(result, log)["landmark_precision"] > 0.9


@pytest.mark.parametrize("runs", [0.5, 1.5], ids=["in the first run", "in the second"])
def test_who_stops_the_learning_keeps_the_best_run_until_then(silent: Log, runs: float) -> None:
    def stop(done: int, total: int) -> None:
        if done * MOST_RUNS > runs * total:
            raise KeyboardInterrupt

    # As many particles as make a run last for a few calls of the progress.
    settings = merge(FEW, {"filter": {"particles": 200}})
    result = fastslam.run(silent, settings, progress=stop)
    assert result.interrupted and not result.warnings
    whole = fastslam.run(silent, settings, auto=False)
    # A fast machine may be through with a run before it is first asked.
    assert len(result.steps.stamp_s) <= len(whole.steps.stamp_s)
    assert runs < 1 or len(result.steps.stamp_s) == len(whole.steps.stamp_s)
    with pytest.raises(KeyboardInterrupt):
        fastslam.tune(silent, settings, progress=stop)


def test_a_log_that_tells_nothing_is_run_as_it_is_with_a_word(tmp_path: Path) -> None:
    log = fastslam.load(write_small_log(tmp_path / "log", steps=30))
    assert is_learning_due(log)
    assert learned_first(log).found is None
    result = fastslam.run(log, {"filter": {"particles": 20}})
    assert result.warnings[0].startswith("the log does not tell its noise (")
    assert result.landmarks.mean_m.shape[0] > 0


def test_the_command_says_what_it_found_and_leaves_it(tmp_path: Path) -> None:
    folder, out = tmp_path / "log", tmp_path / "out"
    simulated = ["--seed", "7", "--set", "max_duration_s=40", "--set", "sensor.range_std_m=0.3"]
    assert command("simulate", str(folder), *simulated).exit_code == 0
    stated = yaml.safe_load((folder / "log.yaml").read_text())
    for section in ("motion", "sensor"):
        stated[section] = {key: value for key, value in stated[section].items() if "_std_" not in key}
    (folder / "log.yaml").write_text(yaml.safe_dump(stated))
    given = ["--particles", "20", "--no-report", "--out", str(out)]
    answer = command("run", str(folder), *given)
    assert answer.exit_code == 0
    assert "not all of the noise is stated: learned from the log" in answer.stderr
    learned = json.loads((out / "learned.json").read_text())
    assert learned["settings"]["sensor"]["range_std_m"] == pytest.approx(0.3, rel=0.25)
    plain = command("run", str(folder), "--no-auto", *given[:-1], str(tmp_path / "plain"))
    assert "not all of the noise" not in plain.stderr
    assert not (tmp_path / "plain" / "learned.json").exists()


@pytest.fixture(scope="module")
def doubling() -> Log:
    """A log whose noise is stated, and whose odometry turns one and a half times as far as the robot."""
    preset = resolve_simulation({"seed": 6, "max_duration_s": 60.0}, preset="demo")
    log = simulate(preset)
    seen = log.sightings
    unnamed = replace(seen, identity=np.full(len(seen.stamp_s), -1, dtype=np.int64))
    turning = log.controls.values / np.array([1.0, 0.65])
    return replace(log, sightings=unnamed, controls=replace(log.controls, values=turning))


def interrupt() -> None:
    raise KeyboardInterrupt


def test_a_doubted_map_gives_way_to_a_sound_one_that_the_log_teaches(doubling: Log) -> None:
    assert not is_learning_due(doubling, FEW)
    plain = fastslam.run(doubling, FEW, auto=False)
    assert len(plain.landmarks.ids) > 100 and plain.verdict
    assert sounder_than(plain, doubling, FEW, on_doubt=interrupt) is None, "what there is stays"
    result = fastslam.run(doubling, FEW)
    assert 57 <= len(result.landmarks.ids) <= 61 and not result.verdict
    assert result.config["motion"]["correction"]["turn_gain"] == pytest.approx(0.65, abs=0.02)
    assert result.warnings[0].startswith("with the settings as they are the map is doubted (")
    assert "motion.correction.turn_gain 0.6" in result.warnings[0]


@pytest.mark.slow
def test_no_noise_makes_a_robot_right_whose_wheels_are_swapped_on_the_way() -> None:
    # After the stretch that teaches: before its end the log itself tells of such wheels, and of their noise.
    log = with_swapped_wheels(simulate(resolve_simulation({"seed": 3}, preset="demo")), at_s=45.0)
    for asked in (log, untold(log)):
        result = fastslam.run(asked, {**FEW, "filter": {"particles": 50}})
        assert evaluate(result, log)["landmark_precision"] < 0.5
        assert result.verdict, "a wrong map is told"


def test_a_map_that_nothing_speaks_against_is_left_alone(doubling: Log) -> None:
    right = replace(
        doubling,
        controls=replace(doubling.controls, values=doubling.controls.values * np.array([1.0, 0.65])),
    )
    result = fastslam.run(right, FEW)
    assert sounder_than(result, right, FEW) is None
    np.testing.assert_array_equal(
        result.landmarks.mean_m, fastslam.run(right, FEW, auto=False).landmarks.mean_m
    )


@pytest.mark.slow
def test_the_command_keeps_the_sound_map_and_says_why(doubling: Log, tmp_path: Path) -> None:
    folder, out = tmp_path / "log", tmp_path / "out"
    write_native(doubling, folder)
    given = [
        str(folder),
        "--association",
        "unknown",
        "--particles",
        "20",
        "--no-report",
        "--json",
        "--out",
        str(out),
    ]
    answer = command("run", *given)
    assert answer.exit_code == 0
    facts = json.loads(answer.stdout)
    assert facts["verdict"] == [] and "turn_gain" in facts["warnings"][0]
    assert json.loads((out / "learned.json").read_text())["settings"]

"""What a run comes to is said: nothing mapped or seen twice, sightings dropped, names that cannot be."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import fastslam
import numpy as np
import pytest
from cli_runner import Outcome
from cli_runner import fastslam as command
from fabricate import make_run
from fastslam import FastSlam
from fastslam.datasets import load, write_native
from fastslam.errors import ConfigError
from fastslam.evaluation import evaluate
from fastslam.health import has_reason
from fastslam.log import Log
from fastslam.resultfiles import read_result, write_result
from fastslam.simulation import resolve_simulation, simulate
from fastslam.verdict import in_one_line, is_believable, named_twice, verdict, warnings_of


def demo(**settings: object) -> Log:
    return simulate(resolve_simulation({"seed": 3, "max_duration_s": 40.0, **settings}, preset="demo"))


def with_ranges(log: Log, factor: float, chosen: slice = slice(None)) -> Log:
    range_m = log.sightings.range_m.copy()
    range_m[chosen] *= factor
    return replace(log, sightings=replace(log.sightings, range_m=range_m))


@pytest.mark.parametrize(
    ("factor", "unit"), [(1e3, "millimetres"), (1e2, "centimetres"), (1 / 0.3048, "feet"), (1e7, None)]
)
def test_ranges_in_another_unit_are_asked_about(factor: float, unit: str | None) -> None:
    verdict = fastslam.run(with_ranges(demo(), factor), {"filter": {"particles": 10}}).verdict
    assert len(verdict) == 1 and "lie beyond sensor.max_range_m" in verdict[0]
    assert (f"({unit}?)" in verdict[0]) == (unit is not None) and ("?" in verdict[0]) == (unit is not None)


def test_more_than_a_hundredth_dropped_is_a_line() -> None:
    log = demo()
    total = len(log.sightings.stamp_s)
    for share, lines in ((0.005, 0), (0.02, 1)):
        result = fastslam.run(with_ranges(log, 100.0, slice(0, int(share * total))))
        assert len(result.verdict) == lines, result.verdict
    assert result.verdict[0].startswith(f"{int(0.02 * total):,} of {total:,} sightings lie beyond")
    assert result.verdict[0].endswith("and were left out")


@pytest.mark.slow(but="2")
@pytest.mark.parametrize("seed", [2, 3])
def test_a_field_that_was_mapped_twice_is_said_and_one_mapped_once_is_not(seed: int) -> None:
    """Three laps with a sensor of 120 degrees: the plain filter maps all twice, the default once."""
    sensor = {"field_of_view_rad": float(np.radians(120.0))}
    log = simulate(
        resolve_simulation({"seed": seed}, {"trajectory": {"laps": 3}, "sensor": sensor}, preset="loop")
    )
    for every_steps, twice in ((0, True), (None, False)):
        settings = {"seed": seed, "association": {"mode": "unknown"}}
        settings |= {"filter": {"rejuvenation": {"every_steps": every_steps}}}
        result = fastslam.run(log, settings, auto=False)
        found = evaluate(result, log)
        assert (found["landmarks"] > 1.5 * found["landmark_matched"]) == twice
        said = [line for line in result.verdict if "to which the robot came back" in line]
        assert len(said) == twice and result.counts["landmarks_visited_again"] > 50
        assert has_reason(result.steps.health_reasons, "not_found_again").any() == twice
        if twice:
            assert said[0].endswith("without filter.rejuvenation.every_steps = 0 such loops are closed")


def test_nothing_seen_twice_is_said() -> None:
    log = demo()
    first = np.unique(log.sightings.identity, return_index=True)[1]
    first.sort()
    once = replace(
        log,
        sightings=replace(
            log.sightings,
            **{
                name: getattr(log.sightings, name)[first]
                for name in ("stamp_s", "range_m", "bearing_rad", "identity", "class_index", "signature")
            },
        ),
    )
    result = fastslam.run(once)
    assert len(result.landmarks.ids) == len(first)
    assert len(result.verdict) == 1 and result.verdict[0].startswith("no landmark was seen twice")


def test_a_log_without_usable_sightings_fails_after_its_results_are_written(tmp_path: Path) -> None:
    assert command("simulate", str(tmp_path / "log"), "--preset", "demo").exit_code == 0
    out = tmp_path / "out"
    outcome = command("run", str(tmp_path / "log"), "--out", str(out), "--set", "sensor.max_range_m=0.1")
    assert outcome.exit_code == 1 and "nothing was mapped" in outcome.stderr
    assert json.loads((out / "run.json").read_text())["verdict"] and (out / "report.html").is_file()


def test_the_verdict_comes_back_from_the_folder(tmp_path: Path) -> None:
    log = with_ranges(demo(), 1e3)
    result = fastslam.run(log, {"filter": {"particles": 10}})
    write_result(result, log, tmp_path)
    assert read_result(tmp_path).verdict == result.verdict and result.verdict
    facts = json.loads((tmp_path / "run.json").read_text())
    del facts["verdict"]
    (tmp_path / "run.json").write_text(json.dumps(facts))
    assert read_result(tmp_path).verdict == ()


def test_a_name_twice_in_a_scan_is_counted_and_reported() -> None:
    log = demo()
    assert named_twice(log.sightings) == 0
    assert fastslam.run(log).counts["sightings_named_twice_in_a_scan"] == 0
    stamps, identity = log.sightings.stamp_s, log.sightings.identity.copy()
    again = np.flatnonzero(np.diff(stamps) == 0)[::20]
    identity[again + 1] = identity[again]
    twice = replace(log, sightings=replace(log.sightings, identity=identity))
    found = fastslam.run(twice)
    assert found.counts["sightings_named_twice_in_a_scan"] == named_twice(twice.sightings) > 0
    assert any("name a landmark that another one of their scan names" in text for text in found.verdict)


@pytest.mark.parametrize("algorithm", ["fastslam1", "fastslam2", "ekf"])
@pytest.mark.parametrize("seed", [2, 9])
def test_a_landmark_founded_by_a_misread_moves_to_its_place(algorithm: str, seed: int) -> None:
    log = simulate(resolve_simulation({"seed": seed}, preset="demo"))
    names, first = np.unique(log.sightings.identity, return_index=True)
    identity = log.sightings.identity.copy()
    # Long before some landmarks come, sightings of others are said to be theirs.
    late = names[np.argsort(first)][-8:]
    taken = np.arange(150, 400, 30)[: len(late)]
    assert len(taken) == len(late) and np.sort(first)[-8] > taken.max()
    identity[taken] = late
    misread = replace(log, sightings=replace(log.sightings, identity=identity))
    result = fastslam.run(misread, {"seed": 1, "algorithm": algorithm})
    clean = fastslam.run(log, {"seed": 1, "algorithm": algorithm})
    assert sorted(result.landmarks.ids) == sorted(clean.landmarks.ids)
    assert evaluate(result, log)["landmark_rmse_m"] < 2.0 * evaluate(clean, log)["landmark_rmse_m"]


def test_a_robot_that_was_carried_away_is_not_blamed_on_the_names() -> None:
    robot = FastSlam({"filter": {"particles": 30}}, identities="all")
    places = np.array([[4.0, 1.0], [4.5, -2.5], [3.0, 5.0], [-3.0, 6.0]])

    def seen_from(x: float, y: float, heading: float) -> dict[str, Any]:
        dx, dy = (places - [x, y]).T
        bearing = (np.arctan2(dy, dx) - heading + np.pi) % (2 * np.pi) - np.pi
        return {"range_m": np.hypot(dx, dy), "bearing_rad": bearing, "identity": ["a", "b", "c", "d"]}

    for _ in range(15):
        robot.step([0.0, 0.0], dt_s=0.2, **seen_from(0.0, 0.0, 0.0))
    carried = seen_from(-2.0, 3.0, 1.5)
    info = robot.step([0.0, 0.0], dt_s=0.2, **carried)
    assert info.ignored == 0 and info.matched == 4
    carried["range_m"][3] = 90.0
    one = robot.step([0.0, 0.0], dt_s=0.2, **carried)
    assert one.sightings + one.skipped + one.ignored == 4


@pytest.mark.parametrize(
    "word", [None, -1, "-1", "nan", "NaN", float("nan"), "None", "null", "UNKNOWN", "", " none "]
)
def test_words_for_nobody_knows_are_no_names(word: object) -> None:
    robot = FastSlam({"filter": {"particles": 5}})
    robot.update(0.0, range_m=[2.0, 3.0], bearing_rad=[0.5, -0.4], identity=[word, "oak"])  # type: ignore[list-item]
    assert sorted(robot.landmarks.ids) == ["L0", "oak"] or sorted(robot.landmarks.ids) == ["L1", "oak"]


@pytest.mark.parametrize("word", ["-1", "nan", "NaN", "None", "null", "Unknown", ""])
def test_words_for_nobody_knows_are_no_names_in_files(word: str, tmp_path: Path) -> None:
    (tmp_path / "log.yaml").write_text(
        "format_version: 1\nmotion: {model: velocity}\nsensor: {model: range_bearing}\n"
    )
    (tmp_path / "odometry.csv").write_text("stamp_s,speed_m_per_s,yaw_rate_rad_per_s\n0,1,0\n1,1,0\n")
    rows = f"stamp_s,range_m,bearing_rad,landmark_id\n0,2,0.1,oak\n0.5,2,0.2,{word}\n1,3,0.1,elm\n"
    (tmp_path / "sightings.csv").write_text(rows)
    log = load(tmp_path)
    assert log.identity_names == ("oak", "elm") and log.sightings.identity.tolist() == [0, -1, 1]


@pytest.mark.parametrize(("period_s", "duration_s"), [(5.0, 600.0), (1.0, 240.0), (0.2, 120.0), (0.02, 30.0)])
@pytest.mark.parametrize("algorithm", ["fastslam1", "fastslam2"])
def test_the_watch_looks_at_scans_at_every_rate(period_s: float, duration_s: float, algorithm: str) -> None:
    """0.2, 1, 5 and 50 scans a second: wrong noise is noticed, right noise is not complained about."""
    settings = {
        "seed": 4,
        "scan": {"period_s": period_s},
        "control_period_s": min(0.1, period_s),
        "motion": {"speed_std_m_per_s": 0.05, "yaw_rate_std_rad_per_s": 0.01},
        "trajectory": {"laps": 20},
        "max_duration_s": duration_s,
    }
    log = simulate(resolve_simulation(settings))
    scans = len(np.unique(log.sightings.stamp_s))
    base = {"algorithm": algorithm, "seed": 1, "filter": {"particles": 50}}
    right = fastslam.run(log, base)
    # Every scan where they are more than 0.75 s apart, every fourth where they are dense.
    wanted = scans if period_s >= 0.75 else scans / 4
    assert 0.9 * wanted <= right.noise["scans"] <= wanted + 1
    assert warnings_of(right) == () and 1.6 < right.noise["nis"] < 2.4
    wrong = fastslam.run(log, {**base, "sensor": {"range_std_m": 0.03}}, auto=False)
    assert any("sensor.range_std_m" in text and "raise" in text for text in wrong.warnings), wrong.warnings


def test_keys_of_earlier_versions_say_what_they_are_called_now(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"health\.window_steps: is called health\.window_scans now"):
        FastSlam({"health": {"window_steps": 20}})
    (tmp_path / "old.yaml").write_text("health:\n  window_steps: 20\n")
    outcome = command("run", "--config", str(tmp_path / "old.yaml"), str(tmp_path))
    assert outcome.exit_code == 2 and "old.yaml:2: health.window_steps: is called" in outcome.stderr


def test_landmarks_that_are_no_numbers_are_told() -> None:
    log = demo()
    result = fastslam.run(log, {"filter": {"particles": 5}})
    assert verdict(result, log) == ()
    mean_m = result.landmarks.mean_m.copy()
    mean_m[1, 0] = np.nan
    (told,) = verdict(replace(result, landmarks=replace(result.landmarks, mean_m=mean_m)), log)
    assert told.startswith(f"1 of {len(mean_m)} landmarks stand at no place that can be computed with")


@pytest.mark.parametrize("seed", [1, 4, 7])
@pytest.mark.parametrize("share", [0.0, 0.03])
def test_neither_drift_nor_misread_names_nor_both_ruin_a_map(seed: int, share: float) -> None:
    """One name of 33 says anything: the robot drifts by metres before it sees the first landmarks again."""
    laps = {"trajectory": {"laps": 3}, "sensor": {"field_of_view_rad": 2.83}}
    log = simulate(resolve_simulation({"seed": seed}, laps, preset="loop"))
    rng, identity = np.random.default_rng(seed), log.sightings.identity.copy()
    wrong = rng.random(len(identity)) < share
    identity[wrong] = rng.integers(0, identity.max() + 1, wrong.sum())
    misread = replace(log, sightings=replace(log.sightings, identity=identity))
    result = fastslam.run(misread, {"seed": seed})
    metrics = evaluate(result, log)
    # With every name right and draws by a schedule it is 0.05 to 0.11 m; without draws 0.4 to 1.3 m.
    assert metrics["smoothed_ate_rmse_m"] < 0.25 and metrics["ate_rmse_m"] < 2.0
    assert (result.steps.ignored.sum() > 0.5 * wrong.sum()) if share else result.verdict == ()
    # A landmark that only misread names have shown lies anywhere.
    often = result.landmarks.sightings >= 5
    true = dict(zip(log.truth_landmarks.names, log.truth_landmarks.position_m, strict=True))
    at = np.array([true[name] for name in result.landmarks.ids])
    off = np.linalg.norm(result.landmarks.mean_m - at, axis=1)[often]
    # In the frame that the robot began in, of which nobody knows more than the first sightings say.
    assert often.sum() > 100 and np.sqrt(np.mean(off**2)) < 1.0


def test_a_run_is_always_told_in_one_line() -> None:
    run = make_run()
    assert in_one_line(run) == "believable: no check speaks against the run" and is_believable(run)
    assert in_one_line(replace(run, warnings=("a", "b"))) == "believable, with 2 warnings"
    doubted = replace(run, verdict=("a",), warnings=("b",))
    assert in_one_line(doubted) == "not believable: 1 check speaks against map or path"
    assert is_believable(doubted) is False
    stopped = replace(run, interrupted=True)
    assert in_one_line(stopped) == "undecided: the run was stopped early" and is_believable(stopped) is None
    steps = replace(run.steps, health=np.zeros_like(run.steps.health))
    unjudged = replace(run, steps=steps)
    assert in_one_line(unjudged).startswith("undecided: too little") and is_believable(unjudged) is None


def lost_on_the_way(folder: Path) -> None:
    """A log whose robot is turned by 1 rad half-way, which its odometry does not say."""
    log = demo()
    half_s = float(np.median(log.sightings.stamp_s))
    turned = log.sightings.bearing_rad - np.where(log.sightings.stamp_s > half_s, 1.0, 0.0)
    bearing_rad = (turned + np.pi) % (2.0 * np.pi) - np.pi
    write_native(replace(log, sightings=replace(log.sightings, bearing_rad=bearing_rad)), folder)


def test_a_script_can_tell_a_run_that_is_not_to_be_believed(tmp_path: Path) -> None:
    lost_on_the_way(tmp_path / "turned")
    write_native(demo(), tmp_path / "sound")

    def run(log: str, *options: str) -> Outcome:
        out = tmp_path / f"{log}-{len(options)}"
        given = ("--no-auto", "--no-report", "--out", out, "--particles", "20")
        return command("run", tmp_path / log, *given, *options)

    told = run("turned", "--json")
    facts = json.loads(told.stdout)
    assert told.exit_code == 0 and facts["verdict"] and not facts["believable"], "without --strict as ever"
    strict = run("turned", "--json", "--strict")
    assert strict.exit_code == 1 and json.loads(strict.stdout)["verdict"], (
        "the numbers are there all the same"
    )
    assert strict.stderr.splitlines()[-1] == "error: the verdict speaks against this run (--strict)"
    several = run("turned", "--strict", "--runs", "2")
    assert several.exit_code == 1 and "speaks against 2 of 2 runs" in several.stderr
    sound = run("sound", "--strict")
    assert sound.exit_code == 0
    assert "\nverdict: believable: no check speaks against the run\n" in sound.stdout
    assert "\nverdict: believable:" in command("eval", tmp_path / "sound-1").stdout
    assert run("sound", "--strict", "--runs", "2").exit_code == 0

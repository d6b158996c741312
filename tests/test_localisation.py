"""Robots that find themselves in a map."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cli_runner import fastslam
from fastslam import Anywhere, Log, Map, Start, localize, run
from fastslam.datasets.native_write import write_native
from fastslam.localisation import between, find
from fastslam.placement import Constellation, View, odds_of, placements
from fastslam.simulation import simulate

UNKNOWN: dict[str, Any] = {"filter": {"particles": 20}, "association": {"mode": "unknown"}, "seed": 3}


def _log(seed: int) -> Log:
    return simulate({"seed": seed, "world": {"count": 40}})


def _true_start(log: Log, part: Log) -> np.ndarray:
    truth = log.truth_trajectory
    assert truth is not None
    return truth.T_world_robot[np.searchsorted(truth.stamp_s, part.controls.stamp_s[0])]


def _true_map(log: Log) -> Map:
    assert log.truth_landmarks is not None
    places = dict(zip(log.truth_landmarks.names, log.truth_landmarks.position_m, strict=True))
    return Map.at({f"t{name}": place for name, place in places.items()}, std_m=0.05)


@pytest.mark.parametrize("seed", [11, 12, 13])
def test_a_robot_put_down_anywhere_finds_itself(seed: int) -> None:
    log = _log(seed)
    part = between(log, log.controls.stamp_s[0] + 7.0 * (seed - 10), np.inf)
    found = find(part, _true_map(log), config=UNKNOWN)
    assert found.status == "found" and found.searched_s < 30.0
    off = found.modes[0].T_map_robot - _true_start(log, part)
    assert np.linalg.norm(off[:2]) < 0.5 and abs(np.angle(np.exp(1j * off[2]))) < 0.1


@pytest.mark.parametrize("seed", [11, 12, 13])
def test_in_the_map_of_another_place_it_is_never_sure(seed: int) -> None:
    found = find(between(_log(seed), -np.inf, 40.0), _true_map(_log(seed + 50)), config=UNKNOWN)
    assert found.status == "searching" and found.result is None
    assert "searching" in found.sentence


def _scattered(seed: int, count: int) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-15.0, 15.0, (count, 2))


def _constellation(places: np.ndarray) -> Constellation:
    count = len(places)
    return Constellation(places, np.full(count, 0.01), np.full(count, -1, dtype=np.int64))


VIEW = View(np.zeros((1, 3)), 5.0, np.pi)


def test_a_symmetric_map_keeps_all_its_places() -> None:
    half = _scattered(3, 25) + np.array([20.0, 0.0])
    chart = _constellation(np.concatenate([half, -half]))
    near = half[np.argsort(np.linalg.norm(half - half[0], axis=1))[:9]]
    found = placements(_constellation(near - half[0]), chart, VIEW)
    odds = odds_of(found)
    np.testing.assert_allclose(odds[:2], 0.5, atol=0.01)
    turned = found[0].T_map_local[2] - found[1].T_map_local[2]
    assert abs(abs(np.angle(np.exp(1j * turned))) - np.pi) < 1e-3
    np.testing.assert_allclose(found[0].T_map_local[:2], -found[1].T_map_local[:2], atol=1e-2)


def test_missing_and_false_landmarks_are_survived_and_strangers_placed_nowhere() -> None:
    sure = right = 0
    for seed in range(20):
        rng = np.random.default_rng(100 + seed)
        chart = _scattered(seed, 80)
        near = chart[np.argsort(np.linalg.norm(chart - chart[0], axis=1))[:12]]
        kept = near[rng.random(12) > 0.3]
        false = chart[0] + rng.uniform(-5.0, 5.0, (2, 2))
        local = np.concatenate([kept, false]) + rng.normal(0.0, 0.1, (len(kept) + 2, 2)) - chart[0]
        found = placements(_constellation(local), _constellation(chart), VIEW)
        if odds_of(found)[0] >= 0.999:
            sure += 1
            right += bool(np.linalg.norm(found[0].T_map_local[:2] - chart[0]) < 0.5)
        strangers = placements(_constellation(_scattered(seed + 500, 8) / 3.0), _constellation(chart), VIEW)
        assert odds_of(strangers)[-1] > 0.001
    assert sure >= 10 and right == sure


def test_classes_tell_places_apart() -> None:
    half = _scattered(3, 25) + np.array([20.0, 0.0])
    labels = np.repeat([0, 1], 25)
    chart = replace(_constellation(np.concatenate([half, -half])), label=labels)
    near = half[np.argsort(np.linalg.norm(half - half[0], axis=1))[:9]]
    local = replace(_constellation(near - half[0]), label=np.ones(9, dtype=np.int64))
    found = placements(local, chart, VIEW)
    assert odds_of(found)[0] > 0.999
    np.testing.assert_allclose(found[0].T_map_local[:2], -half[0], atol=1e-2)


def test_the_map_is_kept_or_extended_as_asked() -> None:
    log = _log(11)
    whole = run(log, UNKNOWN).map
    chart = whole.rows(np.arange(len(whole.role)) != 2)
    kept = localize(log, chart, start=Start(std=(0.1, 0.1, 0.02)), config=UNKNOWN).result
    assert kept is not None and kept.changes is not None and len(kept.changes.new) >= 1
    np.testing.assert_allclose(
        kept.landmarks.mean_m[: len(chart.role)], chart.landmarks.mean_m, rtol=0.0, atol=1e-9
    )
    extended = localize(log, chart, start=Start(), config=UNKNOWN, keep=False).result
    assert extended is not None
    assert len(extended.map.role) > len(chart.role)
    assert not np.allclose(extended.landmarks.mean_m[0], chart.landmarks.mean_m[0], rtol=0.0, atol=1e-9)


def test_the_commands(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    log, folder, chart = _log(11), tmp_path / "log", tmp_path / "yard.map"
    write_native(log, folder)
    common = ("--set", "filter.particles=20", "--association", "unknown", "--no-report")
    outcome = fastslam("run", folder, "--out", tmp_path / "a", "--map-out", chart, *common)
    assert outcome.exit_code == 0, outcome.stderr
    count = len(Map.load(chart).role)
    assert fastslam("map", "check", chart).exit_code == 0
    assert f"{count}" in fastslam("map", "info", chart).stdout
    assert fastslam("map", "draw", chart, "--out", tmp_path / "m.png").exit_code == 0
    assert (tmp_path / "m.png").stat().st_size > 5000
    first, second, *_ = Map.load(chart).landmarks.ids
    edit = ("--remove", first, "--move", f"{second}=1,2", "--fix", second, "--name", f"{second}=gate")
    outcome = fastslam("map", "edit", chart, *edit, "--out", tmp_path / "b.map")
    assert outcome.exit_code == 0, outcome.stderr
    edited = Map.load(tmp_path / "b.map")
    assert edited.landmarks.ids[0] == "gate" and edited.role[0] == "fixed" and len(edited.role) == count - 1
    assert "gone" in fastslam("map", "diff", chart, tmp_path / "b.map").stdout
    for kind in ("csv", "geojson", "g2o"):
        out = tmp_path / f"x.{kind}"
        assert fastslam("map", "export", chart, "--to", kind, "--out", out).exit_code == 0 and out.exists()
    monkeypatch.chdir(tmp_path)
    assert fastslam("map", "export", "x.csv", "--to", "geojson").stdout == "x.geojson\n"
    fastslam("map", "export", "x.csv").assert_one_line_error(exit_code=2, contains="x.csv is the map itself")
    outcome = fastslam(
        *("localize", folder, "--map", chart, "--start", "anywhere", "--out", tmp_path / "c", *common),
        "--figures",
    )
    assert outcome.exit_code == 0 and "start: anywhere; found after" in outcome.stdout, outcome.stderr
    assert (tmp_path / "c" / "map.png").stat().st_size > 5000
    outcome = fastslam("localize", folder, "--map", chart, "--out", tmp_path / "d", *common)
    assert outcome.exit_code == 0 and "start: the initial_pose of the settings" in outcome.stdout
    fastslam("localize", folder, "--map", chart, "--start", "1,2").assert_one_line_error(
        exit_code=2, contains="--start 1,2: expected three numbers"
    )
    fastslam("map", "edit", chart, "--remove", "nobody").assert_one_line_error(
        exit_code=2, contains="the map has no landmark nobody"
    )
    fastslam("map", "info", tmp_path / "none").assert_one_line_error(exit_code=1, contains="no such map")


def test_a_start_anywhere_is_followed_to_the_end() -> None:
    log = _log(12)
    found = localize(log, _true_map(log), start=Anywhere(), config=UNKNOWN)
    assert found.status == "found" and found.result is not None
    truth = log.truth_trajectory
    assert truth is not None
    path = found.result.trajectory
    at = np.clip(np.searchsorted(truth.stamp_s, path.stamp_s), 0, len(truth.stamp_s) - 1)
    off_m = np.linalg.norm(path.T_world_robot[:, :2] - truth.T_world_robot[at, :2], axis=1)
    assert np.sqrt(np.mean(off_m**2)) < 0.2


def test_without_a_start_the_robot_is_searched_for_unless_one_is_stated() -> None:
    log = _log(12)
    chart = _true_map(log)
    stated = localize(log, chart, config=UNKNOWN)
    assert (stated.start, stated.searched_s) == ("stated", 0.0)
    bare = replace(log, config={key: value for key, value in log.config.items() if key != "initial_pose"})
    assert log.config != bare.config
    found = localize(bare, chart, config=UNKNOWN)
    assert (found.start, found.status) == ("anywhere", "found") and found.searched_s > 0.0
    assert np.linalg.norm(found.modes[0].T_map_robot - _true_start(log, log)) < 0.5
    initial = dict(zip(("x_m", "y_m", "heading_rad"), map(float, _true_start(log, log)), strict=True))
    assert localize(bare, chart, config={**UNKNOWN, "initial_pose": initial}).start == "stated"
    assert localize(bare, chart, start=Start(*initial.values()), config=UNKNOWN).start == "given"

"""Maps that are kept: files, filters and runs that begin in one."""

from __future__ import annotations

import copy
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fastslam import Anywhere, FastSlam, Map, Robot, Start, run
from fastslam.checkpoint import CHECKPOINT_FILE, Checkpoints
from fastslam.errors import ConfigError, DataError
from fastslam.log import Log
from fastslam.maps import Changes, difference, oddities
from fastslam.result import RunResult
from fastslam.simulation import simulate

UNKNOWN: dict[str, Any] = {"filter": {"particles": 30}, "association": {"mode": "unknown"}, "seed": 3}


def _log(seed: int = 2, **more: Any) -> Log:
    return simulate({"seed": seed, "world": {"count": 25}, **more})


@pytest.fixture(scope="module")
def made() -> tuple[Log, RunResult]:
    log = _log()
    return log, run(log, UNKNOWN)


def test_a_map_is_written_and_read_again(made: tuple[Log, RunResult], tmp_path: Path) -> None:
    chart = made[1].map
    assert len(chart.landmarks.ids) > 10 and set(chart.role) == {"prior"}
    chart = replace(
        chart,
        role=("fixed", *chart.role[1:]),
        note=('a "gate", blue', *chart.note[1:]),
        existence=np.array([0.75, *chart.existence[1:]]),
    )
    again = Map.load(chart.save(tmp_path / "yard.map"))
    assert again.landmarks.ids == chart.landmarks.ids
    np.testing.assert_allclose(again.landmarks.mean_m, chart.landmarks.mean_m, rtol=1e-8)
    np.testing.assert_allclose(again.landmarks.covariance_m2, chart.landmarks.covariance_m2, rtol=1e-8)
    np.testing.assert_array_equal(again.existence, chart.existence)
    assert (again.role, again.note, again.name) == (chart.role, chart.note, chart.name)
    assert again.frame == "map" and again.made_from["seed"] == 3
    assert sorted(path.name for path in (tmp_path / "yard.map").iterdir()) == ["landmarks.csv", "map.yaml"]


def test_a_plain_table_is_a_map(tmp_path: Path) -> None:
    table = tmp_path / "reflectors.csv"
    table.write_text("id;x_m;y_m\nA;1,5;2\nB;-3;0,25\n")
    chart = Map.load(table)
    assert (chart.name, chart.role) == ("reflectors", ("fixed", "fixed"))
    np.testing.assert_array_equal(chart.landmarks.mean_m, [[1.5, 2.0], [-3.0, 0.25]])
    table.write_text("id,x_m,y_m,std_m,class\nA,1,2,0.1,cone\nB,3,4,0,\n")
    chart = Map.load(table)
    assert chart.role == ("prior", "fixed")
    np.testing.assert_allclose(chart.landmarks.covariance_m2[0], 0.01 * np.eye(2))
    assert [chart.landmarks.class_name(row) for row in range(2)] == ["cone", ""]


@pytest.mark.parametrize(
    ("file", "old", "new", "message"),
    [
        ("landmarks.csv", "oak,1,", "oak,north,", r"landmarks.csv:2: x_m: got 'north', expected a number"),
        ("landmarks.csv", "elm,", "oak,", r"landmarks.csv:3: id: oak stands in line 2 too"),
        ("landmarks.csv", "elm,", ",", r"landmarks.csv:3: id: expected a name"),
        ("landmarks.csv", "fixed,", "solid,", r"landmarks.csv:2: role: got solid, expected fixed or prior"),
        (
            "landmarks.csv",
            "0.04,0,0.04",
            "0.04,0.05,0.04",
            r"landmarks.csv:2: the covariance is not positive",
        ),
        ("landmarks.csv", "id,x_m", "id,east_m", r"landmarks.csv:1: the column x_m is missing"),
        (
            "map.yaml",
            "format_version: 1",
            "format_version: 7",
            r"map.yaml:1: format_version: got 7, this version",
        ),
        ("map.yaml", "frame:", "fame:", r"map.yaml:3: fame: unknown key"),
        ("map.yaml", "frame: map", "frame: [map", r"map.yaml:\d: "),
    ],
)
def test_faults_are_told_with_file_and_line(
    file: str, old: str, new: str, message: str, tmp_path: Path
) -> None:
    folder = Map.at({"oak": (1.0, 2.0), "elm": (4.0, -1.0)}, std_m=0.2).save(tmp_path / "a.map")
    text = (folder / file).read_text()
    assert old in text
    (folder / file).write_text(text.replace(old, new, 1))
    with pytest.raises(DataError, match=message):
        Map.load(folder)
    with pytest.raises(DataError, match=r"none.map: no such map"):
        Map.load(tmp_path / "none.map")


def test_a_robot_begins_in_a_map_and_goes_on_from_a_copy() -> None:
    chart = Map.at({"oak": (3.0, 1.0), "L7": (3.0, -2.0)}, std_m=0.01)
    robot = FastSlam(
        {"filter": {"particles": 200}}, map=chart, start=Start(0.3, 0.2, 0.1, std=(0.3, 0.3, 0.1))
    )
    assert robot.landmarks.ids == ("oak", "L7")
    for step in range(1, 4):
        robot.update(
            0.1 * step,
            range_m=[np.hypot(3.0, 1.0), np.hypot(3.0, 2.0), 5.0],
            bearing_rad=[np.arctan2(1.0, 3.0), np.arctan2(-2.0, 3.0), 1.5],
            identity=["oak", None, None],
        )
    pose, covariance = robot.pose
    assert np.abs(pose).max() < 0.15 and np.sqrt(covariance[0, 0]) < 0.2
    assert robot.landmarks.ids == ("oak", "L7", "L8")
    np.testing.assert_allclose(robot.landmarks.mean_m[:2], [[3.0, 1.0], [3.0, -2.0]], atol=1e-12)
    assert copy.deepcopy(robot).landmarks.ids == robot.landmarks.ids


def test_what_cannot_be_a_start_or_a_map_is_refused() -> None:
    chart = Map.at({"oak": (3.0, 1.0)})
    with pytest.raises(DataError, match="EKF-SLAM cannot start in a given map"):
        FastSlam({"algorithm": "ekf"}, map=chart)
    with pytest.raises(DataError, match="covariance"):
        FastSlam(map=chart.with_role("prior"))
    with pytest.raises(DataError, match=r"start: got std"):
        FastSlam(start=Start(std=(0.1, -1.0, 0.0)))
    with pytest.raises(DataError, match=r"start: got shape \(2,\)"):
        FastSlam(start=[1.0, 2.0])
    with pytest.raises(ConfigError, match=r"fastslam.localize"):
        FastSlam(start=Anywhere())


@pytest.mark.parametrize(
    ("at", "value", "why"),
    [
        ((0, 1), 0.02, r"not symmetric, \[0\]\[1\] is 0.02 and \[1\]\[0\] is 0.01"),
        ((2, 2), -0.01, r"not positive, a variance is -0.01"),
        ((0, 0), 0.0001, r"not positive, its smallest eigenvalue is -"),
        ((1, 1), np.nan, r"not all of it is finite"),
    ],
)
def test_a_covariance_that_is_none_says_why(at: tuple[int, int], value: float, why: str) -> None:
    covariance = np.array([[0.04, 0.01, 0.0], [0.01, 0.09, 0.0], [0.0, 0.0, 0.01]])
    covariance[at] = value
    with pytest.raises(DataError, match=rf"^start\.covariance: got \[\[.*expected a covariance: .*{why}"):
        FastSlam(start=Start(covariance=covariance))
    with pytest.raises(DataError, match=rf"^covariance: .*{why}"):
        Robot().odometry(0.0, [1.0, 0.0], covariance=covariance)


def test_rounding_is_no_asymmetry() -> None:
    covariance = np.array([[0.04, 0.01, 0.0], [0.01, 0.09, 0.0], [0.0, 0.0, 0.01]])
    exact = FastSlam(start=Start(covariance=covariance)).pose
    covariance[1, 0] *= 1.0 + 1e-10
    rounded = FastSlam(start=Start(covariance=covariance)).pose
    np.testing.assert_array_equal(rounded[1], exact[1])
    covariance[1, 0] *= 1.0 + 1e-7
    with pytest.raises(DataError, match="not symmetric"):
        FastSlam(start=Start(covariance=covariance))


@pytest.mark.parametrize("mode", ["known", "unknown"])
def test_a_run_in_the_map_of_another_keeps_it_or_improves_it(mode: str) -> None:
    log = _log()
    config = {**UNKNOWN, "association": {"mode": mode}}
    chart = run(log, config).map
    kept = run(log, config, map=chart.with_role("fixed"))
    assert kept.landmarks.ids[: len(chart.role)] == chart.landmarks.ids
    moved = kept.landmarks.mean_m[: len(chart.role)] - chart.landmarks.mean_m
    assert np.abs(moved).max() < 1e-9
    assert kept.changes is not None and len(kept.changes.new) <= 1 and not kept.changes.gone
    assert kept.changes.sighted >= len(chart.role) - 1
    extended = run(log, config, map=chart)
    rows = slice(len(chart.role))
    narrower = np.linalg.det(extended.landmarks.covariance_m2[rows]) <= 1.01 * np.linalg.det(
        chart.landmarks.covariance_m2
    )
    assert narrower.mean() > 0.9
    assert len(extended.map.role) <= len(chart.role) + 1


def test_what_was_edited_is_a_difference_and_slips_are_odd(tmp_path: Path) -> None:
    places = {"P1": (0.0, 0.0), "p1": (4.0, 0.0), "P2": (0.0, 5.0), "P3": (40_000.0, 0.0)}
    chart = Map.at(places, std_m=0.05)
    assert oddities(chart) == [
        "P3 stands 39,996 m from the nearest other landmark",
        "P1 and p1 differ only in case",
    ]
    ids = ("gate", *chart.landmarks.ids[1:])
    after = replace(
        chart,
        landmarks=replace(chart.landmarks, ids=ids),
        role=("fixed", "fixed", "prior", "fixed"),
        note=("", "leans", "", ""),
    )
    assert difference(chart, after)["changed"] == [
        ("P1", "gate", "name", "P1", "gate"),
        ("p1", "p1", "note", "", "leans"),
        ("P2", "P2", "role", "fixed", "prior"),
    ]
    assert difference(chart, chart)["changed"] == []
    columns = after.to_columns()
    assert columns["role"] == list(after.role) and columns["note"] == list(after.note)
    assert {len(column) for column in columns.values()} == {4}
    frame = after.to_dataframe()
    assert list(frame["id"]) == list(ids) and list(frame["note"]) == list(after.note)
    table = tmp_path / "posts.csv"
    table.write_text("id,x_m,y_m,std_m,role\nP1,0,0,0.1,Prior\nP2,1,1,0,FIXED\n")
    assert Map.load(table).role == ("prior", "fixed")


def test_what_is_new_and_what_is_gone_is_told(made: tuple[Log, RunResult]) -> None:
    log, result = made
    chart = result.map
    hidden, phantom = chart.landmarks.ids[3], "phantom"
    rows = chart.rows([row for row, name in enumerate(chart.landmarks.ids) if name != hidden])
    places = {name: rows.landmarks.mean_m[row] for row, name in enumerate(rows.landmarks.ids)}
    places[phantom] = places["L1"] + [2.5, 2.0]
    found = run(log, UNKNOWN, map=Map.at(places, std_m=0.05)).changes
    assert isinstance(found, Changes)
    assert phantom in found.gone and len(found.gone) == 1
    assert len(found.new) == 1 and not set(found.new) & set(places)
    assert len(found.lines()) == 2


def test_what_was_sighted_by_its_name_is_not_gone() -> None:
    log = _log()
    full = run(log, {"filter": {"particles": 20}}).map
    names = full.landmarks.ids
    before, now = names[2], names[3]
    # Sighted three times in hundreds of scans in which a sensor without a limit would have it in view.
    rare = np.flatnonzero(log.sightings.identity == log.identity_names.index(before))[3:]
    kept = np.setdiff1d(np.arange(len(log.sightings.stamp_s)), rare)
    columns = {name: None if value is None else value[kept] for name, value in vars(log.sightings).items()}
    drive = replace(log, sightings=replace(log.sightings, **columns))
    renamed = replace(full.landmarks, ids=tuple("gate" if name == now else name for name in names))
    settings = {"filter": {"particles": 20}, "sensor": {"max_range_m": 100.0, "field_of_view_rad": 6.28}}
    found = run(drive, settings, map=replace(full.with_role("fixed"), landmarks=renamed)).changes
    assert found is not None and not found.gone and not found.new
    assert found.renamed == ((now, "gate"),)
    assert found.lines() == [f"{now} stands where gate stands: renamed?"]


def test_a_stopped_run_in_a_map_goes_on_and_not_in_another(
    made: tuple[Log, RunResult], tmp_path: Path
) -> None:
    log, result = made
    chart, place = result.map, tmp_path / CHECKPOINT_FILE

    def stop(_done: int, _total: int) -> None:
        raise KeyboardInterrupt

    whole = run(log, UNKNOWN, map=chart)
    run(log, UNKNOWN, map=chart, progress=stop, checkpoints=Checkpoints(place))
    kept = place.read_bytes()
    resumed = run(log, UNKNOWN, map=chart, checkpoints=Checkpoints(place, resume=True))
    np.testing.assert_array_equal(resumed.trajectory.T_world_robot, whole.trajectory.T_world_robot)
    np.testing.assert_array_equal(resumed.landmarks.mean_m, whole.landmarks.mean_m)
    place.write_bytes(kept)
    with pytest.raises(DataError, match="another log, map or start"):
        run(log, UNKNOWN, map=chart.with_role("fixed"), checkpoints=Checkpoints(place, resume=True))

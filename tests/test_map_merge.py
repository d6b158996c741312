"""Maps of several robots or days that become one, and those of different places that do not."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from cli_runner import fastslam
from fastslam import Map
from fastslam.errors import DataError
from fastslam.maps import align, merge
from fastslam.overlays import inverse, overlap
from fastslam.placement import apply

STD_M = 0.08
T = np.array([7.0, -3.0, 2.0])
"""Where the second map's frame lies in that of the first."""


def chart(places_m: np.ndarray, *, name: str = "map", std_m: float = STD_M) -> Map:
    places = {f"L{row}": place for row, place in enumerate(places_m)}
    return Map.at(places, std_m=std_m, role="prior", name=name)


def seen(world_m: np.ndarray, rng: np.random.Generator, *, kept: float = 0.85) -> np.ndarray:
    """Places as a robot maps them: some missing, all with errors."""
    chosen = world_m[rng.random(len(world_m)) < kept]
    return chosen + rng.normal(0.0, STD_M, chosen.shape)


def world(seed: int, count: int = 150) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-40.0, 40.0, (count, 2))


def halves(seed: int) -> tuple[Map, Map]:
    """Two maps of one world that overlap by 20 m, each in its own frame."""
    places, rng = world(seed), np.random.default_rng(seed + 1000)
    first, second = places[places[:, 0] < 10.0], places[places[:, 0] > -10.0]
    return chart(seen(first, rng), name="a"), chart(apply(inverse(T), seen(second, rng)), name="b")


@pytest.mark.slow
def test_maps_that_overlap_become_one_with_covariances_that_hold() -> None:
    nees, merged_count = [], 0
    for seed in range(6):
        ours, theirs = halves(seed)
        try:
            merged = merge([ours, theirs])
        except DataError as error:
            assert "no overlap found" in str(error)
            continue
        merged_count += 1
        part = merged.parts[1]
        off = part.T_map_part - T
        off[2] = np.angle(np.exp(1j * off[2]))
        assert np.linalg.norm(off[:2]) < 0.25 and abs(off[2]) < 0.01
        assert off @ np.linalg.solve(part.covariance, off) < 25.0
        assert len(merged.map.role) == len(ours.role) + len(theirs.role) - part.pairs
        landmarks = merged.map.landmarks
        places = world(seed)
        nearest = np.linalg.norm(landmarks.mean_m[:, None] - places[None], axis=2).argmin(axis=1)
        wrong = landmarks.mean_m - places[nearest]
        weighted = np.linalg.solve(landmarks.covariance_m2, wrong[..., None])[..., 0]
        nees += list(np.sum(wrong * weighted, axis=1))
    assert merged_count >= 4
    assert 0.8 < np.mean(nees) < 2.4


@pytest.mark.slow
def test_different_places_are_never_joined() -> None:
    with pytest.raises(DataError, match=r"no overlap found: b; no overlap found: c"):
        merge([chart(world(91, 40)), chart(world(92, 40), name="b"), chart(world(93, 40), name="c")])
    for few in (0, 1, 4):
        small = chart(world(94, few), name="small")
        with pytest.raises(DataError, match="no overlap found: small"):
            merge([chart(world(94, 40)), small])
    for seed in range(8):
        ours, theirs = chart(seen(world(seed, 100), np.random.default_rng(seed))), halves(seed + 500)[1]
        assert overlap(ours, theirs).status == "none"


@pytest.mark.slow
def test_a_map_between_joins_two_that_have_nothing_in_common() -> None:
    places, rng = world(3, 260), np.random.default_rng(4)
    west, east = places[places[:, 0] < -5.0], places[places[:, 0] > 5.0]
    middle = places[np.abs(places[:, 0]) < 25.0]
    maps = [chart(seen(part, rng, kept=0.95), name=name) for part, name in ((west, "w"), (east, "e"))]
    assert overlap(*maps).status == "none"
    merged = merge([*maps, chart(apply(inverse(T), seen(middle, rng, kept=0.95)), name="m")])
    assert [part.name for part in merged.parts] == ["w", "e", "m"]
    np.testing.assert_allclose(merged.parts[1].T_map_part, 0.0, atol=0.2)
    np.testing.assert_allclose(merged.parts[2].T_map_part, T, atol=0.2)
    assert 0.0 < merged.parts[1].covariance[0, 0] < 0.1


def test_a_symmetric_map_and_a_regular_one_are_not_settled() -> None:
    half = world(5, 60) / 2.0 + np.array([25.0, 0.0])
    both = overlap(chart(np.concatenate([half, -half])), chart(half))
    assert both.status == "ambiguous" and len(both.overlays) == 2
    rows = np.stack(np.meshgrid(np.arange(12) * 3.0, np.arange(5) * 5.0), axis=-1).reshape(-1, 2)
    rng = np.random.default_rng(6)
    for shift in (0, 3):
        ours = chart(rows + rng.normal(0.0, STD_M, rows.shape))
        part = rows[(rows[:, 0] >= 3.0 * shift) & (rows[:, 0] <= 3.0 * shift + 15.0)]
        assert overlap(ours, chart(part + rng.normal(0.0, STD_M, part.shape))).status == "ambiguous"


def test_roles_names_classes_and_doubts_are_kept() -> None:
    places = world(7, 60)
    ours, theirs = chart(places[:50]), chart(apply(inverse(T), places[10:]))
    ours = replace(
        ours,
        role=("fixed", *ours.role[1:20], "fixed", *ours.role[21:]),
        landmarks=replace(
            ours.landmarks,
            class_index=np.full(50, 0, dtype=np.int64),
            class_names=("oak",),
        ),
    )
    theirs = replace(
        theirs,
        note=("by the gate", *theirs.note[1:]),
        landmarks=replace(theirs.landmarks, ids=("gate", *theirs.landmarks.ids[1:49], "hut")),
    )
    merged = merge([ours, theirs]).map
    assert len(merged.role) == 60 and len(set(merged.landmarks.ids)) == 60
    assert merged.role[0] == merged.role[20] == "fixed"
    np.testing.assert_array_equal(merged.landmarks.mean_m[20], ours.landmarks.mean_m[20])
    assert merged.note[10] == "by the gate" and merged.landmarks.ids[10] == "L10"
    assert merged.landmarks.ids[-1] == "hut" and merged.landmarks.class_name(3) == "oak"
    lacking = ours.rows(np.arange(50) != 30)
    doubted = merge([ours, chart(lacking.landmarks.mean_m)]).map
    assert doubted.existence[30] < 0.9 and np.isnan(doubted.existence[29])


def test_names_of_landmarks_settle_what_places_do_not() -> None:
    rows = np.stack(np.meshgrid(np.arange(6) * 3.0, np.arange(3) * 5.0), axis=-1).reshape(-1, 2)
    named = Map.at({f"tree-{row}": place for row, place in enumerate(rows)}, std_m=STD_M, role="prior")
    turned = replace(named, landmarks=replace(named.landmarks, mean_m=apply(inverse(T), rows)))
    found = overlap(named, turned.rows(np.arange(4, 18)))
    assert found.status == "found"
    np.testing.assert_allclose(found.overlays[0].T_map_other, T, atol=1e-6)
    assert [first - second for first, second in found.overlays[0].pairs] == [4] * 14


def test_the_commands(tmp_path: Path) -> None:
    ours, theirs = halves(1)
    ours.save(tmp_path / "a.map")
    theirs.save(tmp_path / "b.map")
    out = tmp_path / "c.map"
    outcome = fastslam("map", "merge", tmp_path / "a.map", tmp_path / "b.map", "--out", out, "--json")
    assert outcome.exit_code == 0, outcome.stderr
    found = json.loads(outcome.stdout)
    assert found["landmarks"] == len(Map.load(out).role) > len(ours.role)
    assert Map.load(out).made_from["merged"][1]["name"] == "b"
    outcome = fastslam("map", "align", tmp_path / "b.map", tmp_path / "a.map", "--out", tmp_path / "d.map")
    assert outcome.exit_code == 0 and "heading" in outcome.stdout, outcome.stderr
    aligned, part = align(theirs, ours)
    np.testing.assert_allclose(part.T_map_part, T, atol=0.2)
    np.testing.assert_allclose(Map.load(tmp_path / "d.map").landmarks.mean_m, aligned.landmarks.mean_m)
    assert len(aligned.role) == len(theirs.role) and aligned.landmarks.ids == theirs.landmarks.ids
    chart(world(99, 80), name="elsewhere").save(tmp_path / "e.map")
    for command in (("merge",), ("align",)):
        fastslam("map", *command, tmp_path / "a.map", tmp_path / "e.map").assert_one_line_error(
            exit_code=1, contains="no overlap found"
        )
    fastslam("map", "merge", tmp_path / "a.map").assert_one_line_error(
        exit_code=1, contains="merging takes two maps or more, got 1"
    )

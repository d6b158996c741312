"""Matching and measuring maps: by name, by position, with and without true poses."""

from __future__ import annotations

from itertools import permutations

import numpy as np
import pytest
from fabricate import LANDMARKS_M, T_WORLD_TRUTH, make_map
from fastslam.errors import DataError
from fastslam.evaluation import LandmarkMatching, assign_points, gospa, landmark_errors
from fastslam.evaluation.constellation import find_transform
from fastslam.log import TruthLandmarks

NAMES = tuple(f"tree{k}" for k in range(len(LANDMARKS_M)))
TRUTH = TruthLandmarks(NAMES, LANDMARKS_M)
BY_NAME = LandmarkMatching(identities=NAMES)
BY_PATH = LandmarkMatching(initial=T_WORLD_TRUTH.inverse())


def born(count: int) -> tuple[str, ...]:
    return tuple(f"L{k}" for k in range(count))


@pytest.mark.parametrize(
    ("ids", "matching"), [(NAMES, BY_NAME), (born(8), BY_PATH), (born(8), LandmarkMatching())]
)
def test_a_perfect_map_in_another_frame(ids: tuple[str, ...], matching: LandmarkMatching) -> None:
    found = landmark_errors(make_map(ids, LANDMARKS_M), TRUTH, matching=matching)
    assert found.matched == 8
    assert found.rmse_m == pytest.approx(0.0, abs=1e-12)
    assert (found.precision, found.recall, found.duplicates, found.missed) == (1.0, 1.0, 0, 0)
    np.testing.assert_array_equal(found.estimate_index[np.argsort(found.truth_index)], np.arange(8))
    assert found.gospa is not None
    assert found.gospa.distance_m == pytest.approx(0.0, abs=1e-12)


def test_error_by_hand() -> None:
    # The same bend as for paths: neither shift nor turn of the line absorbs it.
    line = np.column_stack([np.arange(5.0), np.zeros(5)])
    bent = line + np.column_stack([np.zeros(5), 0.1 * np.array([2.0, -1.0, -2.0, -1.0, 2.0])])
    truth = TruthLandmarks(NAMES[:5], line)
    for ids, matching in ((NAMES[:5], BY_NAME), (born(5), BY_PATH)):
        found = landmark_errors(make_map(ids, bent), truth, matching=matching)
        assert found.rmse_m == pytest.approx(0.1 * np.sqrt(14 / 5))
        # Cutoff 1 m: all five pair, Σ d² = 0.14 m².
        assert found.gospa is not None
        assert found.gospa.distance_m == pytest.approx(np.sqrt(0.14))


def test_swapped_identities_cost_what_they_should() -> None:
    cross = np.array([[-1.0, 0.0], [1.0, 0.0], [0.0, 3.0], [0.0, -3.0]])
    truth = TruthLandmarks(("a", "b", "c", "d"), cross)
    swapped = make_map(("b", "a", "c", "d"), cross)
    found = landmark_errors(swapped, truth, matching=LandmarkMatching(identities=truth.names))
    # c and d hold the rotation; a and b are 2 m off each: sqrt((4 + 4) / 4).
    assert found.matched == 4
    assert found.rmse_m == pytest.approx(np.sqrt(2.0))
    by_position = landmark_errors(swapped, truth, matching=LandmarkMatching(min_sightings=1))
    assert by_position.rmse_m == pytest.approx(0.0, abs=1e-12)


def test_duplicates_and_false_landmarks_are_told_apart() -> None:
    points = np.vstack([LANDMARKS_M, LANDMARKS_M[2] + [0.3, 0.0], LANDMARKS_M[3] + [0.8, 0.0]])
    for matching in (BY_PATH, LandmarkMatching()):
        found = landmark_errors(make_map(born(10), points), TRUTH, matching=matching)
        assert (found.matched, found.duplicates, found.false_landmarks) == (8, 1, 2)
        assert found.precision == pytest.approx(8 / 10)
        assert found.recall == 1.0
        # Cutoff 1 m: two false at 1/2 m² each.
        assert found.gospa is not None
        assert found.gospa.false_m2 == pytest.approx(1.0)


def test_an_incomplete_truth_accuses_duplicates_only() -> None:
    points = np.vstack([LANDMARKS_M, LANDMARKS_M[2] + [0.3, 0.0], LANDMARKS_M[3] + [0.8, 0.0]])
    truth = TruthLandmarks(NAMES, LANDMARKS_M, complete=False)
    found = landmark_errors(make_map(born(10), points), truth, matching=BY_PATH)
    assert (found.matched, found.duplicates, found.false_landmarks) == (8, 1, 1)
    assert found.gospa is not None
    assert found.gospa.false_m2 == 0.0


def test_landmarks_seen_seldom_count_only_where_identities_are_known() -> None:
    named = make_map(NAMES, LANDMARKS_M, sightings=4)
    assert landmark_errors(named, TRUTH, matching=BY_NAME).matched == 8
    unnamed = make_map(born(8), LANDMARKS_M, sightings=4)
    assert landmark_errors(unnamed, TRUTH, matching=BY_PATH).matched == 0
    mixed = make_map((*NAMES[:3], *born(5)), LANDMARKS_M, sightings=4)
    assert landmark_errors(mixed, TRUTH, matching=BY_NAME).matched == 3
    once = LandmarkMatching(initial=BY_PATH.initial, min_sightings=4)
    assert landmark_errors(unnamed, TRUTH, matching=once).matched == 8


def test_names_and_positions_mix_and_a_named_landmark_is_never_matched_by_position() -> None:
    # tree0 is called rock, which the truth does not know; tree1 has no name; the rest have theirs.
    ids = ("rock", "L1", *NAMES[2:])
    matching = LandmarkMatching(identities={*NAMES, "rock"})
    found = landmark_errors(make_map(ids, LANDMARKS_M), TRUTH, matching=matching)
    assert sorted(found.estimate_index.tolist()) == [1, 2, 3, 4, 5, 6, 7]
    assert (found.matched, found.missed, found.false_landmarks) == (7, 1, 1)


def test_unnamed_pairs_take_part_in_the_final_alignment() -> None:
    line = np.column_stack([np.arange(5.0), np.zeros(5)])
    bent = line + np.column_stack([np.zeros(5), 0.1 * np.array([2.0, -1.0, -2.0, -1.0, 2.0])])
    ids = (NAMES[0], "L1", "L2", "L3", NAMES[4])
    found = landmark_errors(make_map(ids, bent), TruthLandmarks(NAMES[:5], line), matching=BY_NAME)
    # Aligned by the two ends alone the others would be 0.3, 0.4 and 0.3 m off.
    assert found.matched == 5
    assert found.rmse_m == pytest.approx(0.1 * np.sqrt(14 / 5))


@pytest.mark.parametrize("scale", [0.98, 1.02])
@pytest.mark.parametrize("order", [1, -1])
def test_an_unlabelled_map_of_slightly_wrong_size_in_any_order_is_placed(scale: float, order: int) -> None:
    estimate = make_map(born(8), scale * LANDMARKS_M[::order])
    found = landmark_errors(estimate, TRUTH)
    # Alignment puts centre on centre; what is left is the scale times the distance from there.
    spread = np.sqrt(np.mean(np.sum((LANDMARKS_M - LANDMARKS_M.mean(axis=0)) ** 2, axis=1)))
    assert found.matched == 8
    assert found.rmse_m == pytest.approx(0.02 * spread)


def test_reversed_pairs_are_tried_too() -> None:
    triangle = np.array([[0.0, 0.0], [10.0, 0.0], [3.0, 7.0]])
    found = find_transform(triangle[::-1], triangle, gate_m=0.1)
    assert found is not None
    np.testing.assert_allclose(found.apply_points(triangle), triangle, atol=1e-9)


def test_missing_landmarks_lower_the_recall() -> None:
    found = landmark_errors(make_map(NAMES[:6], LANDMARKS_M[:6]), TRUTH, matching=BY_NAME)
    assert (found.matched, found.missed, found.recall, found.precision) == (6, 2, 0.75, 1.0)
    assert found.gospa is not None
    assert found.gospa.missed_m2 == pytest.approx(1.0)


@pytest.mark.parametrize("matching", [BY_NAME, BY_PATH, LandmarkMatching()])
def test_an_empty_map_finds_nothing_and_claims_nothing(matching: LandmarkMatching) -> None:
    found = landmark_errors(make_map((), np.zeros((0, 2))), TRUTH, matching=matching)
    assert (found.matched, found.missed, found.recall) == (0, 8, 0.0)
    assert found.precision is None
    assert found.rmse_m is None
    assert found.gospa is not None
    assert found.gospa.distance_m == pytest.approx(2.0)  # sqrt(8 / 2) at cutoff 1 m


def test_a_single_landmark_has_an_error_only_where_the_path_gives_the_frame() -> None:
    single = make_map(NAMES[:1], LANDMARKS_M[:1] + np.array([0.3, 0.4]))
    alone = landmark_errors(single, TRUTH, matching=BY_NAME)
    assert (alone.matched, alone.rmse_m, alone.transform) == (1, None, None)
    aligned = LandmarkMatching(identities=NAMES, initial=T_WORLD_TRUTH.inverse())
    assert landmark_errors(single, TRUTH, matching=aligned).rmse_m == pytest.approx(0.5)


def test_values_that_are_not_finite_are_refused() -> None:
    points = LANDMARKS_M.copy()
    points[5, 0] = np.nan
    with pytest.raises(DataError, match="estimated map: landmark in row 5"):
        landmark_errors(make_map(NAMES, points), TRUTH, matching=BY_NAME)
    with pytest.raises(DataError, match="true map: landmark in row 5"):
        landmark_errors(make_map(NAMES, LANDMARKS_M), TruthLandmarks(NAMES, points), matching=BY_NAME)


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_an_unlabelled_map_is_placed_without_true_poses(seed: int) -> None:
    rng = np.random.default_rng(seed)
    truth_m = rng.uniform(0.0, 30.0, (15, 2))
    seen = np.vstack([truth_m[3:] + rng.normal(0.0, 0.05, (12, 2)), rng.uniform(-5.0, 35.0, (20, 2))])
    seen = seen[rng.permutation(len(seen))]
    truth = TruthLandmarks(tuple(f"t{k}" for k in range(15)), truth_m)
    found = landmark_errors(make_map(born(32), seen), truth)
    # Twenty points of clutter in 1600 m² may fall within half a metre of one of three missing landmarks.
    assert 12 <= found.matched <= 13
    assert found.rmse_m is not None
    assert found.rmse_m < 0.15
    assert found.transform is not None
    turn = found.transform.rotation_rad + T_WORLD_TRUTH.rotation_rad
    assert np.sin(turn) == pytest.approx(0.0, abs=0.01)
    assert np.cos(turn) > 0


def test_maps_with_nothing_in_common_are_not_placed() -> None:
    triangle = np.array([[0.0, 0.0], [10.0, 0.0], [3.0, 7.0]])
    other = np.array([[0.0, 0.0], [50.0, 0.0], [90.0, 77.0]])
    assert find_transform(triangle, other, gate_m=0.5) is None
    assert find_transform(triangle[:1], other, gate_m=0.5) is None


def test_assignment_is_not_greedy() -> None:
    first = np.array([[0.0, 0.0], [0.4, 0.0]])
    second = np.array([[0.25, 0.0], [0.7, 0.0]])
    # Nearest first would pair 0.4 with 0.25 and leave two points alone.
    rows, columns = assign_points(first, second, gate_m=0.5)
    assert (rows.tolist(), columns.tolist()) == ([0, 1], [0, 1])


@pytest.mark.parametrize("seed", range(5))
def test_gospa_equals_the_minimum_over_all_assignments(seed: int) -> None:
    rng = np.random.default_rng(seed)
    estimate, truth = rng.uniform(0.0, 2.0, (4, 2)), rng.uniform(0.0, 2.0, (6, 2))
    cutoff = 0.8
    best = min(
        sum(min(float(np.sum((estimate[i] - truth[j]) ** 2)), cutoff**2) for i, j in enumerate(order))
        for order in permutations(range(6), 4)
    )
    expected = np.sqrt(best + 0.5 * cutoff**2 * 2)
    found = gospa(estimate, truth, cutoff_m=cutoff)
    assert found.distance_m == pytest.approx(expected)
    assert found.distance_m**2 == pytest.approx(found.localization_m2 + found.missed_m2 + found.false_m2)
    assert gospa(truth, estimate, cutoff_m=cutoff).distance_m == pytest.approx(expected)


def test_coincident_points_and_large_sets_are_paired() -> None:
    rng = np.random.default_rng(8)
    points = rng.uniform(0.0, 500.0, (5000, 2))
    order = rng.permutation(5000)
    rows, columns = assign_points(points, points[order], gate_m=0.5)
    np.testing.assert_array_equal(rows, np.arange(5000))
    np.testing.assert_array_equal(order[columns], np.arange(5000))

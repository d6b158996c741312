"""Stretches of a map that stand there once more."""

from __future__ import annotations

import math

import numpy as np
import pytest
from fastslam.laid import Laid
from fastslam.log import Floats
from fastslam.placement import apply, composed
from fastslam.runner import run
from fastslam.simulation import resolve_simulation, simulate
from fastslam.trust import TWICE, against, doubts
from fastslam.twofold import twofold

REACH_M, VIEW_RAD, RADIUS_M = 10.0, 1.2, 30.0
OFF = np.array([0.7, 3.3, 0.05])
"""How far the second lap lies off the first."""
ERROR_M = 0.05


def lap() -> Floats:
    """Poses (200, 3) once round a circle."""
    angle = np.linspace(0.0, 2.0 * math.pi, 200)
    return np.column_stack([RADIUS_M * np.sin(angle), RADIUS_M * (1.0 - np.cos(angle)), angle])


def beside(points_m: Floats) -> Floats:
    """Those that the robot passes."""
    apart = np.abs(np.hypot(points_m[:, 0], points_m[:, 1] - RADIUS_M) - RADIUS_M)
    return points_m[apart < 0.8 * REACH_M]


def scattered(seed: int) -> Floats:
    return beside(np.random.default_rng(seed).uniform([-45.0, -15.0], [45.0, 75.0], (300, 2)))


def regular() -> Floats:
    return beside(
        np.stack(np.meshgrid(np.arange(-45.0, 46.0, 6.0), np.arange(-15.0, 76.0, 6.0)), -1).reshape(-1, 2)
    )


def two_laps(field_m: Floats, off: Floats | None) -> tuple[Laid, Floats]:
    """Sightings of two laps on the map that they make: of the field, and once more `off` it in the second."""
    rng = np.random.default_rng(1)
    apart = field_m[None] - lap()[:, None, :2]
    range_m = np.hypot(apart[..., 0], apart[..., 1])
    bearing = np.arctan2(apart[..., 1], apart[..., 0]) - lap()[:, None, 2]
    bearing = np.arctan2(np.sin(bearing), np.cos(bearing))
    at, seen = np.nonzero((range_m < REACH_M) & (np.abs(bearing) < VIEW_RAD))
    poses, maps, landmark = [lap(), lap()], [field_m], [seen, seen]
    if off is not None:
        poses[1] = np.array([composed(off, pose) for pose in lap()])
        maps.append(apply(off, field_m))
        landmark[1] = seen + len(field_m)
    mean_m = np.vstack(maps)
    stamp_s = np.concatenate([at, at + len(lap())])
    found = Laid(
        row=np.arange(len(stamp_s)),
        stamp_s=stamp_s.astype(float),
        squared=np.zeros(2 * len(at)),
        landmark=np.concatenate(landmark),
        frame=stamp_s,
        mean_m=mean_m + ERROR_M * rng.normal(size=mean_m.shape),
        origin=np.vstack([poses[0][at], poses[1][at]]),
        range_m=np.tile(range_m[at, seen], 2),
        bearing_rad=np.tile(bearing[at, seen], 2),
    )
    return found, np.full(len(mean_m), ERROR_M**2)


@pytest.mark.slow(but="0")
@pytest.mark.parametrize("seed", range(4))
def test_a_field_that_was_mapped_anew_is_found_and_one_mapped_once_is_not(seed: int) -> None:
    field_m = scattered(seed)
    seen = len(np.unique(two_laps(field_m, None)[0].landmark))
    left_over = twofold(*two_laps(field_m, OFF), 0.05)
    assert 0.8 * seen < len(left_over) <= seen
    assert set(left_over) <= set(range(len(field_m), 2 * len(field_m)))
    assert twofold(*two_laps(field_m, None), 0.05) == []


def test_places_that_are_alike_are_two_places() -> None:
    assert twofold(*two_laps(regular(), None), 0.05) == []


def test_what_no_drift_explains_is_another_place() -> None:
    field_m = scattered(1)
    for off in ([60.0, 0.0, 0.0], [0.0, 0.0, 1.5]):
        assert twofold(*two_laps(field_m, np.array(off)), 0.05) == []


def test_things_that_are_sighted_together_are_two_things() -> None:
    """A shelf behind a shelf, alike: both are in view at once."""
    field_m = scattered(2)
    laid, variance_m2 = two_laps(field_m, OFF)
    second = laid.landmark >= len(field_m)
    both = np.where(second, laid.landmark - len(field_m), laid.landmark + len(field_m))
    doubled = {name: np.concatenate([value, value]) for name, value in vars(laid).items() if name != "mean_m"}
    doubled["landmark"] = np.concatenate([laid.landmark, both])
    order = np.argsort(doubled["stamp_s"], kind="stable")
    shown = Laid(mean_m=laid.mean_m, **{name: value[order] for name, value in doubled.items()})
    assert twofold(shown, variance_m2, 0.05) == []


def test_a_map_without_sightings_is_not_there_twice() -> None:
    laid, variance_m2 = two_laps(scattered(0), None)
    unseen = Laid(**{**vars(laid), "squared": np.full(len(laid.squared), np.inf)})
    assert twofold(unseen, variance_m2, 0.05) == []


@pytest.mark.slow
def test_a_second_map_that_the_robot_never_looks_back_from_is_told() -> None:
    """A sensor that faces back sees of the first map nothing that could be missed."""
    world = {
        "seed": 214,
        "trajectory": {"laps": 3},
        "sensor": {"field_of_view_rad": math.radians(120.0), "mounting": {"yaw_rad": math.pi}},
    }
    log = simulate(resolve_simulation(world, preset="loop"))
    result = run(log, {"seed": 214, "association": {"mode": "unknown"}})
    found = doubts(result, log)
    assert max(doubt.ratio for doubt in found if doubt.rule == TWICE) > 1.0
    assert any("part of the map is there twice" in sentence for sentence in against(found))

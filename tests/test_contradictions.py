"""Names at two places, and names that only seem to be because the robot was wrong about where it was."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import fastslam
import numpy as np
import pytest
from fastslam import runner
from fastslam.contradictions import TwoPlaces, share_misnamed, that_contradict_themselves
from fastslam.log import Log
from fastslam.result import RunResult
from fastslam.simulation import presets, simulate
from fastslam.trust import Doubt

SEEN_OFTEN = 20


def drive(preset: str, seed: int) -> Log:
    return simulate({**presets()[preset], "seed": seed})


def run(
    log: Log, monkeypatch: pytest.MonkeyPatch, seed: int = 0, *, plain: bool = False
) -> tuple[RunResult, tuple[TwoPlaces, ...]]:
    """A run with known names, and the names that the filter doubted."""
    doubted: list[TwoPlaces] = []
    judge = runner.judged

    def judged(result: RunResult, log: Log, two_places: list[TwoPlaces], more: Iterable[Doubt]) -> RunResult:
        doubted.extend(two_places)
        return judge(result, log, two_places, more)

    monkeypatch.setattr(runner, "judged", judged)
    settings = {"seed": seed, "association": {"mode": "known"}}
    filter_ = {"rejuvenation": {"every_steps": 0}} if plain else {}
    return fastslam.run(log, {**settings, "filter": filter_}, auto=False), tuple(doubted)


def one_name_for_two(log: Log, seed: int) -> tuple[Log, int]:
    """The log with one name on two of the landmarks that were seen often, and that name."""
    identity = log.sightings.identity.copy()
    often = np.flatnonzero(np.bincount(identity) >= SEEN_OFTEN)
    name, other = np.random.default_rng(seed).choice(often, 2, replace=False).tolist()
    identity[identity == other] = name
    return replace(log, sightings=replace(log.sightings, identity=identity)), name


@pytest.mark.parametrize(
    ("preset", "seed", "filter_seed"),
    [("loop", 1, 0), ("loop", 16, 16), pytest.param("lawn-mower", 8, 8, marks=pytest.mark.slow)],
)
def test_names_are_not_accused_where_the_robot_drifted(
    preset: str, seed: int, filter_seed: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Old landmarks that come into view at the end of a loop are off together."""
    log = drive(preset, seed)
    result, doubted = run(log, monkeypatch, filter_seed, plain=True)
    # The filter did leave out sightings of names that are sound.
    assert len(doubted) >= 1 or result.steps.ignored.sum() >= 100
    assert not [sentence for sentence in result.verdict if "name" in sentence]
    # By default drift is known for what it is.
    result, doubted = run(log, monkeypatch, filter_seed)
    assert len(doubted) == 0 and result.steps.ignored.sum() < 20
    assert result.verdict == ()


@pytest.mark.parametrize(("preset", "seed"), [("demo", 1), ("demo", 2), ("loop", 4), ("loop", 7)])
def test_one_name_on_two_landmarks_is_told(preset: str, seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Also where the filter drifts: other names that it doubted are not accused with it."""
    log, name = one_name_for_two(drive(preset, seed), seed)
    result, doubted = run(log, monkeypatch, seed)
    real = that_contradict_themselves(doubted, result, log)
    assert [two[0] for two in real] == [name]
    told = [text for text in result.verdict if "stands at two places" in text]
    assert len(told) == 1 and told[0].startswith(
        f"landmark {log.identity_names[name]} stands at two places: ("
    )
    assert share_misnamed(result, log) > 0.5


def test_a_name_that_moves_with_another_is_no_contradiction(monkeypatch: pytest.MonkeyPatch) -> None:
    log, name = one_name_for_two(drive("demo", 1), 1)
    result, doubted = run(log, monkeypatch, 1)
    assert [two[0] for two in that_contradict_themselves(doubted, result, log)] == [name]
    (held_x, held_y, seen, other_x, other_y, there) = doubted[0][1:]
    along = (name + 1, held_x + 3.0, held_y, seen, other_x + 3.2, other_y - 0.1, there)
    assert that_contradict_themselves((*doubted, along), result, log) == ()
    across = (name + 1, held_x + 3.0, held_y, seen, 2 * held_x - other_x, 2 * held_y - other_y, there)
    assert [two[0] for two in that_contradict_themselves((*doubted, across), result, log)] == [name]


def test_without_others_a_name_contradicts_itself_where_the_way_was_too_short(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """One name at a time: nothing but the odometry says how far the robot can be wrong."""
    log, name = one_name_for_two(drive("demo", 1), 1)
    result, doubted = run(log, monkeypatch, 1)
    mine = log.sightings.identity == name
    columns = {key: value[mine] for key, value in vars(log.sightings).items() if value is not None}
    alone = replace(log, sightings=replace(log.sightings, **columns))
    assert [two[0] for two in that_contradict_themselves(doubted, result, alone)] == [name]
    near = (*doubted[0][:4], doubted[0][1] + 0.5, doubted[0][2], doubted[0][6])
    assert that_contradict_themselves((near,), result, alone) == ()

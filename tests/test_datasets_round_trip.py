"""Property: a log that is written as a native folder reads back as the same log."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fastslam.datasets import load, write_native
from fastslam.errors import DataError
from fastslam.log import (
    Controls,
    Log,
    PositionFixes,
    Sightings,
    TruthLandmarks,
    TruthTrajectory,
)
from fastslam.runner import configure
from hypothesis import given, settings
from hypothesis import strategies as st

SENSOR = {
    "model": "range_bearing",
    "range_std_m": 1e-7,
    "bearing_std_rad": 0.1 + 0.2,
    "mounting": {"x_m": -0.5},
}
WIDTHS = {"velocity": 2, "ackermann": 2, "odometry": 3, "increments": 3}
numbers = st.floats(allow_nan=False, allow_infinity=False, width=64)
# Stamps farther apart than 58 days are refused, and sightings that repeat each other are dropped.
stamps = st.lists(st.floats(-2e6, 2e6), min_size=1, max_size=8)
names = st.lists(
    st.text(min_size=1, max_size=6).filter(
        # Words for "nobody knows" are no names.
        lambda text: (
            text == text.strip()
            and text.isprintable()
            and text.casefold() not in ("-1", "nan", "none", "null", "n/a", "unknown")
        )
    ),
    min_size=1,
    max_size=3,
    unique=True,
)


def first_seen_order(indices: list[int]) -> list[int]:
    """The same labelling with indices renumbered in order of first appearance, as a reader numbers them."""
    order: dict[int, int] = {}
    return [index if index < 0 else order.setdefault(index, len(order)) for index in indices]


@st.composite
def sightings_and_names(draw: st.DrawFn) -> tuple[Sightings, tuple[str, ...], tuple[str, ...]]:
    stamp = sorted(set(draw(stamps)))
    count = len(stamp)

    def labels() -> tuple[Any, tuple[str, ...]]:
        pool = draw(names)
        drawn = draw(st.lists(st.integers(-1, len(pool) - 1), min_size=count, max_size=count))
        indices = np.array(first_seen_order(drawn), dtype=np.int64)
        return indices, tuple(pool[: indices.max() + 1])

    def column(values: st.SearchStrategy[float]) -> Any:
        return np.array(draw(st.lists(values, min_size=count, max_size=count)))

    identity, identity_names = labels()
    class_index, class_names = labels()
    sightings = Sightings(
        stamp_s=np.array(stamp),
        range_m=column(st.floats(5e-324, 1e300)),
        bearing_rad=column(st.floats(-np.pi, np.pi)),
        identity=identity,
        class_index=class_index,
        signature=column(numbers | st.just(np.nan)),
    )
    return sightings, identity_names, class_names


@st.composite
def logs(draw: st.DrawFn) -> Log:
    model = draw(st.sampled_from(sorted(WIDTHS)))
    control_stamps = sorted(set(draw(stamps)))
    rows = st.lists(numbers, min_size=WIDTHS[model], max_size=WIDTHS[model])
    count = len(control_stamps)
    values = draw(st.lists(rows, min_size=count, max_size=count))
    sightings, identity_names, class_names = draw(sightings_and_names())
    heading_known = draw(st.booleans())
    headings = st.floats(-np.pi, np.pi) if heading_known else st.just(np.nan)
    poses = draw(st.lists(st.tuples(numbers, numbers, headings), min_size=count, max_size=count))
    points = st.tuples(numbers, numbers)
    landmarks = draw(st.dictionaries(names.map(lambda pool: pool[0]), points, min_size=1, max_size=4))
    fixes = draw(st.lists(points, min_size=count, max_size=count))
    config: dict[str, Any] = {"motion": {"model": model, "noise_period_s": draw(numbers)}, "sensor": SENSOR}
    if model == "ackermann":
        config["motion"] |= {"sensor_ahead_m": draw(numbers)}
    if draw(st.booleans()):
        config["initial_pose"] = {"x_m": draw(numbers), "y_m": np.float64(draw(numbers)), "heading_rad": 0.0}
    return Log(
        name=draw(names)[0],
        source="memory",
        format="test",
        controls=Controls(np.array(control_stamps), np.array(values)),
        sightings=sightings,
        identity_names=identity_names,
        class_names=class_names,
        truth_trajectory=TruthTrajectory(np.array(control_stamps), np.array(poses), heading_known),
        truth_landmarks=TruthLandmarks(
            tuple(landmarks), np.array(list(landmarks.values())), draw(st.booleans())
        ),
        position_fixes=PositionFixes(np.array(control_stamps), np.array(fixes)),
        config=config,
    )


def test_a_car_that_says_nothing_of_its_size_is_written_with_that_of_a_run(tmp_path: Path) -> None:
    log = minimal_log(config={"motion": {"model": "ackermann"}, "sensor": SENSOR})
    back = load(write_native(log, tmp_path / "log"))
    assert dict(configure(back)) == dict(configure(log)) and "sensor_left_m" in back.config["motion"]


@pytest.mark.slow
@settings(max_examples=100, deadline=None)
@given(log=logs())
def test_written_log_reads_back_bit_for_bit(log: Log) -> None:
    with tempfile.TemporaryDirectory() as base:
        back = load(write_native(log, Path(base) / "log"))
    assert back.name == log.name
    assert back.config == log.config
    for name in ("stamp_s", "values"):
        np.testing.assert_array_equal(getattr(back.controls, name), getattr(log.controls, name))
    for name in ("stamp_s", "range_m", "bearing_rad", "identity", "class_index", "signature"):
        np.testing.assert_array_equal(getattr(back.sightings, name), getattr(log.sightings, name))
    assert (back.identity_names, back.class_names) == (log.identity_names, log.class_names)
    assert back.truth_landmarks is not None and log.truth_landmarks is not None
    assert back.truth_landmarks.names == log.truth_landmarks.names
    assert back.truth_landmarks.complete == log.truth_landmarks.complete
    np.testing.assert_array_equal(back.truth_landmarks.position_m, log.truth_landmarks.position_m)
    assert back.position_fixes is not None and log.position_fixes is not None
    np.testing.assert_array_equal(back.position_fixes.position_m, log.position_fixes.position_m)
    assert back.truth_trajectory is not None and log.truth_trajectory is not None
    assert back.truth_trajectory.heading_known == log.truth_trajectory.heading_known
    got, expected = back.truth_trajectory.T_world_robot, log.truth_trajectory.T_world_robot
    np.testing.assert_array_equal(got[:, :2], expected[:, :2])
    # Sine, cosine, products and atan2 of the half angle each err by at most about one unit in the last place
    # of 1; eight of them stay within 2e-15. Headings of +-pi are one heading.
    turn = np.abs(np.angle(np.exp(1j * (got[:, 2] - expected[:, 2]))))
    assert np.isnan(turn).all() if not log.truth_trajectory.heading_known else turn.max() < 2e-15


def minimal_log(**changes: Any) -> Log:
    nobody = np.array([0], dtype=np.int64)
    parts: dict[str, Any] = {
        "name": "small",
        "source": "memory",
        "format": "test",
        "controls": Controls(np.array([0.0]), np.array([[1.0, 0.0]])),
        "sightings": Sightings(np.zeros(1), np.ones(1), np.zeros(1), nobody, nobody - 1, np.full(1, np.nan)),
        "identity_names": ("a",),
        "config": {"motion": {"model": "velocity"}, "sensor": SENSOR},
    }
    return Log(**(parts | changes))


@pytest.mark.parametrize("name", ["", " a", "a\n", "a\tb"])
def test_name_that_would_not_read_back_is_refused(tmp_path: Path, name: str) -> None:
    with pytest.raises(DataError, match="is empty, has blanks around it or cannot be printed"):
        write_native(minimal_log(identity_names=(name,)), tmp_path / "log")
    assert not (tmp_path / "log").exists()


def test_log_without_a_motion_model_is_refused(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="no motion model and sensor settings to write"):
        write_native(minimal_log(config={}), tmp_path / "log")
    assert not (tmp_path / "log").exists()


def test_folder_with_files_is_not_overwritten(tmp_path: Path) -> None:
    folder = write_native(minimal_log(), tmp_path / "log")
    with pytest.raises(DataError, match="is not an empty folder"):
        write_native(minimal_log(), folder)
    assert load(folder).identity_names == ("a",)

"""Whatever stands in a file of scans, reading and detecting ends with scans or with one clear error."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.io
from fastslam.datasets import load, write_native
from fastslam.detection import find
from fastslam.errors import DataError
from fastslam.log import Log
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from test_datasets_formats import car_park, victoria_scans
from test_detection import log_of_posts

FUZZ = settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
KINDS = ("trunks", "reflectors", "corners")

ODD = st.sampled_from([np.nan, np.inf, -np.inf, 0.0, -1.0, 1e-300, 1e300, 7.0, 81.91])
NUMBERS = st.one_of(ODD, st.floats(allow_nan=True, allow_infinity=True))
ARRAYS: dict[str, Any] = {
    "stamp_s": st.lists(NUMBERS, max_size=4).map(np.array),
    "ranges_m": st.tuples(st.integers(0, 4), st.integers(0, 9), st.randoms(use_true_random=False)).map(
        lambda shape: np.array(
            [[shape[2].choice([np.nan, np.inf, 0.0, 5.0, 5.1, 80.0]) for _ in range(shape[1])]] * shape[0]
        )
    ),
    "intensities": st.integers(0, 400).map(lambda beams: np.ones((4, beams))),
    "first_angle_rad": NUMBERS,
    "angle_step_rad": st.one_of(NUMBERS, st.just(-np.pi / 360), st.just(np.pi / 100)),
    "min_range_m": NUMBERS,
    "max_range_m": NUMBERS,
    "beam_period_s": NUMBERS,
    "mounting": st.lists(NUMBERS, max_size=4).map(np.array),
    "detector_json": st.one_of(st.text(max_size=20), st.just('{"kind": "corners"}')).map(np.array),
}
CHANGES = st.fixed_dictionaries({}, optional=ARRAYS)


def use(path: Path) -> int:
    """Read and detect with every detector; the number of logs that came through, 0 or 1."""
    try:
        log = load(path)
    except DataError as error:
        assert str(path) in str(error) or path.name in str(error), "the error says where"
        return 0
    assert log.scans is not None
    for kind in KINDS:
        try:
            found = find(log.scans, {"kind": kind})
        except DataError as error:
            assert "geometry" in str(error) or "scans" in str(error)
            return 0
        assert np.isfinite(found.range_m).all() and np.isfinite(found.covariance).all()
    return 1


@pytest.fixture(scope="module")
def native(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Log]:
    log = log_of_posts()
    return write_native(log, tmp_path_factory.mktemp("fuzz") / "log"), log


def test_any_arrays_in_scans_npz(native: tuple[Path, Log]) -> None:
    folder, _ = native
    with np.load(folder / "scans.npz") as content:
        whole = dict(content)
    came_through: list[int] = []

    @FUZZ
    @given(CHANGES)
    @example({})
    @example({"angle_step_rad": -np.pi / 360, "first_angle_rad": np.pi / 2})
    def check(changes: dict[str, Any]) -> None:
        np.savez(folder / "scans.npz", **{**whole, **changes})
        came_through.append(use(folder))

    check()
    np.savez(folder / "scans.npz", **whole)
    assert 2 <= sum(came_through) < len(came_through), "some are read and some refused"


def test_any_bytes_in_scans_npz(native: tuple[Path, Log]) -> None:
    folder, _ = native
    whole = (folder / "scans.npz").read_bytes()
    came_through: list[int] = []

    @FUZZ
    @given(st.integers(0, len(whole) - 1), st.binary(min_size=1, max_size=8), st.integers(0, len(whole)))
    def check(at: int, junk: bytes, keep: int) -> None:
        damaged = bytearray(whole)
        damaged[at : at + len(junk)] = junk
        (folder / "scans.npz").write_bytes(bytes(damaged[: max(keep, at)]))
        came_through.append(use(folder))

    check()
    (folder / "scans.npz").write_bytes(whole)
    assert use(folder) == 1 and len(came_through) >= 100


def test_any_text_in_the_laser_file_of_victoria_park(tmp_path: Path) -> None:
    folder = victoria_scans(tmp_path)
    words = (folder / "LASER.txt").read_text(encoding="utf-8").split()
    came_through: list[int] = []

    @FUZZ
    @given(
        st.integers(0, len(words) - 1),
        st.sampled_from(["nan", "inf", "-inf", "0", "x", "", "1e999", "-3", "5"]),
    )
    @example(3, "nan")
    @example(0, "x")
    def check(at: int, word: str) -> None:
        changed = [*words[:at], word, *words[at + 1 :]]
        (folder / "LASER.txt").write_text(" ".join(changed), encoding="utf-8")
        came_through.append(use(folder))

    check()
    assert 0 < sum(came_through) < len(came_through)


def test_any_matrix_in_the_laser_file_of_the_car_park(tmp_path: Path) -> None:
    folder = car_park(tmp_path)
    path = next(folder.glob("juan*_lsr2.mat"))
    whole = {name: value for name, value in scipy.io.loadmat(path).items() if not name.startswith("__")}
    kinds = st.sampled_from([np.uint16, np.int32, np.float64])
    shapes = st.tuples(st.integers(0, 3), st.sampled_from([0, 1, 360, 361, 362]))
    came_through: list[int] = []

    @FUZZ
    @given(st.sampled_from(["LASER", "TLsr"]), shapes, kinds, st.integers(0, 65535))
    def check(name: str, shape: tuple[int, int], kind: Any, value: int) -> None:
        content = io.BytesIO()
        scipy.io.savemat(content, {**whole, name: np.full(shape, value, dtype=kind)})
        path.write_bytes(content.getvalue())
        came_through.append(use(folder))

    check()
    scipy.io.savemat(path, whole)
    assert use(folder) == 1 and len(came_through) - sum(came_through) > 0

"""Data frames in and out, and what a result gives to other programs."""

from __future__ import annotations

import dataclasses
import subprocess
import sys
from datetime import timedelta
from typing import Any

import fastslam
import numpy as np
import pandas as pd
import polars as pl
import pytest
from fastslam.datasets import write_native
from fastslam.errors import ConfigError, DataError
from fastslam.log import Log
from fastslam.result import RunResult
from fastslam.resultfiles import LANDMARKS_FILE, SMOOTHED_FILE, STEPS_FILE, TRAJECTORY_FILE, write_result
from small_log import make_small_log

BACKENDS = ("pandas", "polars")
MAKE: dict[str, Any] = {"pandas": pd.DataFrame, "polars": pl.DataFrame}
ODOMETRY = {"t": [0.0, 0.1, 0.2], "v": [1.0, 1.0, 1.0], "w": [0.0, 0.1, 0.1]}
SIGHTINGS = {"t": [0.1, 0.2], "Range [mm]": [4200, 4100], "bearing_deg": [18.0, -90.0], "tag": ["a", None]}


@pytest.fixture(scope="module")
def log() -> Log:
    return make_small_log(steps=120)


@pytest.fixture(scope="module")
def result(log: Log) -> RunResult:
    return fastslam.run(log, {"filter": {"particles": 20}, "seed": 5})


def changed(columns: dict[str, list[Any]], **new: list[Any]) -> dict[str, list[Any]]:
    return {name: column for name, column in {**columns, **new}.items() if column}


def same(left: Log, right: Log) -> None:
    for part in ("controls", "sightings"):
        for field in dataclasses.fields(getattr(left, part)):
            np.testing.assert_array_equal(
                getattr(getattr(left, part), field.name), getattr(getattr(right, part), field.name)
            )
    assert left.identity_names == right.identity_names and left.class_names == right.class_names


@pytest.mark.parametrize("backend", BACKENDS)
def test_a_log_goes_through_frames_to_the_same_bits_as_through_files(
    log: Log, backend: Any, tmp_path: Any
) -> None:
    rng = np.random.default_rng(8)
    count = len(log.sightings.stamp_s)
    signature = np.where(rng.random(count) < 0.5, np.nan, rng.random(count))
    identity = np.where(rng.random(count) < 0.3, -1, log.sightings.identity)
    class_index = rng.integers(-1, 2, count)
    covariance = np.column_stack([np.full(count, 0.01), np.zeros(count), rng.uniform(1e-4, 2e-4, count)])
    covariance[::3] = np.nan
    seen = dataclasses.replace(
        log.sightings, identity=identity, signature=signature, class_index=class_index, covariance=covariance
    )
    full = dataclasses.replace(log, sightings=seen, class_names=("blue", "yellow"))
    made = Log.from_dataframe(*full.to_dataframes(backend), config=full.config)
    same(made, fastslam.load(write_native(full, tmp_path / "log")))
    assert set(made.identity_names) == set(log.identity_names) and made.problems == ()
    np.testing.assert_array_equal(made.sightings.range_m, log.sightings.range_m)
    np.testing.assert_array_equal(made.sightings.signature, signature)
    np.testing.assert_array_equal(made.controls.values, log.controls.values)


@pytest.mark.parametrize("backend", BACKENDS)
def test_names_and_units_of_frames_are_those_of_files(backend: str) -> None:
    log = Log.from_dataframe(
        MAKE[backend](ODOMETRY),
        MAKE[backend](SIGHTINGS),
        config={"sensor": {"model": "range_bearing", "range_std_cm": 5, "bearing_std_deg": 1}},
        name="mine",
    )
    assert log.name == "mine" and log.config["motion"]["model"] == "velocity"
    assert log.config["sensor"]["range_std_m"] == pytest.approx(0.05)
    np.testing.assert_allclose(log.sightings.range_m, [4.2, 4.1])
    np.testing.assert_allclose(log.sightings.bearing_rad, np.radians([18.0, -90.0]))
    assert log.identity_names == ("a",) and log.sightings.identity.tolist() == [0, -1]
    assert "odometry: column v names no unit: taken as speed_m_per_s" in log.notes
    assert any(note.startswith("config names no motion model: velocity") for note in log.notes)
    assert len(fastslam.run(log, {"filter": {"particles": 3}}).landmarks.ids) == 2


@pytest.mark.parametrize("backend", BACKENDS)
def test_dates_gaps_and_indexes(backend: str) -> None:
    zoned = pd.to_datetime(["2024-05-01T10:00:00.5Z", "2024-05-01T10:00:01.25Z"])
    frame = pd.DataFrame({"time": zoned, "range_m": [2.0, 3.0], "bearing_rad": [0.0, 0.1], "id": [7, None]})
    moves = pd.DataFrame({"time": zoned.tz_convert("Asia/Tokyo"), "v": [1.0, 2.0], "w": [0.0, np.nan]})
    if backend == "pandas":
        given: tuple[Any, Any] = (moves.set_index("time"), frame)
    else:
        given = (pl.DataFrame(moves.to_dict("list")), pl.DataFrame(frame.to_dict("list"), strict=False))
    log = Log.from_dataframe(*given)
    # 10:00 of that day, as `date -d 2024-05-01T10:00Z +%s` says it.
    assert log.sightings.stamp_s.tolist() == [1714557600.5, 1714557601.25]
    assert log.controls.stamp_s.tolist() == [1714557600.5]
    assert [(problem.count, problem.message[:24]) for problem in log.problems] == [
        (1, "odometry rows with NaN o"),
    ]
    assert log.identity_names == ("7",) and log.sightings.identity.tolist() == [0, -1]


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize(
    ("odometry", "sightings", "message"),
    [
        ({"w": []}, {}, r"odometry: column yaw_rate_rad_per_s is missing: got stamp_s,speed_m_per_s"),
        ({"sped": [1, 2, 3]}, {}, r"^odometry: unknown column: got sped, .* did you mean speed_m_per_s"),
        ({"sped_km_per_h": [1, 2, 3]}, {}, r"got sped_km_per_h, .* did you mean speed_km_per_h\?"),
        ({"v": ["1", "2", "fast"]}, {}, r"^odometry:2: v: got 'fast', expected a number"),
        ({}, {"bearing_deg": [20000.0, 30000.0]}, r"^sightings: bearings up to .* degrees\?"),
        ({"t": [0.0, 5.0, 1.0]}, {}, r"^odometry: clock set back: odometry row 3"),
        ({"t": [], "v": [], "w": []}, {}, r"odometry: the data frame has no rows"),
        (
            {"t": [timedelta(seconds=second) for second in range(3)]},
            {},
            "column t holds durations: give seconds",
        ),
        (
            {"v": [], "w": [], "left_ticks": [1, 2, 3], "right_ticks": [1, 2, 3]},
            {},
            r"^odometry: config names no motion model, .*: add",
        ),
    ],
)
def test_frames_that_make_no_log_are_refused(
    backend: str, odometry: dict[str, Any], sightings: dict[str, Any], message: str
) -> None:
    frames = (MAKE[backend](changed(ODOMETRY, **odometry)), MAKE[backend](changed(SIGHTINGS, **sightings)))
    with pytest.raises(DataError, match=message) as caught:
        Log.from_dataframe(*frames)
    assert "log.yaml" not in str(caught.value) and ".csv" not in str(caught.value)


def test_what_is_no_frame_or_no_backend_is_refused(
    result: RunResult, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(DataError, match=r"odometry: got \[1, 2\], expected a data frame of pandas"):
        Log.from_dataframe([1, 2], pd.DataFrame(SIGHTINGS))
    with pytest.raises(DataError, match="collect a lazy one first"):
        Log.from_dataframe(pl.LazyFrame(ODOMETRY), pd.DataFrame(SIGHTINGS))
    with pytest.raises(ConfigError, match="config: got 'velocity'"):
        Log.from_dataframe(pd.DataFrame(ODOMETRY), pd.DataFrame(SIGHTINGS), config="velocity")  # type: ignore[arg-type]
    with pytest.raises(DataError, match="config: unknown key sensr, did you mean sensor"):
        Log.from_dataframe(pd.DataFrame(ODOMETRY), pd.DataFrame(SIGHTINGS), config={"sensr": {}})
    with pytest.raises(ConfigError, match="backend: got 'excel', expected one of pandas, polars, pyarrow"):
        result.landmarks.to_dataframe("excel")  # type: ignore[arg-type]
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(ConfigError, match="pyarrow is not installed: pip install pyarrow"):
        result.landmarks.to_dataframe("pyarrow")
    monkeypatch.setitem(sys.modules, "narwhals", None)
    with pytest.raises(ConfigError, match="pip install narwhals"):
        result.landmarks.to_dataframe("pandas")


def test_frames_of_a_result_are_its_files(log: Log, result: RunResult, tmp_path: Any) -> None:
    files = write_result(result, log, tmp_path)
    for file, table in ((LANDMARKS_FILE, result.landmarks), (STEPS_FILE, result.steps)):
        read = pd.read_csv(files[file], keep_default_na=False, na_values=[""])
        made = table.to_dataframe("pandas")
        assert list(made) == [name for name in read if name in made] and len(made) == len(read) > 5
        for name in made:
            if made[name].dtype.kind == "f":
                np.testing.assert_allclose(made[name], read[name], rtol=1e-8)
            elif made[name].dtype.kind in "ib":
                assert made[name].astype(int).tolist() == read[name].tolist()
            else:
                texts = [column.astype(object).fillna("").tolist() for column in (made[name], read[name])]
                assert texts[0] == texts[1]
    path = result.trajectory.to_dataframe("polars")
    assert path.columns[:4] == ["stamp_s", "x_m", "y_m", "heading_rad"] and len(path.columns) == 10
    np.testing.assert_array_equal(path["y_m"].to_numpy(), result.trajectory.T_world_robot[:, 1])
    assert "cov_xx_m2" not in result.smoothed.to_columns()
    assert result.to_tum() == files[TRAJECTORY_FILE].read_text()
    assert result.to_tum(path="smoothed") == files[SMOOTHED_FILE].read_text() != result.to_tum()
    with pytest.raises(ConfigError, match="path: got true, expected live or smoothed"):
        result.to_tum(path="true")  # type: ignore[arg-type]


def test_geojson_of_a_result_has_the_path(result: RunResult) -> None:
    features = result.to_geojson(coordinates="local_metres")["features"]
    assert [feature["id"] for feature in features] == [*result.landmarks.ids, "path"]
    assert features[-1]["geometry"]["type"] == "LineString"
    assert features[-1]["geometry"]["coordinates"][0] == result.smoothed.T_world_robot[0, :2].tolist()


def test_without_frames_no_frame_library_is_loaded() -> None:
    code = "import fastslam.frames, sys; print({'narwhals', 'pandas', 'polars'} & set(sys.modules))"
    assert subprocess.check_output([sys.executable, "-c", code], text=True).strip() == "set()"

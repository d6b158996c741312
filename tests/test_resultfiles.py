"""The results folder: written whole or not at all, and read back as it was."""

from __future__ import annotations

import json
import os
from dataclasses import fields, replace
from datetime import datetime
from pathlib import Path

import numpy as np
import pytest
import yaml
from fabricate import make_log, make_map, make_run, make_steps
from fastslam.errors import DataError
from fastslam.evaluation import evaluate
from fastslam.result import Trajectory
from fastslam.resultfiles import (
    new_result_folder,
    read_result,
    to_json,
    write_atomically,
    write_measured,
    write_result,
)

FILES = {
    *("trajectory.tum", "smoothed.tum", "landmarks.csv", "metrics.json", "config.yaml", "steps.csv"),
    *("run.json", "trajectory_covariance.csv"),
}


def test_a_run_comes_back_as_it_was(tmp_path: Path) -> None:
    run, log = make_run(interrupted=True), make_log()
    paths = write_result(run, log, tmp_path / "new" / "folder")
    assert set(paths) == FILES == {path.name for path in (tmp_path / "new" / "folder").iterdir()}
    found = read_result(tmp_path / "new" / "folder")
    assert (found.config, found.version, found.log_name) == (run.config, run.version, run.log_name)
    assert (found.counts, found.interrupted) == (run.counts, True)
    assert (found.filter_seconds, found.peak_memory_bytes, found.map_bytes) == (2.0, 12_345_678, 4_321)
    assert found.landmarks.ids == run.landmarks.ids
    np.testing.assert_allclose(found.landmarks.mean_m, run.landmarks.mean_m, rtol=1e-8)
    np.testing.assert_allclose(found.landmarks.covariance_m2, run.landmarks.covariance_m2, rtol=1e-8)
    for name in ("trajectory", "smoothed"):
        there, here = getattr(run, name), getattr(found, name)
        np.testing.assert_array_equal(here.stamp_s, there.stamp_s)
        np.testing.assert_allclose(here.T_world_robot, there.T_world_robot, rtol=1e-8, atol=1e-8)
    assert found.trajectory.covariance is not None
    assert run.trajectory.covariance is not None
    np.testing.assert_allclose(found.trajectory.covariance, run.trajectory.covariance, rtol=1e-8)
    assert found.smoothed.covariance is None
    for field in fields(run.steps):
        there, here = getattr(run.steps, field.name), getattr(found.steps, field.name)
        np.testing.assert_allclose(here, there, rtol=1e-8, err_msg=field.name)
        assert here.dtype == there.dtype, field.name


def test_scoring_the_files_again_gives_the_same_metrics(tmp_path: Path) -> None:
    rng = np.random.default_rng(5)
    run, log = make_run(path_error_m=rng.normal(0.0, 0.3, (200, 2))), make_log(fixes=True)
    write_result(run, log, tmp_path)
    again = evaluate(read_result(tmp_path), log)
    written = json.loads((tmp_path / "metrics.json").read_text())
    assert set(again) == set(written)
    for name in ("ate_rmse_m", "smoothed_ate_rmse_m", "gps_median_m", "heading_rmse_rad"):
        assert again[name] == pytest.approx(written[name], rel=1e-6), name


def test_tum_lines_by_hand(tmp_path: Path) -> None:
    stamp = 1_288_971_842.161  # Unix time: the digits after the point must survive.
    path = Trajectory(np.array([stamp]), np.array([[1.5, -2.0, np.pi / 2]]))
    write_result(make_run(trajectory=path, smoothed=path), make_log(truth=False), tmp_path)
    header, line = (tmp_path / "trajectory.tum").read_text().splitlines()
    assert header.startswith("#")
    fields = line.split()
    assert fields[0] == "1288971842.161"
    assert fields[1:6] == ["1.5", "-2", "0", "0", "0"]
    assert [float(field) for field in fields[6:]] == pytest.approx([np.sqrt(0.5), np.sqrt(0.5)])


def test_landmark_columns_and_awkward_names(tmp_path: Path) -> None:
    ids = ('oak, "old"', "two\nlines", "größe")
    points = np.array([[0.0, 0.0], [1.0, 2.0], [3.0, 1.0]])
    write_result(make_run(landmarks=make_map(ids, points)), make_log(truth=False), tmp_path)
    text = (tmp_path / "landmarks.csv").read_text(encoding="utf-8")
    first = "id,x_m,y_m,cov_xx_m2,cov_xy_m2,cov_yy_m2,sightings,confirmed,class,signature"
    residuals = "range_residuals,range_residual_rms,range_residual_mean"
    assert text.splitlines()[0] == ",".join([first, residuals, residuals.replace("range", "bearing")])
    assert '"oak, ""old""",3,-2,0.02,0.008,0.01,20' in text
    assert read_result(tmp_path).landmarks.ids == ids


def test_metrics_hold_no_nan(tmp_path: Path) -> None:
    metrics = {"a": float("nan"), "b": np.float64(2.5), "c": {"d": float("inf"), "e": np.int64(3)}}
    assert json.loads(to_json(metrics)) == {"a": None, "b": 2.5, "c": {"d": None, "e": 3}}
    steps = make_steps(np.arange(3.0))
    run = make_run(steps=replace(steps, effective_sample_size=np.full(3, np.nan)))
    write_result(run, make_log(), tmp_path)
    text = (tmp_path / "metrics.json").read_text()
    assert "NaN" not in text
    assert json.loads(text)["mean_effective_sample_size"] is None


def test_the_configuration_can_be_given_to_a_run_again(tmp_path: Path) -> None:
    run = make_run()
    write_result(run, make_log(), tmp_path)
    text = (tmp_path / "config.yaml").read_text()
    assert yaml.safe_load(text) == run.config
    assert "0.0.test" in text.splitlines()[0]


def test_an_empty_run_is_written_and_read(tmp_path: Path) -> None:
    nothing = Trajectory(np.zeros(0), np.zeros((0, 3)))
    run = make_run(
        trajectory=nothing,
        smoothed=nothing,
        landmarks=make_map((), np.zeros((0, 2))),
        steps=make_steps(np.zeros(0)),
    )
    write_result(run, make_log(), tmp_path)
    found = read_result(tmp_path)
    assert found.landmarks.mean_m.shape == (0, 2)
    assert found.trajectory.T_world_robot.shape == (0, 3)
    assert len(found.steps.stamp_s) == 0


def test_a_failed_write_leaves_the_old_file_and_no_rest(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    target = tmp_path / "metrics.json"
    write_atomically(target, "old")

    def refuse(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "replace", refuse)
    with pytest.raises(DataError, match=r"metrics\.json: cannot write: No space left on device"):
        write_atomically(target, "new")
    assert target.read_text() == "old"
    assert list(tmp_path.iterdir()) == [target]


def test_a_file_in_the_way_of_the_folder_is_one_clear_error(tmp_path: Path) -> None:
    (tmp_path / "out").write_text("mine")
    with pytest.raises(DataError, match="cannot write"):
        write_result(make_run(), make_log(), tmp_path / "out")
    with pytest.raises(DataError, match="cannot make a results folder"):
        new_result_folder(tmp_path / "out")
    assert (tmp_path / "out").read_text() == "mine"


def test_result_folders_are_stamped_and_latest_points_to_the_last(tmp_path: Path) -> None:
    now = datetime(2001, 2, 3, 4, 5, 6)
    first = new_result_folder(tmp_path / "results", now=now)
    second = new_result_folder(tmp_path / "results", now=now)
    assert (first.name, second.name) == ("2001-02-03_04-05-06", "2001-02-03_04-05-06-2")
    latest = tmp_path / "results" / "latest"
    assert not latest.is_symlink(), "nothing is complete yet"
    write_result(make_run(), make_log(), second)
    assert latest.is_symlink()
    assert latest.resolve() == second.resolve()
    assert read_result(latest).version == "0.0.test"
    new_result_folder(tmp_path / "results", now=now)
    assert latest.resolve() == second.resolve()


def test_without_links_latest_is_a_file_with_the_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise OSError("links are not allowed here")

    monkeypatch.setattr(Path, "symlink_to", refuse)
    write_result(make_run(), make_log(), new_result_folder(tmp_path, now=datetime(2001, 1, 1)))
    folder = new_result_folder(tmp_path, now=datetime(2001, 1, 2))
    write_result(make_run(), make_log(), folder)
    assert (tmp_path / "latest").read_text().strip() == folder.name
    assert read_result(tmp_path / "latest").version == "0.0.test"


def test_a_folder_named_latest_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "latest").mkdir()
    (tmp_path / "latest" / "precious").write_text("data")
    write_result(make_run(), make_log(), new_result_folder(tmp_path))
    assert (tmp_path / "latest" / "precious").read_text() == "data"


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("trajectory.tum", "# fine\n0 1 2 3\n", r"trajectory\.tum:2: expected 8 numbers"),
        ("smoothed.tum", "0 0 0 x 0 0 0 1\n", r"smoothed\.tum:1: expected a number, got 'x'"),
        ("landmarks.csv", "id,x,y\n", r"landmarks\.csv:1: expected the header id,x_m"),
        ("steps.csv", "", r"steps\.csv:1: expected the header"),
        ("config.yaml", "[1, 2", r"config\.yaml:1: not YAML"),
        ("config.yaml", "- 1\n", r"config\.yaml:1: expected a mapping"),
        ("run.json", "{\n", r"run\.json:\d: not JSON"),
        ("run.json", "{}", r"run\.json: `version` is missing"),
        ("trajectory_covariance.csv", None, "expected 200 rows, one per pose, got 199"),
        ("landmarks.csv", b"\xff\xfe", "cannot read"),
    ],
)
def test_damaged_files_are_named(tmp_path: Path, name: str, text: str | bytes | None, message: str) -> None:
    write_result(make_run(), make_log(), tmp_path)
    path = tmp_path / name
    if text is None:
        path.write_text("".join(path.read_text().splitlines(keepends=True)[:-1]))
    else:
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(DataError, match=message):
        read_result(tmp_path)


def test_missing_files_and_folders_are_named(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="no such results folder"):
        read_result(tmp_path / "nowhere")
    write_result(make_run(), make_log(), tmp_path)
    (tmp_path / "smoothed.tum").unlink()
    with pytest.raises(DataError, match=r"smoothed\.tum: no such file"):
        read_result(tmp_path)


def test_what_is_measured_takes_the_place_of_what_was(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    marked = "before\n<!-- measured: begin -->\n\n{}\n\n<!-- measured: end -->\nafter\n"
    page.write_text(marked.format("old"))
    for _ in range(2):
        write_measured(page, "new\n")
        assert page.read_text() == marked.format("new")
    page.write_text("no marks\n")
    with pytest.raises(DataError, match="has no part between"):
        write_measured(page, "new\n")
    assert page.read_text() == "no marks\n"

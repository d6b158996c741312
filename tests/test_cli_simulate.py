"""`fastslam simulate`: native logs with truth, reproducible from their settings."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from cli_runner import fastslam
from fastslam.datasets import load
from fastslam.simulation import SCHEMA, presets, resolve_simulation, simulate

SMALL = ("--set", "max_duration_s=10")


def test_writes_a_log_that_can_be_read_with_its_truth(tmp_path: Path) -> None:
    out = tmp_path / "log"
    outcome = fastslam("simulate", out, "--landmarks", "80", "--seed", "3", *SMALL)
    assert outcome.exit_code == 0, outcome.stderr
    log = load(out)
    assert log.truth_landmarks is not None and log.truth_trajectory is not None
    assert len(log.truth_landmarks.names) == 80
    assert len(log.sightings.stamp_s) > 50
    assert f"{len(log.sightings.stamp_s):,} sightings of 80 landmarks" in outcome.stdout
    start = log.truth_trajectory.T_world_robot[0]
    assert log.config["initial_pose"] == pytest.approx(
        {"x_m": start[0], "y_m": start[1], "heading_rad": start[2]}, abs=1e-12
    )


def test_sightings_agree_with_truth_to_the_noise(tmp_path: Path) -> None:
    log = simulate(resolve_simulation({"max_duration_s": 30.0}, preset="demo"))
    assert log.truth_landmarks is not None and log.truth_trajectory is not None
    pose = log.truth_trajectory.T_world_robot[
        np.searchsorted(log.truth_trajectory.stamp_s, log.sightings.stamp_s - 1e-9)
    ]
    offset = log.truth_landmarks.position_m[log.sightings.identity] - pose[:, :2]
    residual_m = log.sightings.range_m - np.hypot(offset[:, 0], offset[:, 1])
    range_std_m = log.config["sensor"]["range_std_m"]
    count = len(residual_m)
    assert count > 200
    # Five standard errors of a standard deviation and of a mean: one false alarm in about a million.
    assert np.std(residual_m) == pytest.approx(range_std_m, rel=5.0 / np.sqrt(2 * count))
    assert abs(np.mean(residual_m)) < 5.0 * range_std_m / np.sqrt(count)


def test_kept_settings_make_the_same_log_again(tmp_path: Path) -> None:
    first, second = tmp_path / "first", tmp_path / "second"
    fastslam("simulate", first, "--preset", "cones", "--seed", "9", *SMALL)
    outcome = fastslam("simulate", second, "--config", first / "simulation.yaml")
    assert outcome.exit_code == 0, outcome.stderr
    names = sorted(path.name for path in first.iterdir() if path.name != "log.yaml")
    assert len(names) >= 5
    for name in names:
        assert (first / name).read_bytes() == (second / name).read_bytes(), name


def test_every_preset_resolves() -> None:
    assert len(presets()) >= 5
    for name, settings in presets().items():
        assert dict(SCHEMA.resolve(settings)) == settings, name


def test_a_layout_takes_its_own_settings_in_any_order(tmp_path: Path) -> None:
    for number, order in enumerate(
        (("world.rows=2", "world.layout=orchard"), ("world.layout=orchard", "world.rows=2"))
    ):
        arguments = [part for setting in order for part in ("--set", setting)]
        outcome = fastslam(
            "simulate",
            tmp_path / str(number),
            *arguments,
            "--path",
            "lawn_mower",
            "--set",
            "world.missing_probability=0",
        )
        assert "sightings of 50 landmarks" in outcome.stdout, outcome.stderr


@pytest.mark.parametrize(
    ("arguments", "contains"),
    [
        (("--set", "world.cuont=3"), "did you mean world.count?"),
        (("--set", "world.count=0"), "world.count"),
        (("--set", "world.rows=3"), "world.rows: only for layout = orchard"),
        (("--preset", "moon"), "expected one of demo"),
        (("--landmarks", "0"), "landmarks: got 0"),
        (("--max-range-m", "-1"), "sensor.max_range_m"),
        (("--set", "world.size_m=[5, 5]", "--set", "world.min_spacing_m=3"), "world."),
        (("--config", "nosuch.yaml"), "nosuch.yaml: does not exist"),
    ],
)
def test_bad_settings_are_one_line(tmp_path: Path, arguments: tuple[str, ...], contains: str) -> None:
    outcome = fastslam("simulate", tmp_path / "log", *arguments)
    outcome.assert_one_line_error(exit_code=2, contains=contains)
    assert not (tmp_path / "log").exists()


def test_a_folder_in_use_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "precious.txt").write_text("mine")
    fastslam("simulate", tmp_path, *SMALL).assert_one_line_error(exit_code=1, contains="not an empty folder")
    assert [path.name for path in tmp_path.iterdir()] == ["precious.txt"]


def test_explain_lists_every_setting() -> None:
    outcome = fastslam("simulate", "--explain")
    assert outcome.exit_code == 0
    assert len(SCHEMA.keys) > 30
    for info in SCHEMA.keys:
        assert info.name in outcome.stdout


def test_a_rover_with_a_laser_maps_its_rocks_from_raw_scans(tmp_path: Path) -> None:
    """Simulate, detect, associate, map: the whole way with the commands a user would type."""
    folder, out = tmp_path / "rover", tmp_path / "out"
    outcome = fastslam("simulate", folder, "--preset", "rover", "--seed", 1, "--set", "trajectory.laps=1")
    assert outcome.exit_code == 0 and "laser scans among 31 rocks" in outcome.stdout, outcome.stderr
    assert (folder / "scans.npz").is_file() and not (folder / "sightings.csv").exists()
    options = ("--particles", 10, "--seed", 1, "--no-report", "--out", out)
    assert fastslam("run", folder, *options).exit_code == 0
    metrics = json.loads((out / "metrics.json").read_text())
    # Of 8 worlds, two laps: all rocks found, one false or double landmark in one, 3 to 8 mm on the map.
    assert metrics["landmark_recall"] >= 0.96
    assert metrics["landmark_precision"] >= 0.96
    assert metrics["landmark_rmse_m"] <= 0.012
    assert metrics["ate_rmse_m"] <= 0.02


def test_a_simulated_laser_sees_the_rocks_and_walls_where_they_are() -> None:
    settings = {"seed": 2, "scan": {"laser": {"range_std_m": 0.0, "dropout_probability": 0.0}}}
    log = simulate(resolve_simulation(settings, {"max_duration_s": 20.0}, preset="rover"))
    assert log.scans is not None and log.truth_landmarks is not None and log.truth_trajectory is not None
    assert len(log.sightings.stamp_s) == 0 and log.identity_names == ()
    assert log.scans.ranges_m.shape == (41, 361)
    row = np.searchsorted(log.truth_trajectory.stamp_s, log.scans.stamp_s - 1e-9)
    pose = log.truth_trajectory.T_world_robot[row]
    angle = log.scans.geometry.first_angle_rad + log.scans.geometry.angle_step_rad * np.arange(361)
    heading = pose[:, 2, None] + angle
    hit_x = pose[:, 0, None] + log.scans.ranges_m * np.cos(heading)
    hit_y = pose[:, 1, None] + log.scans.ranges_m * np.sin(heading)
    hit = np.isfinite(log.scans.ranges_m)
    points = np.column_stack([hit_x[hit], hit_y[hit]])
    offset = points[:, None] - log.truth_landmarks.position_m
    nearest_m = np.hypot(offset[..., 0], offset[..., 1]).min(axis=1)
    on_rock = nearest_m < 0.4 + 1e-9
    # No echo comes from within a rock, and those that are of no rock are of the walls.
    assert nearest_m.min() >= 0.1 - 1e-9 and 500 < on_rock.sum() < 0.9 * len(points)
    open_field = simulate(
        resolve_simulation(
            settings, {"max_duration_s": 20.0, "scan": {"laser": {"wall_margin_m": None}}}, preset="rover"
        )
    )
    assert open_field.scans is not None
    assert np.isfinite(open_field.scans.ranges_m).sum() == on_rock.sum()


@pytest.mark.parametrize(
    ("setting", "key"),
    [
        ("angle_step_rad=0", "angle_step_rad"),
        ("radius_m=[0.5, 0.1]", "radius_m"),
        ("dropout_probability=2", "dropout_probability"),
        ("clearance_m=-1", "clearance_m"),
    ],
)
def test_a_laser_out_of_range_is_one_line(tmp_path: Path, setting: str, key: str) -> None:
    outcome = fastslam("simulate", tmp_path / "log", "--preset", "rover", "--set", f"scan.laser.{setting}")
    outcome.assert_one_line_error(exit_code=2, contains=f"scan.laser.{key}")

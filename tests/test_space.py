"""Three dimensions: reading, running, scoring and showing logs in space."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from cli_runner import fastslam
from fastslam.errors import ConfigError, DataError
from fastslam.space import SpaceConfig, evaluate, load, matches, run, write_outputs
from fastslam.space.evaluation import alignment, at_stamps, compose, matrices, quaternions
from fastslam.space.learning import learn
from fastslam.space.log import MEASURED, SpaceLog
from fastslam.space.native import ON_THE_GROUND
from fastslam.space.result import SpacePath
from fastslam.space.simulation import POSITION_STD, STD, TURN_STD, simulate

HEADERS = {"point": "x_m,y_m,z_m", "range_bearing_elevation": "range_m,bearing_deg,elevation_rad"}
STEPS, DT_S = 60, 0.1


def turned(vector: np.ndarray) -> np.ndarray:
    """The rotation matrix of a rotation vector."""
    angle = np.linalg.norm(vector)
    quaternion = np.concatenate([[np.cos(angle / 2)], vector / max(angle, 1e-12) * np.sin(angle / 2)])
    return matrices(quaternion[None])[0]


def write_log(folder: Path, model: str = "point", *, noise: float = 0.02, settings: str = "") -> Path:
    """A robot that circles and climbs among eight landmarks, as a native log in space."""
    rng = np.random.default_rng(1)
    landmarks = rng.uniform([-3, -3, -1], [3, 3, 2], (8, 3))
    rotation, position = np.eye(3), np.array([1.5, 0.0, 0.0])
    odometry, seen, truth = [], [], []
    for step in range(STEPS):
        velocity = np.array([0.8, 0.0, 0.1, 0.05, -0.1, 0.6])
        odometry.append([step * DT_S, *velocity])
        true = velocity + rng.normal(0.0, noise, 6)
        position = position + rotation @ turned(true[3:] * DT_S / 2) @ true[:3] * DT_S
        rotation = rotation @ turned(true[3:] * DT_S)
        stamp_s = (step + 1) * DT_S
        truth.append([stamp_s, *position, *quaternions(rotation[None])[0][[1, 2, 3, 0]]])
        for name, landmark in enumerate(landmarks):
            x, y, z = rotation.T @ (landmark - position)
            if model != "point":
                level = np.hypot(x, y)
                x, y, z = np.hypot(level, z), np.degrees(np.arctan2(y, x)), np.arctan2(z, level)
            off = rng.normal(0.0, noise, 3) * (1.0, np.degrees(1.0) if model != "point" else 1.0, 1.0)
            seen.append([stamp_s, f"star-{name}", *(np.array([x, y, z]) + off)])

    def table(header: str, rows: list[list[object]]) -> str:
        return "\n".join([header, *(",".join(str(cell) for cell in row) for row in rows)]) + "\n"

    folder.mkdir(exist_ok=True)
    std = "position_std_m: [0.02, 0.02, 0.02]"
    if model != "point":
        std = "range_std_m: 0.02, bearing_std_rad: 0.02, elevation_std_rad: 0.02"
    (folder / "log.yaml").write_text(
        f"format_version: 1\ndimensions: 3\nsensor: {{model: {model}, {std}}}\n"
        "initial_pose: {x_m: 1.5}\nfilter: {particles: 50}\n" + settings
    )
    names = "stamp_s,vx_m_per_s,vy_m_per_s,vz_m_per_s,wx_rad_per_s,wy_rad_per_s,wz_rad_per_s"
    (folder / "odometry.csv").write_text(table(names, odometry))
    (folder / "sightings.csv").write_text(table(f"stamp_s,landmark_id,{HEADERS[model]}", seen))
    (folder / "truth_trajectory.tum").write_text(
        "\n".join(" ".join(map(repr, map(float, row))) for row in truth)
    )
    places = [[f"star-{name}", *map(float, landmark)] for name, landmark in enumerate(landmarks)]
    (folder / "truth_landmarks.csv").write_text(table("id,x_m,y_m,z_m", places))
    return folder


@pytest.mark.parametrize("model", sorted(HEADERS))
def test_a_native_log_is_read_run_and_scored(model: str, tmp_path: Path) -> None:
    path = write_log(tmp_path / "log", model)
    assert matches(path) == "space"
    log = load(path)
    assert (len(log.row_stamp_s), len(log.value), len(log.names), log.sensor) == (STEPS, 8 * STEPS, 8, model)
    result = run(log)
    metrics = evaluate(result, log)
    # Sixty looks with noise of 0.02, in angles from within 6 m, and a path that is no better.
    assert metrics["map.matched"] == 8 and metrics["map.rmse_m"] < (0.02 if model == "point" else 0.06)
    assert metrics["path.smoothed.position_rmse_m"] < metrics["path.live.position_rmse_m"] < 0.1
    assert metrics["path.smoothed.rotation_rmse_rad"] < 0.02
    assert 0.8 < result.innovation_ratio < 1.3 and result.warnings == ()
    assert 0.1 < metrics["map.nees_per_number"] < 3.0


def test_stereo_is_read_as_pixels(tmp_path: Path) -> None:
    path = write_log(tmp_path / "log")
    (path / "log.yaml").write_text(
        "format_version: 1\ndimensions: 3\nsensor: {model: stereo, column_std_px: 1.0}\n"
    )
    (path / "sightings.csv").write_text(
        "stamp_s,landmark_id,u,v,disparity\n0.1,a,300,200,40\n0.2,b,310,200,-1\n"
    )
    log = load(path)
    assert log.value.tolist() == [[300, 200, 40], [310, 200, -1]]
    result = run(log)
    # 500 px times 0.2 m over 40 px: 2.5 m ahead; a disparity below zero is no point.
    assert result.landmarks.ids == ("a",) and result.counts["sightings_not_finite"] == 1
    assert any("left out" in warning for warning in result.warnings)
    assert set(MEASURED) == {"point", "range_bearing_elevation", "stereo"}


def test_a_log_in_which_nothing_is_seen_again_says_so(tmp_path: Path) -> None:
    path = write_log(tmp_path / "log")
    header, *lines = (path / "sightings.csv").read_text().splitlines()
    once = [line for number, line in enumerate(lines) if line.split(",")[1] not in _names(lines[:number])]
    (path / "sightings.csv").write_text("\n".join([header, *once]) + "\n")
    result = run(load(path))
    assert len(result.landmarks.ids) == len(once) > 0
    assert any(warning.startswith("no landmark was seen twice") for warning in result.warnings)
    command = ("run", str(path), "--no-report", "--out", str(tmp_path / "out"))
    assert fastslam(*command).exit_code == 0 and fastslam(*command, "--strict").exit_code == 1


def _names(lines: list[str]) -> set[str]:
    return {line.split(",")[1] for line in lines}


def test_covariances_of_sightings_are_heeded(tmp_path: Path) -> None:
    path = write_log(tmp_path / "log")
    lines = (path / "sightings.csv").read_text().splitlines()
    names = ",".join(f"covariance_{i}{j}" for i in range(3) for j in range(i, 3))
    wide = [f"{lines[0]},{names}", *(f"{line},0.04,0,0,0.04,0,0.04" for line in lines[1:])]
    (path / "sightings.csv").write_text("\n".join(wide) + "\n")
    result = run(path)
    assert load(path).covariance is not None
    assert result.innovation_ratio < 0.1
    assert any("too large" in warning for warning in result.warnings)
    (path / "sightings.csv").write_text(f"{lines[0]},covariance_00\n{lines[1]},0.1\n")
    with pytest.raises(DataError, match=r"covariance_01 is missing beside covariance_00"):
        load(path)


def test_the_same_seed_gives_the_same_bits_on_any_number_of_threads(tmp_path: Path) -> None:
    log = load(write_log(tmp_path / "log"))
    one, two, other = (
        run(log, {"seed": seed, "filter": {"threads": threads}}) for seed, threads in ((3, 1), (3, 2), (4, 1))
    )
    assert np.array_equal(one.trajectory.T_world_robot, two.trajectory.T_world_robot)
    assert not np.array_equal(one.trajectory.T_world_robot, other.trajectory.T_world_robot)


def test_the_command_leaves_a_folder(tmp_path: Path) -> None:
    path, out = write_log(tmp_path / "log"), tmp_path / "out"
    finished = fastslam("run", str(path), "--out", str(out), "--runs", "2", "--json", "--strict")
    assert finished.exit_code == 0, finished.stderr
    facts = json.loads(finished.stdout)
    assert len(facts["runs"]) == 2 and facts["metrics"]["map.matched"] == 8
    files = {file.name for file in out.iterdir()}
    wanted = {
        "run.json",
        "map.csv",
        "map.png",
        "trajectory.tum",
        "smoothed.tum",
        "metrics.json",
        "config.yaml",
    }
    assert wanted | {"steps.csv", "runs.json", "log.json", "trajectory_covariance.csv"} == files
    header, first, *_ = (out / "map.csv").read_text().splitlines()
    assert header.startswith("id,x_m,y_m,z_m,cov_xx_m2") and first.startswith("star-")
    rows = np.loadtxt(out / "smoothed.tum")
    assert rows.shape == (STEPS, 8) and np.allclose(np.linalg.norm(rows[:, 4:], axis=1), 1.0)
    assert json.loads((out / "run.json").read_text())["dimensions"] == 3
    again = SpaceConfig.resolve({"filter": {"particles": 50}})
    assert again["filter"]["particles"] == 50
    scored = fastslam("eval", str(out), "--json")
    assert scored.exit_code == 0 and json.loads(scored.stdout) == pytest.approx(facts["metrics"], rel=1e-6)
    both = fastslam("eval", str(out), str(out))
    assert both.exit_code == 0 and "2 results: 2 runs" in both.stdout
    fastslam("eval", str(out), "--runs", "3").assert_one_line_error(
        exit_code=2, contains="--runs: not for a log"
    )
    table = fastslam("info", str(path))
    assert table.exit_code == 0 and "three dimensions" in table.stdout and "true landmarks" in table.stdout


def test_what_cannot_be_met_is_said_in_one_line(tmp_path: Path) -> None:
    path = write_log(tmp_path / "log")
    refused = fastslam("run", str(path), "--out", str(tmp_path / "out"), "--algorithm", "ekf")
    refused.assert_one_line_error(exit_code=2, contains="--algorithm: not for a log in three dimensions")
    planar = fastslam("doctor", str(path))
    planar.assert_one_line_error(exit_code=1, contains="is a log in three dimensions")
    flat = tmp_path / "flat"
    write_log(flat)
    settings = (
        (flat / "log.yaml")
        .read_text()
        .replace("dimensions: 3\n", "")
        .replace("point", "range_bearing_elevation")
    )
    (flat / "log.yaml").write_text(settings)
    needs = fastslam("run", str(flat), "--out", str(tmp_path / "out"))
    needs.assert_one_line_error(
        exit_code=1, contains="range_bearing_elevation needs a map in three dimensions"
    )


@pytest.mark.parametrize(
    ("file", "old", "new", "message"),
    [
        ("log.yaml", "point", "echo", r"log\.yaml:3: sensor\.model: got echo, expected"),
        ("log.yaml", "filter:", "fitler:", r"log\.yaml:\d+: unknown key fitler"),
        ("log.yaml", "x_m: 1.5", "qw: 0.5", r"initial_pose\.qw: got 0\.5, expected a quaternion of length 1"),
        ("log.yaml", "format_version: 1", "format_version: 2", r"format_version: got 2, expected 1"),
        ("odometry.csv", "vz_m_per_s", "vq", r"odometry\.csv:1: "),
        ("odometry.csv", "\n0.1,", "\n0.0,", r"odometry\.csv:3: the stamp is not later"),
        ("sightings.csv", "z_m", "w_m", r"sightings\.csv:1: "),
        ("sightings.csv", "star-0,", "star-0,x", r"sightings\.csv:2: "),
        ("truth_trajectory.tum", "0.1 ", "0.1 1 ", r"truth_trajectory\.tum"),
    ],
)
def test_faults_are_named(file: str, old: str, new: str, message: str, tmp_path: Path) -> None:
    path = write_log(tmp_path / "log")
    text = (path / file).read_text()
    assert old in text
    (path / file).write_text(text.replace(old, new, 1))
    with pytest.raises(DataError, match=message):
        load(path)


def test_settings_are_checked(tmp_path: Path) -> None:
    log = load(write_log(tmp_path / "log"))
    with pytest.raises(ConfigError, match=r"filter\.particles: got 0, expected 1 to 1000000"):
        run(log, {"filter": {"particles": 0}})
    with pytest.raises(ConfigError, match=r"sensor\.model: got stereo, expected point"):
        run(log, {"sensor": {"model": "stereo"}})
    with pytest.raises(
        ConfigError, match=r"filter\.partikles: unknown key; did you mean filter\.particles\?"
    ):
        run(log, {"filter": {"partikles": 3}})


def test_a_run_without_names_maps_nothing_and_says_so(tmp_path: Path) -> None:
    path = write_log(tmp_path / "log")
    rows = [line.split(",") for line in (path / "sightings.csv").read_text().splitlines()]
    text = "\n".join(",".join([row[0], "" if i else row[1], *row[2:]]) for i, row in enumerate(rows))
    (path / "sightings.csv").write_text(text + "\n")
    out = fastslam("run", str(path), "--out", str(tmp_path / "out"))
    assert out.exit_code == 1 and "no landmark was mapped" in out.stderr


def test_rotations_go_both_ways_and_points_are_aligned() -> None:
    rng = np.random.default_rng(2)
    some = rng.normal(size=(200, 4))
    some /= np.linalg.norm(some, axis=1, keepdims=True)
    some[:4] = np.eye(4)
    back = quaternions(matrices(some))
    assert np.allclose(back * np.sign(np.sum(back * some, axis=1))[:, None], some)
    assert np.allclose(matrices(compose(some[:100], some[100:])), matrices(some[:100]) @ matrices(some[100:]))
    points = rng.normal(size=(30, 3))
    for quaternion in some[:20]:
        moved = points @ matrices(quaternion[None])[0].T + [1.0, -2.0, 3.0]
        turn, shift = alignment(points, moved)
        assert np.allclose(points @ matrices(turn[None])[0].T + shift, moved)


def test_poses_between_stamps_are_on_the_way() -> None:
    path = SpacePath(
        np.array([0.0, 0.2, 5.0]),
        np.array([[0, 0, 0, 1, 0, 0, 0], [1, 0, 0, -1, 0, 0, 0], [9, 0, 0, 1, 0, 0, 0]], dtype=float),
    )
    stamps, poses = at_stamps(path, np.array([-1.0, 0.05, 0.2, 3.0]))
    # Before the start, and in a gap, nothing is known; a quaternion and its negative are one turn.
    assert stamps.tolist() == [0.05, 0.2] and np.allclose(poses[0], [0.25, 0, 0, 1, 0, 0, 0])


def test_a_robot_on_the_ground_maps_heights(tmp_path: Path) -> None:
    path = write_log(tmp_path / "rover", settings="motion: {turn_std_rad_per_sqrt_s: [0.002, 0.002, 0.02]}\n")
    rng = np.random.default_rng(7)
    places = rng.uniform([-4.0, -1.0, 0.5], [4.0, 7.0, 2.5], (9, 3))
    rows, seen = ["stamp_s,speed_m_per_s,yaw_rate_deg_per_s"], ["stamp_s,landmark_id,x_m,y_m,z_m"]
    for step in range(200):
        # A circle of 3 m, and wheels that slip by 3 cm a root second.
        angle = 0.02 * (step + 1)
        off = places - [3.0 * np.sin(angle), 3.0 * (1.0 - np.cos(angle)), 0.0]
        points = off @ turned(np.array([0.0, 0.0, angle])) + rng.normal(0.0, 0.02, off.shape)
        rows.append(f"{0.1 * step:.1f},{0.6 + rng.normal(0.0, 0.1)},{np.degrees(0.2)}")
        seen += [f"{0.1 * (step + 1):.1f},star-{n},{x},{y},{z}" for n, (x, y, z) in enumerate(points)]
    (path / "odometry.csv").write_text("\n".join(rows) + "\n")
    (path / "sightings.csv").write_text("\n".join(seen) + "\n")
    (path / "truth_landmarks.csv").unlink()
    log = load(path)
    assert log.velocity[:, 1:5].tolist() == [[0.0] * 4] * 200
    assert log.velocity[:, 5] == pytest.approx(0.2)
    # What the log says goes before what a robot on the ground does.
    assert log.config["motion"]["turn_std_rad_per_sqrt_s"] == [0.002, 0.002, 0.02]
    assert log.config["motion"]["position_std_m_per_sqrt_s"] == ON_THE_GROUND["position_std_m_per_sqrt_s"]
    result = run(log)
    order = [int(name.removeprefix("star-")) for name in result.landmarks.ids]
    # 200 sightings of 2 cm; the turn is known to 2 cm over 3 m at first, and so is all that hangs on it.
    started = np.array([1.5, 0.0, 0.0])
    assert len(order) == 9 and np.abs(result.landmarks.mean_m - places[order] - started).max() < 0.05
    assert np.abs(result.smoothed.T_world_robot[:, 2]).max() < 0.01


def test_numbers_can_be_written_without_pictures(tmp_path: Path) -> None:
    log = load(write_log(tmp_path / "log"))
    assert isinstance(log, SpaceLog)
    metrics = write_outputs(run(log), log, tmp_path / "out", report=False)
    assert not (tmp_path / "out" / "map.png").exists() and metrics["landmarks.count"] == 8


@pytest.mark.slow
def test_starry_night_is_as_good_as_a_batch_solution(data_dir: Path) -> None:
    log = load(data_dir / "starry_night")
    assert (len(log.value), len(log.names), log.problems[0].count) == (9410, 20, 212)
    metrics = evaluate(run(log), log)
    assert metrics["path.live.aligned.position_rmse_m"] < 0.06
    assert metrics["path.live.aligned.rotation_rmse_rad"] < np.radians(4.5)
    assert metrics["path.smoothed.aligned.position_rmse_m"] < 0.035
    assert metrics["path.smoothed.aligned.rotation_rmse_rad"] < np.radians(3.0)
    assert metrics["map.aligned.rmse_m"] < 0.008


@pytest.mark.slow(but="point3d")
@pytest.mark.parametrize("sensor", ["point3d", "elevation"])
def test_a_simulated_log_is_written_and_comes_back(sensor: str, tmp_path: Path) -> None:
    path = tmp_path / "stars"
    assert (
        fastslam("simulate", str(path), "--sensor", sensor, "--landmarks", "15", "--seed", "4").exit_code == 0
    )
    log = load(path)
    made = simulate(sensor=log.sensor, landmarks=15, seed=4, name="stars")
    assert np.array_equal(log.velocity, made.velocity) and np.array_equal(log.value, made.value)
    # Names stand in the order of their first sightings.
    assert [log.names[i] for i in log.identity] == [made.names[i] for i in made.identity]
    assert log.truth is not None and made.truth is not None
    assert np.allclose(log.truth.T_world_robot, made.truth.T_world_robot, rtol=0, atol=1e-7)
    assert run(log).innovation_ratio == pytest.approx(1.0, abs=0.1)
    again = fastslam("simulate", str(path), "--sensor", sensor)
    again.assert_one_line_error(exit_code=1, contains="is not empty")


@pytest.mark.slow
def test_noise_that_is_stated_wrongly_is_learned(tmp_path: Path) -> None:
    log = simulate(seed=5, landmarks=25)
    wrong = {
        "motion": {"position_std_m_per_sqrt_s": [0.06, 0.006, 0.02], "turn_std_rad_per_sqrt_s": [0.01] * 3},
        "sensor": {"position_std_m": [0.2, 0.02, 0.06]},
    }
    learned = learn(log, wrong)
    # 600 motions. From scan to scan the robot errs by 9 mm, which sightings of 60 mm hardly tell.
    assert learned["motion"]["position_std_m_per_sqrt_s"] == pytest.approx(POSITION_STD, rel=0.4)
    assert learned["motion"]["turn_std_rad_per_sqrt_s"] == pytest.approx(TURN_STD, rel=0.2)
    assert learned["sensor"]["position_std_m"] == pytest.approx(STD["point"], rel=0.05)
    path = write_log(tmp_path / "log", settings="motion: {turn_std_rad_per_sqrt_s: [0.1, 0.1, 0.1]}\n")
    out = tmp_path / "out"
    assert fastslam("run", str(path), "--auto", "--out", str(out), "--no-report").exit_code == 0
    assert (
        "0.1" not in (out / "config.yaml").read_text().partition("turn_std_rad_per_sqrt_s")[2].splitlines()[1]
    )

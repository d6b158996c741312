"""Poses in space without odometry: logs, runs, verdicts, and what STAR-loc has of its own."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from cli_runner import fastslam
from fastslam.errors import ConfigError, DataError
from fastslam.space import SpaceLog, evaluate, load, matches, run
from fastslam.space.evaluation import matrices
from fastslam.space.learning import learn
from fastslam.space.log import WITHOUT_ODOMETRY
from fastslam.space.native_write import write_native
from fastslam.space.simulation import MOTIONS, simulate
from fastslam.space.starloc import EXCHANGED, PIXEL_STD
from fastslam.space.verdict import is_unsound

TAGS = "time_s,apriltag_id,left_u,left_v,right_u,right_v"


def begin(log: SpaceLog, seconds: float) -> SpaceLog:
    """What was noted and seen at first."""
    rows, seen = log.row_stamp_s < seconds, log.sighting_stamp_s < seconds
    return replace(
        log,
        row_stamp_s=log.row_stamp_s[rows],
        velocity=log.velocity[rows],
        sighting_stamp_s=log.sighting_stamp_s[seen],
        value=log.value[seen],
        identity=log.identity[seen],
    )


@pytest.mark.parametrize("motion", MOTIONS[1:])
def test_a_log_without_odometry_is_written_and_comes_back(motion: str, tmp_path: Path) -> None:
    made = begin(simulate(motion=motion, landmarks=15, seed=4), 5.0)
    path = write_native(made, tmp_path / "log")
    file = path / "odometry.csv"
    assert file.is_file() is (motion == "gyro")
    if motion == "gyro":
        assert file.read_text().splitlines()[0] == "stamp_s,wx_rad_per_s,wy_rad_per_s,wz_rad_per_s"
    log = load(path)
    assert log.motion == motion and log.config["filter"] == WITHOUT_ODOMETRY
    assert np.array_equal(log.velocity, made.velocity) and np.array_equal(log.value, made.value)
    assert log.velocity.shape[1] == 6 and not log.velocity[:, :3].any()


def test_a_camera_in_a_hand_finds_its_way(tmp_path: Path) -> None:
    found = {}
    for motion in MOTIONS[1:]:
        log = begin(simulate(motion=motion, seed=4), 10.0)
        result = run(log, {"filter": {"particles": 50}})
        assert result.warnings == () and result.hold is not None and result.ratios is not None
        metrics = evaluate(result, log)
        found[motion] = metrics
        # Ten looks at once of 6 cm each: a pose is known to less, the way between two scans to more.
        assert metrics["path.live.position_rmse_m"] < 0.3, motion
        assert metrics["path.smoothed.position_rmse_m"] < 0.12, motion
        assert metrics["map.aligned.rmse_m"] < 0.06, motion
        assert 0.3 < result.hold.misfit < 1.5 and result.hold.shape_std_m < 0.06, motion
        assert np.all(np.diff(result.smoothed.stamp_s) < 0.21)
    # A gyro knows the turns that sightings alone tell to a degree or two.
    turn = "path.live.rotation_rmse_rad"
    assert found["gyro"][turn] < found["wandering"][turn]


def test_what_wanders_more_than_the_settings_say_is_learned() -> None:
    log = begin(simulate(motion="wandering", seed=2, landmarks=25), 20.0)
    wrong = {"motion": {"velocity_std_m_per_s": [0.05] * 3, "rate_std_rad_per_s": [3.0] * 3}}
    learned = learn(log, wrong)["motion"]
    # It is carried at 0.8 m/s, turns by 0.2 rad/s, and sways by 0.3 m/s and 0.4 rad/s.
    assert all(0.15 < std < 1.5 for std in learned["velocity_std_m_per_s"]), learned
    assert all(0.15 < std < 1.5 for std in learned["rate_std_rad_per_s"]), learned
    assert set(learned) == {"velocity_std_m_per_s", "rate_std_rad_per_s"}


def test_landmarks_that_sightings_do_not_hold_together_are_lost() -> None:
    """Two that are seen, then, blind seconds later, two others: nothing says how these lie to those."""
    log = begin(simulate(motion="wandering", seed=1), 8.0)
    first, last = log.sighting_stamp_s < 2.0, log.sighting_stamp_s > 6.0
    early = np.unique(log.identity[first])[:2]
    late = np.setdiff1d(np.unique(log.identity[last]), log.identity[first])[:2]
    kept = (first & np.isin(log.identity, early)) | (last & np.isin(log.identity, late))
    assert len(early) == len(late) == 2
    parts = {"value": log.value[kept], "identity": log.identity[kept]}
    result = run(replace(log, sighting_stamp_s=log.sighting_stamp_s[kept], **parts))
    assert is_unsound(result)
    assert any(text.startswith("lost: sightings alone hold the landmarks to") for text in result.warnings)


def test_the_command_simulates_and_runs_one(tmp_path: Path) -> None:
    path = tmp_path / "carried"
    made = fastslam("simulate", str(path), "--sensor", "point3d", "--motion", "wandering", "--landmarks", "8")
    assert made.exit_code == 0 and not (path / "odometry.csv").exists()
    shown = fastslam("info", str(path))
    assert shown.exit_code == 0 and "wandering" in shown.stdout
    flat = fastslam("simulate", str(tmp_path / "flat"), "--motion", "gyro")
    flat.assert_one_line_error(exit_code=2, contains="--motion: for a sensor in space")
    with pytest.raises(ConfigError, match=r"motion: got wheels, expected odometry or gyro or wandering"):
        simulate(motion="wheels")
    for key, value in (("velocity_std_m_per_s", "[0, 1, 1]"), ("velocity_time_s", "0")):
        refused = fastslam("run", str(path), "--out", str(tmp_path / "out"), "--set", f"motion.{key}={value}")
        refused.assert_one_line_error(exit_code=2, contains=f"motion.{key}")


def write_run(
    folder: Path, tags: str, optics: str = '{"fu": 500, "fv": 500, "cu": 300, "cv": 200, "b": 0.1}'
) -> Path:
    folder.mkdir(parents=True)
    (folder / "apriltag.csv").write_text(f"{TAGS}\n{tags}\n")
    (folder / "calib.json").write_text(optics)
    return folder


def test_pixels_of_a_run_of_starloc_are_points_with_covariances(tmp_path: Path) -> None:
    folder = write_run(tmp_path / "run", "0.5,7,400,300,380,300\n0.25,3,350,210,325,210")
    assert matches(folder) == "starloc"
    log = load(folder)
    # 500 px times 0.1 m over 25 px and over 20 px, in the order of time.
    assert log.names == ("3", "7") and log.identity.tolist() == [0, 1] and log.truth is not None
    assert log.value == pytest.approx(np.array([[0.2, 0.04, 2.0], [0.5, 0.5, 2.5]]))
    assert log.covariance is not None and log.motion == "wandering" and not len(log.row_stamp_s)
    depth_std = 2.5**2 / (500 * 0.1) * PIXEL_STD[2]
    assert np.sqrt(log.covariance[1, 5]) == pytest.approx(depth_std)
    across = (2.5 / 500 * PIXEL_STD[0]) ** 2 + (0.5 / 2.5 * depth_std) ** 2
    assert log.covariance[1, 0] == pytest.approx(across)


@pytest.mark.parametrize(
    ("tags", "optics", "message"),
    [
        ("0.5,7,400,300,410,300", None, "a tag lies behind the cameras"),
        ("0.5,7,400,300,380,", None, "right_v"),
        ("0.5,7,400,300,380,300", "{", "is malformed"),
        ("0.5,7,400,300,380,300", '{"fu": 500}', "is malformed"),
    ],
)
def test_faults_of_a_run_of_starloc_are_named(
    tags: str, optics: str | None, message: str, tmp_path: Path
) -> None:
    folder = write_run(tmp_path / "run", tags, **({} if optics is None else {"optics": optics}))
    with pytest.raises(DataError, match=message):
        load(folder)


def test_starloc_is_read_with_its_traps(data_dir: Path) -> None:
    runs = {
        name: load(data_dir / "starloc" / "data" / f"loop-2d{name}") for name in ("_s4", "-v2_s5", "-fast_s1")
    }
    assert {name: (len(log.value), len(log.names)) for name, log in runs.items()} == {
        "_s4": (1087, 42),
        "-v2_s5": (1538, 49),
        "-fast_s1": (136, 17),
    }
    fast = runs["-fast_s1"]
    assert fast.motion == "gyro" and runs["_s4"].motion == "wandering" and not len(runs["_s4"].row_stamp_s)
    truth = fast.truth
    assert truth is not None and EXCHANGED == {"v1": (35, 36)}
    height = {name: place[2] for name, place in zip(truth.names, truth.position_m, strict=True)}
    assert height["35"] == pytest.approx(1.677, abs=1e-3) and height["36"] == pytest.approx(0.927, abs=1e-3)
    # True poses turn the camera's points into the world: tags lie where they were surveyed, to calibration.
    stamps = dict(zip(truth.stamp_s.tolist(), truth.T_world_robot, strict=True))
    off = []
    for stamp_s, value, identity in zip(fast.sighting_stamp_s, fast.value, fast.identity, strict=True):
        pose = stamps[float(stamp_s)]
        seen = matrices(pose[None, 3:])[0] @ value + pose[:3]
        off.append(np.linalg.norm(seen - truth.position_m[truth.names.index(fast.names[identity])]))
    assert len(off) == 136 and np.median(off) < 0.3
    # By its own clock the gyro would begin a second and a half later.
    assert abs(fast.row_stamp_s[0] - fast.sighting_stamp_s[0]) < 0.3
    assert sum(problem.count for problem in runs["-v2_s5"].problems) == 2


def test_a_fast_run_of_starloc_is_lost_without_its_gyro_alone(data_dir: Path) -> None:
    log = load(data_dir / "starloc" / "data" / "loop-2d-fast_s1")
    with_gyro, without = (run(log, {"motion": {"kind": kind}}) for kind in ("gyro", "wandering"))
    assert is_unsound(without) and not is_unsound(with_gyro)
    assert with_gyro.hold is not None and without.hold is not None
    assert with_gyro.hold.shape_std_m < 0.4 < 0.6 < without.hold.shape_std_m


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "bars"), [("loop-2d_s4", (0.45, 0.10, 0.16)), ("loop-2d-v2_s5", (0.40, 0.15, 0.14))]
)
def test_starloc_without_gyro_is_as_good_as_an_incremental_solver(
    name: str, bars: tuple[float, float, float], data_dir: Path
) -> None:
    log = load(data_dir / "starloc" / "data" / name)
    result = run(log)
    metrics = evaluate(result, log)
    assert not is_unsound(result)
    path = "aligned.position_rmse_m"
    names = (f"path.live.{path}", f"path.smoothed.{path}", "map.aligned.rmse_m")
    for metric, bar in zip(names, bars, strict=True):
        assert metrics[metric] < bar

"""The paper's experiments: every one runs, writes its files, and shows the effect that it is about."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cli_runner import fastslam
from fastslam.reproduce import EXPERIMENTS, Scale, claims_table, reproduce
from fastslam.reproduce.rover import arena_log
from fastslam.reproduce.scaling import revisiting_log
from fastslam.runner import run

pytestmark = pytest.mark.slow


def table(folder: Path, name: str) -> list[dict[str, str]]:
    return list(csv.DictReader((folder / f"{name}.csv").open()))


@pytest.fixture(scope="module")
def quick(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Any]]:
    """All experiments in their quick version, run once."""
    folder = tmp_path_factory.mktemp("reproduce")
    return folder / "quick", reproduce(["all"], folder, quick=True)


def test_every_experiment_leaves_figure_data_and_claims(quick: tuple[Path, dict[str, Any]]) -> None:
    folder, claims = quick
    assert set(claims) == set(EXPERIMENTS) and len(claims) >= 7
    for name, found in claims.items():
        assert found and all(claim.ours for claim in found)
        assert len((folder / f"{name}.png").read_bytes()) > 5_000
        assert (folder / f"{name}.svg").read_text().startswith("<?xml")
        assert table(folder, name)
    text = claims_table(claims, quick=True)
    assert text.count("\n") == 2 + sum(len(found) for found in claims.values())


def test_the_effects_of_the_paper_show(quick: tuple[Path, dict[str, Any]]) -> None:
    folder, _ = quick
    robot = [(float(r["ate_rmse_m_mean"]), float(r["ate_rmse_m_ci95"])) for r in table(folder, "figure6a")]
    assert robot[-1][0] + robot[-1][1] < robot[0][0] - robot[0][1], "6a: more landmarks, less error"
    by_m = {
        r["filter.particles"]: (float(r["ate_rmse_m_mean"]), float(r["ate_rmse_m_ci95"]))
        for r in table(folder, "figure6b")
        if r["algorithm"] == "fastslam1"
    }
    assert by_m["100"][0] + by_m["100"][1] < by_m["1"][0] - by_m["1"][1], "6b: more particles, less error"
    rocks = [float(r["landmark_rmse_m"]) for r in table(folder, "figure4") if r["log"].startswith("arena")]
    assert len(rocks) == 10 and max(rocks) < 0.083
    large, small = table(folder, "figure5")
    assert float(large["path_std_m"]) < float(small["path_std_m"])


def test_ekf_slam_needs_the_square_of_the_landmarks(quick: tuple[Path, dict[str, Any]]) -> None:
    folder, _ = quick
    rows = {(r["method"], int(r["landmarks"])): int(r["map_bytes"]) for r in table(folder, "growth")}
    # Three times the landmarks: nine times the numbers but for edges of blocks and pending vectors.
    assert 5.0 < rows["EKF-SLAM", 300] / rows["EKF-SLAM", 100] < 9.1
    assert 9.0 < rows["dense", 1000] / rows["dense", 100] < 11.0


def test_an_experiment_that_is_done_is_not_run_again(quick: tuple[Path, dict[str, Any]]) -> None:
    folder, claims = quick
    store = folder / ".sweeps/figure6b/cells.jsonl"
    before = store.read_bytes()
    assert EXPERIMENTS["figure6b"].run(Scale(folder, quick=True)) == claims["figure6b"]
    assert store.read_bytes() == before


def test_an_unknown_figure_is_an_error_of_one_line(tmp_path: Path) -> None:
    outcome = fastslam("reproduce", "figure7", "--out", tmp_path)
    outcome.assert_one_line_error(exit_code=2, contains="figure7: no such figure; expected all or figure4")


def test_the_timing_log_revisits_a_complete_map() -> None:
    log = revisiting_log(50, 10)
    result = run(log, {"algorithm": "ekf"})
    assert len(result.landmarks.ids) == 50
    assert result.steps.new_landmarks.tolist()[0] == 50 and result.steps.new_landmarks[1:].sum() == 0
    assert np.all(result.steps.sightings[1:] == 8)


def test_the_wide_laser_sees_the_rocks_behind() -> None:
    narrow, wide = (arena_log(view_deg, seed=1).sightings.bearing_rad for view_deg in (180, 360))
    # The centre of a rock whose edge is in view may lie a little behind.
    assert np.abs(narrow).max() < 2.0 and np.abs(wide).max() > 3.0

"""The filter notices faults that are put into logs, and nothing in sound ones."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import fastslam
import numpy as np
import pytest
from fabricate import make_steps
from fastslam import FastSlam
from fastslam.datasets import load
from fastslam.evaluation import evaluate
from fastslam.health import (
    REASONS,
    HealthStatus,
    has_reason,
    health_summary,
    health_warning,
    reason_bits,
    reason_names,
)
from fastslam.log import Log
from fastslam.result import RunResult
from fastslam.simulation import resolve_simulation, simulate
from faults import blinded, kidnapped, with_moved_landmarks, with_swapped_wheels

DATA = Path(os.environ.get("FASTSLAM_DATA", Path(__file__).parents[2] / "shared" / "data"))
FAULT_S = 35.0
"""In the second lap of the demo, when the map is known."""

Fault = Callable[[Log], Log]
FAULTS: dict[str, tuple[Fault, int, HealthStatus, int]] = {
    # Fault, steps until degraded, worst status, steps until then. Steps with sightings come every 0.2 s,
    # those without every 0.5 s: 10 s of blindness are 20 steps, and one more.
    "kidnapped": (lambda log: kidnapped(log, at_s=FAULT_S, for_s=12.0), 4, HealthStatus.LOST, 24),
    "swapped wheels": (lambda log: with_swapped_wheels(log, at_s=FAULT_S), 8, HealthStatus.LOST, 40),
    "blinded": (lambda log: blinded(log, at_s=FAULT_S), 21, HealthStatus.DEGRADED, 21),
    "stale map": (
        lambda log: with_moved_landmarks(log, at_s=FAULT_S, by_m=2.0, seed=1),
        4,
        HealthStatus.LOST,
        24,
    ),
}


def demo(seed: int) -> Log:
    return simulate(resolve_simulation({"seed": seed}, preset="demo"))


def run(log: Log, algorithm: str, association: str) -> RunResult:
    settings = {"algorithm": algorithm, "association": {"mode": association}, "seed": 1}
    return fastslam.run(log, {**settings, "filter": {"particles": 50}}, auto=False)


def steps_until(result: RunResult, status: HealthStatus) -> int | None:
    """Steps from the fault to the first that is as bad as `status`."""
    health = result.steps.health[result.steps.stamp_s >= FAULT_S]
    reached = np.flatnonzero(health >= status)
    return int(reached[0]) if len(reached) else None


@pytest.mark.parametrize(
    ("lost", "degraded", "said"),
    [
        (0, 80, "the filter was degraded in 8 % of its steps (no sightings)"),
        (80, 0, "the filter was lost in 8 % of its steps (no sightings)"),
        (3, 80, "the filter was lost in less than 1 % and degraded in 8 % of its steps (no sightings)"),
        (0, 50, None),
    ],
)
def test_only_what_happened_is_said(lost: int, degraded: int, said: str | None) -> None:
    health = np.full(1000, int(HealthStatus.OK))
    health[:degraded], health[degraded : degraded + lost] = HealthStatus.DEGRADED, HealthStatus.LOST
    reasons = np.where(health > HealthStatus.OK, reason_bits("no_sightings"), 0)
    steps = replace(make_steps(np.arange(1000.0)), health=health, health_reasons=reasons)
    assert health_warning(steps) == said


@pytest.mark.slow(but="kidnapped-fastslam2-known")
@pytest.mark.parametrize("association", ["known", "unknown"])
@pytest.mark.parametrize("algorithm", ["fastslam1", "fastslam2"])
@pytest.mark.parametrize("fault", FAULTS)
def test_faults_are_noticed_in_time(fault: str, algorithm: str, association: str) -> None:
    broken, degraded_within, worst, worst_within = FAULTS[fault]
    for seed in (3, 4):
        result = run(broken(demo(seed)), algorithm, association)
        before = result.steps.health[result.steps.stamp_s < FAULT_S]
        assert np.mean(before[before > 0] == HealthStatus.OK) > 0.95
        degraded, reached = steps_until(result, HealthStatus.DEGRADED), steps_until(result, worst)
        assert degraded is not None and degraded <= degraded_within, f"seed {seed}: {degraded}"
        assert reached is not None and reached <= worst_within, f"seed {seed}: {reached}"
        assert "degraded in" in str(health_warning(result.steps))


@pytest.mark.slow(but="cones-fastslam2-unknown")
@pytest.mark.parametrize("association", ["known", "unknown"])
@pytest.mark.parametrize("algorithm", ["fastslam1", "fastslam2", "ekf"])
@pytest.mark.parametrize("preset", ["demo", "loop", "cones"])
def test_sound_simulations_are_ok(preset: str, algorithm: str, association: str) -> None:
    log = simulate(resolve_simulation({"seed": 3, "max_duration_s": 120.0}, preset=preset))
    if preset == "cones" and association == "known":
        pytest.skip("nobody names the cones")
    result = run(log, algorithm, association)
    assert result.steps.health[0] == HealthStatus.INITIALIZING
    if (preset, algorithm) == ("cones", "fastslam1"):
        # With 50 particles it may lose the loop of this track, and must say so then.
        assert evaluate(result, log)["landmark_precision"] > 0.9 or result.verdict
        return
    ok = health_summary(result.steps).ok
    assert ok is not None and ok >= 0.95
    assert health_warning(result.steps) is None


@pytest.mark.slow
@pytest.mark.skipif(not DATA.is_dir(), reason=f"no data at {DATA}")
@pytest.mark.parametrize(
    ("folder", "association"),
    [("lost_in_the_woods", "known"), ("lost_in_the_woods", "unknown"), ("victoria_park", "unknown")],
)
def test_real_logs_are_ok(folder: str, association: str) -> None:
    if not (DATA / folder).is_dir():
        pytest.skip(f"no {folder} in {DATA}")
    ok = health_summary(run(load(DATA / folder), "fastslam2", association).steps).ok
    assert ok is not None and ok >= 0.95


def test_blindness_ends_with_the_next_sightings() -> None:
    filter_ = FastSlam({"filter": {"particles": 20}, "health": {"longest_blindness_s": 2.0}})
    seen = {"range_m": [4.0, 5.0, 6.0], "bearing_rad": [0.3, -0.5, 1.0], "identity": ["a", "b", "c"]}
    infos = [filter_.step([0.0, 0.0], dt_s=0.2, **seen) for _ in range(15)]
    assert infos[0].health == "initializing" and infos[-1].health == "ok"
    assert infos[-1].matched == 3 and infos[-1].health_reasons == ()
    dark = [filter_.step([0.0, 0.0], dt_s=0.5) for _ in range(5)]
    assert [info.health for info in dark] == ["ok"] * 4 + ["degraded"]
    assert dark[-1].health_reasons == ("no_sightings",)
    assert filter_.step([0.0, 0.0], dt_s=0.2, **seen).health == "ok"


def test_an_uncertain_pose_is_degraded_then_lost() -> None:
    settings = {"largest_position_std_m": 0.5, "longest_blindness_s": 1e3}
    filter_ = FastSlam({"filter": {"particles": 200}, "health": settings})
    seen = {"range_m": [4.0, 5.0, 6.0], "bearing_rad": [0.3, -0.5, 1.0], "identity": ["a", "b", "c"]}
    for _ in range(12):
        assert filter_.step([0.0, 0.0], dt_s=0.1, **seen).health in ("initializing", "ok")
    statuses = [filter_.step([2.0, 0.0], dt_s=0.5).health for _ in range(300)]
    assert statuses[0] == "ok" and "degraded" in statuses and statuses[-1] == "lost"
    assert sorted(statuses, key=["ok", "degraded", "lost"].index) == statuses


def test_codes_and_names_of_reasons_agree() -> None:
    assert reason_names(0) == () and len(REASONS) == 7
    for bits in range(1 << len(REASONS)):
        assert reason_bits("+".join(reason_names(bits))) == bits
    codes = np.array([0, 4, 6])
    assert has_reason(codes, "no_sightings").tolist() == [False, True, True]


@pytest.mark.parametrize("key", ["window_scans", "longest_blindness_s", "largest_innovation_ratio"])
def test_bad_settings_are_errors_that_name_the_key(key: str) -> None:
    with pytest.raises(fastslam.errors.ConfigError, match=f"health.{key}"):
        FastSlam({"health": {key: 0}})

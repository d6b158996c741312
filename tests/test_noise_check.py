"""Innovations that contradict the configured noise are reported, with the noise and the direction."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import Any

import fastslam
import numpy as np
import pytest
from fastslam import FastSlam
from fastslam.config import merge
from fastslam.log import Log
from fastslam.noise import (
    ASK_FIRST,
    MAP_FIRST,
    after_findings,
    after_learning,
    after_verdict,
    noise_sentences,
)
from fastslam.runner import configure
from fastslam.simulation import resolve_simulation, simulate

LOOP = {"seed": 2, "max_duration_s": 240.0, "scan": {"period_s": 0.2}}


def loop(scan_period_s: float = 0.2) -> Log:
    return simulate(resolve_simulation(merge(LOOP, {"scan": {"period_s": scan_period_s}}), preset="loop"))


def warnings(log: Log, *layers: dict[str, object]) -> tuple[str, ...]:
    return fastslam.run(log, merge({"seed": 1, "filter": {"particles": 50}}, *layers)).warnings


ADVICE = "range innovations are 2 times as large as sensor.range_std_m says (NIS 8.0, band 1.7-2.3): raise it"


def test_advice_on_noise_waits_for_what_was_found_in_the_log() -> None:
    mirrored = {"code": "bearing-mirrored", "severity": "problem", "message": "mirrored?", "remedy": "negate"}
    told = after_findings(("a checkpoint failed", ADVICE), [mirrored])
    assert told[0] == "a checkpoint failed" and "mirrored? [bearing-mirrored]" in told[1] and len(told) == 2
    assert "raise" not in told[1]
    note = {**mirrored, "severity": "note"}
    assert after_findings((ADVICE,), [note]) == (ADVICE,)
    assert after_findings((), [mirrored]) == ()
    # Too small a noise loses a filter too: the advice stays, with what comes first, once.
    lost = after_verdict((ADVICE,), ("the filter was lost in 100% of its steps",))
    assert lost == after_findings(lost, [note]) == (f"{ADVICE}; {ASK_FIRST}",)
    assert after_verdict((ADVICE,), ()) == (ADVICE,)


def test_innovations_that_blame_nothing_name_the_next_step() -> None:
    found = {"what": None, "keys": (), "std_factor": 0.7, "power": 1.0, "nis": 1.0, "nis_band": (1.7, 2.3)}
    assert "run LOG --auto" in noise_sentences([found], {})[0]
    for where in ({"algorithm": "ekf"}, {"sensor": {"model": "range"}}, {"sensors": {"left": {}}}):
        (plain,) = noise_sentences([found], where)
        assert "to blame" in plain and "--auto" not in plain, "nothing can be learned there"
    assert "--auto" not in noise_sentences([found], {}, kept_map=True)[0]
    (asked,) = after_learning(noise_sentences([found], {}))
    assert "--auto" not in asked and "left it open" in asked, "what was just done is not advised"


NARROWER = (
    "the odometry's turn is off 0.5 times as much (NIS 0.9, band 1.8-2.2): lower motion.alpha1 to 0.005"
)


def test_no_narrower_noise_is_advised_for_a_doubted_map_or_below_what_the_log_said() -> None:
    twice = "40 of 193 landmarks stand among others as earlier ones do a little further on"
    assert after_verdict((NARROWER, ADVICE), (twice,)) == (ADVICE, MAP_FIRST)
    assert after_verdict((NARROWER,), ()) == (NARROWER,)
    assert after_learning((NARROWER, ADVICE, "a checkpoint failed")) == (ADVICE, "a checkpoint failed")
    unnamed = {"motion": {"speed_std_m_per_s": 0.4}, "association": {"mode": "unknown"}}
    narrow = {"what": "speed", "keys": ["motion.speed_std_m_per_s"], "std_factor": 0.5, "power": 1.0}
    (said,) = noise_sentences([{**narrow, "nis": 1.0, "nis_band": (1.7, 2.3)}], unnamed)
    assert "lower motion.speed_std_m_per_s to about 0.2" in said and "add up over a loop" in said


@pytest.mark.slow(but="fastslam2-unknown")
@pytest.mark.parametrize("association", ["known", "unknown"])
@pytest.mark.parametrize("algorithm", ["fastslam1", "fastslam2", "ekf"])
def test_right_noise_is_not_complained_about(algorithm: str, association: str) -> None:
    settings = {"algorithm": algorithm, "association": {"mode": association}}
    result = fastslam.run(loop(), {**settings, "seed": 1, "filter": {"particles": 50}})
    assert result.warnings == ()
    # Depletion and the gates move the mean a little: 2.0 is exact for neither.
    assert result.noise["sightings"] > 500 and 1.7 < result.noise["nis"] < 2.4


@pytest.mark.parametrize("algorithm", ["fastslam1", "fastslam2"])
@pytest.mark.parametrize(
    ("settings", "words"),
    [
        (
            {"sensor": {"range_std_m": 0.04}},
            ("range innovations", "sensor.range_std_m", "raise sensor.range_std_m to about 0."),
        ),
        (
            {"sensor": {"range_std_m": 0.2}},
            ("range innovations", "sensor.range_std_m", "lower sensor.range_std_m to about 0."),
        ),
        (
            {"sensor": {"bearing_std_rad": 0.006}},
            ("bearing innovations", "bearing_std_rad", "raise sensor.bearing_std_rad"),
        ),
        (
            {"sensor": {"bearing_std_rad": 0.06}},
            ("bearing innovations", "bearing_std_rad", "lower sensor.bearing_std_rad"),
        ),
        (
            {"motion": {"speed_std_m_per_s": 1.0, "yaw_rate_std_rad_per_s": 0.5}},
            (
                "the odometry's speed is off",
                "motion.speed_std_m_per_s",
                "lower motion.speed_std_m_per_s to about",
            ),
        ),
    ],
)
def test_the_noise_that_is_wrong_is_named_with_its_direction(
    settings: dict[str, object], words: tuple[str, ...], algorithm: str
) -> None:
    found = warnings(loop(), settings, {"algorithm": algorithm})
    blamed = [warning for warning in found if words[0] in warning]
    assert len(blamed) == 1, found
    assert all(word in blamed[0] for word in words), blamed
    assert "NIS" in blamed[0] and "band" in blamed[0]


def test_odometry_that_is_worse_than_its_noise_is_blamed_on_it() -> None:
    # Scans 1 s apart: at 5 Hz the motion between two scans is so certain that its noise hardly shows. Only
    # FastSLAM 2.0: the particles of 1.0 cannot follow, the map goes wrong, and every noise looks too small.
    found = warnings(loop(1.0), {"motion": {"speed_std_m_per_s": 0.03, "yaw_rate_std_rad_per_s": 0.015}})
    raised = [
        key
        for key in ("speed_std_m_per_s", "yaw_rate_std_rad_per_s")
        if f"raise motion.{key}" in "".join(found)
    ]
    assert raised and not any("lower" in text for text in found), found


@pytest.mark.slow(but="0.2")
@pytest.mark.parametrize("configured", [0.05, 0.2])
def test_the_suggested_value_is_near_the_true_one(configured: float) -> None:
    found = []
    for world in range(1, 7):
        log = simulate(resolve_simulation({**LOOP, "seed": world}, preset="loop"))
        for seed in (1, 2):
            settings = {"seed": seed, "sensor": {"range_std_m": configured}, "filter": {"particles": 50}}
            factors = fastslam.run(log, settings).noise["std_factors"]["sensor.range_std_m"]
            found.append(np.array(factors) * configured / 0.1)
    suggested, low, high = np.array(found).T
    # One step of scoring from half or twice the truth: a run errs by 0.1, and by 0.5 where its interval says
    # so. Each counts as it is certain; the mean of twelve has a standard error of 0.02 of the truth.
    mean = np.average(suggested, weights=(high - low) ** -2)
    assert abs(mean - 1.0) < 0.15, (mean, found)
    assert np.sum((low <= 1.0) & (high >= 1.0)) >= 11, found


def test_steps_carry_the_warning_once_the_window_is_full_enough() -> None:
    filter_ = FastSlam({"filter": {"particles": 20}, "sensor": {"range_std_m": 2.0, "bearing_std_rad": 0.01}})
    seen = {"bearing_rad": [0.3, -0.5, 1.0, 2.0], "identity": ["a", "b", "c", "d"]}
    infos = [filter_.step([0.0, 0.0], dt_s=0.2, range_m=[4.0, 5.0, 6.0, 7.0], **seen) for _ in range(300)]
    assert infos[20].warnings == ()
    assert any("lower sensor.range_std_m" in warning for warning in infos[-1].warnings)
    told = list(dict.fromkeys(text for info in infos for text in info.warnings if "range_std_m" in text))
    advised = [float(text.split(" to about ")[1].split()[0].rstrip(",")) for text in told]
    assert 1 <= len(told) <= 5
    assert all(abs(b - a) > 0.15 * a for a, b in pairwise(advised)), told
    assert infos[-1].nis < infos[-1].nis_band[0] < 2.0 < infos[-1].nis_band[1]


WARNING: dict[str, Any] = {
    "what": "range",
    "keys": ["sensor.range_std_m"],
    "std_factor": 0.5,
    "power": 1.0,
    "nis": 0.5,
    "nis_band": (1.8, 2.2),
}


def test_sightings_with_covariances_of_their_own_are_not_told_to_set_the_sensors() -> None:
    log = loop()
    config = configure(log)
    (plain,) = noise_sentences([WARNING], config, log.sightings)
    assert "lower sensor.range_std_m to" in plain
    covariance = np.tile([0.01, 0.0, 1e-4], (len(log.sightings.stamp_s), 1))
    own = replace(log.sightings, covariance=covariance)
    (of_rows,) = noise_sentences([WARNING], config, own)
    assert "range innovations are 0.5 times as large as the sightings' own covariances say" in of_rows
    assert "lower the covariances of the rows" in of_rows and "counts for nothing" in of_rows
    (of_scans,) = noise_sentences([{**WARNING, "std_factor": 2.0}], config, own, detected=True)
    assert "raise the detector's range_std_m and beam_std_rad;" in of_scans
    # Where some rows leave it to the settings these are to be set, and odometry has its own keys.
    covariance[0] = np.nan
    assert noise_sentences([WARNING], config, replace(own, covariance=covariance)) == (plain,)
    motion = {**WARNING, "what": "speed", "keys": ["motion.speed_std_m_per_s"]}
    assert "lower motion.speed_std_m_per_s" in noise_sentences([motion], config, own)[0]


def test_a_run_on_covariances_that_are_too_large_says_so() -> None:
    log = loop()
    covariance = np.tile([1.0, 0.0, 0.04], (len(log.sightings.stamp_s), 1))
    found = warnings(replace(log, sightings=replace(log.sightings, covariance=covariance)), {})
    assert any("the sightings' own covariances" in text for text in found), found
    assert not any("lower sensor." in text for text in found)

"""What association is worth on simulated logs: clutter, colours, and how the map tells them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import fastslam
import numpy as np
import pytest
from fabricate import make_log, make_run
from fastslam.charts.map import landmark_groups
from fastslam.charts.palette import class_color
from fastslam.config import merge
from fastslam.datasets import load, write_native
from fastslam.errors import ConfigError, DataError
from fastslam.evaluation import evaluate, evaluate_run
from fastslam.log import Log
from fastslam.plots.chart import plot_chart
from fastslam.plots.style import new_figure
from fastslam.result import LandmarkMap, RunResult
from fastslam.resultfiles import read_result, write_result
from fastslam.simulation import presets, simulate

SEEDS = range(1, 11)


def cluttered_world(seed: int) -> tuple[Log, float]:
    """The demo with 20 % misses and 20 % false sightings; the log and the density of the false ones."""
    misses = {"detection_probability": 0.8, "identities": "none", "clutter_per_scan": 0.0}
    settings = merge(presets()["demo"], {"seed": seed, "scan": misses})
    stamp_s = simulate(settings).sightings.stamp_s
    # A quarter of the true ones is a fifth of all.
    false_per_scan = 0.25 * len(stamp_s) / len(np.unique(stamp_s))
    log = simulate(merge(settings, {"scan": {"clutter_per_scan": false_per_scan}}))
    assert 1.2 < len(log.sightings.stamp_s) / len(stamp_s) < 1.3
    sensor = settings["sensor"]
    return log, false_per_scan / (sensor["max_range_m"] * sensor["field_of_view_rad"])


def life_by_bayes(clutter_density: float) -> dict[str, Any]:
    return {
        "filter": {"particles": 30},
        "association": {
            "mode": "unknown",
            "detection_probability": 0.8,
            "clutter_density": clutter_density,
            "existence": {"form": "bayes", "removal": "when_missed"},
        },
    }


@pytest.mark.slow
def test_confirmed_landmarks_are_right_and_complete_among_a_fifth_of_misses_and_false_sightings() -> None:
    scores = []
    for seed in SEEDS:
        log, density = cluttered_world(seed)
        result = fastslam.run(log, life_by_bayes(density))
        metrics = evaluate(result, log)
        scores.append((metrics["landmark_precision"], metrics["landmark_recall"]))
        assert result.landmarks.confirmed is not None
        assert result.landmarks.confirmed.sum() < 70 < len(result.landmarks.ids)
    precision, recall = np.median(scores, axis=0)
    assert precision >= 0.95, scores
    assert recall >= 0.95, scores
    # Measured: 1.00 and 0.975, worst 1.00 and 0.95.
    assert np.min(scores) >= 0.9, scores


def interleaved_cones(seed: int) -> Log:
    """Blue and yellow cones in pairs a quarter of a metre apart, less than the sensor tells apart."""
    changes = {
        "seed": seed,
        "world": {"track_width_m": 0.25, "spacing_m": 2.0, "track_length_m": 100.0},
        "vehicle": {"speed_m_per_s": 3.0},
        "motion": {"speed_std_m_per_s": 0.09, "yaw_rate_std_rad_per_s": 0.015},
        "sensor": {"max_range_m": 10.0, "range_std_m": 0.2, "bearing_std_rad": 0.04},
    }
    log = simulate(merge(presets()["cones"], changes))
    # Without what such a log asks for by itself, colours above all.
    return replace(log, config={key: log.config[key] for key in ("motion", "sensor", "initial_pose")})


def error_within_pairs_m(result: RunResult, log: Log) -> float:
    """How far the vectors from blue cone to yellow one are off, root mean square: drift cancels."""
    aligned = evaluate_run(result, log).T_truth_world
    assert aligned is not None and log.truth_landmarks is not None
    mapped_m = aligned.apply_points(result.landmarks.mean_m[result.landmarks.confirmed])
    true_m = log.truth_landmarks.position_m
    found_m = mapped_m[np.hypot(*np.moveaxis(mapped_m - true_m[:, None], -1, 0)).argmin(axis=1)]
    off_m = (found_m - true_m)[1::2] - (found_m - true_m)[::2]
    assert len(off_m) == 50
    return float(np.sqrt(np.mean(np.sum(off_m**2, axis=1))))


@pytest.mark.slow
def test_colour_resolves_what_position_confuses() -> None:
    by_place = merge(life_by_bayes(0.01), {"association": {"detection_probability": 0.9}})
    by_colour = merge(by_place, {"association": {"classes": {"number": 2, "correct_probability": 0.95}}})
    errors_m: dict[str, list[float]] = {"place": [], "colour": []}
    for seed in range(1, 9):
        log = interleaved_cones(seed)
        for name, config in (("place", by_place), ("colour", by_colour)):
            result = fastslam.run(log, config)
            errors_m[name].append(error_within_pairs_m(result, log))
            assert (result.landmarks.class_index is not None) == (name == "colour")
        # Cones come in pairs, the blue one first: of those found, all but a few have their true colour.
        assert result.landmarks.class_index is not None and log.truth_landmarks is not None
        aligned = evaluate_run(result, log).T_truth_world
        assert aligned is not None
        offset_m = aligned.apply_points(result.landmarks.mean_m)[:, None] - log.truth_landmarks.position_m
        true_class = np.hypot(*np.moveaxis(offset_m, -1, 0)).argmin(axis=1) % 2
        confirmed = result.landmarks.confirmed
        assert np.mean((true_class == result.landmarks.class_index)[confirmed]) > 0.9
    # Measured over 24 worlds: 0.083 m by place, 0.037 m by colour. In 5 of them colour loses a cone, and is
    # as bad. The error of the whole map is no measure: it is drift, and the same for both.
    assert np.median(errors_m["colour"]) < 0.6 * np.median(errors_m["place"]), errors_m


@pytest.mark.slow
@pytest.mark.parametrize("identities", ["none", "all"])
def test_the_loop_of_a_cone_track_is_closed_with_its_colours_alone_told(
    identities: str, tmp_path: Path
) -> None:
    changes = {"seed": 1, "scan": {"identities": identities}, "trajectory": {"laps": 2}}
    write_native(simulate(merge(presets()["cones"], changes)), tmp_path / "log")
    log = load(tmp_path / "log")
    assert log.config["association"] == {"classes": {"number": 2, "correct_probability": 0.95}}
    assert "filter" not in log.config
    metrics = evaluate(fastslam.run(log), log)
    # Measured over 10 seeds: at most 0.1 m; a lost loop is 1 m and more.
    assert metrics["smoothed_ate_rmse_m"] < 0.2
    assert metrics["landmark_matched"] == 150 and metrics["landmark_precision"] > 0.95


def coloured_map() -> LandmarkMap:
    plain = make_run().landmarks
    count = len(plain.ids)
    assert count >= 4
    class_index = np.arange(count) % 3 - 1
    confirmed = np.arange(count) != 1
    signature = np.where(np.arange(count) % 2 == 0, 0.25, np.nan)
    names = ("blue", "yellow")
    return LandmarkMap(
        plain.ids,
        plain.mean_m,
        plain.covariance_m2,
        plain.sightings,
        confirmed,
        class_index,
        signature,
        names,
    )


def test_classes_signatures_and_confirmation_come_back_from_the_table(tmp_path: Path) -> None:
    landmarks = coloured_map()
    write_result(make_run(landmarks=landmarks), make_log(), tmp_path)
    found = read_result(tmp_path).landmarks
    assert found.class_names == landmarks.class_names
    assert found.class_index is not None and found.signature is not None and found.confirmed is not None
    np.testing.assert_array_equal(found.class_index, landmarks.class_index)
    np.testing.assert_array_equal(found.confirmed, landmarks.confirmed)
    np.testing.assert_array_equal(found.signature, landmarks.signature)


def test_tables_of_older_results_are_read(tmp_path: Path) -> None:
    write_result(make_run(), make_log(), tmp_path)
    table = tmp_path / "landmarks.csv"
    rows = [line.split(",") for line in table.read_text(encoding="utf-8").splitlines()]
    assert rows[0][7:10] == ["confirmed", "class", "signature"]
    for kept in (10, 7):
        table.write_text("".join(",".join(row[:kept]) + "\n" for row in rows), encoding="utf-8")
        found = read_result(tmp_path).landmarks
        assert found.confirmed is None and found.class_index is None and found.signature is None
        assert len(found.ids) == len(rows) - 1 and found.residuals == ()


def test_the_map_is_drawn_in_the_colours_of_its_classes_without_the_provisional_landmarks() -> None:
    landmarks = coloured_map()
    groups = {group.label: group for group in landmark_groups(landmarks)}
    assert set(groups) == {"landmark, class unknown", "landmark, blue", "landmark, yellow"}
    assert groups["landmark, blue"].color == "#0000ff"
    # Landmark 1 is blue and provisional.
    blue = sum(1 for row in range(len(landmarks.ids)) if landmarks.class_name(row) == "blue")
    assert len(groups["landmark, blue"].mean_m) == blue - 1
    assert class_color("large orange cone", 0) == "#ffa500"
    assert class_color("oak", 0) != class_color("elm", 1)


def test_a_kept_map_is_drawn_in_the_colours_of_its_classes() -> None:
    chart = make_run(landmarks=coloured_map()).map
    first, *others = chart.role
    axis = plot_chart(new_figure(6.0, 4.0).add_subplot(), replace(chart, role=("fixed", *others)))
    by_label = {str(line.get_label()): line for line in axis.get_lines()}
    plain = chart.landmarks.class_name(0) or "class unknown"
    assert by_label[f"fixed, {plain}"].get_marker() == "s" and len(by_label) == 4 and first == "prior"
    for name in ("blue", "yellow"):
        line = by_label[f"prior, {name}"]
        expected = [n for n in map(chart.landmarks.class_name, range(1, len(chart.role))) if n == name]
        assert line.get_color() == class_color(name, 0) and len(line.get_xdata()) == len(expected) > 0
    edges = axis.collections[0].get_edgecolor()
    assert len(np.unique(edges, axis=0)) == 3 and len(edges) == len(chart.role)


def test_provisional_landmarks_do_not_count_in_the_evaluation() -> None:
    log, plain = make_log(), make_run()
    count = len(plain.landmarks.ids)
    unknown = {"association": {"mode": "unknown"}}
    assert evaluate(make_run(config=unknown), log)["landmark_matched"] == count
    half = replace(plain.landmarks, confirmed=np.arange(count) < count // 2)
    found = evaluate(make_run(landmarks=half, config=unknown), log)
    assert found["landmark_matched"] == count // 2


def test_steps_take_classes_and_signatures() -> None:
    classes = {"classes": {"number": 2}, "signatures": {"std": 0.05, "spread": 1.0}}
    robot = fastslam.FastSlam({"association": classes}, identities="none")
    for time in range(3):
        robot.update(
            float(time),
            range_m=[2.0, 3.0],
            bearing_rad=[0.5, -0.4],
            class_index=[1, -1],
            signature=[np.nan, 0.3],
        )
    landmarks = robot.landmarks
    assert landmarks.class_index is not None and landmarks.class_index.tolist() == [1, -1]
    assert landmarks.signature is not None and np.isnan(landmarks.signature[0])
    assert landmarks.signature[1] == pytest.approx(0.3)
    assert landmarks.class_name(0) == "1"
    with pytest.raises(DataError, match="1 classes"):
        robot.update(3.0, range_m=[2.0, 3.0], bearing_rad=[0.5, -0.4], class_index=[1])


def test_a_class_that_is_not_configured_and_a_form_without_its_numbers_are_errors() -> None:
    log = interleaved_cones(1)
    too_many = log.sightings.class_index.copy()
    too_many[5] = 2
    changed = replace(log, sightings=replace(log.sightings, class_index=too_many))
    message = r"class 2 of a sighting: expected 0 to 1 \(association.classes.number\)"
    with pytest.raises(DataError, match=message):
        fastslam.run(changed, {"association": {"classes": {"number": 2}}})
    named = replace(changed, class_names=("blue", "yellow", "orange"))
    message = (
        r"class 'orange' of a sighting: expected one of blue, yellow \(association.classes.number is 2\)"
    )
    with pytest.raises(DataError, match=message):
        fastslam.run(named, {"association": {"classes": {"number": 2}}})
    with pytest.raises(ConfigError, match=r"association\.detection_probability"):
        fastslam.run(log, {"association": {"existence": {"form": "bayes"}}})


def test_a_name_is_believed_though_other_sightings_have_none() -> None:
    """After a lap nobody could tell by place which landmark is meant: names do, and clutter stays clutter."""
    world = {"seed": 3, "scan": {"identities": "all", "clutter_per_scan": 0.2}, "trajectory": {"laps": 2}}
    log = simulate(merge(presets()["cones"], world))
    unnamed = int((log.sightings.identity < 0).sum())
    assert 100 < unnamed < 0.05 * len(log.sightings.identity)
    metrics = evaluate(fastslam.run(log, {"filter": {"particles": 30}}, auto=False), log)
    assert metrics["landmarks"] == metrics["landmark_matched"] == 150

"""What logs, results and maps say of themselves."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from dataclasses import replace
from typing import Any

import fastslam
import numpy as np
import pytest
from fastslam.cards import MOST_DRAWN, map_picture
from fastslam.errors import ConfigError, DataError
from fastslam.log import Log
from fastslam.result import LandmarkMap, RunResult
from small_log import LANDMARKS_M, make_small_log


@pytest.fixture(scope="module")
def log() -> Log:
    return make_small_log(steps=120)


@pytest.fixture(scope="module")
def result(log: Log) -> RunResult:
    return fastslam.run(log, {"filter": {"particles": 20}, "seed": 5})


def landmarks(count: int, confirmed: int) -> LandmarkMap:
    mean_m = np.column_stack([np.arange(count) * 2.0, np.arange(count) * 1.0])
    return LandmarkMap(
        ids=tuple(f"<{row}>" for row in range(count)),
        mean_m=mean_m,
        covariance_m2=np.broadcast_to(np.diag([0.04, 0.01]), (count, 2, 2)).copy(),
        sightings=np.arange(count),
        confirmed=np.arange(count) < confirmed,
    )


def test_cards_are_short_and_count(log: Log, result: RunResult) -> None:
    for text in (repr(log), repr(result), repr(result.landmarks)):
        assert 30 < len(text) < 600, text
    assert f"{len(log.sightings.stamp_s):,} sightings" in repr(log)
    assert f"{len(LANDMARKS_M)} landmarks" in repr(log)
    assert f"{len(LANDMARKS_M)} landmarks" in repr(result) and "20 particles, seed 5" in repr(result)
    assert "stopped before the end" in repr(replace(result, interrupted=True))
    assert "stopped before the end" not in repr(result)


def test_provisional_landmarks_are_not_counted_as_landmarks() -> None:
    text = repr(landmarks(10, confirmed=7))
    assert text.startswith("LandmarkMap of 7 landmarks and 3 provisional\n")
    # The first seven span 12 m by 6 m; the larger standard deviation is 0.2 m.
    assert "over 12.0 m by 6.0 m, standard deviation 0.2 m" in text
    assert repr(landmarks(0, confirmed=0)) == "LandmarkMap of 0 landmarks"


def test_the_picture_of_a_notebook_has_every_landmark(result: RunResult) -> None:
    html: Any = result._repr_html_()
    assert html.count("<circle") == len(result.landmarks.ids) and html.count("<polyline") == 1
    picture = map_picture(landmarks(10, confirmed=7))
    assert picture.count("<circle") == 7 and "&lt;3&gt;, 3 sightings" in picture
    circles = [node for node in ET.fromstring(picture).iter() if node.tag == "circle"]
    # Landmarks go up and to the right, so on the screen y falls while x grows.
    assert float(circles[0].attrib["cx"]) < float(circles[6].attrib["cx"])
    assert float(circles[0].attrib["cy"]) > float(circles[6].attrib["cy"])
    assert map_picture(landmarks(0, confirmed=0)) == ""
    assert map_picture(landmarks(3 * MOST_DRAWN, confirmed=3 * MOST_DRAWN)).count("<circle") == MOST_DRAWN


def test_the_card_of_a_log_shows_the_truth_or_else_the_path_of_odometry(log: Log) -> None:
    html: Any = log._repr_html_()
    assert html.count("<circle") == len(LANDMARKS_M) and html.count("<title>post") == len(LANDMARKS_M)
    assert len(html) < 20_000
    blind = replace(log, truth_trajectory=None)
    html = blind._repr_html_()
    # A circle of 4 m by odometry, without landmarks: those of a survey lie in another frame.
    corners = html.partition('points="')[2].partition('"')[0].split()
    assert "<circle" not in html and len(corners) > 20 and len(set(corners)) > 20
    nothing = replace(blind, config={})
    assert "<svg" not in nothing._repr_html_() and "no truth" not in nothing._repr_html_()


def test_figures_show_themselves_in_a_notebook(log: Log, result: RunResult) -> None:
    from fastslam.plots import map_figure

    figure: Any = map_figure(result, log)
    picture = figure._repr_png_()
    assert picture.startswith(b"\x89PNG") and 10_000 < len(picture) < 400_000
    assert len(figure.axes[0].lines) > 3


def test_geojson_in_metres_is_asked_for_by_name(result: RunResult) -> None:
    found = result.landmarks.to_geojson(coordinates="local_metres")
    assert found["type"] == "FeatureCollection" and found["coordinate_system"] == "local_metres"
    assert "coordinates" not in found  # RFC 7946, section 7.1
    assert [feature["id"] for feature in found["features"]] == list(result.landmarks.ids)
    first = found["features"][0]
    assert first["geometry"] == {"type": "Point", "coordinates": result.landmarks.mean_m[0].tolist()}
    assert first["properties"]["x_std_m"] == pytest.approx(result.landmarks.covariance_m2[0, 0, 0] ** 0.5)
    with pytest.raises(ConfigError, match="coordinates: got wgs84"):
        result.landmarks.to_geojson(coordinates="wgs84")  # type: ignore[arg-type]


def test_a_log_from_arrays_runs_as_the_log_it_was_made_from(log: Log, result: RunResult) -> None:
    names = [log.identity_names[index] for index in log.sightings.identity]
    columns = (log.sightings.stamp_s, log.sightings.range_m, log.sightings.bearing_rad)
    made = Log.from_arrays(
        (log.controls.stamp_s, log.controls.values.tolist()), columns, identities=names, config=log.config
    )
    again = fastslam.run(made, {"filter": {"particles": 20}, "seed": 5})
    row = {name: index for index, name in enumerate(again.landmarks.ids)}
    order = [row[name] for name in result.landmarks.ids]
    assert len(order) == len(LANDMARKS_M)
    np.testing.assert_array_equal(again.trajectory.T_world_robot, result.trajectory.T_world_robot)
    np.testing.assert_array_equal(again.landmarks.mean_m[order], result.landmarks.mean_m)


def test_sightings_of_a_log_from_arrays_are_sorted_and_may_lack_names() -> None:
    made = Log.from_arrays(
        ([0.0, 1.0], [[1.0, 0.0], [1.0, 0.0]]),
        ([0.9, 0.2, 0.5, 0.2], [1.0, 2.0, 3.0, 4.0], [0.1, 0.2, 0.3, 0.4]),
        identities=["b", None, float("nan"), 7],
    )
    assert made.sightings.stamp_s.tolist() == [0.2, 0.2, 0.5, 0.9]
    assert made.sightings.range_m.tolist() == [2.0, 4.0, 3.0, 1.0]
    assert made.identity_names == ("b", "7") and made.sightings.identity.tolist() == [-1, 1, -1, 0]


@pytest.mark.parametrize(
    ("controls", "sightings", "message"),
    [
        (([0.0, 0.0], [[1, 0], [1, 0]]), ([], [], []), "row 1 .0. does not"),
        (([0.0], [[1, 0], [1, 0]]), ([], [], []), "1 stamps and 2 rows"),
        (([0.0], [[1, float("nan")]]), ([], [], []), "controls: values: row 0 is not finite"),
        (([0.0], [[1]]), ([], [], []), "1 columns, expected 2 or 3"),
        (([0.0], [1.0]), ([], [], []), "shape"),
        (([0.0], [["x", "y"]]), ([], [], []), "expected numbers, got"),
        (([0.0], [[1, 0]]), ([0.0], [1.0, 2.0], [0.0]), "of one length"),
        (([0.0], [[1, 0]]), ([0.0], [-1.0], [0.0]), "row 0 is -1"),
    ],
)
def test_arrays_that_make_no_log_are_refused(controls: Any, sightings: Any, message: str) -> None:
    with pytest.raises(DataError, match=message):
        Log.from_arrays(controls, sightings)

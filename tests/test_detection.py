"""Scans in logs and landmarks detected in them, from Python."""

from __future__ import annotations

import base64
import json
from dataclasses import replace
from pathlib import Path

import fastslam
import numpy as np
import pytest
from fastslam.datasets import load, write_native
from fastslam.datasets.clean import no_sightings
from fastslam.detection import VERDICTS, configure_detector, detect, explain, find, with_sightings
from fastslam.errors import ConfigError, DataError
from fastslam.evaluation import evaluate
from fastslam.log import BeamGeometry, Controls, Floats, Log, Scans
from fastslam.plots.scan import plot_scan, write_scan_figure, write_scan_page
from fastslam.runner import configure
from matplotlib.figure import Figure
from scipy.spatial import cKDTree

STEP_RAD = np.pi / 360
GEOMETRY = BeamGeometry(-np.pi / 2, STEP_RAD, 0.1, 80.0)


def scans_of_posts(count: int = 4) -> Scans:
    """Posts of 0.6 m at (8, 2) and (5, -3) m, seen by a sensor that creeps ahead by 0.1 m a scan."""
    angle = GEOMETRY.first_angle_rad + STEP_RAD * np.arange(361)
    ranges_m = np.full((count, 361), np.inf)
    for scan in range(count):
        for x_m, y_m in ((8.0 - 0.1 * scan, 2.0), (5.0 - 0.1 * scan, -3.0)):
            along = x_m * np.cos(angle) + y_m * np.sin(angle)
            across = x_m * np.sin(angle) - y_m * np.cos(angle)
            hit = (np.abs(across) < 0.3) & (along > 0)
            ranges_m[scan, hit] = along[hit] - np.sqrt(0.09 - across[hit] ** 2)
    return Scans(0.2 * np.arange(count), ranges_m, GEOMETRY)


def log_of_posts() -> Log:
    controls = Controls(np.array([0.0, 0.2, 0.4, 0.6]), np.tile([0.5, 0.0], (4, 1)))
    settings = {
        "motion": {"model": "velocity", "speed_std_m_per_s": 0.1, "yaw_rate_std_rad_per_s": 0.1},
        "sensor": {"model": "range_bearing", "range_std_m": 0.1, "bearing_std_rad": 0.02},
    }
    return Log("posts", "memory", "test", controls, no_sightings(), scans=scans_of_posts(), config=settings)


def test_detections_are_where_the_posts_are() -> None:
    found = find(scans_of_posts())
    assert found.scan_index.tolist() == [0, 0, 1, 1, 2, 2, 3, 3]
    assert found.covariance.shape == (8, 3)
    np.testing.assert_allclose(found.range_m[:2], [np.hypot(5, 3), np.hypot(8, 2)], atol=0.03)
    np.testing.assert_allclose(found.bearing_rad[:2], [np.arctan2(-3, 5), np.arctan2(2, 8)], atol=0.003)
    np.testing.assert_allclose(found.signature, 0.6, atol=0.08)


def test_single_and_double_precision_agree() -> None:
    scans = scans_of_posts()
    single = find(replace(scans, ranges_m=scans.ranges_m.astype(np.float32)))
    np.testing.assert_allclose(single.range_m, find(scans).range_m, atol=1e-5)


def test_a_run_detects_where_a_log_has_only_scans() -> None:
    result = fastslam.run(log_of_posts())
    assert len(result.landmarks.ids) == 2
    assert result.steps.sightings.sum() == 8


def test_detected_sightings_replace_those_of_the_log() -> None:
    log = detect(log_of_posts(), {"trunks": {"max_range_m": 7.0}})
    assert len(log.sightings.stamp_s) == 4
    assert log.config["association"] == {"mode": "unknown"}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"geometry": replace(GEOMETRY, angle_step_rad=0.5)}, "geometry.angle_step_rad"),
        ({"geometry": replace(GEOMETRY, first_angle_rad=float("nan"))}, "first_angle_rad"),
        ({"geometry": replace(GEOMETRY, max_range_m=0.0)}, "geometry.max_range_m"),
        ({"intensities": np.zeros((4, 7))}, "intensities"),
        ({"stamp_s": np.zeros(3)}, "4 rows for 3 stamps"),
        ({"ranges_m": np.zeros(361)}, "ranges_m"),
    ],
)
def test_scans_that_make_no_sense_are_an_error(change: dict[str, object], message: str) -> None:
    with pytest.raises(DataError, match=message):
        find(replace(scans_of_posts(), **change))


def test_hostile_ranges_are_survived() -> None:
    rng = np.random.default_rng(5)
    odd = np.array([np.nan, np.inf, -np.inf, 0.0, -1.0, 1e300, 5.0])
    ranges_m = rng.choice(odd, size=(300, 361))
    scans = Scans(np.arange(300.0), ranges_m, GEOMETRY, intensities=rng.choice(odd, size=(300, 361)))
    for kind in ("trunks", "reflectors", "corners"):
        found = find(scans, {"kind": kind})
        assert np.isfinite(found.range_m).all() and np.isfinite(found.covariance).all()


def test_unknown_settings_and_logs_without_scans_are_errors() -> None:
    with pytest.raises(ConfigError, match="trunks"):
        configure_detector({"trunks": {"jump": 1.0}})
    with pytest.raises(DataError, match="no laser scans"):
        detect(replace(log_of_posts(), scans=None))


def test_a_native_log_keeps_its_scans(tmp_path: Path) -> None:
    log = log_of_posts()
    assert log.scans is not None
    geometry = replace(GEOMETRY, beam_period_s=1e-4)
    scans = replace(
        log.scans,
        geometry=geometry,
        intensities=np.ones_like(log.scans.ranges_m),
        detector={"kind": "corners"},
    )
    back = load(write_native(replace(log, scans=scans), tmp_path / "log")).scans
    assert back is not None and back.geometry == geometry and back.detector == {"kind": "corners"}
    np.testing.assert_array_equal(back.ranges_m, scans.ranges_m)
    np.testing.assert_array_equal(back.stamp_s, scans.stamp_s)
    assert back.intensities is not None and back.mounting == (0.0, 0.0, 0.0)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"ranges_m": np.zeros((3, 361))}, "ranges_m"),
        ({"range_cm": np.zeros(3)}, "unknown array range_cm"),
        ({"angle_step_rad": 0.0}, "angle_step_rad"),
        ({"max_range_m": "far"}, "max_range_m"),
        ({"mounting": np.zeros(2)}, "mounting"),
        ({"detector_json": "{"}, "detector_json"),
        ({"stamp_s": None}, "stamp_s is missing"),
    ],
)
def test_faults_in_scans_npz_name_the_array(tmp_path: Path, change: dict[str, object], message: str) -> None:
    folder = write_native(log_of_posts(), tmp_path / "log")
    with np.load(folder / "scans.npz") as content:
        arrays = {**content, **change}
    np.savez(folder / "scans.npz", **{key: value for key, value in arrays.items() if value is not None})
    with pytest.raises(DataError, match=rf"scans\.npz: .*{message}"):
        load(folder)
    (folder / "scans.npz").write_bytes(b"PK no archive")
    with pytest.raises(DataError, match=r"scans\.npz: is no readable NPZ file"):
        load(folder)


def test_disordered_scans_are_repaired_and_counted(tmp_path: Path) -> None:
    folder = write_native(log_of_posts(), tmp_path / "log")
    with np.load(folder / "scans.npz") as content:
        arrays = {**content, "stamp_s": np.array([0.2, 0.0, np.nan, 0.2])}
    np.savez(folder / "scans.npz", **arrays)
    log = load(folder)
    assert log.scans is not None and log.scans.stamp_s.tolist() == [0.0, 0.2]
    assert sorted(problem.count for problem in log.problems) == [1, 1, 1]


def test_car_park_from_raw_scans(data_dir: Path) -> None:
    log = load(data_dir / "car_park", run=3)
    assert log.scans is not None and log.scans.ranges_m.shape == (1296, 361)
    metrics = evaluate(fastslam.run(log, {"filter": {"particles": 100}, "seed": 0}), detect(log))
    assert metrics["landmark_matched"] >= 9
    assert metrics["landmark_rmse_m"] <= 0.10
    assert metrics["ate_rmse_m"] <= 0.50
    assert metrics["smoothed_ate_rmse_m"] <= 0.40


def test_no_post_of_the_car_park_is_split_in_two(data_dir: Path) -> None:
    log = with_sightings(load(data_dir / "car_park"))
    seen = log.sightings
    place = seen.range_m * np.exp(1j * seen.bearing_rad)
    beside = np.flatnonzero(np.diff(seen.stamp_s) == 0)
    assert len(place) > 1900 and len(beside) > 500
    assert np.abs(place[beside + 1] - place[beside]).min() > 0.5


def test_victoria_park_scans_are_read_and_detected(data_dir: Path) -> None:
    log = load(data_dir / "victoria_park" / "ascii_2003")
    assert log.scans is not None and log.scans.ranges_m.shape == (7230, 361)
    found = find(log.scans, log.scans.detector)
    assert 60_000 < len(found.stamp_s) < 110_000
    features = load(data_dir / "victoria_park" / "features_rfs_slam").sightings
    scan = np.searchsorted(log.scans.stamp_s, features.stamp_s - 1e-3)
    # Most of what others took for a tree is found, to centimetres; they went to 75 m.
    wanted = (features.range_m < 35.0) & (scan < 1500)
    chosen = found.scan_index < 1500
    place = np.column_stack([found.scan_index * 1e3, *polar(found.range_m, found.bearing_rad)])[chosen]
    theirs = np.column_stack([scan * 1e3, *polar(features.range_m, features.bearing_rad)])[wanted]
    distance_m, _ = cKDTree(place).query(theirs)
    assert len(theirs) > 8_000 and np.mean(distance_m < 0.5) > 0.8
    assert np.median(distance_m[distance_m < 0.5]) < 0.05


def polar(range_m: Floats, bearing_rad: Floats) -> tuple[Floats, Floats]:
    return range_m * np.cos(bearing_rad), range_m * np.sin(bearing_rad)


@pytest.mark.slow
def test_victoria_park_from_raw_scans(data_dir: Path) -> None:
    log = detect(load(data_dir / "victoria_park" / "ascii_2003"))
    found = evaluate(fastslam.run(log, {"seed": 1}), log)
    # Five seeds: median 1.06 m, worst 1.33 m.
    assert found["gps_median_m"] <= 1.35


def test_a_scan_is_drawn_with_its_detections(tmp_path: Path) -> None:
    log = log_of_posts()
    assert log.scans is not None
    found = explain(log.scans)
    axis = Figure().add_subplot()
    plot_scan(axis, log.scans, found, scan=1, max_range_m=30.0)
    assert axis.get_title() == "Scan 1 at 0.20 s: 2 detections"
    crosses = [line.get_xydata() for line in axis.lines if line.get_marker() == "+"]
    np.testing.assert_allclose(np.vstack(crosses), [[3.0, 4.9], [-2.0, 7.9]], atol=0.03)
    assert write_scan_figure(log, tmp_path / "scan.png", scan=0).read_bytes()[:4] == b"\x89PNG"
    with pytest.raises(DataError, match="scans 0 to 3"):
        write_scan_figure(log, tmp_path / "other.png", scan=4)


def test_a_figure_says_why_an_object_was_missed() -> None:
    scans = scans_of_posts()
    found = explain(scans, {"trunks": {"max_diameter_m": 0.3, "min_beams": 10}})
    named = [VERDICTS[verdict] for verdict in found[1].verdict]
    assert len(found[0].range_m) == 0 and named.count("too wide") == 4 and named.count("too few beams") == 4
    axis = Figure().add_subplot()
    plot_scan(axis, scans, found, scan=0, max_range_m=30.0)
    legend = axis.get_legend()
    assert legend is not None
    assert [text.get_text() for text in legend.get_texts()] == ["too few beams (1)", "too wide (1)"]
    labels = {text.get_text(): text.xy for text in axis.texts}
    # To the right and ahead of the sensor, at the surface of the nearer post.
    assert labels["too wide"] == pytest.approx((3.0 - 0.3 * 3 / 34**0.5, 5.0 - 0.3 * 5 / 34**0.5), abs=0.05)


def test_pieces_cover_every_echo_once() -> None:
    scans = scans_of_posts()
    _, pieces = explain(scans)
    beams = (pieces.last_beam - pieces.first_beam + 1).sum()
    assert len(pieces.verdict) == 8 and beams == np.isfinite(scans.ranges_m).sum()


def test_the_page_of_scans_holds_them_all(tmp_path: Path) -> None:
    page = write_scan_page(log_of_posts(), tmp_path / "scans.html").read_text(encoding="utf-8")
    text = page.split('type="application/json">')[1].split("</script>")[0]
    data = json.loads(text)
    assert [len(rows) for rows in data["detections"]] == [2, 2, 2, 2]
    ranges_cm = np.frombuffer(base64.b64decode(data["ranges_cm"]), dtype="<u2").reshape(4, 361)
    assert ranges_cm.max() == round(100 * max(r for r in scans_of_posts().ranges_m.ravel() if r < 80))
    assert [len(rows) for rows in data["pieces"]] == [2, 2, 2, 2]
    assert [name for name, _ in data["verdicts"]] == list(VERDICTS)
    assert "http" not in page


def limits_of(log: Log, detector: dict[str, object] | None = None) -> tuple[float, float]:
    sensor = configure(detect(log, detector))["sensor"]
    return sensor["max_range_m"], sensor["field_of_view_rad"]


def test_scans_say_how_far_and_how_far_aside_landmarks_are_seen() -> None:
    log = log_of_posts()
    # Half of the largest diameter, 2 m, lies between the surface and the middle of a trunk.
    assert limits_of(log) == pytest.approx((76.0, np.pi))
    assert limits_of(log, {"trunks": {"max_range_m": 10.0, "max_diameter_m": 0.4}})[0] == pytest.approx(10.2)
    assert limits_of(log, {"kind": "corners"})[0] == pytest.approx(80.0)
    before = configure(log)["sensor"]
    assert (before["max_range_m"], before["field_of_view_rad"]) == pytest.approx((76.0, np.pi))
    own = {**log.config, "sensor": {**log.config["sensor"], "max_range_m": 12.0, "field_of_view_rad": 1.0}}
    assert limits_of(replace(log, config=own)) == (12.0, 1.0)


@pytest.mark.parametrize(
    ("first_deg", "beams", "view_deg"),
    [(-180.0, 720, 360.0), (0.0, 720, 360.0), (-60.0, 241, 120.0), (-30.0, 181, 60.0), (300.0, 241, 120.0)],
)
def test_the_field_of_view_is_what_the_beams_fill_on_both_sides(
    first_deg: float, beams: int, view_deg: float
) -> None:
    log = log_of_posts()
    geometry = replace(GEOMETRY, first_angle_rad=np.radians(first_deg))
    scans = Scans(0.2 * np.arange(4), np.full((4, beams), np.inf), geometry)
    assert limits_of(replace(log, scans=scans))[1] == pytest.approx(np.radians(view_deg))
    # No beam points ahead: nothing can be said of an angle that is centred there.
    aside = replace(scans, geometry=replace(geometry, first_angle_rad=np.radians(90.0)))
    if beams < 400:
        assert limits_of(replace(log, scans=aside))[1] == pytest.approx(2.0 * np.pi)


def test_trees_beyond_the_detectors_reach_are_not_gone() -> None:
    # A third post, 40 m ahead, is in the map; the detector looks 12 m far, so that nobody can miss it.
    log = log_of_posts()
    assert log.scans is not None
    many = Scans(0.2 * np.arange(40), np.repeat(log.scans.ranges_m[:1], 40, axis=0), GEOMETRY)
    still = Controls(0.2 * np.arange(40), np.zeros((40, 2)))
    chart = fastslam.Map.at({"a": (8.0, 2.0), "b": (5.0, -3.0), "far": (40.0, 0.0)})

    def gone(detector: dict[str, object]) -> list[str]:
        standing = replace(log, controls=still, scans=replace(many, detector=detector))
        result = fastslam.run(standing, map=chart.with_role("fixed"))
        assert result.changes is not None
        return list(result.changes.gone)

    assert gone({}) == ["far"]
    assert gone({"trunks": {"max_range_m": 12.0}}) == []

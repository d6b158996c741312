"""Pose graphs as text: g2o, TORO and iSAM, GTSAM and PyFG."""

from __future__ import annotations

import gzip
from pathlib import Path

import numpy as np
import pytest
from fastslam.datasets import load
from fastslam.datasets.graph_noise import from_information, from_square_root, from_toro, meaning_of_edge2
from fastslam.errors import DataError
from fastslam.log import Log

UPPER = np.triu_indices(3)
# A covariance that is neither diagonal nor the same along x and y.
COVARIANCE = np.array([[0.04, 0.01, 0.002], [0.01, 0.09, -0.001], [0.002, -0.001, 0.0025]])
INFORMATION = np.linalg.inv(COVARIANCE)


def text(values: np.ndarray) -> str:
    return " ".join(repr(float(value)) for value in values)


G2O = f"""\
VERTEX_SE2 0 1 2 0.5
VERTEX_XY 7 4 5
VERTEX_SE2 1 2 2 0.5
VERTEX_SE2 2 3 2 0.5
FIX 0
EDGE_SE2 0 1 1 0 0.5 {text(INFORMATION[UPPER])}
EDGE_SE2_XY 0 7 3 4 100 0 25
EDGE_SE2 1 2 1 0 0.5 {text(INFORMATION[UPPER])}
EDGE_SE2_POINT_XY 2 7 0 -2 100 0 25
EDGE_SE2 2 0 -2 0 -1 {text(INFORMATION[UPPER])}
"""


def written(base: Path, name: str, content: str) -> Path:
    path = base / name
    path.write_text(content)
    return path


def names(log: Log) -> list[str]:
    return [log.identity_names[index] for index in log.sightings.identity]


def test_g2o_is_read_with_its_noise(tmp_path: Path) -> None:
    log = load(written(tmp_path, "small.g2o", G2O))
    assert log.format == "g2o" and log.name == "small"
    np.testing.assert_array_equal(log.controls.values, [[1, 0, 0.5], [1, 0, 0.5]])
    np.testing.assert_array_equal(log.controls.stamp_s, [1, 2])
    np.testing.assert_allclose(log.controls.covariance, [COVARIANCE[UPPER]] * 2, rtol=1e-12, atol=1e-15)
    np.testing.assert_allclose(log.sightings.range_m, [5, 2])
    np.testing.assert_allclose(log.sightings.bearing_rad, [np.arctan2(4, 3), -np.pi / 2])
    # Straight to the right, y is the range: its variance is 1/25, that across 1/100 over 2 m squared.
    assert log.sightings.covariance is not None
    np.testing.assert_allclose(log.sightings.covariance[1], [0.04, 0, 0.0025], atol=1e-17)
    assert names(log) == ["7", "7"]
    assert log.config["initial_pose"] == {"x_m": 1.0, "y_m": 2.0, "heading_rad": 0.5}
    assert log.truth_landmarks is None and log.truth_trajectory is None
    assert any("initial guess, not truth" in note for note in log.notes)
    assert [(problem.message, problem.count) for problem in log.problems] == [
        ("edges between poses that do not follow each other: not used", 1)
    ]


def test_g2o_without_information_takes_the_defaults(tmp_path: Path) -> None:
    lines = [line.split() for line in G2O.splitlines()]
    bare = "\n".join(" ".join(words[: 6 if words[0] == "EDGE_SE2" else 5]) for words in lines) + "\n"
    log = load(written(tmp_path, "student.g2o", bare))
    assert log.controls.covariance is None and log.sightings.covariance is None
    assert log.config["motion"] == {"model": "increments"} and log.config["sensor"] == {
        "model": "range_bearing"
    }
    assert len(log.sightings.stamp_s) == 2 and any("no noise" in note for note in log.notes)


def test_edge_that_leads_back_is_turned_round(tmp_path: Path) -> None:
    """From pose 1 pose 0 is at (-1, -2) facing -90 deg: from pose 0 pose 1 is at (-2, 1) facing 90 deg.

    What noise of the edge becomes, to first order, is what many noisy edges turned round show.
    """
    back = f"EDGE_SE2 1 0 -1 -2 {-np.pi / 2!r} {text(INFORMATION[UPPER])}\nEDGE_SE2_XY 0 7 3 4\n"
    log = load(written(tmp_path, "back.g2o", back))
    np.testing.assert_allclose(log.controls.values, [[-2.0, 1.0, np.pi / 2]], atol=1e-15)
    draws = np.random.default_rng(3).multivariate_normal(np.zeros(3), 1e-4 * COVARIANCE, 200_000)
    x, y, heading = (np.array([-1, -2, -np.pi / 2]) + draws).T
    turned = np.column_stack(
        [-np.cos(heading) * x - np.sin(heading) * y, np.sin(heading) * x - np.cos(heading) * y, -heading]
    )
    sampled = 1e4 * np.cov(turned.T)
    assert log.controls.covariance is not None
    # 200,000 draws: each entry within 5 standard errors of at most 2 / sqrt(200,000) of the largest variance.
    np.testing.assert_allclose(log.controls.covariance[0], sampled[UPPER], atol=5 * 2 / 447 * sampled.max())


def test_bearings_and_ranges_of_one_landmark_make_a_sighting(tmp_path: Path) -> None:
    rows = "EDGE_SE2 0 1 1 0 0\nEDGE_BEARING_SE2_XY 0 5 0.25 400\nEDGE_BEARING_SE2_XY 1 5 0.5 400\n"
    log = load(written(tmp_path, "pairs.g2o", rows + "EDGE_RANGE_SE2_XY 0 5 3 25\n"))
    assert (log.sightings.range_m.tolist(), log.sightings.bearing_rad.tolist()) == ([3.0], [0.25])
    np.testing.assert_allclose(log.sightings.covariance, [[0.04, 0, 0.0025]])
    assert [problem.message for problem in log.problems] == ["bearings without range: not used"]


def test_bearings_alone_make_a_log_of_them_and_so_do_ranges(tmp_path: Path) -> None:
    rows = "EDGE_SE2 0 1 1 0 0\nEDGE_BEARING_SE2_XY 0 5 0.25 400\nEDGE_BEARING_SE2_XY 1 5 0.5 400\n"
    log = load(written(tmp_path, "bearings.g2o", rows))
    assert log.sightings.bearing_rad.tolist() == [0.25, 0.5] and np.isnan(log.sightings.range_m).all()
    assert log.config["sensor"] == {"model": "bearing", "bearing_std_rad": 0.05} and log.problems == ()
    log = load(written(tmp_path, "ranges.g2o", "EDGE_SE2 0 1 1 0 0\nEDGE_RANGE_SE2_XY 0 5 300 25\n"))
    assert log.sightings.range_m.tolist() == [300.0] and np.isnan(log.sightings.bearing_rad).all()
    assert log.config["sensor"] == {"model": "range", "range_std_m": 0.2, "max_range_m": 330}


SQUARE_ROOT = np.linalg.cholesky(INFORMATION).T
TORO = [0, 1, 3, 5, 2, 4]
# matrix of an edge, what else stands in the file, tells
MEANINGS = [
    ("information in TORO's order", INFORMATION[UPPER][TORO], "VERTEX2 0 0 0 0\n"),
    ("information in TORO's order", np.array([25.0, 0, 4, 400, 0, 0]), ""),
    ("square roots of information, as iSAM has it", SQUARE_ROOT[UPPER], ""),
    ("square roots of information, as iSAM has it", np.array([50.0, 0, 0, 50, 0, 100]), ""),
    ("covariances", COVARIANCE[UPPER], ""),
    ("covariances", np.array([1e-4, 0, 0, 4e-6, 0, 4e-6]), ""),
]


@pytest.mark.parametrize(("meaning", "matrix", "vertices"), MEANINGS)
def test_noise_of_edges_is_told_apart(
    tmp_path: Path, meaning: str, matrix: np.ndarray, vertices: str
) -> None:
    rows = f"{vertices}EDGE2 0 1 1 0 0 {text(matrix)}\nLANDMARK 1 1 3 4\n"
    log = load(written(tmp_path, "graph.txt", rows))
    assert log.format == "toro" and f"the noise of edges is taken as {meaning}" in log.notes
    found, words = meaning_of_edge2(matrix[None], with_vertices=bool(vertices))
    assert words == meaning
    assert log.controls.covariance is not None
    np.testing.assert_allclose(log.controls.covariance[0], found(matrix[None])[0][UPPER], rtol=1e-12)
    if np.count_nonzero(matrix) == 6:
        np.testing.assert_allclose(log.controls.covariance[0], COVARIANCE[UPPER], rtol=1e-9, atol=1e-12)


def test_three_ways_to_write_one_covariance() -> None:
    for read, triangle in (
        (from_information, INFORMATION[UPPER]),
        (from_square_root, SQUARE_ROOT[UPPER]),
        (from_toro, INFORMATION[UPPER][TORO]),
    ):
        np.testing.assert_allclose(read(triangle[None])[0], COVARIANCE, rtol=1e-9)


def test_isam_numbers_poses_and_landmarks_together(tmp_path: Path) -> None:
    step = "1 0 0 1e-4 0 0 1e-4 0 1e-4\n"
    rows = f"ODOMETRY 0 1 {step}LANDMARK 1 2 3 4 0.4 0 0.4\nODOMETRY 1 3 {step}"
    log = load(written(tmp_path, "vp.txt", rows + "LANDMARK 3 2 2 4 0.4 0 0.4\n"))
    np.testing.assert_array_equal(log.sightings.stamp_s, [1, 2])
    assert names(log) == ["2", "2"]


def test_bearing_and_range_of_gtsam(tmp_path: Path) -> None:
    rows = "VERTEX2 0 0 0 0\nEDGE2 0 1 1 0 0 1 0 1 1 0 0\nBR 0 9 0.5 4 0.03 0.1\n"
    log = load(written(tmp_path, "example.graph", rows))
    assert (log.sightings.bearing_rad[0], log.sightings.range_m[0]) == (0.5, 4.0)
    np.testing.assert_allclose(log.sightings.covariance, [[0.01, 0, 0.0009]])


PYFG = """\
VERTEX_SE2 10.5 A0 1 2 0.5
VERTEX_SE2 11.5 A1 2 2 0.5
VERTEX_SE2 10.5 B0 5 5 0
VERTEX_SE2 11.0 B1 6 5 0
VERTEX_XY L3 4 5
EDGE_SE2 11.5 A0 A1 1 0 0 0.01 0 0 0.01 0 0.0001
EDGE_SE2 11.0 B0 B1 1 0 0 0.01 0 0 0.01 0 0.0001
EDGE_SE2_XY 10.5 B0 L3 2 0 0.25 0 0.25
EDGE_RANGE 10.5 A0 B0 4 0.01
EDGE_SE2_XY 11.5 A1 L3 3 0 0.25 0 0.25
"""


def test_pyfg_holds_a_log_for_each_robot_with_truth(tmp_path: Path) -> None:
    path = tmp_path / "two.pyfg.gz"
    path.write_bytes(gzip.compress(PYFG.encode()))
    for robot, range_m, stamp_s in ((1, 3.0, 11.5), (2, 2.0, 10.5)):
        log = load(path, robot=robot)
        assert log.name == f"two_{'AB'[robot - 1]}" and log.format == "pyfg"
        assert (log.sightings.range_m.tolist(), log.sightings.stamp_s.tolist()) == ([range_m], [stamp_s])
        np.testing.assert_allclose(log.controls.covariance, [[0.01, 0, 0, 0.01, 0, 0.0001]])
        assert log.truth_landmarks is not None and log.truth_landmarks.names == ("L3",)
        assert log.truth_trajectory is not None and len(log.truth_trajectory.stamp_s) == 2
    assert [problem.message for problem in load(path).problems] == ["ranges without bearing: not used"]
    with pytest.raises(DataError, match=r"has no robot 3; robots there: 1 \(A\), 2 \(B\)"):
        load(path, robot=3)
    ranges_only = "".join(line for line in PYFG.splitlines(keepends=True) if "EDGE_SE2_XY" not in line)
    with pytest.raises(DataError, match=r"holds no landmarks: .*\(pyfg file; see docs/formats\.md\)"):
        load(written(tmp_path, "ranges.pyfg", ranges_only))
    to_landmark = load(written(tmp_path, "tiers.pyfg", ranges_only + "EDGE_RANGE 11.5 A1 L3 3 0.04\n"))
    assert to_landmark.sightings.range_m.tolist() == [3.0] and to_landmark.identity_names == ("L3",)
    assert to_landmark.config["sensor"] == {"model": "range", "range_std_m": 0.2}
    assert [problem.message for problem in to_landmark.problems] == ["ranges without bearing: not used"]


EDGE = "EDGE_SE2 0 1 1 0 0\n"
POINT = "EDGE_SE2_XY 1 5 3 4\n"
FAULTS = [
    # file, content, pattern
    ("a.g2o", "VERTEX_SE3:QUAT 0 0 0 0 0 0 0 1\n", r"g2o:1: VERTEX_SE3:QUAT is of a graph in space"),
    ("a.g2o", EDGE + "EDGE_FOO 1\n", r"g2o:2: got row 'EDGE_FOO', expected one of VERTEX_SE2"),
    ("a.g2o", EDGE + "EDGE_SE2_XY 1 5 3\n", r"g2o:2: EDGE_SE2_XY: got 4 columns, expected 5 or 8"),
    ("a.g2o", EDGE + "EDGE_SE2_XY 1 5 3", r"g2o:2: .*the file seems cut off"),
    ("a.g2o", EDGE + "EDGE_SE2_XY 1 5 3 x\n", r"g2o:2: EDGE_SE2_XY: got 'x', expected a finite number"),
    ("a.g2o", EDGE + "EDGE_SE2_XY 1 5 3 inf\n", r"g2o:2: EDGE_SE2_XY: got 'inf', expected a finite number"),
    ("a.g2o", EDGE + "EDGE_SE2_XY 4 5 3 4\n", r"g2o:2: EDGE_SE2_XY: pose 4 is not on the path of odometry"),
    (
        "a.g2o",
        EDGE + POINT.replace("\n", " 1 0 -1\n"),
        r"g2o:2: EDGE_SE2_XY: the noise is not positive definite",
    ),
    (
        "a.g2o",
        EDGE.replace("\n", " 1 0 0 0 0 1\n") + POINT,
        r"g2o:1: EDGE_SE2: the noise is not positive definite",
    ),
    ("a.g2o", EDGE, r"holds no landmarks: needs sightings of them"),
    ("a.g2o", "VERTEX_SE2 0 0 0 0\n", r"holds no edge between poses"),
    (
        "a.g2o",
        EDGE + "EDGE_SE2 2 3 1 0 0\n" + POINT,
        r"holds no edge from pose 1 to pose 2: the path is broken",
    ),
    ("a.g2o", EDGE.replace("0 1", "1 1") + POINT, r"holds no edge at all: the path is broken"),
    ("a.txt", "EDGE2 0 1 1 0 0 1 1\n", r"txt:1: EDGE2: got 8 columns, expected 6 or 12"),
]


@pytest.mark.parametrize(("name", "content", "pattern"), FAULTS)
def test_fault_names_line_format_and_page(tmp_path: Path, name: str, content: str, pattern: str) -> None:
    path = written(tmp_path, name, content)
    with pytest.raises(DataError, match=pattern) as caught:
        load(path)
    format_name = "g2o" if name.endswith("g2o") else "toro"
    assert str(caught.value).endswith(f"({format_name} file; see docs/formats.md)")
    assert "\n" not in str(caught.value)

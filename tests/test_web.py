"""The filter in a browser: the same bits as here, clear words about bad files, a page that stands alone.

What runs the compiled filter is skipped where `make web` was not called, or where there is no Node.
"""

from __future__ import annotations

import json
import re
import runpy
import shutil
import struct
import subprocess
from pathlib import Path
from typing import Any

import fastslam
import pytest
from doc_pages import ROOT
from fastslam.simulation import simulate

PAGE = ROOT / "crates" / "fastslam-wasm" / "page"
WASM = ROOT / "target" / "web" / "fastslam.wasm"
NODE = shutil.which("node")
built = pytest.mark.skipif(
    not WASM.is_file() or NODE is None, reason="needs the page that `make web` builds, and Node"
)
LOG = {
    "seed": 5,
    "world": {"count": 30, "size_m": [30.0, 30.0]},
    "trajectory": {"kind": "loop", "laps": 1, "margin_m": 6.0, "corner_radius_m": 5.0},
    "sensor": {"max_range_m": 9.0},
}


def ask(*requests: dict[str, Any]) -> list[dict[str, Any]]:
    """What the compiled filter answers, request by request."""
    assert NODE is not None
    lines = "\n".join(json.dumps(request) for request in requests)
    command = [NODE, str(PAGE / "ask.cjs"), str(WASM)]
    done = subprocess.run(command, input=lines, capture_output=True, text=True, timeout=120, check=True)
    answers = [json.loads(line) for line in done.stdout.splitlines()]
    assert len(answers) == len(requests)
    return answers


def files_of(folder: Path) -> dict[str, str]:
    names = {"odometry": "odometry.csv", "sightings": "sightings.csv", "settings": "log.yaml"}
    return {key: (folder / name).read_text(encoding="utf-8") for key, name in names.items()}


def hexadecimal(numbers: Any) -> str:
    return "".join(struct.pack(">d", float(number)).hex() for number in numbers)


@built
@pytest.mark.parametrize("names", [True, False])
def test_the_same_seed_gives_the_same_bits(tmp_path: Path, names: bool) -> None:
    log = simulate(LOG, name="log")
    fastslam.datasets.write_native(log, tmp_path / "log")
    log = fastslam.load(tmp_path / "log")
    filters = ["fastslam1", "fastslam2", "ekf"]
    settings = {"seed": 7, "filters": filters, "particles": 30, "names": names}
    answers = ask(
        {"ask": "load", "files": files_of(tmp_path / "log"), "settings": settings},
        {"ask": "replay", "seconds": 1e9},
        *({"ask": "bits", "filter": index} for index in range(3)),
    )
    assert [answer.get("error") for answer in answers] == [None] * 5 and answers[1]["answer"] is False
    for algorithm, answer in zip(filters, answers[2:], strict=True):
        result = fastslam.run(
            log,
            {
                "seed": 7,
                "algorithm": algorithm,
                "association": {"mode": "known" if names else "unknown"},
                "filter": {"particles": 30, "rejuvenation": {"every_steps": 0}},
            },
        )
        landmarks = result.landmarks
        rows = (
            [*mean, covariance[0][0], covariance[0][1], covariance[1][1]]
            for mean, covariance in zip(landmarks.mean_m, landmarks.covariance_m2, strict=True)
        )
        assert len(landmarks.mean_m) > 15
        assert answer["answer"]["map"] == "".join(hexadecimal(row) for row in rows), algorithm


@built
@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        (
            "odometry",
            "stamp_s,speed_m_per_s,yaw_rate_rad_per_s\n0,1\n",
            "csv, line 2: 2 columns, expected 3",
        ),
        ("odometry", "stamp_s,speed_m_per_s,yaw_rate_rad_per_s\n0,fast,0\n", "odometry.csv, line 2"),
        ("odometry", "time;v;w\n0;1;0\n", "no column stamp_s"),
        ("sightings", "stamp_s,range_m,bearing_rad\n0,3,90\n", "are these degrees?"),
        ("sightings", "stamp_s,range_m,bearing_rad,colour\n0,3,1,red\n", "does not know the column colour"),
        ("settings", "sensor: {range_std_m: -1}\n", "sensor.range_std_m: got -1"),
        ("settings", "motion: {model: hovercraft}\n", "does not fit motion.model hovercraft"),
        ("settings", "sensor: [1\n", "log.yaml"),
        ("settings", "sensors: {}\n", "log.yaml: sensors"),
    ],
)
def test_a_bad_file_is_told_with_its_line(name: str, text: str, said: str) -> None:
    files = {
        "odometry": "stamp_s,speed_m_per_s,yaw_rate_rad_per_s\n0,1,0\n1,1,0\n",
        "sightings": "stamp_s,range_m,bearing_rad\n0,3,1\n",
        "settings": "",
    }
    good, bad, driven = ask(
        {"ask": "load", "files": files, "settings": {}},
        {"ask": "load", "files": files | {name: text}, "settings": {}},
        {"ask": "drive", "speed": 1.0, "turn": 0.0, "ticks": 1},
    )
    assert good["answer"]["seconds"] == 1.0 and said in bad["error"]
    assert driven == {"error": "a log cannot be driven"}


@built
def test_a_robot_that_is_driven_is_followed() -> None:
    settings = {"seed": 3, "filters": ["fastslam2", "ekf"], "particles": 50, "landmarks": 60, "names": True}
    begin, _, world, *filters = ask(
        {"ask": "begin", "settings": settings},
        {"ask": "autopilot", "ticks": 600},
        {"ask": "world"},
        *({"ask": "now", "filter": index} for index in range(2)),
    )
    assert begin == {"answer": None}
    (x, y, _, reported_x, reported_y, *_), landmarks = world["answer"][:2]
    assert len(landmarks) == 2 * 60
    drift_m = ((x - reported_x) ** 2 + (y - reported_y) ** 2) ** 0.5
    for answer in filters:
        status = answer["answer"][0]
        assert ((x - status[0]) ** 2 + (y - status[1]) ** 2) ** 0.5 < min(0.5, drift_m)


def test_the_page_needs_nothing_beside_it(tmp_path: Path) -> None:
    wasm = tmp_path / "a.wasm"
    wasm.write_bytes(b"\0asm")
    page = runpy.run_path(str(PAGE / "bundle.py"))["bundle"](wasm)
    assert 'id="wasm">AGFzbQ==</script>' in page
    assert not re.search(r"""(?:src|href)=["']|https?://|@import|url\(""", page)


def test_every_control_of_the_page_is_a_setting() -> None:
    page = (PAGE / "index.html").read_text(encoding="utf-8")
    source = (PAGE.parent / "src" / "settings.rs").read_text(encoding="utf-8")
    names = set(re.findall(r'data-set="(\w+)"', page)) - {"sensor_noise"}
    fields = set(re.findall(r"^    pub (\w+):", source, re.MULTILINE))
    assert len(names) == 7 and names <= fields

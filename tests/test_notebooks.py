"""The notebooks run from top to bottom, with few seeds, and show what their text says."""

from __future__ import annotations

from typing import Any

import fastslam
import numpy as np
import pytest
from doc_pages import ROOT

pytestmark = pytest.mark.slow

NOTEBOOKS = sorted((ROOT / "examples" / "notebooks").glob("*.py"))


def cells(text: str) -> list[str]:
    """The code cells of a notebook in the percent format of Jupytext."""
    found = text.split("# %%")[1:]
    return [cell for cell in found if not cell.startswith(" [markdown]")]


def run_cells(name: str, *, few: tuple[str, str] = ("", "")) -> dict[str, Any]:
    """The names that a notebook leaves, and under `shown` what its cells end with.

    `few` is a line of it, and what stands there instead, so that it takes less time.
    """
    text = (ROOT / "examples" / "notebooks" / name).read_text(encoding="utf-8")
    assert few[0] in text
    names: dict[str, Any] = {"__name__": "__main__", "shown": []}
    for cell in cells(text.replace(*few)):
        body, _, last = f"pass\n{cell.strip()}".rpartition("\n")
        if last.isidentifier() or last.startswith("map_figure("):
            exec(compile(body, name, "exec"), names)
            names["shown"].append(eval(last, names))
        else:
            exec(compile(f"{body}\n{last}", name, "exec"), names)
    return names


@pytest.fixture(scope="module")
def paper() -> dict[str, Any]:
    return run_cells("paper.py", few=("SEEDS = range(1, 13)", "SEEDS = range(1, 4)"))


@pytest.fixture(scope="module")
def own_log() -> dict[str, Any]:
    return run_cells("own_log.py")


@pytest.fixture(scope="module")
def compare_filters() -> dict[str, Any]:
    return run_cells("compare_filters.py", few=("SEEDS = range(1, 6)", "SEEDS = range(1, 3)"))


@pytest.fixture(scope="module")
def own_sensor() -> dict[str, Any]:
    return run_cells("own_sensor.py")


@pytest.mark.parametrize(
    ("notebook", "count"), [("paper", 6), ("own_log", 3), ("compare_filters", 2), ("own_sensor", 3)]
)
def test_cells_end_with_what_shows_itself(notebook: str, count: int, request: pytest.FixtureRequest) -> None:
    shown = request.getfixturevalue(notebook)["shown"]
    assert len(shown) == count
    assert all(hasattr(item, "_repr_html_") or hasattr(item, "_repr_png_") for item in shown)


def test_every_notebook_is_run() -> None:
    assert [path.name for path in NOTEBOOKS] == [
        "compare_filters.py",
        "own_log.py",
        "own_sensor.py",
        "paper.py",
    ]


def test_the_paper_in_small(paper: dict[str, Any]) -> None:
    # A factor of 25 here: with 6 m of sight the robot drifts until it comes back.
    assert paper["uncertainty_m"][6.0] > 3.0 * paper["uncertainty_m"][25.0]
    errors = [error for found in paper["map_error_m"].values() for error in found]
    assert len(errors) == 7 and np.isfinite(errors).all() and min(errors) > 0.0
    assert len(paper["robot_by_count"]) == 3


def test_the_log_of_ones_own(own_log: dict[str, Any]) -> None:
    found_m = own_log["result"].landmarks.mean_m
    off_m = np.linalg.norm(found_m[:, None] - own_log["posts_m"][None], axis=-1).min(axis=1)
    assert len(found_m) == 5 and off_m.max() < 0.3
    assert own_log["findings"] == () and own_log["diagnosis"].suspected == ()
    assert len(fastslam.Map.load(own_log["FOLDER"] / "map").role) == 5


def test_the_filters_compared(compare_filters: dict[str, Any]) -> None:
    scores = compare_filters["scores"]
    assert len(scores) == 6
    for (mode, _), found in scores.items():
        assert 0.0 < np.median(found["map [m]"]) < 0.5
        assert mode == "unknown" or found["landmarks"] == scores["known", "EKF-SLAM"]["landmarks"] * len(
            found["landmarks"]
        )


def test_the_sensor_of_ones_own(own_sensor: dict[str, Any]) -> None:
    assert own_sensor["cases"] == 300 and own_sensor["apart_m"] < 1e-5
    assert own_sensor["error_m"] < 0.5 and len(own_sensor["result"].landmarks.ids) == 8
    assert own_sensor["widths_m"][0] > 10.0 > 3.0 > own_sensor["widths_m"][-1]

"""The notebooks run from top to bottom, with few seeds, and show what their text says."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from doc_pages import ROOT

NOTEBOOKS = sorted((ROOT / "examples" / "notebooks").glob("*.py"))


def cells(text: str) -> list[str]:
    """The code cells of a notebook in the percent format of Jupytext."""
    found = text.split("# %%")[1:]
    return [cell for cell in found if not cell.startswith(" [markdown]")]


@pytest.fixture(scope="module")
def paper() -> dict[str, Any]:
    """The names that the notebook leaves, and under `shown` what its cells end with."""
    text = (ROOT / "examples" / "notebooks" / "paper.py").read_text(encoding="utf-8")
    assert "SEEDS = range(1, 13)" in text
    names: dict[str, Any] = {"__name__": "__main__", "shown": []}
    for cell in cells(text.replace("SEEDS = range(1, 13)", "SEEDS = range(1, 4)")):
        body, _, last = f"pass\n{cell.strip()}".rpartition("\n")
        if last.isidentifier() or last.startswith("map_figure("):
            exec(compile(body, "paper.py", "exec"), names)
            names["shown"].append(eval(last, names))
        else:
            exec(compile(f"{body}\n{last}", "paper.py", "exec"), names)
    return names


def test_there_is_one_notebook() -> None:
    assert [path.name for path in NOTEBOOKS] == ["paper.py"]


def test_cells_end_with_what_shows_itself(paper: dict[str, Any]) -> None:
    assert len(paper["shown"]) == 7
    assert all(hasattr(item, "_repr_html_") or hasattr(item, "_repr_png_") for item in paper["shown"])


def test_the_paper_in_small(paper: dict[str, Any]) -> None:
    # A factor of 25 here: with 6 m of sight the robot drifts until it comes back.
    assert paper["uncertainty_m"][6.0] > 3.0 * paper["uncertainty_m"][25.0]
    errors = [error for found in paper["map_error_m"].values() for error in found]
    assert len(errors) == 7 and np.isfinite(errors).all() and min(errors) > 0.0
    assert len(paper["robot_by_count"]) == 3


def test_the_log_of_ones_own(paper: dict[str, Any]) -> None:
    found_m = paper["own"].landmarks.mean_m
    off_m = np.linalg.norm(found_m[:, None] - paper["posts_m"][None], axis=-1).min(axis=1)
    assert len(found_m) == 5 and off_m.max() < 0.3

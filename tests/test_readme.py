"""The figures of the README are those of the pages that measure them."""

from __future__ import annotations

import re

import pytest
from doc_pages import ROOT

README = (ROOT / "README.md").read_text(encoding="utf-8")


def rows(page: str) -> list[list[str]]:
    """The cells of every table of a page."""
    text = (ROOT / page).read_text(encoding="utf-8")
    return [
        [cell.strip() for cell in line.strip("|").split("|")]
        for line in text.splitlines()
        if line.startswith("|") and not line.startswith("|--")
    ]


def row_of(name: str) -> list[str]:
    """The row of the README's table that begins so."""
    found = [row for row in rows("README.md") if row[0].startswith(name)]
    assert len(found) == 1, name
    return found[0]


def median(cell: str) -> float:
    return float(cell.partition(" ")[0])


def worst(cell: str) -> float:
    return float(cell.partition("(")[2].partition(")")[0])


ACCURACY = {(row[0], row[1]): row[2:] for row in rows("docs/accuracy.md") if row[1] in ("known", "unknown")}


@pytest.mark.parametrize(
    ("readme", "page"), [("Lost in the Woods", "Lost in the Woods"), ("cityTrees", "cityTrees10000")]
)
def test_map_and_live_path_of_single_logs(readme: str, page: str) -> None:
    row = row_of(readme)
    for cell, identities in ((row[1], "known"), (row[2], "unknown")):
        measured = ACCURACY[page, identities]
        digits = len(cell.partition("/")[2].strip().partition(";")[0].partition(".")[2])
        assert cell.startswith(f"{median(measured[0]):.3f} / {median(measured[1]):.{digits}f}")


@pytest.mark.parametrize("log", [1, 2, 6])
def test_least_and_largest_of_the_utias_logs(log: int) -> None:
    row = row_of(f"UTIAS MR.CLAM {log}")
    for cell, identities in ((row[1], "known"), (row[2], "unknown")):
        measured = [ACCURACY[f"UTIAS {log} robot {robot}", identities] for robot in range(1, 6)]
        maps = [median(one[0]) for one in measured]
        assert cell.startswith(f"{min(maps):.3f}–{max(maps):.3f}")
        found = min(median(one[3]) for one in measured)
        assert identities == "known" or ("all 15" if found == 15 else f"{found:.0f} or all") in cell
    live = sorted(
        median(one[1]) for robot in range(1, 6) if (one := ACCURACY[f"UTIAS {log} robot {robot}", "known"])[1]
    )
    shown = re.findall(r"\d\.\d\d(?!\d)", row[1])
    assert shown == ([f"{value:.2f}" for value in (live[0], live[-1])] if live else [])


def test_victoria_park() -> None:
    measured = ACCURACY["Victoria Park", "unknown"]
    assert row_of("Victoria Park, tree features")[2] == f"{median(measured[6]):.2f}"
    measured = ACCURACY["Victoria Park, raw scans", "unknown"]
    said = f"{median(measured[6]):.2f} (worst seed {worst(measured[6]):.2f})"
    assert row_of("Victoria Park, raw scans")[2] == said


def test_lanes_and_loops_with_nothing_set() -> None:
    (lanes,) = [row for row in rows("docs/lawn-mower.md") if row[0] == "unknown, defaults"]
    _, live, _, map_m, found, *_ = lanes
    said = f"{median(map_m):.2f} / {median(live):.2f}, worst {worst(map_m):.2f} / {worst(live):.2f}"
    assert row_of("[Lawn-mower]")[2] == f"{said} ({worst(found):.0f} of 1,000 found)"
    right = {"default": 0, "plain": 0}
    for row in rows("docs/loops.md"):
        if row[1] in right:
            right[row[1]] += int(row[2].partition(" ")[0])
    assert f"{right['default']}\nof 80 runs are right, plain FastSLAM 2.0 in {right['plain']}" in README


def test_scale() -> None:
    (name,) = re.findall(r"benchmarks/reports/[\w-]+\.md", README)
    known, unknown = (
        next(row for row in rows(name) if row[0].startswith(f"fastslam2, {identities}, lineage, paths"))
        for identities in ("known", "unknown")
    )
    text = " ".join(README.split())
    found = unknown[4].partition(" ")[0]
    for said in (
        f"finds {found} of them without identities, the map off by {unknown[1]} m, "
        f"in {float(unknown[5]):.0f} s",
        f"with identities it takes {round(float(known[5]))} s ({known[1]} m)",
        f"the maps of 250 particles occupy 9 MB for 50,000 landmarks ({float(unknown[8]):.0f} MB while",
    ):
        assert said in text

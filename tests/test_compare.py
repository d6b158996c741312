"""Several results on one page."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest
from cli_runner import fastslam
from fabricate import make_log, make_run
from fastslam.comparison import (
    Scored,
    compared_metrics,
    differing_settings,
    group_results,
    render_comparison,
    short_names,
)
from fastslam.errors import DataError
from fastslam.evaluation import evaluate_run
from test_report import read_page


def scored(name: str, *, seed: int = 7, particles: int = 100, truth: bool = True) -> Scored:
    run, log = make_run(), make_log(truth=truth)
    config = {**run.config, "seed": seed, "filter": {"particles": particles}}
    run = replace(run, config=config, filter_seconds=float(seed))
    return Scored(name, run, log, evaluate_run(run, log))


def test_results_that_differ_in_the_seed_are_one_group_with_an_interval() -> None:
    groups = group_results([scored("a", seed=1), scored("b", seed=3), scored("c", particles=10)])
    assert [group.name for group in groups] == ["a and 1 more", "c"]
    assert differing_settings(groups) == {"filter.particles": ("100", "10")}
    # Mean 2 s, half width 12.706 * sqrt(2) / sqrt(2).
    assert compared_metrics(groups)["filter_seconds"] == ("2.000 ± 12.71", "7.000")


def test_none_or_too_many_are_refused() -> None:
    with pytest.raises(DataError, match="got 0 sets"):
        group_results([])
    with pytest.raises(DataError, match=r"got 13 sets .* expected 1 to 12"):
        group_results([scored(str(n), particles=n) for n in range(1, 14)])


@pytest.mark.parametrize("truth", [True, False])
def test_the_page_shows_each_by_name_and_loads_nothing(truth: bool) -> None:
    page = render_comparison(
        group_results([scored("<a>", truth=truth), scored("b", particles=10, truth=truth)])
    )
    found = read_page(page)
    assert found.tags.count("svg") == 2
    assert "script" not in found.tags and "link" not in found.tags
    assert len(found.addresses) > 0 and all(address.startswith("#") for address in found.addresses)
    assert "&lt;a&gt;" in page and "<a>" not in page
    assert ("ate_rmse_m" in page) == truth
    assert (
        '<td><code>filter.particles</code></td><td class="number">100</td><td class="number">10</td>' in page
    )


def test_names_are_as_short_as_they_can_be() -> None:
    assert short_names([Path("/a/x"), Path("/a/y")]) == ("x", "y")
    assert short_names([Path("/a/x"), Path("/b/x"), Path("/b/y")]) == ("a/x", "b/x", "b/y")
    assert short_names([Path("/a/x"), Path("/a/x")]) == ("x", "x")


def run_ok(*arguments: object) -> str:
    done = fastslam(*arguments)
    assert done.exit_code == 0, done.stderr
    return done.stdout


def test_the_command_compares_folders(tmp_path: Path) -> None:
    log, out = tmp_path / "log", tmp_path / "page.html"
    run_ok("simulate", log, "--preset", "demo", "--set", "trajectory.laps=1")
    for name, particles in (("few", 5), ("more", 20)):
        run_ok("run", log, "--out", tmp_path / name, "--particles", particles, "--no-report")
    folders = tmp_path / "few", tmp_path / "more"
    shown = run_ok("compare", *folders, "--out", out)
    assert "filter.particles" in shown and "page.html" in shown
    assert out.read_text(encoding="utf-8").count("few") > 3
    found = json.loads(run_ok("compare", *folders, "--out", out, "--json"))
    assert found["settings"] == {"filter.particles": ["5", "20"]}
    assert [one["landmarks"]["mean"] > 0 for one in found["metrics"]] == [True, True]
    done = fastslam("compare", folders[0], tmp_path / "nowhere", "--out", out)
    done.assert_one_line_error(exit_code=1, contains="nowhere")


def test_results_of_different_logs_are_told_so() -> None:
    one, other = scored("a"), scored("b", particles=10)
    words = "These results are of different logs"
    assert words not in render_comparison(group_results([one, other]))
    elsewhere = replace(other, log=replace(other.log, source="elsewhere"))
    assert words in render_comparison(group_results([one, elsewhere]))

"""Figures and the report page."""

from __future__ import annotations

import re
import subprocess
import sys
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from fabricate import make_log, make_map, make_run, make_steps, truth_path
from fastslam.charts.layout import frames
from fastslam.charts.map import ellipse_axes
from fastslam.charts.over_time import position_std_m
from fastslam.charts.panel import Chart, Panel
from fastslam.charts.svg import draw_chart
from fastslam.evaluation import evaluate
from fastslam.health import HealthStatus
from fastslam.log import Log, Problem
from fastslam.page_svg import themed_svg
from fastslam.plots import (
    house_style,
    make_figures,
    new_figure,
    plot_effective_sample_size,
    plot_error_over_time,
    plot_health,
    plot_latency,
    plot_latency_histogram,
    plot_map,
    render,
    write_figures,
)
from fastslam.report import render_report, write_report
from fastslam.result import RunResult, Trajectory
from matplotlib.axes import Axes

NAMES = {"map", "error", "effective_sample_size", "health", "latency"}


def empty_run() -> RunResult:
    nothing = Trajectory(np.zeros(0), np.zeros((0, 3)))
    empty_map = make_map((), np.zeros((0, 2)))
    return make_run(trajectory=nothing, smoothed=nothing, landmarks=empty_map, steps=make_steps(np.zeros(0)))


def new_axis() -> Axes:
    return new_figure(5.0, 4.0).add_subplot()


def legend_texts(axis: Axes) -> list[str]:
    legend = axis.get_legend()
    return [] if legend is None else [text.get_text() for text in legend.get_texts()]


def test_figures_are_written_as_png(tmp_path: Path) -> None:
    paths = write_figures(make_run(), make_log(), tmp_path / "new")
    assert set(paths) == {f"{name}.png" for name in NAMES}
    for path in paths.values():
        data = path.read_bytes()
        assert data.startswith(b"\x89PNG\r\n")
        width, height = (int.from_bytes(data[start : start + 4], "big") for start in (16, 20))
        assert width == 1200 and height >= 400


def test_drawing_logs_nothing(caplog: pytest.LogCaptureFixture) -> None:
    # Limits that are fixed under an equal scale are told by Matplotlib to be ignored.
    figures = make_figures(make_run(), make_log())
    for figure in figures.values():
        render(figure, "png")
    left, right = figures["map"].axes[0].get_xlim()
    assert right - left > 1.0 and len(figures) == len(NAMES)
    assert [record.getMessage() for record in caplog.records] == []


def test_the_same_run_gives_the_same_bytes() -> None:
    first, second = (make_figures(make_run(), make_log())["error"] for _ in range(2))
    assert render(first, "svg") == render(second, "svg")


def test_map_shows_all_that_is_known() -> None:
    with house_style():
        axis = plot_map(new_axis(), make_run(), make_log())
    assert axis.get_aspect() == 1.0
    assert (axis.get_xlabel(), axis.get_ylabel()) == ("x in world [m]", "y in world [m]")
    texts = legend_texts(axis)
    for expected in ("path, live", "path, smoothed", "path, true (aligned)", "landmark, true", "2σ ellipse"):
        assert expected in texts
    assert {"start", "end"} <= set(texts)
    lines = {line.get_label(): np.column_stack(line.get_data()) for line in axis.get_lines()}
    # A perfect run: the aligned truth lies on the estimate, in the world of the run.
    np.testing.assert_allclose(lines["path, true (aligned)"], lines["path, live"], atol=1e-9)
    np.testing.assert_allclose(lines["landmark, true"], lines["landmark"], atol=1e-9)


def test_map_without_truth_shows_fixes_or_nothing_else() -> None:
    log = make_log(truth=False, fixes=True)
    texts = legend_texts(plot_map(new_axis(), make_run(), log))
    assert "position fixes (aligned)" in texts
    assert not any("true" in text for text in texts)


def test_ellipse_axes_by_hand() -> None:
    # Standard deviations 3 along 30 degrees and 1 across: full axes are four times that.
    angle = np.radians(30.0)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    major, minor, degrees = ellipse_axes((turn @ np.diag([9.0, 1.0]) @ turn.T)[None])
    assert (major[0], minor[0]) == pytest.approx((12.0, 4.0))
    assert degrees[0] % 180.0 == pytest.approx(30.0)


def test_error_band_is_two_deviations_along_the_major_axis() -> None:
    covariance = np.zeros((1, 3, 3))
    covariance[0, :2, :2] = [[5.0, 4.0], [4.0, 5.0]]  # eigenvalues 9 and 1
    np.testing.assert_allclose(position_std_m(covariance), 3.0)
    axis = plot_error_over_time(new_axis(), make_run(), make_log())
    band = axis.collections[0].get_paths()[0].vertices
    assert band[:, 1].max() == pytest.approx(2.0 * 0.2)
    assert axis.get_ylabel().endswith("[m]")
    assert axis.get_xlabel().endswith("[s]")


def test_errors_of_fixes_say_how_many_lie_beyond_the_axis() -> None:
    log = make_log(truth=False, fixes=True)
    assert log.position_fixes is not None
    rng = np.random.default_rng(2)
    fixes_m = truth_path().T_world_robot[:, :2] + rng.normal(0.0, 0.3, (200, 2))
    fixes_m[[10, 60, 61]] += 200.0
    log = replace(log, position_fixes=replace(log.position_fixes, position_m=fixes_m))
    axis = plot_error_over_time(new_axis(), make_run(), log)
    assert "distance to fix (3 beyond this axis)" in legend_texts(axis)
    assert axis.get_ylim()[1] < 10.0


def test_effective_sample_size_marks_each_resampling() -> None:
    axis = plot_effective_sample_size(new_axis(), make_run())
    lines = {line.get_label(): line for line in axis.get_lines()}
    assert len(lines["resampled"].get_xdata()) == 20
    assert "100 particles" in lines
    assert "20 resamplings in 200 steps" in axis.get_title(loc="left") + axis.get_title()


def test_many_steps_are_drawn_as_range_and_median() -> None:
    run = make_run(steps=make_steps(np.arange(6000.0)))
    axis = plot_effective_sample_size(new_axis(), run)
    band = axis.collections[0].get_paths()[0].vertices
    # Each stretch of 20 steps holds two whole cycles from 100 down to 55.
    assert (band[:, 1].min(), band[:, 1].max()) == (55.0, 100.0)
    median = next(line for line in axis.get_lines() if str(line.get_label()).endswith("median"))
    assert set(median.get_ydata()) == {77.5}


def test_latency_states_its_percentiles() -> None:
    axis = plot_latency(new_axis(), make_run())
    assert axis.get_yscale() == "log"
    histogram = plot_latency_histogram(new_axis(), make_run())
    assert legend_texts(histogram) == ["p50: 100 µs", "p99: 198 µs"]
    tops = [path.vertices[:, 1].max() for path in histogram.collections[0].get_paths()]
    assert len(tops) == 60 and sum(tops) == 200


@pytest.mark.parametrize("truth", [True, False])
def test_an_empty_run_is_drawn_without_failing(truth: bool) -> None:
    figures = make_figures(empty_run(), make_log(truth=truth, fixes=truth))
    assert set(figures) == NAMES
    for figure in figures.values():
        assert len(render(figure, "png")) > 1000


class _Collector(HTMLParser):
    """Every tag, and every address that a browser would load."""

    def __init__(self) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.addresses: list[str] = []
        self.ids: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        for name, value in attrs:
            if name in ("src", "href", "xlink:href", "data", "action"):
                self.addresses.append(value or "")
            if name == "id":
                self.ids.append(value or "")


def read_page(page: str) -> _Collector:
    collector = _Collector()
    collector.feed(page)
    return collector


def make_page(log: Log | None = None, run: RunResult | None = None) -> str:
    return render_report(run or make_run(), log or make_log())


def test_the_page_loads_nothing_from_elsewhere() -> None:
    page = make_page()
    found = read_page(page)
    assert found.tags.count("svg") == 10
    assert "script" not in found.tags and "link" not in found.tags
    assert found.addresses == []
    assert "@import" not in page
    assert not re.search(r"url\((?!#)", page)


def test_ids_of_the_figures_do_not_clash_and_references_hold() -> None:
    page = make_page()
    found = read_page(page)
    references = set(re.findall(r"url\(#([^)]+)\)", page))
    # Each figure twice: two panels each of health and latency, one of the others.
    assert len(references) == 14
    assert references <= set(found.ids)
    assert len(found.ids) == len(set(found.ids))


def test_a_path_is_cut_where_a_search_begins() -> None:
    run = make_run()
    steps = run.steps
    health = np.ones(len(steps.stamp_s), dtype=np.int64)
    health[:3] = health[50:60] = health[90:] = HealthStatus.SEARCHING
    searched = replace(run, steps=replace(steps, health=health))
    lines = [line for line in plot_map(new_axis(), searched, make_log()).get_lines()]
    live = [line for line in lines if line.get_color() == "#0072b2"]
    assert [len(line.get_xdata()) for line in live] == [50, 40, len(health) - 90]
    whole = np.concatenate([np.column_stack(line.get_data()) for line in live])
    np.testing.assert_array_equal(whole, run.trajectory.T_world_robot[:, :2])
    assert legend_texts(lines[0].axes).count("path, live") == 1
    assert "searching" in make_page(run=searched) and "searching" not in make_page(run=run)


def test_the_page_follows_a_dark_theme() -> None:
    page = make_page()
    assert "prefers-color-scheme: dark" in page
    assert "var(--ink)" in page[page.index("<svg") :]
    assert "#1f2328" not in page[page.index("<svg") :]


def test_the_page_holds_metrics_with_units_configuration_and_problems() -> None:
    log = replace(make_log(), problems=(Problem("range <not> finite & skipped", 4),))
    page = make_page(log)
    assert "range &lt;not&gt; finite &amp; skipped" in page
    assert "covariance repairs" in page
    assert "range_std_m: 0.1" in page
    assert re.search(
        r"<code>peak_memory_bytes</code></td><td class=\"number\">12\.35</td>\s*<td class=\"unit\">MB", page
    )
    assert "<code>step_latency_us.p99</code>" in page
    assert "Over" not in page


def test_names_are_escaped() -> None:
    page = make_page(replace(make_log(), name="<script>alert(1)</script>"))
    assert "<script>" not in page


def test_several_runs_get_a_table_with_intervals() -> None:
    run, log = make_run(), make_log()
    metrics = evaluate(run, log)
    runs = [{**metrics, "ate_rmse_m": value} for value in (0.1, 0.2, 0.3)]
    page = render_report(run, log, runs=runs)
    assert "Over 3 runs" in page
    # Half width 4.30265 * 0.1 / sqrt(3).
    row = re.search(r"<code>ate_rmse_m</code></td>(.*?)</tr>", page)
    assert row is not None
    cells = re.findall(r"<td class=\"number\">([^<]*)</td>", row.group(1))
    assert cells == ["3", "0.2000", "0.2484", "0.2000", "0.1000", "0.3000"]


def test_what_is_not_determined_or_was_cut_short_is_said() -> None:
    page = make_page(run=replace(make_run(), interrupted=True))
    assert "stopped before the end" in page
    page = make_page(run=empty_run())
    assert "no step" in page
    assert "Not determined in this run: " in page and "ate_rmse_m" in page


def test_the_report_is_written_into_a_folder_or_a_file(tmp_path: Path) -> None:
    assert write_report(make_run(), make_log(), tmp_path) == tmp_path / "report.html"
    other = write_report(make_run(), make_log(), tmp_path / "deep" / "page.html")
    assert other.read_text(encoding="utf-8").startswith("<!doctype html>")


def test_scoring_imports_no_matplotlib_and_plots_no_pyplot() -> None:
    code = (
        "import sys, fastslam.evaluation, fastslam.resultfiles, fastslam.report, fastslam.charts.figures\n"
        "assert 'matplotlib' not in sys.modules, 'matplotlib'\n"
        "import fastslam.plots\n"
        "assert 'matplotlib' in sys.modules\n"
        "assert 'matplotlib.pyplot' not in sys.modules, 'pyplot'\n"
        "print('seen')"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.stdout.strip() == "seen", done.stderr


def test_the_health_figure_names_reasons_and_the_page_repeats_warnings() -> None:
    run = make_run(warnings=("range innovations are 2.3 times as large as sensor.range_std_m says",))
    with house_style():
        axis = plot_health(new_figure(8.0, 3.0).add_subplot(), run)
    rows = [label.get_text() for label in axis.get_yticklabels()]
    # Reasons 6 of the fabricated run: bits 1 and 2.
    assert rows == ["status", "innovations too large", "no sightings"]
    assert "89.5 %" in axis.get_title(loc="left")
    page = render_report(run, make_log())
    assert (
        '<p class="warning">Range innovations are 2.3 times as large as sensor.range_std_m says.</p>' in page
    )


def test_without_truth_nothing_is_called_an_error() -> None:
    with house_style():
        axis = plot_error_over_time(new_axis(), make_run(), make_log(truth=False))
    words = " ".join((axis.get_title(loc="left"), axis.get_ylabel(), *legend_texts(axis)))
    assert "2σ of the position [m]" in words
    assert "error" not in words
    with house_style():
        axis = plot_error_over_time(new_axis(), make_run(), make_log(truth=False, fixes=True))
    assert axis.get_ylabel() == "distance to fix [m]"


def test_the_verdict_comes_first_then_the_map_then_numbers() -> None:
    page = make_page(run=replace(make_run(), warnings=("range_std_m is too small", "bearing_std_rad too")))
    where = [page.index(mark) for mark in ('class="verdict"', 'class="warning"', "<svg", 'class="cards"')]
    assert where == sorted(where)
    against = re.search(r'<p class="verdict">([^<]*)</p>', page)
    assert against is not None and "Believable, with 2 warnings." in against.group(1)
    steps = replace(make_steps(np.arange(200.0)), health=np.ones(200, dtype=np.int64))
    assert "Believable: no check speaks against the run." in make_page(run=replace(make_run(), steps=steps))


def test_provisional_landmarks_are_not_in_the_headline() -> None:
    run = make_run()
    confirmed = np.ones(len(run.landmarks.ids), dtype=bool)
    confirmed[:3] = False
    page = make_page(run=replace(run, landmarks=replace(run.landmarks, confirmed=confirmed)))
    assert f"<b>{len(confirmed) - 3} <small></small></b><span>landmarks in the map</span>" in page
    assert "<b>3 <small></small></b><span>landmarks not yet believed" in page
    assert page.count(", provisional</title>") == 2 * 3, "on both maps"


def test_the_map_tells_each_landmark_under_the_pointer_and_in_a_table() -> None:
    run = make_run()
    page = make_page(run=run)
    titles = re.findall(r'<circle cx="([^"]*)" cy="([^"]*)" r="5"><title>([^<]*)</title>', page)
    titles, on_the_small_map = titles[: len(titles) // 2], titles[len(titles) // 2 :]
    assert [says for _, _, says in titles] == [says for _, _, says in on_the_small_map]
    assert [title.split(":")[0] for _, _, title in titles] == list(run.landmarks.ids)
    # The spots lie where the picture has the landmarks: distances keep their proportion, and north is up.
    at = np.array([[float(x), float(y)] for x, y, _ in titles])
    spans = at - at[0], run.landmarks.mean_m - run.landmarks.mean_m[0]
    scale = np.linalg.norm(spans[0]) / np.linalg.norm(spans[1])
    np.testing.assert_allclose(spans[0], spans[1] * [scale, -scale], atol=0.2)
    for name in run.landmarks.ids:
        assert f"<tr><td>{name}</td>" in page


def test_a_page_with_a_thousand_landmarks_stays_small_and_one_with_more_says_where_they_are() -> None:
    rng = np.random.default_rng(3)
    names = tuple(f"L{k}" for k in range(1000))
    page = make_page(run=replace(make_run(), landmarks=make_map(names, rng.uniform(0.0, 100.0, (1000, 2)))))
    assert page.count("<circle") == 2 * 1000
    assert page.count('class="more">') == 2 * 1000, "so many names would hide the map"
    assert len(page.encode()) < 1_000_000
    names = tuple(f"L{k}" for k in range(2001))
    page = make_page(run=replace(make_run(), landmarks=make_map(names, rng.uniform(0.0, 100.0, (2001, 2)))))
    assert "<circle" not in page
    assert "2,001 landmarks: <code>landmarks.csv</code>" in page


def test_a_run_that_was_stopped_or_never_judged_is_not_called_good() -> None:
    steps = replace(make_steps(np.arange(200.0)), health=np.ones(200, dtype=np.int64))
    stopped = make_page(run=replace(make_run(), steps=steps, interrupted=True))
    assert "Undecided: the run was stopped early." in stopped and 'class="verdict good"' not in stopped
    unjudged = replace(steps, health=np.zeros(200, dtype=np.int64))
    page = make_page(run=replace(make_run(), steps=unjudged))
    assert "Undecided: too little was seen again to judge the run." in page


def named(page: str) -> list[tuple[float, float, bool, str]]:
    """Where the wide map has each name, whether it is shown without a pointer, and the name."""
    wide = page[: page.index("of-small-map", page.index("</style>"))]
    texts = re.findall(r'</circle><text x="([^"]*)" y="([^"]*)"( class="more")?>([^<]*)</text>', wide)
    return [(float(x), float(y), not more, name) for x, y, more, name in texts]


def test_landmarks_are_named_on_the_map_where_there_is_room() -> None:
    crowd = [(0.01 * k, 0.0) for k in range(5)]
    places = np.array([*crowd, (-40.0, 0.0), (40.0, 30.0), (40.0, -30.0)])
    names = tuple(f"tree-{k}" for k in range(len(places)))
    run = replace(make_run(), landmarks=make_map(names, places))
    shown = [name for _, _, is_shown, name in named(make_page(run=run)) if is_shown]
    assert {"tree-5", "tree-6", "tree-7"} <= set(shown) and len(shown) < len(names)
    assert [name for *_, name in named(make_page(run=run))] == list(names), "under the pointer all are"
    # No name covers another one: letters are 7 points high, and none narrower than a point.
    at = np.array([(x, y) for x, y, is_shown, _ in named(make_page(run=run)) if is_shown])
    apart = np.abs(at[:, None] - at[None])[~np.eye(len(at), dtype=bool)]
    assert ((apart[:, 1] >= 7.0) | (apart[:, 0] >= len("tree-0"))).all()
    # One that is not believed yet is named under the pointer alone.
    doubted = replace(run.landmarks, confirmed=np.array([name != "tree-6" for name in names]))
    page = make_page(run=replace(run, landmarks=doubted))
    assert [is_shown for *_, is_shown, name in named(page) if name == "tree-6"] == [False]


def test_names_are_hidden_by_the_style_until_they_are_asked_for() -> None:
    style = make_page()
    style = style[style.index("<style>") : style.index("</style>")]
    hidden, shown = ".landmarks .more { display: none; }", ".landmarks circle:hover + text { display: block;"
    assert style.index(hidden) < style.index(shown)


def test_a_phone_gets_figures_whose_letters_it_can_show() -> None:
    """At 390 pixels a figure is 340 wide: letters of 8 points are then as many pixels high on 4 inches."""
    page = make_page()
    for name in NAMES:
        (wide,), (small,) = (
            map(float, re.findall(rf'class="chart of-{kind}"[^>]*? width="([0-9.]+)pt"', page))
            for kind in (name, f"small-{name}")
        )
        assert small < 300.0 < wide
    assert page.count('<figure class="two">') == len(NAMES)
    style = page[page.index("<style>") : page.index("</style>")]
    assert 'figure [class*="of-small-"] { display: none; }' in style
    narrow = style[style.index("max-width: 600px") : style.index("@media print")]
    assert narrow.index("figure.two svg { display: none; }") < narrow.index('svg[class*="of-small-"]')
    assert "overflow-x" not in narrow, "nothing scrolls sideways"
    identities = re.findall(r' id="([^"]+)"', page)
    assert len(identities) == len(set(identities)) == 28


def test_a_title_that_is_too_long_for_its_panel_goes_on_in_another_line() -> None:
    panel = Panel(
        title="Health: ok in 48.2 % of the steps after initialising",
        x_label="",
        y_label="",
        marks=(),
        x_range=(0.0, 1.0),
        y_range=(0.0, 1.0),
    )
    for width_in, lines in ((8.0, 1), (4.0, 2)):
        chart = Chart(panels=(panel,), width_in=width_in, height_in=3.0)
        texts = re.findall(r'<text [^>]*y="([^"]*)" class="title">([^<]*)<', draw_chart(chart, "health"))
        assert " ".join(text for _, text in reversed(texts)) == panel.title and len(texts) == lines
        (frame,) = frames(chart)
        assert all(8.0 <= float(y) < frame.box[1] for y, _ in texts), "above the axes and within the page"


def test_marks_of_one_look_say_it_once() -> None:
    mark = '<use xlink:href="#m" x="{}" y="2.987654" style="fill: #0072b2"/>'
    row = "".join(mark.format(x) for x in ("1.234567", "3.5"))
    slim = themed_svg(f'<svg width="8pt"><g clip-path="url(#p)">\n{row}\n</g></svg>', "map")
    assert '<use href="#map-m" x="1.23" y="2.98"/><use href="#map-m" x="3.5" y="2.98"/></g>' in slim
    assert slim.count("style=") == 1 and 'style="fill: var(--live)"' in slim
    other = row.replace("#0072b2", "#123456", 1)
    assert themed_svg(f"<svg><g>{other}</g></svg>", "map").count("style=") == 2

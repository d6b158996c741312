"""Charts as data and as SVG: scales, ticks, layout and marks, by hand."""

from __future__ import annotations

import re
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from fabricate import make_log, make_run, make_steps
from fastslam.charts import palette
from fastslam.charts.layout import frames
from fastslam.charts.panel import (
    Band,
    Bars,
    Chart,
    Dots,
    DotShape,
    Ellipses,
    Level,
    Line,
    Mark,
    Panel,
    range_of,
)
from fastslam.charts.scales import Scale, tick_texts, widened
from fastslam.charts.svg import draw_chart
from fastslam.plots.panel import chart_figure
from fastslam.report import render_report
from fastslam.result import Trajectory


def a_panel(*marks: Mark, **other: Any) -> Panel:
    basic = Panel(title="t", x_label="x", y_label="y", marks=marks, x_range=(0.0, 10.0), y_range=(0.0, 5.0))
    return replace(basic, **other)


def drawn(*marks: Mark, **other: object) -> str:
    return draw_chart(Chart(panels=(a_panel(*marks, **other),), width_in=8.0, height_in=4.0), "some")


@pytest.mark.parametrize(
    ("values", "most", "ticks", "texts"),
    [
        ((0.0, 10.0), 5, [0.0, 2.0, 4.0, 6.0, 8.0, 10.0], ["0", "2", "4", "6", "8", "10"]),
        ((-0.31, 0.29), 4, [-0.2, 0.0, 0.2], ["−0.2", "0.0", "0.2"]),
        ((1234.0, 5678.0), 3, [2000.0, 4000.0], ["2,000", "4,000"]),
        ((5.0, -1.0), 6, [-1.0, 0.0, 1.0, 2.0, 3.0, 4.0, 5.0], ["−1", "0", "1", "2", "3", "4", "5"]),
    ],
)
def test_even_ticks_are_round(
    values: tuple[float, float], most: int, ticks: list[float], texts: list[str]
) -> None:
    scale = Scale(values, (0.0, 100.0))
    assert scale.ticks(most) == ticks
    assert tick_texts(scale.ticks(most)) == texts


def test_ticks_of_logarithmic_scales() -> None:
    assert Scale((3.0, 60.0), (0.0, 1.0), log=True).ticks(9) == [5.0, 10.0, 20.0, 50.0]
    assert Scale((90.0, 450.0), (0.0, 1.0), log=True).ticks(9) == [100.0, 150.0, 200.0, 300.0, 400.0]
    assert Scale((0.5, 2000.0), (0.0, 1.0), log=True).ticks(9) == [1.0, 10.0, 100.0, 1000.0]
    assert tick_texts([0.1, 1.0, 10.0]) == ["0.1", "1.0", "10.0"]
    assert len(Scale((1e-300, 1e300), (0.0, 1.0), log=True).ticks(9)) < 12


def test_scales_place_numbers() -> None:
    np.testing.assert_allclose(Scale((0.0, 4.0), (10.0, 50.0)).at(np.array([0.0, 1.0, 4.0])), [10, 20, 50])
    up = Scale((1.0, 100.0), (200.0, 100.0), log=True)
    np.testing.assert_allclose(up.at(np.array([1.0, 10.0, 100.0, 0.0])), [200, 150, 100, 200])
    np.testing.assert_allclose(Scale((0.0, 4.0), (50.0, 10.0)).length(np.array([1.0])), [10.0])


def test_equal_scales_widen_the_shorter_range() -> None:
    # 10 m over 100 points and 10 m over 50: a metre becomes 5 points, so 20 m across.
    assert widened((0.0, 10.0), (0.0, 10.0), 100.0, 50.0) == ((-5.0, 15.0), (0.0, 10.0))


def test_ranges_leave_room_and_hold_without_data() -> None:
    assert range_of(np.array([0.0, np.nan, 10.0]), margin=0.1) == (-1.0, 11.0)
    assert range_of(np.zeros(0), margin=0.1) == (0.0, 1.0)
    low, high = range_of(np.array([7.0]), margin=0.1)
    assert low < 7.0 < high
    assert range_of(np.array([-1.0, 1.0, 100.0]), margin=0.5, log=True) == pytest.approx((0.1, 1000.0))
    assert range_of(np.zeros(3), margin=0.5, log=True) == (1.0, 10.0)


def test_marks_lie_where_the_axes_say() -> None:
    line = Line(x=np.array([0.0, 10.0]), y=np.array([0.0, 5.0]), color="#123456")
    svg = drawn(line)
    frame = frames(Chart(panels=(a_panel(line),), width_in=8.0, height_in=4.0))[0]
    left, top, right, bottom = frame.box
    assert 0.0 < left < right < 576.0 and 0.0 < top < bottom < 288.0
    path = re.search(r'stroke="#123456"[^>]* d="M([0-9.]+),([0-9.]+)L([0-9.]+),([0-9.]+)"', svg)
    assert path is not None
    np.testing.assert_allclose([float(n) for n in path.groups()], [left, bottom, right, top], atol=0.06)


def test_an_ellipse_is_drawn_at_its_angle() -> None:
    # 4 long along 90 degrees, 2 across, about (5, 2.5): from the lower end to the upper and back.
    mark = Ellipses(
        center=np.array([[5.0, 2.5]]),
        major=np.array([4.0]),
        minor=np.array([2.0]),
        angle_deg=np.array([90.0]),
        color="#123456",
    )
    panel = a_panel(mark, equal=True)
    chart = Chart(panels=(panel,), width_in=8.0, height_in=4.0)
    place = frames(chart)[0].place
    metre = float(place.x.length(np.array([1.0]))[0])
    assert metre == pytest.approx(float(place.y.length(np.array([1.0]))[0]))
    found = re.search(
        r'd="M([0-9.]+),([0-9.]+)a([0-9.]+),([0-9.]+) -90 1 0 (\S+),(\S+?)a', draw_chart(chart, "e")
    )
    assert found is not None
    x, y, major, minor, dx, dy = (float(n) for n in found.groups())
    low = float(place.y.at(np.array([0.5]))[0])
    np.testing.assert_allclose([x, y], [float(place.x.at(np.array([5.0]))[0]), low], atol=0.06)
    np.testing.assert_allclose([major, minor, dx, dy], [2 * metre, metre, 0.0, -4 * metre], atol=0.02)


def test_every_kind_of_mark_is_drawn_by_both_and_named_in_the_legend() -> None:
    x = np.array([1.0, 2.0, 3.0])
    shapes: tuple[DotShape, ...] = ("disc", "cross", "tick", "triangle", "square")
    marks: list[Mark] = [
        Line(x=x, y=x, color="#000001", label="line", dashed=True),
        Line(x=x, y=x, color="#000002", label="stairs", stairs=True),
        Band(x=x, low=x, high=x + 1.0, color="#000003", label="band"),
        Level(at=2.0, color="#000004", label="level"),
        Level(at=2.0, color="#000005", upright=True, label="upright"),
        Bars(left=x, right=x + 0.5, low=x, high=x + 1.0, color="#000006", label="bars"),
        Ellipses(
            center=np.column_stack([x, x]), major=x, minor=x, angle_deg=x, color="#000007", label="ellipse"
        ),
        *(Dots(x=x, y=x, color=f"#00001{k}", shape=shape, label=shape) for k, shape in enumerate(shapes)),
    ]
    svg = drawn(*marks)
    texts = re.findall(r"<text[^>]*>([^<]*)</text>", svg)
    for mark in marks:
        assert texts.count(mark.label) == 1
        # Once in the panel and once in the legend; ellipses and bars have no line of their own.
        assert svg.count(f'"{mark.color}"') >= 2, mark
    figure = chart_figure(Chart(panels=(a_panel(*marks),), width_in=8.0, height_in=4.0))
    legend = figure.axes[0].get_legend()
    assert legend is not None
    assert [text.get_text() for text in legend.get_texts()] == [mark.label for mark in marks]


def test_text_is_escaped_and_the_legend_breaks_into_rows_within_the_panel() -> None:
    marks = [
        Line(x=np.zeros(1), y=np.zeros(1), color="#000001", label=f"<{k}> {'long ' * 8}") for k in range(5)
    ]
    svg = drawn(*marks)
    assert "<0>" not in svg and svg.count("&lt;") == 5
    frame = frames(Chart(panels=(a_panel(*marks),), width_in=8.0, height_in=4.0))[0]
    assert len({entry.at[1] for entry in frame.legend}) == 3
    assert all(entry.at[0] >= 0.0 for entry in frame.legend)


def test_colours_follow_the_theme() -> None:
    svg = drawn(Line(x=np.zeros(2), y=np.zeros(2), color=palette.LIVE))
    assert 'stroke="var(--live)"' in svg and palette.LIVE not in svg


def test_what_cannot_be_drawn_is_left_out() -> None:
    nothing, bad = np.zeros(0), np.array([np.nan, np.inf])
    marks = [
        Line(x=nothing, y=nothing, color="#000001"),
        Line(x=bad, y=bad, color="#000002"),
        Dots(x=bad, y=bad, color="#000003"),
        Band(x=nothing, low=nothing, high=nothing, color="#000004"),
        Bars(left=nothing, right=nothing, low=nothing, high=nothing, color="#000005"),
        Dots(x=np.array([1.0]), y=np.array([-1.0]), color="#000006"),
    ]
    svg = drawn(*marks, y_log=True, y_range=(1.0, 10.0))
    assert "nan" not in svg and "inf" not in svg and "#00000" not in svg


def test_the_page_of_a_long_log_stays_small_and_keeps_its_extremes() -> None:
    count = 200_000
    rng = np.random.default_rng(4)
    stamps = np.arange(float(count))
    steps = make_steps(stamps)
    steps = replace(steps, latency_us=rng.gamma(2.0, 50.0, count))
    walk = np.cumsum(rng.normal(0.0, 0.1, (count, 3)), axis=0)
    covariance = np.tile(0.01 * np.eye(3), (count, 1, 1))
    path = Trajectory(stamps, walk, covariance)
    page = render_report(make_run(trajectory=path, smoothed=path, steps=steps), make_log())
    assert len(page.encode()) < 1_000_000
    values = rng.normal(0.0, 0.2, count)
    values[count // 2] = 4.9
    svg = drawn(Line(x=np.linspace(0.0, 10.0, count), y=values, color="#000001"))
    frame = frames(Chart(panels=(a_panel(),), width_in=8.0, height_in=4.0))[0]
    top = float(frame.place.y.at(np.array([4.9]))[0])
    heights = [
        float(y)
        for y in re.findall(r"[ML][0-9.]+,([0-9.-]+)", svg.split('stroke="#000001"')[1].split("/>")[0])
    ]
    assert min(heights) == pytest.approx(top, abs=0.06) and len(heights) < 3000


def test_classes_get_the_colour_they_are_named_after() -> None:
    assert palette.class_color("blue", 3) == "#0000ff"
    assert palette.class_color("yellow_cone", 0) == palette.DARK_YELLOW
    assert palette.class_color("oak", 1) == palette.CLASSES[1]

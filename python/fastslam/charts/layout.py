"""Where the panels of a chart, their numbers and their legends stand on paper, in points."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from dataclasses import dataclass

from .panel import Chart, Mark, Panel
from .scales import Scale, tick_texts, widened

POINTS = 72.0
LETTERS = 9.0
"""Size of letters."""
_ROW = 13.0
TITLE_LETTERS = 11.5
"""The same of titles."""
TITLE_ROW = 14.0
_TOP, _TITLE, _RIGHT = 8.0, 16.0, 12.0
_SAMPLE, _GAP = 26.0, 14.0
"""Room of a legend's sample, and between its entries."""
_WIDTH_OF_LETTER = 0.54
"""Of a usual sans serif, as part of its size; labels that are longer than this says still have `_GAP`."""


@dataclass(frozen=True)
class Place:
    """Where numbers lie on paper."""

    x: Scale
    y: Scale


@dataclass(frozen=True)
class Entry:
    """A mark in the legend and where its sample begins."""

    mark: Mark
    at: tuple[float, float]


@dataclass(frozen=True)
class Frame:
    """A panel's axes on paper: `box` is left, top, right, bottom; `name_at` where the name of y stands."""

    box: tuple[float, float, float, float]
    place: Place
    x_ticks: list[float]
    y_ticks: list[float]
    x_texts: list[str]
    y_texts: list[str]
    name_at: float
    legend: tuple[Entry, ...]
    title: tuple[str, ...]
    """The title, in as many lines as it needs."""


def text_width(text: str) -> float:
    """About how wide a text is."""
    return _WIDTH_OF_LETTER * LETTERS * len(text)


def frames(chart: Chart) -> list[Frame]:
    """The frames of a chart's panels."""
    whole = POINTS * chart.width_in, POINTS * chart.height_in
    lefts = [_left(panel, whole[1]) for panel in chart.panels]
    if chart.stacked:
        # What is above each other begins at the same place.
        width = whole[0] - max(lefts) - _RIGHT
        tops, bottoms = zip(*(_above_and_below(panel, width) for panel in chart.panels), strict=True)
        heights = _shared(whole[1] - sum(tops) - sum(bottoms), chart.shares)
        made, y = [], 0.0
        for panel, top, bottom, height in zip(chart.panels, tops, bottoms, heights, strict=True):
            made.append(_frame(panel, (max(lefts), y + top, width, height)))
            y += top + height + bottom
        return made
    widths = _shared(whole[0] - sum(lefts) - _RIGHT * len(lefts), chart.shares)
    beside = [_above_and_below(panel, width) for panel, width in zip(chart.panels, widths, strict=True)]
    top, bottom = (max(sides) for sides in zip(*beside, strict=True))
    made, x = [], 0.0
    for panel, left, width in zip(chart.panels, lefts, widths, strict=True):
        made.append(_frame(panel, (x + left, top, width, whole[1] - top - bottom)))
        x += left + width + _RIGHT
    return made


def _shared(room: float, shares: Sequence[float]) -> list[float]:
    return [room * share / sum(shares) for share in shares]


def _frame(panel: Panel, corner_and_size: tuple[float, float, float, float]) -> Frame:
    left, top, width, height = corner_and_size
    right, bottom = left + width, top + height
    x_range, y_range = panel.x_range, panel.y_range
    if panel.equal:
        x_range, y_range = widened(x_range, y_range, width, height)
    x = Scale(x_range, (left, right), panel.x_log)
    y = Scale(y_range, (bottom, top), panel.y_log)
    x_ticks, y_ticks = x.ticks(max(2, round(width / 62.0))), _y_ticks(panel, y, height)
    x_texts, y_texts = tick_texts(x_ticks), list(panel.rows) or tick_texts(y_ticks)
    name_at = left - 13.0 - max(map(text_width, y_texts), default=0.0)
    below = bottom + (35.0 if panel.x_label else 20.0 if panel.x_numbers else 9.0)
    legend = _placed(_legend_rows(panel, width), 0.5 * (left + right), below)
    place, title = Place(x, y), _title_lines(panel, width)
    return Frame(
        (left, top, right, bottom), place, x_ticks, y_ticks, x_texts, y_texts, name_at, legend, title
    )


def _title_lines(panel: Panel, width: float) -> tuple[str, ...]:
    letters = max(1, int(width / (_WIDTH_OF_LETTER * TITLE_LETTERS)))
    return tuple(textwrap.wrap(panel.title, letters, break_long_words=False))


def _y_ticks(panel: Panel, y: Scale, height: float) -> list[float]:
    if panel.rows:
        return [float(row) for row in range(len(panel.rows))]
    return y.ticks(max(2, round(height / 34.0)))


def _left(panel: Panel, height: float) -> float:
    """Room for the numbers of y and its name."""
    ticks = _y_ticks(panel, Scale(panel.y_range, (height, 0.0), panel.y_log), height)
    # Where a range becomes wider its numbers may become longer.
    texts = list(panel.rows) or [*tick_texts(ticks), "000" if panel.equal else ""]
    return 12.0 + max(map(text_width, texts), default=0.0) + (14.0 if panel.y_label else 0.0)


def _above_and_below(panel: Panel, width: float) -> tuple[float, float]:
    """Room for the title, and for numbers, name and legend of x."""
    below = 30.0 if panel.x_label else 16.0 if panel.x_numbers else 4.0
    rows = len(_legend_rows(panel, width))
    more = TITLE_ROW * (len(_title_lines(panel, width)) - 1)
    return _TOP + (_TITLE + more if panel.title else 0.0), below + _ROW * rows + (4.0 if rows else 0.0)


def _legend_rows(panel: Panel, width: float) -> list[list[Mark]]:
    """The marks that have a label, in rows no wider than the panel where that can be."""
    rows: list[list[Mark]] = []
    for mark in panel.marks:
        if not mark.label:
            continue
        last = [*rows[-1], mark] if rows else []
        if last and len(last) <= panel.legend_columns and sum(map(_entry_width, last)) - _GAP <= width:
            rows[-1] = last
        else:
            rows.append([mark])
    return rows


def _entry_width(mark: Mark) -> float:
    return _SAMPLE + text_width(mark.label) + _GAP


def _placed(rows: Sequence[Sequence[Mark]], middle: float, top: float) -> tuple[Entry, ...]:
    entries = []
    for number, row in enumerate(rows):
        x = middle - 0.5 * (sum(map(_entry_width, row)) - _GAP)
        for mark in row:
            entries.append(Entry(mark, (x, top + _ROW * number + 0.5 * _ROW)))
            x += _entry_width(mark)
    return tuple(entries)

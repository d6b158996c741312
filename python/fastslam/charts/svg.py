"""Charts as SVG that stands in a page: in the colours of its theme and its letters, with ids of its own."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from html import escape

import numpy as np

from .layout import LETTERS, POINTS, TITLE_ROW, Frame, Place, frames
from .panel import Chart, Panel
from .shapes import draw_mark, number, sample_of


def draw_chart(chart: Chart, name: str, *, over: Callable[[Place], str] | None = None) -> str:
    """Draws a chart; ids in it begin with `name`.

    `over` makes SVG elements that lie over the first panel from where its numbers stand.
    """
    framed = frames(chart)
    both = zip(chart.panels, framed, strict=True)
    parts = [_panel(panel, frame, f"{name}-{k}") for k, (panel, frame) in enumerate(both)]
    if over is not None:
        parts.append(over(framed[0].place))
    width, height = POINTS * chart.width_in, POINTS * chart.height_in
    label = escape(name.replace("_", " ").replace("-", " "))
    head = (
        f'<svg role="img" class="chart of-{name}" aria-label="{label}" width="{number(width)}pt" '
        f'height="{number(height)}pt" viewBox="0 0 {number(width)} {number(height)}" font-size="{LETTERS:g}">'
    )
    return f"{head}{''.join(parts)}</svg>"


def _panel(panel: Panel, frame: Frame, name: str) -> str:
    """Grid, axes with their numbers, marks, title and legend of a panel."""
    left, top, right, bottom = frame.box
    # A little more than the axes, for marks that stand on them.
    clip = (
        f'<clipPath id="{name}-clip"><rect x="{number(left)}" y="{number(top - 4)}" '
        f'width="{number(right - left)}" height="{number(bottom - top + 8)}"/></clipPath>'
    )
    marks = "".join(draw_mark(mark, frame.place) for mark in sorted(panel.marks, key=lambda mark: mark.order))
    axes = f'<path class="axis" d="M{number(left)},{number(top)}V{number(bottom)}H{number(right)}"/>'
    title = "".join(
        _text((left, top - 9.0 - TITLE_ROW * above), line, 'class="title"')
        for above, line in enumerate(reversed(frame.title))
    )
    return (
        f'<g id="{name}">{clip}{_across(panel, frame)}{_upwards(panel, frame)}'
        f'<g clip-path="url(#{name}-clip)">{marks}</g>{axes}{title}{_legend(frame)}</g>'
    )


def _across(panel: Panel, frame: Frame) -> str:
    """Grid lines and numbers of x, and its name."""
    left, top, right, bottom = frame.box
    at = frame.place.x.at(np.array(frame.x_ticks))
    grid = "" if panel.rows else "".join(f"M{number(x)},{number(top)}V{number(bottom)}" for x in at)
    parts = [f'<path class="grid" d="{grid}"/>' if grid else ""]
    if panel.x_numbers:
        ticks = "".join(f"M{number(x)},{number(bottom)}v3" for x in at)
        parts.append(f'<path class="axis" d="{ticks}"/>')
        parts += [_text((x, bottom + 12.5), text, _MIDDLE) for x, text in zip(at, frame.x_texts, strict=True)]
    if panel.x_label:
        parts.append(_text((0.5 * (left + right), bottom + 26.0), panel.x_label, _MIDDLE))
    return "".join(parts)


def _upwards(panel: Panel, frame: Frame) -> str:
    """Grid lines and numbers of y, or the names of rows, and its name."""
    left, top, right, bottom = frame.box
    at = frame.place.y.at(np.array(frame.y_ticks))
    grid = "" if panel.rows else "".join(f"M{number(left)},{number(y)}H{number(right)}" for y in at)
    ticks = "".join(f"M{number(left)},{number(y)}h-3" for y in at)
    parts = [f'<path class="grid" d="{grid}"/>' if grid else "", f'<path class="axis" d="{ticks}"/>']
    parts += [_text((left - 5.5, y + 3.2), text, _END) for y, text in zip(at, frame.y_texts, strict=True)]
    if panel.y_label:
        x, y = frame.name_at, 0.5 * (top + bottom)
        parts.append(
            _text((x, y), panel.y_label, f'{_MIDDLE} transform="rotate(-90 {number(x)} {number(y)})"')
        )
    return "".join(parts)


def _legend(frame: Frame) -> str:
    """Entries as `layout` has placed them: a sample of each mark and its label."""
    parts = []
    for entry in frame.legend:
        x, y = entry.at
        parts.append(sample_of(entry.mark, x, y) + _text((x + 26.0, y + 3.1), entry.mark.label, ""))
    return f'<g class="key">{"".join(parts)}</g>' if parts else ""


_MIDDLE = 'text-anchor="middle"'
_END = 'text-anchor="end"'


def _text(at: Sequence[float], text: str, look: str) -> str:
    space = " " if look else ""
    return f'<text x="{number(at[0])}" y="{number(at[1])}"{space}{look}>{escape(text)}</text>'

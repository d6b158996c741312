"""Figures as SVG that stands in a page: in its colours, under ids of its own, and short."""

from __future__ import annotations

import re
from functools import partial
from html import escape

from .charts.palette import THEMED

_DECIMALS = re.compile(r"(\.\d\d)\d+")
"""What the outline of a mark does not need: a hundredth of a point is enough."""
_TENTHS = re.compile(r"(\.\d)\d+")
_LONG = 1000
"""A path whose text is longer is a line of data, for which a tenth of a point is enough."""
_MARKS = re.compile(r'<g( clip-path="[^"]*")?>\s*((?:<use [^>]*/>\s*)+)</g>')
_MARK = re.compile(r'<use xlink:(href="[^"]*") x="([^"]*)" y="([^"]*)" style="([^"]*)"/>')


def themed_svg(svg: str, name: str) -> str:
    """SVG ready to stand in the page: its greys follow the page's theme, its ids are its own, it is short."""
    svg = svg[svg.index("<svg") :]
    svg = re.sub(r' d="[^"]*"', _short_path, svg)
    svg = _MARKS.sub(_short_marks, svg)
    svg = re.sub(r"<metadata>.*?</metadata>", "", svg, flags=re.DOTALL)
    for color, variable in THEMED.items():
        svg = svg.replace(color, f"var(--{variable})")
    svg = re.sub(r'id="([^"]+)"', rf'id="{name}-\1"', svg)
    svg = re.sub(r'href="#([^"]+)"', rf'href="#{name}-\1"', svg)
    svg = re.sub(r"url\(#([^)]+)\)", rf"url(#{name}-\1)", svg)
    label = escape(name.replace("_", " ").replace("-", " "))
    return svg.replace("<svg ", f'<svg role="img" class="of-{name}" aria-label="{label}" ', 1)


def _short_path(path: re.Match[str]) -> str:
    text = path.group()
    return (_DECIMALS if len(text) < _LONG else _TENTHS).sub(r"\1", text)


def _short_marks(marks: re.Match[str]) -> str:
    """Marks of one style that each say it become a group that says it once."""
    found = _MARK.findall(marks.group(2))
    styles = {look for *_, look in found}
    if len(styles) != 1 or len(found) != marks.group(2).count("<use "):
        return marks.group()
    short = partial(_DECIMALS.sub, r"\1")
    places = (f'<use {shape} x="{short(x)}" y="{short(y)}"/>' for shape, x, y, _ in found)
    return f'<g{marks.group(1) or ""} style="{styles.pop()}">{"".join(places)}</g>'

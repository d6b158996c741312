"""A sweep on one self-contained HTML page: what was found, figures, a table with intervals."""

from __future__ import annotations

import math
from collections.abc import Sequence
from html import escape
from pathlib import Path

from ..evaluation import MetricSummary
from ..evaluation.display import format_metric, metric_unit
from ..page_svg import themed_svg
from ..report import render_page
from ..resultfiles import write_atomically
from .table import Group, Row, group_rows

PAGE_FILE = "sweep.html"
_RANKED_BY = ("ate_rmse_m", "landmark_rmse_m", "gps_median_m")
_COLUMNS = (
    *("ate_rmse_m", "smoothed_ate_rmse_m", "landmark_rmse_m", "gps_median_m"),
    *("landmarks", "health_ok_fraction", "filter_seconds"),
)


def write_sweep_page(rows: Sequence[Row], folder: Path, *, name: str) -> Path:
    """Write `sweep.html` into a folder. Errors: `DataError` where it cannot be written."""
    return write_atomically(folder / PAGE_FILE, render_sweep(rows, name=name))


def render_sweep(rows: Sequence[Row], *, name: str) -> str:
    """The page as HTML text; it loads nothing from elsewhere."""
    # Imported here so that sweeps run where Matplotlib is not installed.
    from ..plots import render
    from ..plots.sweep import sweep_figures

    groups = group_rows(rows)
    logs = list(dict.fromkeys(group.log for group in groups))
    figures = "".join(
        f"<figure>{themed_svg(render(figure, 'svg').decode(), metric)}</figure>"
        for metric, figure in sweep_figures(groups).items()
    )
    return render_page(
        "sweep_page.html",
        title=escape(f"{name}: {len(groups)} settings compared"),
        facts=escape(f"{len(rows):,} runs over {', '.join(logs)}"),
        verdict="".join(f'<p class="verdict">{escape(best_of(groups, log))}</p>' for log in logs),
        warnings=_failures(rows),
        figures=figures,
        table=_table(groups),
    )


def best_of(groups: Sequence[Group], log: str) -> str:
    """Which setting did best on a log, and how many others cannot be told from it by these seeds.

    Two are told apart where their means differ by more than the 95 % interval of the difference.
    """
    here = [group for group in groups if group.log == log]
    metric = next((name for name in _RANKED_BY if any(name in group.summary for group in here)), None)
    if metric is None:
        return f"{log}: no truth to measure against, so no setting is called the best."
    ranked = sorted(
        (group for group in here if metric in group.summary), key=lambda group: group.summary[metric].mean
    )
    first = ranked[0].summary[metric]
    said = f"{log}: least {metric} with {point_text(ranked[0])}, {interval_text(metric, first)}."
    if len(ranked) == 1:
        return said
    if first.ci95 is None:
        return f"{said} One seed each: whether that is chance nobody can say."
    alike = sum(not _told_apart(first, group.summary[metric]) for group in ranked[1:])
    others = len(ranked) - 1
    return (
        f"{said} Of {others} other setting{'s' * (others > 1)} {alike} cannot be told from it by these seeds."
    )


def point_text(group: Group) -> str:
    """The keys and values of a setting."""
    return ", ".join(f"{key} {value}" for key, value in group.point.items()) or "the settings as they are"


def interval_text(metric: str, found: MetricSummary | None) -> str:
    """Mean and half width of the 95 % interval, with the unit; empty for nothing."""
    if found is None:
        return ""
    text = " ".join(format_metric(metric, found.mean))
    half_width = "" if found.ci95 is None else " ± " + " ".join(format_metric(metric, found.ci95))
    return (text + half_width).strip()


def _told_apart(one: MetricSummary, other: MetricSummary) -> bool:
    if one.ci95 is None or other.ci95 is None:
        return False
    return abs(one.mean - other.mean) > math.hypot(one.ci95, other.ci95)


def _failures(rows: Sequence[Row]) -> str:
    failed = [row["error"] for row in rows if row["error"] is not None]
    if not failed:
        return ""
    text = f"{len(failed)} of {len(rows)} runs failed, the first: {failed[0]}"
    return f'<p class="warning">{escape(text)}</p>'


def _table(groups: Sequence[Group]) -> str:
    keys = list(groups[0].point) if groups else []
    metrics = [name for name in _COLUMNS if any(name in group.summary for group in groups)]
    head = "".join(f"<th>{escape(name)}</th>" for name in ("log", *keys))
    head += "".join(
        f'<th class="number">{escape(name)}{_bracketed(metric_unit(name))}</th>' for name in metrics
    )
    body = []
    for group in groups:
        cells = "".join(f"<td>{escape(str(text))}</td>" for text in (group.log, *group.point.values()))
        cells += "".join(
            f'<td class="number">{escape(_numbers(name, group.summary.get(name)))}</td>' for name in metrics
        )
        runs = max((found.runs for found in group.summary.values()), default=0)
        failed = f", {group.failed} failed" if group.failed else ""
        body.append(f'<tr>{cells}<td class="number">{runs}{failed}</td></tr>')
    last = '<th class="number">runs</th>'
    return f'<div class="scroll"><table><tr>{head}{last}</tr>{"".join(body)}</table></div>'


def _bracketed(unit: str) -> str:
    return f" [{escape(unit)}]" if unit else ""


def _numbers(metric: str, found: MetricSummary | None) -> str:
    if found is None:
        return "-"
    half_width = "" if found.ci95 is None else f" ± {format_metric(metric, found.ci95)[0]}"
    return format_metric(metric, found.mean)[0] + half_width

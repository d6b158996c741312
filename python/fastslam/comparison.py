"""Several results on one page: paths and maps over each other, metrics with intervals, settings."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import Any

from .errors import DataError
from .evaluation import Evaluation, Metrics
from .evaluation.display import format_metric, metric_unit
from .evaluation.runs import summarize
from .log import Log
from .page_svg import themed_svg
from .report import render_page
from .result import RunResult
from .resultfiles import write_atomically
from .verdict import warnings_of

MOST_GROUPS = 12
"""More sets of results than this cannot be told apart on one page."""
_FIRST = ("ate_rmse_m", "smoothed_ate_rmse_m", "gps_median_m", "landmark_rmse_m", "landmarks")


@dataclass(frozen=True)
class Scored:
    """One result with its log and its evaluation; `name` is what the user calls it."""

    name: str
    result: RunResult
    log: Log
    evaluation: Evaluation


@dataclass(frozen=True)
class Group:
    """Results of one log that differ in nothing but the seed."""

    name: str
    members: tuple[Scored, ...]

    @property
    def first(self) -> Scored:
        """The one that is drawn."""
        return self.members[0]

    @property
    def metrics(self) -> list[Metrics]:
        """The metrics of each member."""
        return [member.evaluation.metrics for member in self.members]


def short_names(folders: Sequence[Path]) -> tuple[str, ...]:
    """The last parts of each path, as many as tell the folders apart."""
    parts = [folder.absolute().parts for folder in folders]
    for count in range(1, max(map(len, parts), default=1) + 1):
        names = tuple("/".join(part[-count:]) for part in parts)
        if len(set(names)) == len(set(parts)):
            return names
    return tuple(map(str, folders))


def group_results(scored: Sequence[Scored]) -> tuple[Group, ...]:
    """Results that differ only in the seed together, in the order given; names as short as they can be.

    Errors: `DataError` for none, or for more than `MOST_GROUPS` sets.
    """
    together: dict[str, list[Scored]] = {}
    for one in scored:
        settings = {key: value for key, value in one.result.config.items() if key != "seed"}
        key = json.dumps([one.log.source, one.result.log_name, settings], sort_keys=True, default=str)
        together.setdefault(key, []).append(one)
    if not 0 < len(together) <= MOST_GROUPS:
        found = f"got {len(together)} sets of results that differ in more than the seed"
        raise DataError(f"{found}, expected 1 to {MOST_GROUPS}")
    groups = []
    for members in together.values():
        others = f" and {len(members) - 1} more" if len(members) > 1 else ""
        groups.append(Group(members[0].name + others, tuple(members)))
    return tuple(groups)


def differing_settings(groups: Sequence[Group]) -> dict[str, tuple[str, ...]]:
    """Keys of the configuration whose values differ, with the value of each group; `-` where it has none."""
    flat = [_flat(group.first.result.config) for group in groups]
    keys = dict.fromkeys(key for settings in flat for key in settings if key != "seed")
    table = {key: tuple(settings.get(key, "-") for settings in flat) for key in keys}
    return {key: values for key, values in table.items() if len(set(values)) > 1}


def compared_metrics(groups: Sequence[Group]) -> dict[str, tuple[str, ...]]:
    """Each metric, as text for each group: the mean, of several seeds with its 95 % interval."""
    summaries = [summarize(group.metrics) for group in groups]
    names = dict.fromkeys(name for summary in summaries for name in summary if not name.startswith("counts."))
    first = [name for name in _FIRST if name in names]
    table = {}
    for name in [*first, *(name for name in names if name not in first)]:
        cells = []
        for summary in summaries:
            found = summary.get(name)
            text, unit = format_metric(name, None if found is None else found.mean)
            if found is not None and found.ci95 is not None and found.ci95 > 1e-9 * abs(found.mean):
                text += f" ± {format_metric(name, found.ci95)[0]}" if unit == metric_unit(name) else ""
            cells.append(text if shown_unit(name) == unit else f"{text} {unit}")
        table[name] = tuple(cells)
    return table


def shown_unit(metric: str) -> str:
    """The unit of a row; empty where each cell has its own (memory, rates)."""
    unit = metric_unit(metric)
    return "" if unit in ("B", "1/s") else unit


def render_comparison(groups: Sequence[Group]) -> str:
    """The page as HTML text; it loads nothing from elsewhere."""
    # Imported here so that the numbers are there where Matplotlib is not installed.
    from .plots import comparison_figure, render

    names = [group.name for group in groups]
    maps = (("map", comparison_figure(groups)), ("small-map", comparison_figure(groups, width_in=4.0)))
    settings = differing_settings(groups)
    logs = list(dict.fromkeys(group.first.result.log_name for group in groups))
    return render_page(
        "comparison_page.html",
        title=escape(f"{', '.join(logs)}: {len(groups)} results compared"),
        facts=escape(" · ".join(_facts(group) for group in groups)),
        warnings=_different_logs(groups) + "".join(_warnings(group) for group in groups),
        map="".join(themed_svg(render(figure, "svg").decode(), name) for name, figure in maps),
        metrics=_table("metric", names, compared_metrics(groups), units=True),
        settings=_table("setting", names, settings) if settings else "<p>They differ in no setting.</p>",
    )


def write_comparison(groups: Sequence[Group], path: Path) -> Path:
    """Write the page. Errors: `DataError` where it cannot be written."""
    return write_atomically(path, render_comparison(groups))


def _facts(group: Group) -> str:
    count = len(group.members)
    return f"{group.name}: {count} {'run' if count == 1 else 'runs'}"


def _different_logs(groups: Sequence[Group]) -> str:
    if len({group.first.log.source for group in groups}) == 1:
        return ""
    return (
        '<p class="warning">These results are of different logs: laid over each other they say something '
        "only where the logs are of one world.</p>"
    )


def _warnings(group: Group) -> str:
    texts = dict.fromkeys(text for member in group.members for text in warnings_of(member.result))
    return "".join(f'<p class="warning"><b>{escape(group.name)}:</b> {escape(text)}.</p>' for text in texts)


def _table(what: str, names: Sequence[str], rows: Mapping[str, Sequence[str]], *, units: bool = False) -> str:
    head = "".join(f'<th class="number">{escape(name)}</th>' for name in names)
    body = []
    for key, values in rows.items():
        cells = "".join(f'<td class="number">{escape(value)}</td>' for value in values)
        unit = f'<td class="unit">{escape(shown_unit(key))}</td>' if units else ""
        body.append(f"<tr><td><code>{escape(key)}</code></td>{cells}{unit}</tr>")
    last = "<th>unit</th>" if units else ""
    return f'<div class="scroll"><table><tr><th>{what}</th>{head}{last}</tr>{"".join(body)}</table></div>'


def _flat(settings: Mapping[str, Any], prefix: str = "") -> dict[str, str]:
    flat: dict[str, str] = {}
    for key, value in settings.items():
        if isinstance(value, Mapping):
            flat |= _flat(value, f"{prefix}{key}.")
        else:
            flat[prefix + key] = str(value)
    return flat

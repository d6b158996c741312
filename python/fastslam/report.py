"""One self-contained HTML page about a run: verdict, map, key figures, pictures, tables, configuration."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import partial
from html import escape
from importlib import resources
from pathlib import Path
from string import Template

from . import __version__
from .cards import calibration_text
from .charts.figures import run_charts
from .charts.svg import draw_chart
from .evaluation import Evaluation, Metrics, evaluate_run, flatten
from .evaluation.display import MetricRow, format_metric, format_number, metric_rows, summary_rows
from .evaluation.metrics import METRIC_UNITS, particle_count
from .health import health_summary
from .log import Log
from .report_landmarks import landmark_table, names_layer
from .result import RunResult
from .resultfiles import REPORT_FILE, config_yaml, write_atomically
from .verdict import in_one_line, is_believable, warnings_of

_CARDS = (
    ("ate_rmse_m", "path error, RMSE"),
    ("smoothed_ate_rmse_m", "smoothed path error, RMSE"),
    ("gps_median_m", "distance to GPS, median"),
    ("landmark_rmse_m", "landmark error, RMSE"),
    ("landmarks", "landmarks in the map"),
    ("filter_seconds", "computing time"),
    ("step_latency_us.p99", "step latency, 99th percentile"),
)
SMALL_IN = 4.0
"""How wide figures are whose letters can be read on a phone."""
_CAPTIONS = {
    "map": "Landmarks with 2σ ellipses of the mixture over particles (they hold 86 % of a planar Gaussian), "
    "the path as known at each time (live) and in hindsight (smoothed). Rest the pointer on a landmark, "
    "or tap it, for its name and figures.",
    "error": "The band is twice the standard deviation along the major axis of the reported covariance. "
    "Where the log has true poses or position fixes, the distance to them after rigid alignment.",
    "health": "Above: whether the filter could be believed, and the reasons where not. Below: squared "
    "innovations over what the configured noise predicts (NIS), averaged over a sliding window; far above 2 "
    "the noise is set too small, far below too large.",
    "effective_sample_size": "1 / Σ weight² before resampling; a mark on the axis is a resampling.",
    "latency": "Computing time of each filter step, in order and as a distribution.",
}


def write_report(
    result: RunResult,
    log: Log,
    path: Path | str,
    *,
    evaluation: Evaluation | None = None,
    runs: Sequence[Metrics] = (),
) -> Path:
    """Write the report of a run; with `runs`, metrics of several runs, a table that sums them up.

    `path` is the file, or a folder that gets `report.html`. The page loads nothing from elsewhere.
    Errors: `DataError` where it cannot be written.
    """
    target = Path(path)
    if target.is_dir() or target.suffix == "":
        target = target / REPORT_FILE
    page = render_report(result, log, evaluation=evaluation, runs=runs)
    return write_atomically(target, page)


def render_report(
    result: RunResult,
    log: Log,
    *,
    evaluation: Evaluation | None = None,
    runs: Sequence[Metrics] = (),
) -> str:
    """The report as HTML text; arguments as those of `write_report`."""
    found = evaluate_run(result, log) if evaluation is None else evaluation
    blocks = _figures(result, log, found)
    return render_page(
        "report_page.html",
        title=escape(f"{log.name}: map and path"),
        facts=_facts(result, log),
        verdict=_verdict(result),
        warnings=_warnings(result, found),
        map=blocks.pop("map"),
        cards=_cards(found.metrics),
        figures="".join(blocks.values()),
        runs=_runs_table(runs) if len(runs) > 1 else "",
        metrics=_metrics_tables(found.metrics),
        landmarks=_learned(result) + landmark_table(result.landmarks),
        problems=_problems(result, log),
        config=escape(config_yaml(result)),
    )


def render_page(body: str, **parts: str) -> str:
    """A page whose body is this file of the package; `parts`, title and facts among them, are HTML."""
    folder = resources.files("fastslam")
    frame, style, content = (
        folder.joinpath(name).read_text(encoding="utf-8")
        for name in ("page_frame.html", "page_style.css", body)
    )
    whole = Template(frame).safe_substitute(style=style, body=content)
    return Template(whole).substitute(version=escape(__version__), **parts)


def _facts(result: RunResult, log: Log) -> str:
    particles = particle_count(result.config)
    stamps = result.steps.stamp_s
    parts = [
        f"log format {log.format}",
        f"{format_number(float(stamps[-1] - stamps[0]))} s of driving" if len(stamps) else "no steps",
        "" if particles is None else f"{particles:,} particles",
        f"seed {result.config['seed']}" if "seed" in result.config else "",
        f"fastslam {result.version}",
    ]
    return " · ".join(escape(part) for part in parts if part)


def _verdict(result: RunResult) -> str:
    """One line: whether the run is to be believed, as the console says it."""
    line, health = in_one_line(result), health_summary(result.steps)
    said = "" if health.ok is None else f" The filter's health was ok in {health.ok:.0%} of its steps."
    is_good = is_believable(result) and not warnings_of(result)
    look = "verdict good" if is_good else "verdict"
    return f'<p class="{look}">{escape(line[:1].upper() + line[1:])}.{said}</p>'


def _warnings(result: RunResult, found: Evaluation) -> str:
    texts = []
    if result.interrupted:
        texts.append("This run was stopped before the end of the log; everything here is up to that point.")
    if len(result.steps.stamp_s) == 0:
        texts.append("The log gave the filter no step, so there is no map and no path.")
    texts.extend(f"{warning[:1].upper()}{warning[1:]}." for warning in warnings_of(result))
    undetermined = [name for name, value in found.metrics.items() if value is None and name in METRIC_UNITS]
    if undetermined:
        texts.append("Not determined in this run: " + ", ".join(undetermined) + ".")
    return "".join(f'<p class="warning">{escape(text)}</p>' for text in texts)


def _learned(result: RunResult) -> str:
    """What the run learned of the sensor, in the units of its numbers."""
    if not result.calibration:
        return ""
    return f"<p>Learned of the sensor: {escape(calibration_text(result.calibration))}.</p>"


def _cards(metrics: Metrics) -> str:
    flat = flatten(metrics)
    cards = []
    for name, label in _CARDS:
        if flat.get(name) is not None:
            text, unit = format_metric(name, flat[name])
            cards.append(_card(text, unit, label))
    precision, recall = flat.get("landmark_precision"), flat.get("landmark_recall")
    if precision is not None and recall is not None:
        cards.insert(-3, _card(f"{precision:.0%} / {recall:.0%}", "", "landmark precision / recall"))
    provisional = flat.get("landmarks_provisional")
    if provisional:
        cards.append(_card(f"{provisional:,.0f}", "", "landmarks not yet believed, not counted above"))
    return "".join(cards)


def _card(text: str, unit: str, label: str) -> str:
    return f'<div class="card"><b>{escape(text)} <small>{escape(unit)}</small></b><span>{label}</span></div>'


def _figures(result: RunResult, log: Log, found: Evaluation) -> dict[str, str]:
    """The figures as HTML, by name; each is there twice, and a page shows the one that it has room for."""
    wide = run_charts(result, log, found)
    small = run_charts(result, log, found, width_in=SMALL_IN)
    blocks = {}
    for name, caption in _CAPTIONS.items():
        over = partial(names_layer, landmarks=result.landmarks) if name == "map" else None
        svg = draw_chart(wide[name], name, over=over)
        svg += draw_chart(small[name], f"small-{name}", over=over)
        blocks[name] = f'<figure class="two">{svg}<figcaption>{caption}</figcaption></figure>'
    return blocks


def _metrics_tables(metrics: Metrics) -> str:
    """The metrics in two tables side by side: what the run cost, and how good it was."""
    rows = [row for row in metric_rows(metrics) if not row.name.startswith("counts.")]
    quality = [row for row in rows if row.name.startswith(_QUALITY)]
    cost = [row for row in rows if not row.name.startswith(_QUALITY)]
    return "".join(_table(table) for table in (quality, cost) if table)


_QUALITY = (
    "ate_",
    "smoothed_",
    "heading_",
    "relative_",
    "truth_",
    "landmark_",
    "gps_",
    "edited_",
    "nis",
    "health_",
)


def _table(rows: Iterable[MetricRow]) -> str:
    cells = (
        f'<tr><td><code>{escape(row.name)}</code></td><td class="number">{escape(row.value)}</td>'
        f'<td class="unit">{escape(row.unit)}</td></tr>'
        for row in rows
    )
    head = '<tr><th>metric</th><th class="number">value</th><th>unit</th></tr>'
    return f"<table>{head}{''.join(cells)}</table>"


def _runs_table(runs: Sequence[Metrics]) -> str:
    columns = ("runs", "mean", "± 95 %", "median", "least", "largest")
    head = "".join(f'<th class="number">{column}</th>' for column in columns)
    rows = []
    for row in summary_rows(runs):
        cells = (str(row.runs), row.mean, row.ci95, row.median, row.min, row.max)
        numbers = "".join(f'<td class="number">{cell}</td>' for cell in cells)
        unit = f'<td class="unit">{escape(row.unit)}</td>'
        rows.append(f"<tr><td><code>{escape(row.name)}</code></td>{numbers}{unit}</tr>")
    title = f"<h2>Over {len(runs)} runs</h2><p>Mean with its 95 % confidence interval (Student t). "
    title += "Pictures and the other tables are of one of these runs.</p>"
    table = f"<table><tr><th>metric</th>{head}<th>unit</th></tr>{''.join(rows)}</table>"
    return f'{title}<div class="scroll">{table}</div>'


def _problems(result: RunResult, log: Log) -> str:
    found = [("reading the log", problem.message, problem.count) for problem in log.problems]
    found += [("filtering", name.replace("_", " "), count) for name, count in result.counts.items() if count]
    if not found:
        return "<p>None: no row was skipped and nothing was repaired.</p>"
    rows = "".join(
        f'<tr><td>{where}</td><td>{escape(what)}</td><td class="number">{count:,}</td></tr>'
        for where, what, count in found
    )
    return f'<table><tr><th>while</th><th>what</th><th class="number">count</th></tr>{rows}</table>'

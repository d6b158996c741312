"""`fastslam tune`: the noise and the systematic errors of a log, as settings."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ..errors import DataError
from .console import make_table, progress_bar, stderr, stdout
from .encoding import print_json
from .options import ConfigFile, Format, Json, LogPath, Robot, Run, Seed, Settings

if TYPE_CHECKING:
    from ..automatic import Learning
    from ..config import Config
    from ..log import Log
    from ..result import RunResult
    from ..runner import Progress
    from ..settings import Layer
    from ..tuning import Tuning
    from ..tuning.learn import Value
    from ..watching import Watcher

LEARNED_FILE = "learned.json"
"""What a run learned before it: values, intervals, evidence."""


def tune_log(
    path: LogPath,
    format: Format = None,
    robot: Robot = None,
    run: Run = None,
    config: ConfigFile = None,
    settings: Settings = None,
    seed: Seed = None,
    out: Annotated[Path, typer.Option(help="YAML file for the settings found.")] = Path("settings.yaml"),
    json: Json = False,
) -> None:
    """Find the noise, the gains, biases and delay of the odometry, and the mounting of the sensor.

    The first 70 % of the sightings teach, the others judge: what is written makes a sounder or simpler map
    than the settings stated, or explains them better by 10 nats, or the file is empty. At most seven runs of
    the filter are made.

    Settings come from: defaults < the log's own < --config < --set. What is stated there of mounting, delay,
    gains and biases is a fact: it gives way only where the log clearly contradicts it, which is then said.

    \b
    Examples:
      fastslam tune LOG
      fastslam run LOG --config settings.yaml
      fastslam tune MRCLAM_Dataset2 --robot 3 --set association.mode=unknown --out robot3.yaml
    """
    from .._yaml import write_yaml
    from ..config import load_config, merge, parse_assignments
    from ..datasets.registry import load
    from ..resultfiles import write_atomically
    from ..tuning import tune

    given = [*(settings or []), *([] if seed is None else [f"seed={seed}"])]
    layers = (load_config(config) if config is not None else {}, parse_assignments(given))
    log = load(path, format=format, robot=robot, run=run)
    with progress_bar(log.name) as advance:
        found = tune(log, merge(*layers), progress=advance)
    written = write_atomically(out, write_yaml(found.settings))
    if json:
        print_json({**facts_of(found), "settings_file": str(out)})
        return
    show_tuning(log.name, found)
    for sentence in found.conflicts:
        stderr().print(f"warning: {sentence}", markup=False, highlight=False, soft_wrap=True)
    typer.echo(written)


def learned_into(
    folder: Path,
    log: Log,
    layer: Layer,
    *,
    wanted: bool | None,
    quiet: bool,
    watcher: Watcher | None = None,
) -> Learning | None:
    """Tunes where that is `wanted`, or due where None, and leaves what was learned in a folder of results.

    A `watcher` shows how it goes on. Errors: DataError where it was wanted and cannot be done.
    """
    from ..automatic import is_learning_due, learned_first
    from ..resultfiles import to_json, write_atomically

    if wanted is False or (wanted is None and not is_learning_due(log, layer)):
        return None
    with progress_bar(log.name) as advance:
        report = None if watcher is None else watcher.show_learning
        learning = learned_first(log, layer, progress=advance, report=report)
    found = learning.found
    if found is not None and found.interrupted:
        return learning
    reason = learning.refusal if found is None else found.best.fault
    if wanted and reason is not None:
        raise DataError(f"nothing can be learned from this log: {reason}", log.source)
    if found is None:
        return learning
    write_atomically(folder / LEARNED_FILE, to_json(facts_of(found)))
    if wanted and not quiet:
        show_tuning(log.name, found)
    elif not quiet:
        stderr().print(f"note: {_in_short(found)}", markup=False, highlight=False, soft_wrap=True)
    return learning


def sounder_into(
    folder: Path, result: RunResult, log: Log, config: Config, *, progress: Progress
) -> RunResult:
    """The run, or where its map is doubted a sounder one; what the log taught it is left in a folder."""
    from ..automatic import in_place_of, sounder_than
    from ..resultfiles import to_json, write_atomically

    def say() -> None:
        note = "the map is doubted: learning from the log, up to six runs more (--no-auto: none)"
        stderr().print(f"note: {note}", markup=False, highlight=False, soft_wrap=True)

    found = sounder_than(result, log, config, progress=progress, on_doubt=say)
    if found is None:
        return result
    write_atomically(folder / LEARNED_FILE, to_json(facts_of(found)))
    return in_place_of(result, found)


def _in_short(found: Tuning) -> str:
    """What was found, in a sentence."""
    if not found.settings:
        return "not all of the noise is stated; the log is explained best by the settings as they are"
    set_ = [value for value in found.values if value.significant]
    told = ", ".join(f"{value.key} {value.value:.3g}" for value in set_ if value.value != value.stated)
    better = (
        "the settings as they are map things again and again"
        if found.attempts[0].was_ended
        else f"{found.evidence_gain:,.0f} nats better than the settings as they are"
    )
    return f"not all of the noise is stated: learned from the log ({better}, {LEARNED_FILE}): {told}"


def show_tuning(name: str, found: Tuning) -> None:
    """Prints what was learned, what was tried, and what the log does not tell."""
    headings = ("!parameter", ">stated", ">found", ">95 % interval", "unit", ">nats", "!")
    if found.values:
        stdout().print(make_table(name, headings, [_row(value) for value in found.values]))
    rows = [(a.name, "" if a.was_ended else f"{a.evidence:,.0f}", a.fault or "") for a in found.attempts]
    stdout().print(make_table("evidence", ("settings", f">nats on {found.judged:,} sightings", ""), rows))
    for sentence in sentences_of(found):
        stderr().print(f"note: {sentence}", markup=False, highlight=False, soft_wrap=True)


def sentences_of(found: Tuning) -> list[str]:
    """What is worth a sentence beside the table."""
    hidden = [value.key for value in found.values if not value.observable]
    sentences = []
    if hidden:
        sentences.append(
            f"this log does not tell {', '.join(hidden)}: drive curves, see landmarks from all sides"
        )
    if found.alternative:
        sentences.append(_undecided(found))
    if not found.settings:
        sentences.append("the settings stated explain the log best: nothing is changed")
    return sentences


def _undecided(found: Tuning) -> str:
    """Which of ranges and odometry is set, and what to set if it is the other one."""
    from ..tuning.learn import SCALE

    ranges = any(value.key == SCALE and value.significant for value in found.values)
    taken, right = ("ranges", "odometry is off") if ranges else ("odometry", "ranges are off")
    scale = found.alternative["sensor"]["range_scale"]
    gain = found.alternative["motion"]["correction"]["distance_gain"]
    return (
        f"ranges are {found.ratio:.4g} times as long as the odometry says. The log does not tell which of "
        f"the two is off; it is taken for the {taken}. If the {right}, set sensor.range_scale={scale:.4g} "
        f"and motion.correction.distance_gain={gain:.4g} instead"
    )


def facts_of(found: Tuning) -> dict[str, Any]:
    """The members of a tuning for JSON."""
    values = [
        {
            "key": value.key,
            "unit": value.unit,
            "stated": value.stated,
            "value": value.value,
            "interval95": None if math.isnan(value.standard_error) else value.interval95,
            "observable": value.observable,
            "set": value.significant,
        }
        for value in found.values
    ]
    attempts = [
        {"name": a.name, "evidence": None if a.was_ended else a.evidence, "fault": a.fault}
        for a in found.attempts
    ]
    return {
        "settings": found.settings,
        "alternative": found.alternative,
        "values": values,
        "evidence_gain": None if math.isnan(found.evidence_gain) else found.evidence_gain,
        "judged_sightings": found.judged,
        "attempts": attempts,
        "conflicts": found.conflicts,
        "notes": sentences_of(found),
    }


def _row(value: Value) -> tuple[str, ...]:
    from ..evaluation.display import format_number

    stated, found = format_number(value.stated), format_number(value.value)
    if math.isnan(value.standard_error):
        return (value.key, stated, found, "", value.unit, "", "")
    interval = " to ".join(format_number(end) for end in value.interval95)
    note = "contradicts you" if value.contradicts else "" if value.significant else "kept: chance"
    if value.slack > 0.0 and not value.significant:
        note = "kept: stated"
    if not value.observable:
        note = "kept: not told"
    nats = f"{value.log_odds:,.1f}" if value.significant else ""
    return (value.key, stated, found, interval, value.unit, nats, note)

"""What learning is at, for whoever watches: the runs made so far, the one that runs, what each is told."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, TypeAlias

if TYPE_CHECKING:
    from .learn import Learned, Value
    from .session import Attempt

Report: TypeAlias = Callable[[list[dict[str, Any]]], None]
"""Called with all passes whenever one begins or ends, as JSON can carry them (`passes_of`)."""


def passes_of(
    attempts: Sequence[Attempt], best: Attempt | None, running: tuple[str, Learned | None] | None
) -> list[dict[str, Any]]:
    """The passes that were made, then the one that runs: name, state, landmarks, evidence, what it is told.

    States: `running`, `best` so far, `sound` or `doubted` map, and `ended` early.
    """
    made = [_made(attempt, is_best=attempt is best) for attempt in attempts]
    if running is None:
        return made
    name, learned = running
    return [
        *made,
        {"name": name, "state": "running", "landmarks": None, "nats": None, "told": told_by(learned)},
    ]


def told_by(learned: Learned | None) -> list[str]:
    """What was learned and a run is told, a sentence for each value, with its interval if it has one."""
    return [] if learned is None else [_in_words(value) for value in learned.values if value.significant]


def _made(attempt: Attempt, *, is_best: bool) -> dict[str, Any]:
    state = "sound" if attempt.is_sound else "doubted"
    state = "ended" if attempt.was_ended else "best" if is_best else state
    return {
        "name": attempt.name,
        "state": state,
        "landmarks": attempt.judgement.landmarks,
        "nats": None if math.isnan(attempt.evidence) else round(attempt.evidence),
        "told": told_by(attempt.learned),
    }


def _in_words(value: Value) -> str:
    unit = f" {value.unit}" if value.unit else ""
    if math.isnan(value.standard_error):
        return f"{value.key} {value.value:.3g}{unit}"
    low, high = value.interval95
    stated = f", stated {value.stated:.3g}" if value.contradicts else ""
    return f"{value.key} {value.value:.3g}{unit} ({low:.3g} to {high:.3g}{stated})"

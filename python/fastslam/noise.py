"""What the innovations say against the configured noise, in sentences: what is wrong, what to set."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from .log import Sightings

from .trust import WAS_LOST

ASK_FIRST = "but a lost filter has other reasons too: `fastslam info LOG` and `fastslam doctor LOG` first"
_MARK = "(NIS "
"""What all sentences on noise have, and no others."""
ADDS_UP = "unless loops close only so: errors of odometry that add up over a loop show in no scan"
ASK_THE_LOG = "`fastslam run LOG --auto`, or `fastslam.tuning.tune` in Python, finds out"
ASKED = "learning from the log has left it open"
MAP_FIRST = "how small the noise is can be told only of a right map: what speaks against this one comes first"
_LOWERS = "): lower "
"""What all sentences have that advise a narrower noise, and no others."""
SMALLEST_SAID = 0.1
"""A factor below this is said to be below it: the log hardly tells what is right."""


CHANGED = 0.2
"""From this relative change of the advised value on, a warning is another one."""


class Told:
    """The last warning about each noise, which stays to the letter until its advice changes."""

    def __init__(self, kept: Mapping[str, tuple[float, str]] | None = None) -> None:
        self.kept = dict(kept or {})
        """By the keys of the noise: how many times as large it should be, and the sentence."""

    def sentences(self, warnings: Iterable[Mapping[str, Any]], config: Mapping[str, Any]) -> tuple[str, ...]:
        """One for each warning of the core: as it was told before where hardly anything has changed."""
        return tuple(self._told(warning, config) for warning in warnings)

    def _told(self, warning: Mapping[str, Any], config: Mapping[str, Any]) -> str:
        subject, scale = " ".join(warning["keys"]), warning["std_factor"] ** warning["power"]
        before = self.kept.get(subject)
        if before is None or abs(scale - before[0]) > CHANGED * before[0]:
            before = self.kept[subject] = (scale, _sentence(warning, config))
        return before[1]


def noise_sentences(
    warnings: Iterable[Mapping[str, Any]],
    config: Mapping[str, Any],
    sightings: Sightings | None = None,
    *,
    detected: bool = False,
    kept_map: bool = False,
) -> tuple[str, ...]:
    """One sentence for each warning of the core, with the values to set in place of those of `config`.

    To learn from the log is advised where that can be done: not of a robot in a `kept_map`. Where all
    `sightings` have covariances of their own, as those `detected` in scans have, the noise of `sensor` counts
    for nothing, and the sentence speaks of these covariances.
    """
    asks = not kept_map and _is_learnable(config)
    own = sightings is not None and _all_have_their_own(sightings)
    return tuple(
        _of_covariances(warning, detected=detected)
        if own and _is_of_sensor(warning)
        else _sentence(warning, config, asks=asks)
        for warning in warnings
    )


def _is_learnable(config: Mapping[str, Any]) -> bool:
    """Whether `tune` knows algorithm and sensor of these settings (as `automatic.is_learnable`)."""
    sensor = config.get("sensor", {}).get("model", "range_bearing")
    plain = config.get("algorithm") != "ekf" and not config.get("sensors")
    return bool(plain and sensor == "range_bearing")


def _all_have_their_own(sightings: Sightings) -> bool:
    covariance = sightings.covariance
    return covariance is not None and len(covariance) > 0 and bool(np.isfinite(covariance).all())


def _is_of_sensor(warning: Mapping[str, Any]) -> bool:
    return warning["what"] is not None and bool(warning["keys"][0].startswith("sensor."))


def _of_covariances(warning: Mapping[str, Any], *, detected: bool) -> str:
    """What is wrong with the covariances that sightings bring, and who makes them."""
    factor: float = warning["std_factor"]
    low, high = warning["nis_band"]
    said = (
        f"{warning['what']} innovations are {_times(factor)} as large as the sightings' own covariances say"
    )
    direction = "raise" if factor > 1.0 else "lower"
    unless = ", unless the errors of successive scans repeat" if factor < 1.0 else ""
    who = "the detector's range_std_m and beam_std_rad" if detected else "the covariances of the rows"
    idle = " and ".join(warning["keys"])
    return (
        f"{said} (NIS {warning['nis']:.2f}, band {low:.2f}-{high:.2f}): {direction} {who}{unless}; "
        f"what {idle} says counts for nothing here"
    )


def after_verdict(warnings: Iterable[str], verdict: Iterable[str]) -> tuple[str, ...]:
    """Advice on noise after what speaks against the run.

    No narrower noise is advised for a map that is doubted: it would be there twice all the more. Where the
    filter was lost, which has other reasons too, what is left of the advice says what comes first.
    """
    told, against = tuple(warnings), tuple(verdict)
    if not against:
        return told
    kept = tuple(sentence for sentence in told if _LOWERS not in sentence)
    if any(sentence.startswith(WAS_LOST) for sentence in against):
        kept = tuple(f"{sentence}; {ASK_FIRST}" if _MARK in sentence else sentence for sentence in kept)
    return kept if len(kept) == len(told) else (*kept, MAP_FIRST)


def after_learning(warnings: Iterable[str]) -> tuple[str, ...]:
    """Advice on noise after the log was asked for it: not to ask it, and no narrower one than it said.

    What sightings bring along is not learned: the advice on that stays.
    """
    chosen = (f"{_LOWERS}motion.", f"{_LOWERS}sensor.")
    return tuple(
        sentence.replace(ASK_THE_LOG, ASKED)
        for sentence in warnings
        if not any(advice in sentence for advice in chosen)
    )


def after_findings(warnings: Iterable[str], findings: Iterable[Mapping[str, str]]) -> tuple[str, ...]:
    """No advice on noise where the log has a problem: numbers that are meant otherwise look like noise."""
    told = tuple(warnings)
    problems = [finding for finding in findings if finding["severity"] in ("problem", "error")]
    others = tuple(sentence for sentence in told if _MARK not in sentence)
    if not problems or len(others) == len(told):
        return told
    said = f"{problems[0]['message']} [{problems[0]['code']}]"
    return (*others, f"what the noise is can be told only when this is put right: {said}")


def _sentence(warning: Mapping[str, Any], config: Mapping[str, Any], *, asks: bool = False) -> str:
    factor: float = warning["std_factor"]
    low, high = warning["nis_band"]
    found = f"NIS {warning['nis']:.2f}, band {low:.2f}-{high:.2f}"
    what, keys = warning["what"], warning["keys"]
    if what is None:
        return (
            f"innovations are {_times(factor)} as large as the noise settings say ({found}), and the log "
            "does not tell whether `sensor` or `motion` is to blame"
        ) + (f": {ASK_THE_LOG}" if asks else "")
    values = {key: value for key in keys if (value := _value(config, key)) is not None}
    named = " and ".join(values)
    direction = "raise" if factor > 1.0 else "lower"
    scale = factor ** warning["power"]
    verb = "says" if len(values) == 1 else "say"
    advice = " and ".join(f"{key} to about {_short(value * scale)}" for key, value in values.items())
    if keys[0].startswith("sensor."):
        # A filter that believes repeated errors to be new ones grows too sure; wide noise is a common remedy.
        unless = ", unless the errors of successive scans repeat" if factor < 1.0 else ""
        subject = f"{what} innovations are {_times(factor)} as large as {named} {verb}"
        return f"{subject} ({found}): {direction} {advice}{unless}"
    subject = f"the odometry's {what} is off {_times(factor)} as much as {named} {verb}"
    unless = f", {ADDS_UP}" if factor < 1.0 and _is_unnamed(config) else ""
    return f"{subject} ({found}): {direction} {advice}{unless}"


def _is_unnamed(config: Mapping[str, Any]) -> bool:
    return bool(config.get("association", {}).get("mode") == "unknown")


def _value(config: Mapping[str, Any], key: str) -> float | None:
    """The number at a dotted key; None where it is absent or 0, which no factor changes."""
    value: Any = config
    for part in key.split("."):
        value = value.get(part) if isinstance(value, Mapping) else None
    return float(value) if isinstance(value, int | float) and value > 0 else None


def _times(factor: float) -> str:
    return "less than 0.1 times" if factor < SMALLEST_SAID else f"{_short(factor)} times"


def _short(value: float) -> str:
    """Two significant digits."""
    return f"{float(f'{value:.1e}'):.6g}"

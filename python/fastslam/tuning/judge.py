"""Whether one run explains a log better than another, and whether a run is worth learning from."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..config import merge
from ..health import health_summary
from ..laid import explained_apart, laid_on_map
from ..log import Log
from ..result import RunResult
from ..trust import CROWDED, LANDMARKS, LOST, NOT_FOUND, UNEXPLAINED, Doubt, doubts
from ..verdict import not_found_again

MOST_LOST = 0.2
"""A run that is lost in more of its steps teaches nothing."""
MOST_UNEXPLAINED = 0.5
"""A map of which more of the sightings show nothing is none."""
FEWER = 0.9
"""A map of less than this share of the landmarks is the simpler one."""
AS_MUCH = 0.02
"""A map explains as much as another if it explains less of the log by less than this."""
OWN_SHARE = 0.2
"""Landmarks that explain less than this share of what those of a map do on average may be there twice."""
OF_THE_MAP = (CROWDED, LANDMARKS, LOST, NOT_FOUND, UNEXPLAINED)
"""What speaks against a map whatever its noise; innovations speak against the noise.

Not what is there twice: of the one such map that was tried (a loop with a sensor that faces back) learning
made a bent one against which nothing speaks, and a map that is told wrong is better than that.
"""
WORTHLESS = 4.0
"""A map that goes so many times beyond what is believed of a map is no map: 40 % of it do not stand."""


def log_new_density(config: Mapping[str, Any]) -> float:
    """ln of the density that the filter gives a sighting of a new landmark, or one that it leaves out."""
    association, sensor = config["association"], config["sensor"]
    density = association["new_landmark_density"]
    if density is None:
        outer = -2 * np.log(1 - association["new_landmark_gate_probability"])
        tail = sensor["tail_degrees_of_freedom"]
        excess = 0.0 if tail is None else 0.5 * outer - 0.5 * (tail + 2) * np.log1p(outer / tail)
        log_deviations = np.log(2 * sensor["range_std_m"]) + np.log(sensor["bearing_std_rad"])
        found = -0.5 * outer - log_deviations - np.log(2 * np.pi) + excess
    else:
        found = np.log(density)
    clutter = association["clutter_density"]
    return float(found if clutter is None else np.logaddexp(found, np.log(clutter)))


def evidence(result: RunResult, from_s: float, common: Mapping[str, Any]) -> float:
    """ln of the probability of the sightings after a time, each told by all before it, in nats.

    What a filter takes for new or leaves out counts with the density of the settings `common`: with that of
    its own a run would gain by founding many landmarks, the more the narrower its noise. A likelihood that
    the settings raise to a power is taken back to one of plain sightings.
    """
    steps, config = result.steps, result.config
    judged = steps.stamp_s + config["sensor"]["delay_s"] > from_s
    exponent = float(config["filter"]["likelihood_exponent"])
    total = float(np.sum(steps.log_likelihood[judged])) / exponent
    if config["association"]["mode"] == "known":
        return total + float(np.sum(steps.ignored[judged])) * log_new_density(common)
    unexplained = float(np.sum(steps.new_landmarks[judged] + steps.ignored[judged]))
    return total + unexplained * (log_new_density(common) - log_new_density(config))


@dataclass(frozen=True)
class Judgement:
    """What speaks against a run, a sentence each, and how much of the log how small a map explains."""

    fault: str | None
    """Why the run teaches nothing."""
    doubt: str | None
    """Why its map is not believed."""
    landmarks: int
    """Landmarks that are believed."""
    explained: float
    """Share of the sightings that lie near one of them that no other of their scan needs, in noise that is
    the same for all runs."""

    @property
    def rank(self) -> int:
        """SOUND where nothing speaks against the run, 0 where it is worthless for learning."""
        return SOUND if self.doubt is None else int(self.fault is None)

    def is_simpler(self, other: Judgement) -> bool:
        """Whether clearly fewer landmarks explain as much: what the other has more is there twice.

        Where the other is doubted they may explain less, by as little as landmarks do that are there twice.
        """
        if self.landmarks >= FEWER * other.landmarks:
            return False
        fewer = 1.0 - self.landmarks / other.landmarks
        less = AS_MUCH if other.doubt is None else max(AS_MUCH, OWN_SHARE * fewer)
        return self.explained > other.explained - less

    @property
    def share(self) -> float:
        """A map of which this one has a smaller share is kept in its place only if it is sound; 0 for none.

        As a doubted one it would have to explain more of the log than there is.
        """
        return float(np.clip(1.0 - (1.0 - self.explained) / OWN_SHARE, 0.0, FEWER))

    def explains_as_much_as(self, other: Judgement) -> bool:
        """Whether as many sightings lie near the landmarks as near those of another map."""
        return self.explained > other.explained - AS_MUCH


SOUND = 2


def ended(result: RunResult, best: Judgement) -> Judgement:
    """Of a run that was ended for the landmarks that it had more than the best one."""
    landmarks = int(result.steps.landmarks[-1])
    reason = f"its map had {landmarks:,} landmarks when it was ended, that of the best run {best.landmarks:,}"
    return Judgement(reason, reason, landmarks, explained=1.0)


def judged(result: RunResult, log: Log, common: Mapping[str, Any], held: tuple[Doubt, ...] = ()) -> Judgement:
    """Holds a run against the log, and its map against the noise of the settings `common`.

    `held` is what its verdict was drawn from (`RunResult.doubts`), where that is of this very map.
    """
    landmarks = result.landmarks
    believed = len(landmarks.ids) if landmarks.confirmed is None else int(landmarks.confirmed.sum())
    noise = {name: common["sensor"][name] for name in ("range_std_m", "bearing_std_rad")}
    told = merge(result.config, {"sensor": noise})
    laid = laid_on_map(replace(result, config=told), log)
    explained = 0.0 if laid is None else float(explained_apart(laid, log, told["sensor"]).mean())
    fault = _fault_of(result)
    if fault is not None:
        return Judgement(fault, fault, believed, explained)
    of_map = next((doubt for doubt in held or doubts(result, log) if doubt.rule in OF_THE_MAP), None)
    doubt = None if of_map is None or of_map.ratio < 1.0 else of_map.sentence
    fault = None if of_map is None or of_map.ratio < WORTHLESS else of_map.sentence
    return Judgement(fault, doubt, believed, explained)


def _fault_of(result: RunResult) -> str | None:
    """What makes a run worthless for learning, whatever its map: lost, empty, or its loops open."""
    health = health_summary(result.steps)
    if health.lost is not None and health.lost > MOST_LOST:
        return f"the filter was lost in {health.lost:.0%} of its steps"
    if len(result.landmarks.ids) == 0:
        return "nothing was mapped"
    steps = result.steps
    unexplained = float(np.sum(steps.new_landmarks + steps.ignored)) / max(
        float(np.sum(steps.sightings)), 1.0
    )
    if unexplained > MOST_UNEXPLAINED:
        return f"{unexplained:.0%} of the sightings show no landmark of the map"
    return not_found_again(result)

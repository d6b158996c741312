"""Whether a filter can be believed: status and reasons of a step, as the core codes them, and over a run."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from .log import Bools, Ints
from .result import Steps


class HealthStatus(IntEnum):
    """How the filter is doing; a higher number is worse, after the start."""

    INITIALIZING = 0
    """Too little was seen again to judge."""
    OK = 1
    DEGRADED = 2
    """Something speaks against the estimate: it is worse than it says, or about to be."""
    LOST = 3
    """The estimate should not be used."""
    SEARCHING = 4
    """The robot was lost, or nobody knew where it started, and it was looked for in its map."""


REASONS = {
    "few_effective_particles": "almost all weight on almost no particles",
    "innovations_too_large": "sightings far from where they were predicted",
    "no_sightings": "nothing sighted for long",
    "sightings_unexplained": "sightings that show no known landmark where known ones should be",
    "pose_uncertain": "the particles disagree about the pose",
    "map_stale": "landmarks of the map are in view and not sighted",
    "not_found_again": "landmarks to which the robot came back are not sighted any more",
}
"""Name and meaning of each reason, in the order of the bits of the core."""


def status_name(code: int) -> str:
    """`initializing`, `ok`, `degraded`, `lost` or `searching`."""
    return HealthStatus(code).name.lower()


def status_code(name: str) -> int:
    """The inverse of `status_name`. Errors: `ValueError`."""
    try:
        return int(HealthStatus[name.upper()])
    except KeyError:
        raise ValueError(f"no such health status: {name}") from None


def reason_names(bits: int) -> tuple[str, ...]:
    """The reasons whose bits are set."""
    return tuple(name for bit, name in enumerate(REASONS) if bits >> bit & 1)


def reason_bits(names: str) -> int:
    """The inverse of `reason_names` for names joined by `+`. Errors: `ValueError`."""
    known = list(REASONS)
    return sum(1 << known.index(name) for name in names.split("+") if name)


def has_reason(bits: Ints, name: str) -> Bools:
    """At which steps a reason applies. Shapes: (T,)."""
    return np.asarray(bits >> list(REASONS).index(name) & 1, dtype=np.bool_)


@dataclass(frozen=True)
class HealthSummary:
    """Fractions of the steps after the first verdict and outside of searches; None where there was none."""

    ok: float | None
    degraded: float | None
    lost: float | None


def health_summary(steps: Steps) -> HealthSummary:
    """How often the filter was ok, degraded and lost once it had seen enough to judge."""
    judged = steps.health[~np.isin(steps.health, (HealthStatus.INITIALIZING, HealthStatus.SEARCHING))]
    if len(judged) == 0:
        return HealthSummary(None, None, None)
    ok, degraded, lost = (
        float(np.mean(judged == status))
        for status in (HealthStatus.OK, HealthStatus.DEGRADED, HealthStatus.LOST)
    )
    return HealthSummary(ok, degraded, lost)


def health_warning(steps: Steps) -> str | None:
    """One sentence where the filter was not ok in more than a twentieth of the steps; None where it was."""
    found = health_summary(steps)
    if found.ok is None or found.lost is None or found.degraded is None or found.ok >= 0.95:
        return None
    bad = steps.health_reasons[steps.health > HealthStatus.OK]
    reasons = ", ".join(name.replace("_", " ") for name in REASONS if has_reason(bad, name).any())
    shares = {"lost": found.lost, "degraded": found.degraded}
    said = " and ".join(f"{what} in {_percent(share)}" for what, share in shares.items() if share > 0.0)
    return f"the filter was {said} of its steps ({reasons})"


def _percent(share: float) -> str:
    return "less than 1 %" if share < 0.005 else f"{share:.0%}".replace("%", " %")

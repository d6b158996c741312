"""All experiments by name."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from ..errors import ConfigError
from ..sweep import Progress
from .accuracy import error_against_landmarks, error_against_particles, error_against_time
from .experiment import Claim, Experiment, Scale
from .fields import perceptual_fields
from .rover import rover
from .scaling import growth, many_landmarks

EXPERIMENTS = {
    experiment.name: experiment
    for experiment in (
        Experiment("figure4", "A rover among rocks: from raw scans to a map", rover),
        Experiment("figure5", "Maps with a large and a small perceptual field", perceptual_fields),
        Experiment("figure6a", "Error against the number of landmarks", error_against_landmarks),
        Experiment("figure6b", "Error against the number of particles", error_against_particles),
        Experiment("landmarks", "50,000 landmarks, and the number of parameters", many_landmarks),
        Experiment("growth", "Time and memory per step against K", growth),
        Experiment("error-against-time", "Error against computing time", error_against_time),
    )
}


def reproduce(
    names: Sequence[str],
    folder: Path | str,
    *,
    quick: bool = False,
    processes: int | None = None,
    progress: Callable[[str], Progress] | None = None,
) -> dict[str, list[Claim]]:
    """Runs experiments (`["all"]`: every one) and returns their claims by name.

    `progress`, given an experiment's title, returns what to call with (runs done, runs in all) of each sweep.
    Errors: `ConfigError` for a name that is none.
    """
    chosen = list(EXPERIMENTS) if list(names) == ["all"] else list(names)
    for name in chosen:
        if name not in EXPERIMENTS:
            raise ConfigError(f"{name}: no such figure; expected all or {', '.join(EXPERIMENTS)}")
    claims = {}
    for name in chosen:
        experiment = EXPERIMENTS[name]
        advance = None if progress is None else progress(experiment.title)
        kind = "quick" if quick else "full"
        scale = Scale(Path(folder) / kind, quick=quick, processes=processes, progress=advance)
        claims[name] = experiment.run(scale)
    return claims


def claims_table(claims: dict[str, list[Claim]], *, quick: bool) -> str:
    """A Markdown table: claim, the paper's figure, ours, the command."""
    lines = ["| claim | the paper | measured here | command |", "|---|---|---|---|"]
    option = " --quick" if quick else ""
    for name, found in claims.items():
        for claim in found:
            command = f"`fastslam reproduce {name}{option}`"
            lines.append(f"| {claim.statement} | {claim.paper} | {claim.ours} | {command} |")
    return "\n".join(lines) + "\n"

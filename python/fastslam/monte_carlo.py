"""Many runs with other noise in each, to see whether the reported uncertainties can be believed."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import asdict
from typing import Any

from .config import merge
from .errors import DataError
from .evaluation import Consistency, EvaluationOptions, run_consistency, summarize_consistency
from .log import Log
from .runner import run
from .settings import Layer
from .simulation import resolve_simulation, simulate


def simulated_logs(*settings: Layer, preset: str | None = None) -> Callable[[int], Log]:
    """Logs of one simulation, another seed (world, path noise and sensor noise) each."""
    return lambda seed: simulate(resolve_simulation(*settings, {"seed": seed}, preset=preset))


def monte_carlo(
    log_of: Callable[[int], Log],
    config: Layer,
    *,
    seeds: Iterable[int],
    options: EvaluationOptions | None = None,
    progress: Callable[[int], None] | None = None,
) -> Consistency:
    """Runs the filter once per seed, on the log of that seed, and scores its uncertainties.

    Where `log_of` gives the same log for every seed, the runs differ by the filter's random numbers only:
    they are not independent, and the bounds are too narrow for them. `progress` is called with the runs done.
    Errors: `DataError` where no run has a true path to be compared with, and as for `fastslam.run`.

    >>> logs = simulated_logs({"max_duration_s": 6.0})
    >>> found = monte_carlo(logs, {"filter": {"particles": 20}}, seeds=[1, 2])
    >>> found.runs, found.pose.degrees_of_freedom
    (2, 3)
    """
    runs = []
    for done, seed in enumerate(seeds, start=1):
        log = log_of(seed)
        found = run_consistency(run(log, merge(config, {"seed": seed})), log, options=options)
        if found is None:
            raise DataError("consistency needs a true path that the run covers", log.source)
        runs.append(found)
        if progress is not None:
            progress(done)
    if not runs:
        raise DataError("consistency needs at least one run")
    return summarize_consistency(runs)


def consistency_facts(found: Consistency) -> dict[str, Any]:
    """The numbers of a `Consistency` fit for JSON, without the curves."""
    facts = asdict(found)
    return {name: value for name, value in facts.items() if name not in _CURVES}


_CURVES = ("fraction", "mean_over_runs", "median_over_runs")

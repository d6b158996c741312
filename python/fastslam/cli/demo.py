"""`fastslam demo`: a simulated world, a run, a report."""

from __future__ import annotations

from typing import Annotated

import typer

from ..timing import stage
from .options import Verbose
from .output import LogReference
from .run import NoReport, Out, Results, prepare_folder, run_all, show
from .times import times_shown


def demo(
    out: Out = None,
    seed: Annotated[int, typer.Option(help="Seed of the world and of the filter.", metavar="S")] = 1,
    no_report: NoReport = False,
    verbose: Verbose = False,
) -> None:
    """Simulate a world, run the filter over its log and write a report, in a few seconds.

    \b
    Examples:
      fastslam demo
      fastslam demo --seed 7 --out my-demo
    """
    from ..datasets.native_write import write_native
    from ..runner import configure
    from ..simulation import resolve_simulation, simulate

    folder = prepare_folder(out)
    with times_shown(verbose):
        with stage("simulation"):
            log = simulate(resolve_simulation({"seed": seed}, preset="demo"), name="demo")
            path = write_native(log, folder / "log")
        results = Results(folder, LogReference(path, log.format), report=not no_report)
        show(run_all(log, configure(log, {"seed": seed}), results))

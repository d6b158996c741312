"""`fastslam sweep`: a grid of runs."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from .._entry import INTERRUPTED
from .console import make_table, progress_bar, stderr, stdout
from .errors import RUN_FAILED

if TYPE_CHECKING:
    from ..sweep import Row

_SHOWN = ("ate_rmse_m", "landmark_rmse_m", "gps_inlier_rmse_m", "filter_seconds")

Processes = Annotated[
    int | None,
    typer.Option(min=1, metavar="N", help="Processes; as many as there are processors by default."),
]
Scheduler = Annotated[
    str | None, typer.Option(metavar="ADDRESS", help="Run on the Dask cluster at tcp://HOST:PORT instead.")
]


def sweep(
    spec: Annotated[Path, typer.Argument(help="YAML file: logs, grid, seeds, config.", metavar="SPEC")],
    out: Annotated[
        Path | None, typer.Option(help="Folder for the results; results/<name of SPEC> by default.")
    ] = None,
    processes: Processes = None,
    scheduler: Scheduler = None,
    retry_failed: Annotated[bool, typer.Option(help="Run cells again that ended with an error.")] = False,
) -> None:
    """Run a grid of configurations, seeds and logs, on all processors, and write one table.

    Killed or stopped at any time, the same command goes on where it was: finished cells are kept.
    Writes cells.jsonl (as they finish), results.csv (one row per run), summary.csv (means, 95 %
    intervals), sweep.html (what was found, on one page) and one PNG per metric against the first key
    with several numbers.

    SPEC lists `logs` (`path: FOLDER`, or `simulate: PRESET` with `landmarks`, `settings`, `new_world`), a
    `grid` of configuration keys with their values, `seeds` (how many, or a list), and `config` for all runs.

    \b
    Examples:
      fastslam sweep particles.yaml
      fastslam sweep particles.yaml --processes 4 --out results/particles
      fastslam sweep particles.yaml --scheduler tcp://head:8786
    """
    from ..resultfiles import write_atomically
    from ..sweep import (
        ResultStore,
        group_rows,
        load_spec,
        summary_csv,
        sweep_cells,
        tidy_csv,
        write_sweep_page,
    )

    cells = load_spec(spec).cells()
    folder = Path("results") / spec.stem if out is None else out
    store = ResultStore(folder)
    try:
        with progress_bar(spec.stem, unit="runs") as advance:
            rows = sweep_cells(
                cells,
                store,
                processes=processes,
                scheduler=scheduler,
                retry_failed=retry_failed,
                progress=advance,
            )
    except KeyboardInterrupt:
        known = {row["key"] for row in store.rows()}
        finished = sum(cell.key in known for cell in cells)
        stderr().print(f"interrupted: {finished} of {len(cells)} runs are done; the same command goes on")
        raise typer.Exit(INTERRUPTED) from None
    write_atomically(folder / "results.csv", tidy_csv(rows))
    write_atomically(folder / "summary.csv", summary_csv(rows))
    from ..plots.sweep import write_sweep_figures  # the plotting library takes a second to load

    write_sweep_figures(group_rows(rows), folder)
    page = write_sweep_page(rows, folder, name=spec.stem)
    _show(rows, folder, page)


def _show(rows: Sequence[Row], folder: Path, page: Path) -> None:
    from ..sweep import group_rows, interval_text

    groups = group_rows(rows)
    metrics = [name for name in _SHOWN if any(name in group.summary for group in groups)]
    keys = list(groups[0].point)
    table = []
    for group in groups:
        cells = [group.log, *(str(group.point[key]) for key in keys)]
        cells += [interval_text(name, group.summary.get(name)) for name in metrics]
        table.append(
            [*cells, str(len([r for r in rows if r["log"] == group.log and r["point"] == group.point]))]
        )
    stdout().print(make_table("", ("log", *keys, *(f">{name}" for name in metrics), ">runs"), table))
    for line in (f"results: {folder}", f"page:    {page}"):
        stdout().print(line, soft_wrap=True, highlight=False, markup=False)
    failed = [row for row in rows if row["error"] is not None]
    if failed:
        print(f"{len(failed)} of {len(rows)} runs failed, the first: {failed[0]['error']}", file=sys.stderr)
        raise typer.Exit(RUN_FAILED)

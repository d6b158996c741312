"""Running the cells of a sweep: on the processors of this machine, or on a Dask cluster."""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections.abc import Callable, Generator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import closing
from typing import Any, TypeAlias

from ..errors import ConfigError, FastSlamError
from .cells import Cell, measure_cell
from .store import ResultStore

Progress: TypeAlias = Callable[[int, int], None]
"""Called with (cells done, cells in all)."""

MAX_ATTEMPTS = 3
"""A cell whose worker died this often is recorded as failed: it is likely what kills them."""
WAIT_FOR_SCHEDULER_S = 10.0
"""A scheduler that does not answer within this time is not there."""


def sweep_cells(
    cells: Sequence[Cell],
    store: ResultStore,
    *,
    processes: int | None = None,
    scheduler: str | None = None,
    retry_failed: bool = False,
    progress: Progress | None = None,
) -> list[dict[str, Any]]:
    """Runs the cells that the store does not hold yet and returns the rows of all, in the order of `cells`.

    On `processes` of this machine (default: all processors), or on the Dask cluster at `scheduler`. Each row
    is on the disk before the next is waited for; killed at any time, the same call goes on where it stopped.
    With `retry_failed` cells that ended with an error are run again. Scripts that call this need the usual
    `if __name__ == "__main__":`, since processes are started anew.

    Errors: `ConfigError` where Dask is missing or the cluster cannot be reached; `DataError` for the store.
    """
    done = _finished(store, retry_failed=retry_failed)
    pending = [cell for cell in {cell.key: cell for cell in cells}.values() if cell.key not in done]
    finished, total = len(cells) - len(pending), len(cells)
    if progress is not None:
        progress(finished, total)
    if pending:
        chosen = processes or os.cpu_count() or 1
        rows = _on_processes(pending, chosen) if scheduler is None else _on_dask(pending, scheduler)
        with store.appending() as appender, closing(rows):
            for row in rows:
                appender.add(row)
                done[row["key"]] = row
                finished += 1
                if progress is not None:
                    progress(finished, total)
    return [done[cell.key] for cell in cells]


def _finished(store: ResultStore, *, retry_failed: bool) -> dict[str, dict[str, Any]]:
    """The last row of each cell."""
    rows = {row["key"]: row for row in store.rows()}
    return {key: row for key, row in rows.items() if not (retry_failed and row.get("error"))}


def _failure(cell: Cell, reason: str) -> dict[str, Any]:
    row = {"key": cell.key, "log": cell.log_name, "point": dict(cell.point), "seed": cell.seed}
    return {**row, "metrics": {}, "error": reason, "wall_seconds": None}


def _on_processes(cells: Sequence[Cell], processes: int) -> Generator[dict[str, Any], None, None]:
    """Rows as they come. A worker that dies takes its pool along: the pool is made anew."""
    attempts = dict.fromkeys((cell.key for cell in cells), 0)
    waiting = list(cells)
    while waiting:
        pool = ProcessPoolExecutor(
            min(processes, len(waiting)),
            mp_context=multiprocessing.get_context("spawn"),
            initializer=_leave_interrupts_to_parent,
        )
        running: dict[Future[dict[str, Any]], Cell] = {}
        waiting.reverse()
        broken = False
        try:
            while (waiting and not broken) or running:
                # No more than can run soon: what is in the pool when a worker dies counts as an attempt.
                while waiting and not broken and len(running) < processes:
                    cell = waiting.pop()
                    try:
                        running[pool.submit(measure_cell, cell)] = cell
                    except BrokenProcessPool:
                        waiting.append(cell)
                        broken = True
                for future in wait(running, return_when=FIRST_COMPLETED).done:
                    cell = running.pop(future)
                    try:
                        yield future.result()
                    except BrokenProcessPool:
                        broken = True
                        attempts[cell.key] += 1
                        if attempts[cell.key] < MAX_ATTEMPTS:
                            waiting.append(cell)
                        else:
                            yield _failure(cell, f"its process died {MAX_ATTEMPTS} times")
        finally:
            # Stopped in the middle, nobody waits for the cells that run; there is no public way before 3.14.
            workers = list((pool._processes or {}).values())
            pool.shutdown(wait=False, cancel_futures=True)
            for worker in workers:
                worker.terminate()
        waiting.reverse()


def _leave_interrupts_to_parent() -> None:
    """Ctrl-C reaches every process of the terminal; only the parent answers it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def _on_dask(cells: Sequence[Cell], scheduler: str) -> Generator[dict[str, Any], None, None]:
    """Rows as they come; Dask itself runs the cells of a worker that died on another one."""
    try:
        from distributed import Client, KilledWorker, as_completed
    except ImportError:
        raise ConfigError("a scheduler needs Dask: pip install distributed") from None
    try:
        client = Client(scheduler, timeout=WAIT_FOR_SCHEDULER_S)
    except (OSError, TimeoutError, ValueError) as error:
        raise ConfigError(f"scheduler {scheduler} cannot be reached: {error}") from None
    try:
        futures = client.map(measure_cell, cells, key=[f"fastslam-{cell.key}" for cell in cells], pure=False)
        cell_of = dict(zip((future.key for future in futures), cells, strict=True))
        for future in as_completed(futures):
            try:
                row = future.result()
            except KilledWorker:
                row = _failure(cell_of[future.key], "its worker died too often")
            except OSError as error:
                raise FastSlamError(f"scheduler {scheduler} was lost: {error}") from None
            future.release()
            yield row
    finally:
        client.close()

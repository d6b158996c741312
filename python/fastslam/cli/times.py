"""What `--verbose` says: where the time of a command went."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager

from ..timing import StageTimes, measured
from .console import make_table, stderr


@contextmanager
def times_shown(wanted: bool) -> Iterator[None]:
    """Measures the stages within and shows them on stderr at the end, where `wanted`."""
    if not wanted:
        yield
        return
    begin_s = time.perf_counter()
    with measured() as times:
        try:
            yield
        finally:
            stderr().print(make_table("time", ("stage", ">wall [s]", ">CPU [s]"), _rows(times, begin_s)))


def _rows(times: StageTimes, begin_s: float) -> list[tuple[str, str, str]]:
    rows = [(name, f"{times.wall_s[name]:.2f}", f"{times.cpu_s[name]:.2f}") for name in times.wall_s]
    # The processor's clock started with the process, so start-up and loading of modules are in it.
    cpu_s = time.process_time()
    rows.append(("start-up, the rest", "", f"{cpu_s - sum(times.cpu_s.values()):.2f}"))
    rows.append(("all", f"{time.perf_counter() - begin_s:.2f}", f"{cpu_s:.2f}"))
    return rows

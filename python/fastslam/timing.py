"""Where the time of a run goes: named stages, measured only where somebody asked."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field


@dataclass
class StageTimes:
    """Wall-clock and processor seconds of each stage so far, in the order in which the stages first ended."""

    wall_s: dict[str, float] = field(default_factory=dict)
    cpu_s: dict[str, float] = field(default_factory=dict)

    def add(self, name: str, *, wall_s: float, cpu_s: float) -> None:
        """Adds to what a stage has taken."""
        self.wall_s[name] = self.wall_s.get(name, 0.0) + wall_s
        self.cpu_s[name] = self.cpu_s.get(name, 0.0) + cpu_s


_CURRENT: ContextVar[StageTimes | None] = ContextVar("fastslam_stage_times", default=None)


@contextmanager
def measured() -> Iterator[StageTimes]:
    """Collects the times of all stages within."""
    times = StageTimes()
    token = _CURRENT.set(times)
    try:
        yield times
    finally:
        _CURRENT.reset(token)


@contextmanager
def stage(name: str) -> Iterator[None]:
    """Counts what happens within to a stage; does nothing where nobody measures."""
    times = _CURRENT.get()
    if times is None:
        yield
        return
    wall_s, cpu_s = time.perf_counter(), time.process_time()
    try:
        yield
    finally:
        times.add(name, wall_s=time.perf_counter() - wall_s, cpu_s=time.process_time() - cpu_s)

"""Runs cases in a process that may die, with a watchdog over it."""

from __future__ import annotations

import contextlib
import faulthandler
import itertools
import multiprocessing
import os
import resource
import shutil
import signal
import tempfile
import traceback
import warnings
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from pathlib import Path
from random import Random

from .case import Case, Maker

LONGEST_S = 2.0
"""Computing time that a case may take; a machine that is busy with other work takes nothing away from it."""
LONGEST_WAIT_S = 120.0
"""Time in which a case that computes nothing must end."""
MOST_BYTES = 4 * 2**30
"""Address space of the process that runs the cases."""
MOST_FAULTS = 200


@dataclass(frozen=True)
class Found:
    """A fault: the case by number, what went wrong in a line, and all that is known of it."""

    number: int
    title: str
    detail: str


@dataclass
class Outcome:
    """What became of many cases."""

    cases: int = 0
    told: Counter[str] = field(default_factory=Counter)
    faults: list[Found] = field(default_factory=list)


def name_of(kind: str, seed: int, number: int) -> str:
    """What a case is called, and all that it depends on."""
    return f"{kind}:{seed}:{number}"


def make_case(make: Maker, kind: str, seed: int, number: int) -> Case:
    """The case of that name."""
    return make(Random(name_of(kind, seed, number)))


def watch(make: Maker, kind: str, *, seed: int, enough: Callable[[Outcome], bool]) -> Outcome:
    """Runs cases from number 0 on until it is enough; one that kills its process is a fault as others are."""
    outcome = Outcome()
    context = multiprocessing.get_context("fork")
    with tempfile.TemporaryDirectory(dir=_memory()) as temporary:
        while not enough(outcome) and len(outcome.faults) < MOST_FAULTS:
            ours, theirs = context.Pipe()
            begun = (make, kind, seed, outcome.cases, theirs, Path(temporary))
            process = context.Process(target=_work, args=begun, daemon=True)
            process.start()
            theirs.close()
            _gather(process, ours, outcome, enough, Path(temporary))
    return outcome


def _memory() -> str | None:
    return "/dev/shm" if os.access("/dev/shm", os.W_OK) else None


def _gather(
    process: multiprocessing.process.BaseProcess,
    ours: Connection,
    outcome: Outcome,
    enough: Callable[[Outcome], bool],
    folder: Path,
) -> None:
    """Takes in what the process tells, a case at a time, until it ends or it is enough."""
    try:
        while not enough(outcome) and len(outcome.faults) < MOST_FAULTS:
            if not ours.poll(LONGEST_WAIT_S):
                outcome.faults.append(Found(outcome.cases, "waits for ever", _said(folder)))
                outcome.cases += 1
                return
            told, fault = ours.recv()
            outcome.told.update(told)
            outcome.faults += [] if fault is None else [fault]
            outcome.cases += 1
    except (EOFError, ConnectionResetError):
        process.join()
        outcome.faults.append(Found(outcome.cases, _death(process.exitcode or 0), _said(folder)))
        outcome.cases += 1
    finally:
        process.kill()
        process.join()
        ours.close()


def _death(code: int) -> str:
    if code == -signal.SIGPROF:
        return f"computes for more than {LONGEST_S} s"
    return f"the process ends with {signal.Signals(-code).name if code < 0 else f'exit code {code}'}"


def _said(folder: Path) -> str:
    return (folder / "said.txt").read_text(errors="replace")[-6000:]


def _work(make: Maker, kind: str, seed: int, first: int, theirs: Connection, folder: Path) -> None:
    """The other process: cases from `first` on, for ever."""
    said = open(folder / "said.txt", "w+")  # noqa: SIM115 - open to the end of the process
    os.dup2(said.fileno(), 1)
    os.dup2(said.fileno(), 2)
    _limited()
    faulthandler.enable(said)
    faulthandler.register(signal.SIGPROF, said, chain=True)
    warnings.simplefilter("ignore")
    for number in itertools.count(first):
        told: Counter[str] = Counter()
        said.seek(0)
        said.truncate()
        with _clock():
            fault = _tried(make, kind, seed, number, told, folder)
        theirs.send((told, fault))


def _limited() -> None:
    with contextlib.suppress(ValueError, OSError):
        resource.setrlimit(resource.RLIMIT_AS, (MOST_BYTES, MOST_BYTES))
    with contextlib.suppress(ValueError, OSError):
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


@contextlib.contextmanager
def _clock() -> Iterator[None]:
    """The process is ended by SIGPROF, after a traceback, once it has computed for too long."""
    signal.setitimer(signal.ITIMER_PROF, LONGEST_S)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)


def _tried(make: Maker, kind: str, seed: int, number: int, told: Counter[str], folder: Path) -> Found | None:
    try:
        told.update(make_case(make, kind, seed, number).exercise(folder))
    except KeyboardInterrupt:
        raise
    except BaseException as error:  # A panic of the core is no Exception.
        last = traceback.extract_tb(error.__traceback__)[-1]
        says = " ".join(str(error).split())[:200]
        title = f"{type(error).__name__} at {Path(last.filename).name}:{last.lineno}: {says}"
        return Found(number, title, traceback.format_exc())
    return None


def save(found: Found, kind: str, seed: int, case: Case, folder: Path) -> Path:
    """Writes a fault with the files of its case and the command that runs it again."""
    target = folder / name_of(kind, seed, found.number).replace(":", "-")
    shutil.rmtree(target, ignore_errors=True)
    target.mkdir(parents=True)
    for name, data in case.files().items():
        path = target / "input" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(data)
    again = f"python -m tests.fuzz --replay {name_of(kind, seed, found.number)}"
    text = f"{found.title}\n\nagain: {again}\n\n{found.detail}\n"
    (target / "fault.txt").write_text(text, encoding="utf-8", errors="backslashreplace")
    return target

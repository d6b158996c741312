"""A short pass of the fuzz cases (`python -m tests.fuzz` runs for longer), and that faults would be found."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from random import Random

import numpy as np
import pytest
from conftest import ROOT
from fuzz.case import check_finite
from fuzz.kinds import KINDS, SHARES
from fuzz.watch import make_case, save, watch

SHORT = {"logs": 384, "configs": 1000, "calls": 4000}
"""Mutated inputs that every run of the tests tries."""
SEEN = {
    "logs": ("logs read", "logs refused", "logs run", "logs examined", "logs converted", "commands"),
    "configs": ("settings taken", "settings refused", "filters run", "worlds made"),
    "calls": ("call taken", "call refused", "log run", "log refused"),
}
"""What must happen in a short pass; a pass that only sees refusals tests nothing."""

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="needs fork and process timers")


@pytest.mark.slow(but="configs")
@pytest.mark.parametrize("kind", KINDS)
def test_short_pass(kind: str) -> None:
    outcome = watch(KINDS[kind], kind, seed=0, enough=lambda done: done.told["mutated"] >= SHORT[kind])
    assert outcome.faults == [], [found.title for found in outcome.faults]
    assert outcome.told["mutated"] >= SHORT[kind]
    assert all(outcome.told[name] >= 3 for name in SEEN[kind]), outcome.told


def test_a_name_makes_the_same_case_again() -> None:
    assert set(KINDS) == set(SHARES) == set(SHORT)
    for kind, maker in KINDS.items():
        whole = [make_case(maker, kind, 5, number).files() for number in range(20)]
        again = [make_case(maker, kind, 5, number).files() for number in range(20)]
        assert len({repr(files) for files in whole}) > 15
        # Objects without a value of their own show where they lie in memory.
        assert [[*files] for files in whole] == [[*files] for files in again]


@dataclass(frozen=True)
class Planted:
    """A case that goes wrong in a way of its own."""

    what: int

    def files(self) -> dict[str, bytes]:
        return {"what.txt": str(self.what).encode()}

    def exercise(self, folder: Path) -> Counter[str]:
        if self.what == 0:
            os.abort()
        if self.what == 1:
            while True:
                pass
        if self.what == 2:
            time.sleep(60)
        if self.what == 3:
            check_finite("result", np.array([1.0, np.nan]))
        if self.what == 4:
            raise KeyError("what a user would see as a traceback")
        if self.what == 5:
            np.zeros(2**40)
        return Counter({"mutated": 1})


PLANTED = {
    17: (0, "the process ends with SIGABRT"),
    41: (1, "computes for more than 2.0 s"),
    70: (3, "FaultError at case.py:"),
    71: (4, "KeyError at test_fuzz.py:"),
    150: (5, "MemoryError at test_fuzz.py:"),
}


def test_what_is_planted_is_found(tmp_path: Path) -> None:
    def plant(rng: Random) -> Planted:
        # The case is told from its number by the state of its generator.
        return Planted(PLANTED[number][0] if (number := number_of[rng.random()]) in PLANTED else 99)

    number_of = {Random(f"planted:3:{number}").random(): number for number in range(400)}
    outcome = watch(plant, "planted", seed=3, enough=lambda done: done.cases >= 200)
    found = {fault.number: fault.title for fault in outcome.faults}
    assert sorted(found) == sorted(PLANTED), found
    for number, (_, title) in PLANTED.items():
        assert found[number].startswith(title), found
    assert outcome.cases == 200
    assert outcome.told["mutated"] == outcome.cases - len(PLANTED)
    saved = save(outcome.faults[0], "planted", 3, Planted(0), tmp_path)
    assert (saved / "input" / "what.txt").read_text() == "0"
    assert "python -m tests.fuzz --replay planted:3:17" in (saved / "fault.txt").read_text()


def test_a_case_that_waits_for_ever_is_ended(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("fuzz.watch.LONGEST_WAIT_S", 5.0)
    outcome = watch(lambda _: Planted(2), "planted", seed=3, enough=lambda done: done.cases >= 1)
    assert [(fault.number, fault.title) for fault in outcome.faults] == [(0, "waits for ever")]


@pytest.mark.slow
def test_the_program_prints_counts_and_replays(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "tests.fuzz"]
    run = [*command, "--count", "300", "--only", "calls", "--out", str(tmp_path)]
    done = subprocess.run(run, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "0 faults" in done.stdout and "mutated" in done.stdout
    again = subprocess.run(
        [*command, "--replay", "calls:0:3"], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert again.returncode == 0 and "mutated" in again.stdout, again.stderr

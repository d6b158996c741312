"""Runs the fuzz cases, or one of them again."""

from __future__ import annotations

import argparse
import contextlib
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from .kinds import KINDS, SHARES
from .watch import Outcome, make_case, name_of, save, watch


def main() -> int:
    """The program; 1 where a fault was found."""
    options = _options()
    if options.replay:
        return _replay(options.replay)
    kinds = [options.only] if options.only else list(KINDS)
    whole = sum(SHARES[kind] for kind in kinds)
    faults = 0
    for kind in kinds:
        wanted = max(1, round(options.count * SHARES[kind] / whole))
        faults += _run(kind, options.seed, wanted, options.out)
    return 1 if faults else 0


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz", description=__doc__)
    parser.add_argument("--count", type=int, default=10_000, help="mutated inputs to try in all")
    parser.add_argument("--seed", type=int, default=0, help="another seed, other inputs")
    parser.add_argument("--only", choices=sorted(KINDS), help="one kind of input")
    parser.add_argument("--out", type=Path, default=Path("fuzz-faults"), help="folder for inputs that fail")
    parser.add_argument("--replay", metavar="KIND:SEED:NUMBER", help="one case again, in this process")
    return parser.parse_args()


def _run(kind: str, seed: int, wanted: int, out: Path) -> int:
    """Tries a kind; prints the counts and the first faults of each sort, and saves the inputs of all."""
    started = time.monotonic()
    done = Outcome()
    shown: Counter[str] = Counter()

    def enough(outcome: Outcome) -> bool:
        nonlocal done
        done = outcome
        for found in outcome.faults[shown.total() :]:
            target = save(found, kind, seed, make_case(KINDS[kind], kind, seed, found.number), out)
            sort = found.title.partition(": ")[0]
            shown[sort] += 1
            if shown[sort] <= 3:
                print(f"  {name_of(kind, seed, found.number)}: {found.title} ({target})", flush=True)
        return outcome.told["mutated"] + len(outcome.faults) >= wanted

    with contextlib.suppress(KeyboardInterrupt):
        watch(KINDS[kind], kind, seed=seed, enough=enough)
    enough(done)
    seconds = time.monotonic() - started
    told = ", ".join(f"{count:,} {name}" for name, count in sorted(done.told.items()))
    print(f"{kind}: {done.cases:,} cases in {seconds:.0f} s: {told}; {len(done.faults)} faults", flush=True)
    for sort, count in shown.most_common():
        print(f"  {count} x {sort}", flush=True)
    return len(done.faults)


def _replay(name: str) -> int:
    kind, seed, number = name.split(":")
    case = make_case(KINDS[kind], kind, int(seed), int(number))
    with tempfile.TemporaryDirectory() as folder:
        print(dict(case.exercise(Path(folder))))
    return 0


if __name__ == "__main__":
    sys.exit(main())

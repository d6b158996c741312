"""Which of the faults of tests/log_faults.py `fastslam info` names, on logs of several kinds.

    FASTSLAM_DATA=... python scripts/examination_rates.py

Prints the table of docs/examination.md: of so many logs with the fault, how many were told so, and of how
many something else was said, which shows that they are not sound.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from fastslam.datasets import load
from fastslam.examination import examine
from fastslam.log import Log
from fastslam.simulation import presets, simulate

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "tests"))
from log_faults import FAULTS  # noqa: E402 (the tests are no package)

SEEDS = (1, 2, 3)
GROUPS = ("simulated, names", "simulated, no names", "MR.CLAM", "Lost in the Woods", "Victoria Park")


def logs(data: Path) -> Iterator[tuple[str, Log]]:
    """Sound logs by group."""
    for preset in ("demo", "cones"):
        for seed in SEEDS:
            log = simulate({**presets()[preset], "seed": seed})
            if (log.sightings.identity >= 0).any():
                yield "simulated, names", log
                nobody = np.full(len(log.sightings.stamp_s), -1)
                log = replace(log, sightings=replace(log.sightings, identity=nobody), identity_names=())
            yield "simulated, no names", log
    for number in (1, 2, 6):
        for robot in range(1, 6):
            yield "MR.CLAM", load(data / "utias_mrclam" / f"MRCLAM_Dataset{number}", robot=robot)
    yield "Lost in the Woods", load(data / "lost_in_the_woods")
    yield "Victoria Park", load(data / "victoria_park")


def main() -> None:
    """Prints the table."""
    told: dict[tuple[str, str], list[str]] = {}
    for group, log in logs(Path(os.environ.get("FASTSLAM_DATA", ROOT.parent / "shared" / "data"))):
        told.setdefault(("(none)", group), []).append("found" if examine(log) else "")
        for name, fault in FAULTS.items():
            if log.config["motion"]["model"] in fault.models:
                codes = {finding.code for finding in examine(fault.put(log))}
                found = "found" if codes & set(fault.codes) else "otherwise" if codes else ""
                told.setdefault((name, group), []).append(found)
                if found != "found":
                    print(f"{name}, {group}, {log.name}: {sorted(codes)}", file=sys.stderr, flush=True)
    print("| fault | " + " | ".join(GROUPS) + " |")
    print("|---|" + "---|" * len(GROUPS))
    for name in ("(none)", *FAULTS):
        if not any((name, group) in told for group in GROUPS):
            continue  # A fault of an odometry that none of these logs has.
        print(f"| {name} | " + " | ".join(_cell(told.get((name, group), [])) for group in GROUPS) + " |")


def _cell(told: list[str]) -> str:
    """How many were found, and of how many of the others something was said."""
    otherwise = told.count("otherwise")
    more = f" (+{otherwise})" if otherwise else ""
    return f"{told.count('found')} of {len(told)}{more}" if told else ""


if __name__ == "__main__":
    main()

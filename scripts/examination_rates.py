"""Which of the faults of tests/log_faults.py `fastslam info` names, on logs of several kinds.

    FASTSLAM_DATA=... python scripts/examination_rates.py

Prints the table of docs/examination.md: of so many logs with the fault, how many were told so.
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

SEEDS = (1, 2)
GROUPS = ("simulated, names", "simulated, no names", "MR.CLAM", "Lost in the Woods")


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
    for number, robot in ((1, 2), (6, 2)):
        yield "MR.CLAM", load(data / "utias_mrclam" / f"MRCLAM_Dataset{number}", robot=robot)
    yield "Lost in the Woods", load(data / "lost_in_the_woods")


def main() -> None:
    """Prints the table."""
    told: dict[tuple[str, str], list[bool]] = {}
    for group, log in logs(Path(os.environ.get("FASTSLAM_DATA", ROOT.parent / "shared" / "data"))):
        told.setdefault(("(none)", group), []).append(bool(examine(log)))
        for name, fault in FAULTS.items():
            if log.config["motion"]["model"] in fault.models:
                codes = {finding.code for finding in examine(fault.put(log))}
                told.setdefault((name, group), []).append(bool(codes & set(fault.codes)))
                if not codes & set(fault.codes):
                    print(
                        f"missed: {name}, {group}, {log.name}: {sorted(codes)}", file=sys.stderr, flush=True
                    )
    print("| fault | " + " | ".join(GROUPS) + " |")
    print("|---|" + "---|" * len(GROUPS))
    for name in ("(none)", *FAULTS):
        cells = [told.get((name, group)) for group in GROUPS]
        shown = ["" if cell is None else f"{sum(cell)} of {len(cell)}" for cell in cells]
        print(f"| {name} | " + " | ".join(shown) + " |")


if __name__ == "__main__":
    main()

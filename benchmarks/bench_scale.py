"""Measures how the cost of a filter grows with landmarks, particles and stores, and writes a dated report.

    python benchmarks/bench_scale.py [--quick] [--out benchmarks/reports]

The full sweep takes about a quarter of an hour and 3 GB of memory; `--quick` takes about a minute and writes
its report to `results/benchmarks`. Least values and ratios within one run are what to compare: on a shared
machine other processes lengthen the median and the 99th percentile.
"""

from __future__ import annotations

import argparse
import os
from datetime import datetime, timezone
from pathlib import Path

from scale_cases import (
    algorithm_cases,
    headline_cases,
    many_particles_cases,
    measure_all,
    particle_cases,
    ratio_cases,
    store_cases,
)
from scale_report import Sweep, write_report


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--quick", action="store_true", help="small worlds: does it still work?")
    parser.add_argument("--out", type=Path, help="folder of the report")
    arguments = parser.parse_args()
    quick = arguments.quick
    folder = arguments.out or Path("results/benchmarks" if quick else "benchmarks/reports")
    started, load = datetime.now(timezone.utc), os.getloadavg()[0]
    ratio = measure_all(ratio_cases(quick=quick), label="ratio")
    sweep = Sweep(
        started=started,
        load=load,
        quick=quick,
        ratio=ratio,
        headline=measure_all(headline_cases(quick=quick), label="headline"),
        algorithms=measure_all(algorithm_cases(quick=quick), label="1.0 and 2.0"),
        many_particles=measure_all(many_particles_cases(quick=quick), label="many particles"),
        by_landmarks=[*measure_all(store_cases(quick=quick), label="landmarks"), ratio[1]],
        by_particles=measure_all(particle_cases(quick=quick), label="particles"),
    )
    print(f"report: {write_report(sweep, folder)}")


if __name__ == "__main__":
    main()

"""The cases of the scale benchmark: a simulated world, a filter, and what a run of it costs."""

from __future__ import annotations

import multiprocessing
import time
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field, replace
from typing import Any

import fastslam
import numpy as np
from fastslam.evaluation import EvaluationOptions, evaluate
from fastslam.log import Log
from fastslam.simulation import resolve_simulation, simulate

SECONDS_PER_LANDMARK = 0.76
"""The first sweep over a world at the headline's density (0.05 landmarks per m², 2 m/s) takes 0.73 s each."""


REJUVENATION: Mapping[str, Mapping[str, float]] = {
    "known": {"every_steps": 500, "growth": 0.0, "spread": 0.3, "window_steps": 2000},
    "unknown": {"every_steps": 200, "growth": 0.0, "spread": 0.5, "window_steps": 2500},
}
"""How the headline runs draw their paths anew, by association (`docs/rejuvenation.md`)."""

SCORES = ("landmark_rmse_m", "landmark_matched", "ate_rmse_m", "smoothed_ate_rmse_m")
"""Metrics of a scored run that the report shows."""

FEWEST_STEPS = 8
"""Steps with the same number of sightings that are worth a least and a median."""


@dataclass(frozen=True)
class Case:
    """One configuration. `extra_s` is how long the robot goes on once it has seen the whole world."""

    landmarks: int
    particles: int
    store: str = "lineage"
    association: str = "known"
    algorithm: str = "fastslam1"
    extra_s: float = 2000.0
    max_range_m: float = 10.0
    threads: int = 1
    rejuvenated: bool = False
    """Whether paths are drawn anew, with the settings of `REJUVENATION`."""
    scored: bool = False
    """Whether the map is compared with the truth."""
    seed: int = 1


@dataclass(frozen=True)
class Measurement:
    """What a run of a case cost. Times are those of steps at the end that saw known landmarks only."""

    case: Case
    step_us: tuple[float, float, float]
    """Least, median and 99th percentile of a step."""
    ns_per_particle_sighting: tuple[float, float, float]
    """The same of the step's time over particles and sightings."""
    sightings_per_step: float
    step_us_of_count: dict[int, tuple[float, float]]
    """Least and median step among those with the same number of sightings, where there are enough."""
    steady_steps: int
    sightings: int
    filter_seconds: float
    """All steps of the run, the mapping of the world included."""
    simulation_seconds: float
    rejuvenations: int
    map_rows: int
    map_bytes: int
    peak_memory_bytes: int
    metrics: dict[str, Any] = field(default_factory=dict)


def make_log(case: Case) -> Log:
    """The world of the case at the density of the headline, swept lane by lane."""
    duration_s = SECONDS_PER_LANDMARK * case.landmarks + case.extra_s
    sweeps = 2 + int(case.extra_s / (0.5 * SECONDS_PER_LANDMARK * case.landmarks))
    changes: dict[str, Any] = {
        "max_duration_s": duration_s,
        "seed": case.seed,
        "trajectory": {"sweeps": sweeps},
    }
    changes["sensor"] = {"max_range_m": case.max_range_m}
    if case.max_range_m != 10.0:
        # The lanes stay those of the 10 m sensor, so that the world is mapped in the same time.
        changes["trajectory"]["lane_spacing_m"] = 12.0
    return simulate(resolve_simulation(changes, preset="headline", landmarks=case.landmarks))


def configuration(case: Case) -> dict[str, Any]:
    """What the filter of a case is told."""
    settings: dict[str, Any] = {
        "particles": case.particles,
        "store": case.store,
        "threads": case.threads,
    }
    if case.rejuvenated:
        settings["rejuvenation"] = dict(REJUVENATION[case.association])
    return {
        "algorithm": case.algorithm,
        "seed": case.seed,
        "association": {"mode": case.association},
        "filter": settings,
    }


def measure(case: Case) -> Measurement:
    """Simulates and runs one case in this process."""
    start = time.perf_counter()
    log = make_log(case)
    simulation_seconds = time.perf_counter() - start
    result = fastslam.run(log, configuration(case))
    steps = result.steps
    known = (steps.new_landmarks == 0) & (steps.sightings >= 4)
    steady = known & (steps.stamp_s > steps.stamp_s[-1] - case.extra_s)
    if steady.sum() < 20:
        raise RuntimeError(f"{case}: only {steady.sum()} steps that saw known landmarks only")
    latency_us = steps.latency_us[steady]
    each_ns = 1e3 * latency_us / (case.particles * steps.sightings[steady])
    options = EvaluationOptions()
    metrics = evaluate(result, log, options=options) if case.scored else {}
    return Measurement(
        case=case,
        step_us=_summary(latency_us),
        ns_per_particle_sighting=_summary(each_ns),
        sightings_per_step=float(steps.sightings[steady].mean()),
        step_us_of_count=_by_count(latency_us, steps.sightings[steady]),
        steady_steps=int(steady.sum()),
        sightings=len(log.sightings.stamp_s),
        filter_seconds=result.filter_seconds,
        simulation_seconds=simulation_seconds,
        rejuvenations=int(steps.rejuvenated.sum()),
        map_rows=result.map_rows,
        map_bytes=result.map_bytes,
        peak_memory_bytes=result.peak_memory_bytes,
        metrics={name: metrics[name] for name in SCORES if name in metrics},
    )


def _summary(values: np.ndarray) -> tuple[float, float, float]:
    return float(values.min()), float(np.median(values)), float(np.quantile(values, 0.99))


def _by_count(latency_us: np.ndarray, sightings: np.ndarray) -> dict[int, tuple[float, float]]:
    chosen = {int(n): latency_us[sightings == n] for n in np.unique(sightings)}
    return {
        n: (float(times.min()), float(np.median(times)))
        for n, times in chosen.items()
        if len(times) >= FEWEST_STEPS
    }


def matched_ratio(large: Measurement, small: Sequence[Measurement]) -> tuple[float, float]:
    """How many times as long a whole step takes, least and median, among steps with equally many sightings.

    **Why:** a small world is seen from its edge more often, so its mean step has fewer sightings. Ratios are
    averaged over the numbers of sightings that all cases have.
    """
    tables = [one.step_us_of_count for one in small]
    counts = sorted(set(large.step_us_of_count).intersection(*tables))
    if not counts:
        raise RuntimeError(f"{large.case} and {small[0].case} have no number of sightings in common")
    least = [large.step_us_of_count[n][0] / min(table[n][0] for table in tables) for n in counts]
    median = [large.step_us_of_count[n][1] / np.mean([table[n][1] for table in tables]) for n in counts]
    return float(np.mean(least)), float(np.mean(median))


def measure_all(cases: Sequence[Case], *, label: str) -> list[Measurement]:
    """Measures the cases one after the other, each in a process of its own: its peak memory is its own."""
    done = []
    for number, case in enumerate(cases, start=1):
        context = multiprocessing.get_context("spawn")
        with ProcessPoolExecutor(max_workers=1, mp_context=context) as pool:
            done.append(pool.submit(measure, case).result())
        one = done[-1]
        print(
            f"[{label} {number}/{len(cases)}] {case.algorithm} {case.association} {case.store:>7}"
            f" K={case.landmarks} M={case.particles} x{case.threads}: {one.ns_per_particle_sighting[0]:.1f} /"
            f" {one.ns_per_particle_sighting[1]:.1f} ns per particle-sighting (least / median),"
            f" {one.filter_seconds:.2f} s",
            flush=True,
        )
    return done


def store_cases(*, quick: bool) -> list[Case]:
    """Maps of all sizes in every store, M = 250; the largest of lineage is that of `ratio_cases`.

    **Why:** a dense map is copied whole at every resampling, so that it ends early.
    """
    sizes = {
        "lineage": [100, 1000] if quick else [100, 1000, 10_000, 100_000],
        "tree": [100, 1000] if quick else [100, 1000, 10_000, 30_000],
        "dense": [100, 300] if quick else [100, 1000, 2000],
    }
    extra_s = 300.0 if quick else 2000.0
    # Rising together, so that the sizes whose ratio counts lie as close in time as their order allows.
    cases = [Case(k, 250, store, extra_s=extra_s) for store, ks in sizes.items() for k in ks]
    return sorted(cases, key=lambda case: case.landmarks)


def particle_cases(*, quick: bool) -> list[Case]:
    """Populations of all sizes in every store, in a world of 300 landmarks."""
    sizes = {
        "lineage": [10, 100, 1000] if quick else [10, 100, 1000, 10_000, 100_000],
        "tree": [10, 100] if quick else [10, 100, 1000, 10_000],
        "dense": [10] if quick else [10, 100, 1000],
    }
    return [Case(300, m, store, extra_s=200.0) for store, ms in sizes.items() for m in ms]


def ratio_cases(*, quick: bool) -> list[Case]:
    """The small map before and after the large one, so that a change of the machine's load shows."""
    small, large = (300, 5000) if quick else (1000, 1_000_000)
    return [Case(k, 250, extra_s=300.0 if quick else 2000.0) for k in (small, large, small)]


def algorithm_cases(*, quick: bool) -> list[Case]:
    """FastSLAM 2.0 between two runs of 1.0, for two numbers of particles."""
    particles = [250] if quick else [250, 1000]
    order = ("fastslam1", "fastslam2", "fastslam1")
    extra_s = 300.0 if quick else 2000.0
    return [
        Case(300 if quick else 1000, m, algorithm=name, extra_s=extra_s) for m in particles for name in order
    ]


def many_particles_cases(*, quick: bool) -> list[Case]:
    """100,000 particles and a sensor that sees eight landmarks on average, with one thread and with two."""
    particles, extra_s = (20_000, 50.0) if quick else (100_000, 150.0)
    return [
        Case(100, particles, algorithm=name, extra_s=extra_s, max_range_m=7.1, threads=threads)
        for name in ("fastslam1", "fastslam2")
        for threads in (1, 2)
    ]


def headline_cases(*, quick: bool) -> list[Case]:
    """The paper's run: both algorithms, with and without identities; with paths drawn anew; the tree."""
    landmarks, extra_s = (1000, 100.0) if quick else (50_000, 500.0)
    runs = [
        Case(landmarks, 250, association=association, algorithm=algorithm, extra_s=extra_s, scored=True)
        for algorithm in ("fastslam1", "fastslam2")
        for association in ("known", "unknown")
    ]
    anew = [
        replace(runs[0], algorithm=algorithm, association=association, rejuvenated=True)
        for algorithm, association in (
            ("fastslam1", "known"),
            ("fastslam2", "known"),
            ("fastslam2", "unknown"),
        )
    ]
    return [*runs, *anew, Case(landmarks, 250, "tree", extra_s=extra_s)]

"""The report of the scale benchmark: tables, two figures, and where it was measured."""

from __future__ import annotations

import os
import platform
import subprocess
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import fastslam
import matplotlib.pyplot as plt
from matplotlib.axes import Axes
from scale_cases import Measurement, matched_ratio

STORES = {"lineage": "C0", "tree": "C1", "dense": "C2"}
VECTORS = {"avx512f": "AVX-512", "avx2": "AVX2"}
"""Flag of the processor and name, the widest first."""


@dataclass(frozen=True)
class Sweep:
    """All measurements of one call."""

    started: datetime
    load: float
    """Processes that wanted to run when it started."""
    quick: bool
    ratio: Sequence[Measurement]
    headline: Sequence[Measurement]
    algorithms: Sequence[Measurement]
    many_particles: Sequence[Measurement]
    by_landmarks: Sequence[Measurement]
    by_particles: Sequence[Measurement]


def write_report(sweep: Sweep, folder: Path) -> Path:
    """Draws the figures and writes the report beside them; returns its path."""
    folder.mkdir(parents=True, exist_ok=True)
    stem = f"scale-{sweep.started:%Y-%m-%d}{'-quick' if sweep.quick else ''}"
    # The head first: it names the commit, which a new picture would make a changed one.
    parts = [_head(sweep), f"![step time and memory]({stem}.png)", _targets(sweep)]
    draw(sweep, folder / f"{stem}.png")
    parts += ["## Headline run", _headline_table(sweep.headline)]
    parts += [
        "## Many particles, one thread and two",
        _table(sweep.many_particles),
        "## Landmarks",
        _table(sweep.by_landmarks),
        "## Particles",
        _table(sweep.by_particles),
        NOT_MEASURED,
    ]
    path = folder / f"{stem}.md"
    path.write_text("\n\n".join(parts) + "\n", encoding="utf-8")
    return path


def draw(sweep: Sweep, path: Path) -> None:
    """Log-log plots of step time and of memory over landmarks (upper row) and particles (lower row)."""
    figure, axes = plt.subplots(2, 2, figsize=(10, 7), layout="constrained")
    rows = (
        (axes[0], sweep.by_landmarks, "landmarks (250 particles)", lambda m: m.case.landmarks),
        (axes[1], sweep.by_particles, "particles", lambda m: m.case.particles),
    )
    for (left, right), measurements, label, of in rows:
        _lines(left, measurements, of, lambda m: m.step_us[1])
        _lines(right, measurements, of, lambda m: m.map_bytes / 1e6)
        left.set(ylabel="median time of a step [µs]", xlabel=label)
        right.set(ylabel="map at the end [MB]", xlabel=label)
    axes[0, 0].legend()
    figure.savefig(path, dpi=110)
    plt.close(figure)


def _lines(
    axes: Axes,
    measurements: Sequence[Measurement],
    x: Callable[[Measurement], float],
    y: Callable[[Measurement], float],
) -> None:
    for store, colour in STORES.items():
        points = [(x(m), y(m)) for m in measurements if m.case.store == store]
        axes.loglog(*zip(*points, strict=True), "o-", color=colour, label=store)
    axes.grid(True, which="major", alpha=0.3)


def _head(sweep: Sweep) -> str:
    load = sweep.load
    return f"""# Scale, {sweep.started:%Y-%m-%d %H:%M} UTC

fastslam {fastslam.__version__}, commit {commit()}; {processor()}, {platform.system()}, Python
{platform.python_version()}; load {load:.1f} at the start. Command:
`python benchmarks/bench_scale.py{" --quick" if sweep.quick else ""}`.

Worlds of the `headline` preset (0.05 landmarks per square metre, sensor range 10 m, about 15 sightings a
scan), simulated, mapped lane by lane, then driven on; times are those of the steps at the end that saw known
landmarks only, motion, weights, resampling and path included, on one thread unless it says otherwise. Every
case ran once in a process of its own, those of a ratio directly after one another. The **least** step is the
figure to compare, except for `dense`, whose least step is one that copies nothing; median and 99th percentile
also hold what other processes took."""


def _targets(sweep: Sweep) -> str:
    small, large, again = sweep.ratio
    plain = [m for m in sweep.headline if not m.case.rejuvenated]
    known = {m.case.algorithm: m for m in plain if m.case.association == "known" and not _is_tree(m)}
    tree = next(m for m in sweep.headline if _is_tree(m))
    one = known["fastslam1"]
    rows = [
        (
            f"whole step at K = {large.case.landmarks:,} over that at K = {small.case.landmarks:,}, "
            "equally many sightings",
            _growth(large, [small, again]),
            "≤ 1.3",
        ),
        *_store_rows(sweep.by_landmarks),
        ("ns per particle and sighting, whole step, 1.0", _pair(one), "≤ 30"),
        ("ns per particle and sighting, whole step, 2.0", _pair(known["fastslam2"]), ""),
        *_algorithm_rows(sweep.algorithms),
        *_unknown_rows([m for m in sweep.headline if not _is_tree(m)]),
        *_thread_rows(sweep.many_particles, quick=sweep.quick),
        (
            "rows of lineage over those of tree after the headline run",
            f"{one.map_rows:,} / {tree.map_rows:,} = {one.map_rows / tree.map_rows:.2f};"
            f" {one.map_bytes / 1e6:.1f} MB against {tree.map_bytes / 1e6:.1f} MB",
            "≤ 1.2, ≤ 25 MB",
        ),
        ("99th percentile over median of a step, 1.0", f"{one.step_us[2] / one.step_us[1]:.1f}", "≤ 3"),
    ]
    return "## Against the targets\n\n" + markdown(("what", "measured", "wanted"), rows)


def _algorithm_rows(measurements: Sequence[Measurement]) -> Iterable[tuple[str, str, str]]:
    """What FastSLAM 2.0 costs beside 1.0, between two runs of which it ran."""
    for first in range(0, len(measurements), 3):
        before, second, after = measurements[first : first + 3]
        what = f"whole step of 2.0 over that of 1.0, M = {second.case.particles:,}, equally many sightings"
        yield what, _growth(second, [before, after]), "≤ 2"


def _unknown_rows(headline: Sequence[Measurement]) -> Iterable[tuple[str, str, str]]:
    """What it costs not to know identities, in the maps as they are at the end of the headline runs."""
    for unknown in (m for m in headline if m.case.association == "unknown"):
        (known,) = (m for m in headline if m.case == replace(unknown.case, association="known"))
        pairs = zip(unknown.ns_per_particle_sighting[:2], known.ns_per_particle_sighting[:2], strict=True)
        least, median = (dear / cheap for dear, cheap in pairs)
        whole = unknown.filter_seconds / known.filter_seconds
        how = ", paths drawn anew" if unknown.case.rejuvenated else ""
        # Paths are drawn anew more often without identities, so that whole runs do not compare.
        run = "" if unknown.case.rejuvenated else f", {whole:.1f} (whole run)"
        yield (
            f"unknown over known association, {unknown.case.algorithm}{how}",
            f"{least:.1f} (least), {median:.1f} (median){run}",
            "≤ 3",
        )


def _thread_rows(measurements: Sequence[Measurement], *, quick: bool) -> Iterable[tuple[str, str, str]]:
    for one in measurements:
        case = one.case
        least, median, _ = one.step_us
        threads = "one thread" if case.threads == 1 else f"{case.threads} threads"
        load = f"{case.particles:,} particles, {one.sightings_per_step:.1f} sightings a step"
        yield (
            f"{case.algorithm}, {load}, {threads}",
            f"{1e6 / least:.0f} steps per second (least time), {1e6 / median:.0f} (median)",
            "≥ 40" if case.threads == 2 and not quick else "",
        )


def _growth(large: Measurement, small: Sequence[Measurement]) -> str:
    least, median = matched_ratio(large, small)
    return f"{least:.2f} (least), {median:.2f} (median)"


def _store_rows(measurements: Sequence[Measurement]) -> Iterable[tuple[str, str, str]]:
    """The same growth for the other stores, from their smallest map of a thousand or so to their largest."""
    for store in ("tree", "dense"):
        own = [m for m in measurements if m.case.store == store]
        small, large = own[0 if len(own) < 3 else 1], own[-1]
        sizes = f"K = {large.case.landmarks:,} over K = {small.case.landmarks:,}"
        yield f"the same of {store}, {sizes}", _growth(large, [small]), ""


def _is_tree(measurement: Measurement) -> bool:
    return measurement.case.store == "tree"


def _pair(measurement: Measurement) -> str:
    least, median, _ = measurement.ns_per_particle_sighting
    return f"{least:.1f} (least), {median:.1f} (median)"


def _headline_table(measurements: Iterable[Measurement]) -> str:
    rows = []
    for m in measurements:
        case, scored = m.case, m.metrics
        metres = [
            f"{scored[name]:.2f}" if scored.get(name) is not None else ""
            for name in ("landmark_rmse_m", "ate_rmse_m", "smoothed_ate_rmse_m")
        ]
        anew = f", paths drawn anew {m.rejuvenations} times" if case.rejuvenated else ""
        rows.append(
            (
                f"{case.algorithm}, {case.association}, {case.store}{anew}",
                *metres,
                f"{scored['landmark_matched']:,} of {case.landmarks:,}" if scored else "",
                f"{m.filter_seconds:.1f}",
                f"{m.simulation_seconds:.1f}",
                f"{m.map_rows:,}",
                f"{m.map_bytes / 1e6:.1f}",
                f"{m.peak_memory_bytes / 1e6:.0f}",
            )
        )
    head = ("run", "map RMSE [m]", "path RMSE, live [m]", "path RMSE, smoothed [m]", "found", "filter [s]")
    return markdown((*head, "simulation [s]", "rows", "map [MB]", "peak process [MB]"), rows)


def _table(measurements: Iterable[Measurement]) -> str:
    rows = [
        (
            m.case.store,
            f"{m.case.algorithm[-1]}.0",
            m.case.threads,
            f"{m.case.landmarks:,}",
            f"{m.case.particles:,}",
            f"{m.ns_per_particle_sighting[0]:.1f} / {m.ns_per_particle_sighting[1]:.1f}",
            " / ".join(f"{value:.0f}" for value in m.step_us),
            f"{m.filter_seconds:.1f}",
            f"{m.map_rows:,}",
            f"{m.map_bytes / 1e6:.1f}",
            f"{m.peak_memory_bytes / 1e6:.0f}",
        )
        for m in measurements
    ]
    head = (
        "store",
        "algorithm",
        "threads",
        "K",
        "M",
        "ns/particle-sighting, least / median",
        "step [µs], least / median / p99",
    )
    return markdown((*head, "run [s]", "rows", "map [MB]", "peak process [MB]"), rows)


def markdown(head: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    lines = ["| " + " | ".join(map(str, cells)) + " |" for cells in (head, ["---"] * len(head), *rows)]
    return "\n".join(lines)


NOT_MEASURED = """## Not measured

- Latency percentiles without other processes, unless the load above is near zero: they are upper bounds.
- `tree` above 50,000 landmarks and `dense` above 2,000 in whole runs (`benches/stores.rs` measures a
  touch of theirs alone).
- More than two threads; other instruction sets (see `docs/adr/0002-vector-kernels.md`); ARM; Windows, macOS.
- Rows against the tree's leaves at every step rather than at the end (`benches/stores.rs -- memory` does, and
  a test of the store); 2.0 beside 1.0 and threads within the same steps (`benches/threads.rs` does)."""


def commit() -> str:
    """The commit of this tree, as git describes it."""
    here = Path(__file__).parent
    command = ["git", "-C", str(here), "describe", "--always", "--dirty", "--abbrev=10"]
    try:
        return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        return "unknown"


def processor() -> str:
    """Architecture, the widest vectors that the kernels use, and the number of logical processors."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        lines = []
    flags = {flag for line in lines if line.startswith("flags") for flag in line.split(":", 1)[1].split()}
    widest = next((name for flag, name in VECTORS.items() if flag in flags), "the baseline's vectors")
    return f"{platform.machine()} with {widest} ({os.cpu_count()} logical processors)"

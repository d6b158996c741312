"""How time and memory grow with the map: EKF-SLAM and the three stores, and the run with 50,000 landmarks."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.figure import Figure

from ..config import merge
from ..datasets.native_write import write_native
from ..log import Controls, Log, Sightings
from ..plots import new_figure, style
from ..result import RunResult
from ..settings import Partial
from ..sweep import Group, SimulatedLog, StoredLog, SweepSpec
from .experiment import PLAIN, Claim, Scale

SIGHTINGS_PER_STEP = 8
STEP_S = 0.1
BUDGET_S, BUDGET_BYTES = 0.1, 8e9
"""Usable: a step of 8 sightings keeps up with 10 Hz, and the map fits into 8 GB."""
PARTICLES = 100

_METHODS: dict[str, tuple[Partial, str, str]] = {
    "EKF-SLAM": ({"algorithm": "ekf"}, style.INK, "s"),
    "dense": ({"filter": {"store": "dense"}}, style.LANDMARK, "o"),
    "tree (the paper's)": ({"filter": {"store": "tree"}}, style.SMOOTHED, "o"),
    "lineage": ({"filter": {"store": "lineage"}}, style.LIVE, "o"),
}


def revisiting_log(landmarks: int, steps: int, *, seed: int = 1) -> Log:
    """A map of K landmarks seen in one scan, then `steps` scans of 8 of them each, all identities known."""
    rng = np.random.default_rng(seed)
    radius_m = math.sqrt(landmarks)
    range_m = np.maximum(1.0, radius_m * np.sqrt(rng.uniform(size=landmarks)))
    bearing_rad = rng.uniform(-np.pi, np.pi, landmarks)
    # Neighbours in the order of visits are neighbours in the world.
    order = np.argsort(bearing_rad)
    first = rng.integers(0, landmarks, steps)
    seen = (first[:, None] + np.arange(SIGHTINGS_PER_STEP)) % landmarks
    index = np.concatenate([order, order[seen].ravel()])
    stamps = np.concatenate([np.zeros(landmarks), np.repeat(np.arange(1, steps + 1), SIGHTINGS_PER_STEP)])
    # The robot stands still, so that the landmarks stay where they are; its motion is uncertain all the same.
    wrapped = (bearing_rad[index] + rng.normal(0.0, 0.02, len(index)) + np.pi) % (2.0 * np.pi) - np.pi
    count = len(index)
    return Log(
        name=f"K={landmarks}",
        source="made for timing",
        format="native",
        controls=Controls(np.arange(steps + 1, dtype=np.float64) * STEP_S, np.zeros((steps + 1, 2))),
        sightings=Sightings(
            stamp_s=STEP_S * stamps,
            range_m=range_m[index] + rng.normal(0.0, 0.1, count),
            bearing_rad=wrapped,
            identity=index.astype(np.int64),
            class_index=np.full(count, -1, dtype=np.int64),
            signature=np.full(count, np.nan),
        ),
        identity_names=tuple(str(k) for k in range(landmarks)),
        config={
            "motion": {"model": "velocity", "speed_std_m_per_s": 0.1, "yaw_rate_std_rad_per_s": 0.01},
            "sensor": {
                "model": "range_bearing",
                "range_std_m": 0.1,
                "bearing_std_rad": 0.02,
                "max_range_m": 10.0 * radius_m + 10.0,
            },
        },
    )


def revisits(result: RunResult, log: Log) -> dict[str, float]:
    """Time per step with the whole map in place: the mean, so that the work put off to some steps counts.

    Over the second half, when the maps of the first scan, which no two particles share, have died out.
    """
    latency_us = result.steps.latency_us
    return {"revisit_step_s": 1e-6 * float(latency_us[len(latency_us) // 2 :].mean())}


def _largest(method: str, quick: bool) -> int:
    """How far each method is taken: minutes of work for the dear ones."""
    if method == "EKF-SLAM":
        return 300 if quick else 10_000
    if method == "dense":
        return 10_000 if quick else 100_000
    return 30_000 if quick else 300_000


def growth(scale: Scale) -> list[Claim]:
    """Time and memory per step against K."""
    steps = 120
    counts = [k for e in range(2, 6) for k in (10**e, 3 * 10**e)]
    logs = {}
    for k in counts:
        if k <= max(_largest(method, scale.quick) for method in _METHODS):
            folder = scale.folder / ".sweeps" / f"revisit-{k}"
            if not folder.exists():
                write_native(revisiting_log(k, steps), folder)
            logs[k] = StoredLog(f"K={k}", str(folder.resolve()))
    found: dict[str, dict[int, Group]] = {}
    for method, (layer, _, _) in _METHODS.items():
        # The paper resamples at every step.
        every_step = {"filter": {"particles": PARTICLES, "resampling": {"threshold": 1.0}}}
        config = merge(PLAIN, every_step, layer)
        chosen = {k: log for k, log in logs.items() if k <= _largest(method, scale.quick)}
        spec = SweepSpec(
            logs=list(chosen.values()), seeds=[1], config=config, measure=f"{__name__}:{revisits.__name__}"
        )
        found[method] = dict(zip(chosen, scale.sweep("growth", spec, processes=1), strict=True))
    scale.write_csv(
        "growth",
        [
            {
                "method": method,
                "landmarks": k,
                "step_s": group.summary["revisit_step_s"].mean,
                "map_bytes": int(group.summary["map_bytes"].mean),
            }
            for method, groups in found.items()
            for k, group in groups.items()
        ],
    )
    scale.write_figure("growth", lambda: _draw_growth(found))
    return [*_growth_claims(found), _usable(found)]


def _growth_claims(found: Mapping[str, Mapping[int, Group]]) -> list[Claim]:
    ratios = []
    for k in (100, 1_000, 10_000):
        if k in found["EKF-SLAM"]:
            joint = found["EKF-SLAM"][k].summary["revisit_step_s"].mean
            times = {
                name: found[name][k].summary["revisit_step_s"].mean
                for name in ("tree (the paper's)", "lineage")
            }
            text = ", ".join(f"{name} {1e3 * s:.3g} ms ({joint / s:,.0f} times)" for name, s in times.items())
            ratios.append(f"K = {k:,}: EKF-SLAM {1e3 * joint:,.4g} ms, {text}")
    return [
        Claim(
            f"time per step grows with K² for EKF-SLAM, with log K for FastSLAM (M = {PARTICLES}, "
            f"{SIGHTINGS_PER_STEP} sightings a step)",
            "O(K²) against O(M log K)",
            "; ".join(ratios),
        )
    ]


def _usable(found: Mapping[str, Mapping[int, Group]]) -> Claim:
    parts = []
    for method, groups in found.items():
        good = [
            k
            for k, group in groups.items()
            if group.summary["revisit_step_s"].mean <= BUDGET_S
            and group.summary["map_bytes"].mean <= BUDGET_BYTES
        ]
        largest = max(good, default=0)
        more = "at least " if good and largest == max(groups) else ""
        parts.append(f"{method} {more}{largest:,}")
    return Claim(
        "largest map measured that keeps up with 10 Hz in 8 GB (not in the paper)", "—", "; ".join(parts)
    )


def _draw_growth(found: Mapping[str, Mapping[int, Group]]) -> Figure:
    figure = new_figure(9.0, 4.0)
    time, memory = figure.subplots(1, 2)
    for method, groups in found.items():
        _, color, marker = _METHODS[method]
        line = {"label": method, "color": color, "marker": marker, "markersize": 4}
        time.plot(list(groups), [1e3 * g.summary["revisit_step_s"].mean for g in groups.values()], **line)
        memory.plot(list(groups), [1e-6 * g.summary["map_bytes"].mean for g in groups.values()], **line)
    time.axhline(1e3 * BUDGET_S, color=style.MUTED, linestyle=":", label="10 Hz")
    memory.axhline(1e-6 * BUDGET_BYTES, color=style.MUTED, linestyle=":")
    for axis, label in (
        (time, f"time per step of {SIGHTINGS_PER_STEP} sightings [ms]"),
        (memory, "map [MB]"),
    ):
        axis.set_xscale("log")
        axis.set_yscale("log")
        axis.set_xlabel("landmarks K")
        axis.set_ylabel(label)
        style.plain_log_ticks(axis.xaxis)
        style.plain_log_ticks(axis.yaxis)
    time.set_title(f"Time, M = {PARTICLES}")
    memory.set_title("Memory of the maps")
    style.legend_below(time, columns=3)
    return figure


def many_landmarks(scale: Scale) -> list[Claim]:
    """The run with 50,000 landmarks (5,000 in the quick version)."""
    landmarks = 5_000 if scale.quick else 50_000
    log = SimulatedLog(f"K={landmarks}", preset="headline", landmarks=landmarks)
    config = merge(PLAIN, {"algorithm": "fastslam1", "filter": {"particles": PARTICLES, "store": "lineage"}})
    measure = f"{__name__}:{error_by_age.__name__}"
    spec = SweepSpec(logs=[log], seeds=[1], config=config, measure=measure)
    found = scale.sweep("landmarks", spec, processes=1)[0].summary
    value = {name: summary.mean for name, summary in found.items()}
    state = 2 * landmarks + 3
    row = {
        "landmarks": landmarks,
        "particles": PARTICLES,
        "landmarks_found": value["landmarks"],
        "landmark_rmse_m": value["landmark_rmse_m"],
        "ate_rmse_m": value["ate_rmse_m"],
        "filter_seconds": value["filter_seconds"],
        "sightings": value["sightings"],
        "map_bytes": value["map_bytes"],
        "parameters_ekf": state + state * (state + 1) // 2,
        "parameters_fastslam": PARTICLES * (3 + 5 * landmarks),
    }
    scale.write_csv("landmarks", [row])
    deciles = [value[f"decile_{i}_rmse_m"] for i in range(10)]
    scale.write_figure("landmarks", lambda: _draw_deciles(deciles, row))
    return [
        Claim(
            "maps of 50,000 landmarks",
            "runs with K = 50,000; no error given",
            f"K = {landmarks:,}, M = {PARTICLES}: {value['landmarks']:,.0f} landmarks with "
            f"{value['landmark_rmse_m']:.3g} m RMS, {value['sightings']:,.0f} sightings in "
            f"{value['filter_seconds']:.3g} s, map of {1e-6 * value['map_bytes']:.3g} MB",
        ),
        Claim(
            f"parameters of such a map (K = {landmarks:,})",
            "EKF-SLAM K² against FastSLAM M K",
            f"EKF-SLAM {row['parameters_ekf']:,} (mean and distinct covariances), FastSLAM at most "
            f"{row['parameters_fastslam']:,} (M = {PARTICLES}); held after sharing: "
            f"{value['map_bytes'] / 8:,.0f} numbers",
        ),
    ]


def error_by_age(result: RunResult, log: Log) -> dict[str, float]:
    """RMS error of the landmarks by the tenth of the run in which they were first seen, without alignment."""
    assert log.truth_landmarks is not None, "a simulated log has its truth"
    index = {name: k for k, name in enumerate(log.truth_landmarks.names)}
    truth_m = log.truth_landmarks.position_m[[index[name] for name in result.landmarks.ids]]
    squared = np.square(result.landmarks.mean_m - truth_m).sum(axis=1)
    parts = np.array_split(squared, 10)
    return {f"decile_{i}_rmse_m": float(np.sqrt(part.mean())) for i, part in enumerate(parts)}


def _draw_deciles(deciles: Sequence[float], row: Mapping[str, float]) -> Figure:
    figure = new_figure(6.0, 3.6)
    axis = figure.subplots()
    axis.bar(range(1, 11), deciles, color=style.LIVE, width=0.8)
    axis.set_xticks(range(1, 11))
    axis.set_xlabel("tenth of the run in which the landmark was first seen")
    axis.set_ylabel("landmark error, RMS [m]")
    axis.set_title(f"{row['landmarks_found']:,.0f} landmarks, M = {PARTICLES}, {row['filter_seconds']:.3g} s")
    return figure

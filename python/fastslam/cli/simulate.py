"""`fastslam simulate`: writes a native log with truth."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated, Any

import typer

from .._core import simulation_presets
from ..errors import ConfigError
from .console import width_of_stdout
from .options import ConfigFile, Seed, Settings
from .output import keys_text
from .space import IN_SPACE, refuse, simulate_in_space

SETTINGS_FILE = "simulation.yaml"

_PRESETS = ", ".join(name for name, _ in simulation_presets())

# Flags that stand for a key of the simulation's settings; the schema checks their values.
_KEY_OF_FLAG = {
    "layout": "world.layout",
    "path": "trajectory.kind",
    "sensor": "sensor.model",
    "max_range": "sensor.max_range_m",
    "seed": "seed",
}


def _explain(wanted: bool) -> None:
    if wanted:
        from ..simulation import SCHEMA

        sys.stdout.write(keys_text(SCHEMA.explain(), width_of_stdout()))
        raise typer.Exit


def simulate_log(
    out: Annotated[Path, typer.Argument(help="Folder for the log: new or empty.", metavar="OUT")],
    preset: Annotated[
        str | None, typer.Option(metavar="NAME", help=f"Ready-made simulation: {_PRESETS}.")
    ] = None,
    config: ConfigFile = None,
    settings: Settings = None,
    layout: Annotated[
        str | None, typer.Option(metavar="NAME", help="Where the landmarks stand: `world.layout`.")
    ] = None,
    landmarks: Annotated[
        int | None, typer.Option(metavar="K", help="About so many landmarks, at the same density.")
    ] = None,
    path: Annotated[
        str | None, typer.Option(metavar="NAME", help="Where the robot goes: `trajectory.kind`.")
    ] = None,
    sensor: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            help="What it sees (`sensor.model`): range_bearing, range, bearing; in space point3d, elevation.",
        ),
    ] = None,
    motion: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            help="In space, what is measured of the motion: odometry, gyro, or wandering (nothing).",
        ),
    ] = None,
    max_range: Annotated[
        float | None, typer.Option("--max-range-m", metavar="M", help="How far the sensor sees, in metres.")
    ] = None,
    seed: Seed = None,
    explain: Annotated[
        bool, typer.Option("--explain", callback=_explain, is_eager=True, help="List all settings.")
    ] = False,
) -> None:
    """Simulate a drive and write it as a native log, with the true path and the true landmarks.

    The complete settings are kept in `simulation.yaml` beside it: --config with that file makes the same log.

    Settings come from: defaults < --preset < --config < --set and the flags below.

    \b
    Examples:
      fastslam simulate my-log
      fastslam simulate orchard --preset orchard --seed 3
      fastslam simulate rocks --preset rover
      fastslam simulate large --preset headline --landmarks 100000
      fastslam simulate clutter --set scan.clutter_per_scan=2 --set scan.detection_probability=0.8
      fastslam simulate beacons --sensor range --max-range-m 100 --set world.count=12
      fastslam simulate stars --sensor point3d
      fastslam simulate carried --sensor point3d --motion wandering
      fastslam simulate square --path waypoints --set "trajectory.points_m=[[5, 5], [45, 5], [45, 35]]"
    """
    from ..datasets.native_write import write_native
    from ..resultfiles import write_atomically
    from ..simulation import SCHEMA, resolve_simulation, simulate

    if sensor in IN_SPACE:
        other = {
            "--preset": preset,
            "--config": config,
            "--set": settings,
            "--layout": layout,
            "--path": path,
        }
        refuse(other)
        chosen: dict[str, Any] = {"motion": motion, "landmarks": landmarks, "seed": seed}
        simulate_in_space(out, IN_SPACE[sensor], max_range_m=max_range, **chosen)
        return
    if motion is not None:
        raise ConfigError(f"--motion: for a sensor in space, --sensor {' or '.join(IN_SPACE)}")
    flags = {"layout": layout, "path": path, "sensor": sensor, "max_range": max_range, "seed": seed}
    given = (f"{_KEY_OF_FLAG[name]}={value}" for name, value in flags.items() if value is not None)
    complete = resolve_simulation(
        SCHEMA.load(config) if config is not None else {},
        SCHEMA.parse_assignments([*(settings or []), *given]),
        preset=preset,
        landmarks=landmarks,
    )
    log = simulate(complete, name=out.resolve().name)
    write_native(log, out)
    write_atomically(out / SETTINGS_FILE, complete.dump())
    truth = 0 if log.truth_landmarks is None else len(log.truth_landmarks.names)
    seen = f"{len(log.sightings.stamp_s):,} sightings of {truth:,} landmarks"
    if log.scans is not None:
        seen = f"{len(log.scans.stamp_s):,} laser scans among {truth:,} rocks"
    typer.echo(f"{out}: {seen}")

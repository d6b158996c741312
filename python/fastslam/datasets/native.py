"""Reads the native log, a folder of a YAML file and CSV files (`docs/native-log-format.md`)."""

from __future__ import annotations

from pathlib import Path

from .._hints import like_named
from ..errors import DataError
from ..log import Log, Problem
from ..measured import measured_by_sensor, measured_columns
from .clean import no_sightings
from .native_odometry import Odometry, read_odometry
from .native_settings import LEAST_SENSOR, read_settings
from .native_sightings import SightingsFile, read_sightings
from .native_truth import read_fixes, read_landmarks, read_trajectory
from .options import LoadOptions
from .scans_file import NAME as SCANS
from .scans_file import read_scans
from .text import find_file

FILES = ("log.yaml", "odometry.csv", "sightings.csv")
REMEDIES = {
    "log.yaml": f": write one with format_version: 1 and sensor: {LEAST_SENSOR}",
    "odometry.csv": "",
    "sightings.csv": ": write one, with the header stamp_s,range_m,bearing_rad alone where nothing was seen",
}


def matches(path: Path) -> bool:
    """A folder with any of the files of a native log, so that a missing one is reported by its name."""
    return any(find_file(_folder(path), name) is not None for name in FILES)


def load(path: Path, options: LoadOptions) -> Log:
    """Read a native log. Errors: DataError with file and line for what a person must repair."""
    path = _folder(path)
    scans, scan_problems = read_scans(path / SCANS)
    only_scans = scans is not None and find_file(path, "sightings.csv") is None
    settings = read_settings(_required(path, "log.yaml"))
    odometry_file = _required(path, "odometry.csv")
    measures = measured_columns(settings.config.get("sensor", {}).get("model"))
    sensors = measured_by_sensor(settings.config)
    if only_scans:
        seen = SightingsFile(no_sightings())
    else:
        seen = read_sightings(_required(path, "sightings.csv"), measures=measures, sensors=sensors)
    odometry = read_odometry(odometry_file, model=settings.motion_model, wheels=settings.wheels)
    trajectory, truth_problems = read_trajectory(find_file(path, "truth_trajectory.tum"))
    clocks = clock_problems(odometry, seen, path)
    config = {"motion": {"model": odometry.model}} | settings.config
    return Log(
        name=settings.name or path.resolve().name,
        source=str(path),
        format="native",
        controls=odometry.controls,
        sightings=seen.sightings,
        identity_names=seen.identity_names,
        class_names=seen.class_names,
        sensor_names=seen.sensor_names,
        truth_trajectory=trajectory,
        truth_landmarks=read_landmarks(
            find_file(path, "truth_landmarks.csv"), complete=settings.truth_landmarks_complete
        ),
        position_fixes=read_fixes(find_file(path, "position_fixes.csv")),
        scans=scans,
        config=config,
        problems=odometry.problems + seen.problems + scan_problems + clocks + truth_problems,
        notes=settings.notes + odometry.notes + seen.notes,
    )


def _folder(path: Path) -> Path:
    """The log's folder, also where the path is that of its log.yaml."""
    return path.parent if path.name == "log.yaml" and path.is_file() else path


def _required(path: Path, name: str) -> Path:
    """The file, plain or compressed. Errors: DataError that says how to get on without it."""
    found = find_file(path, name)
    if found is None:
        hint = like_named(path, name) or REMEDIES[name]
        raise DataError(f"the file {name} of a native log is missing{hint}", path)
    return found


def clock_problems(odometry: Odometry, seen: SightingsFile, path: Path) -> tuple[Problem, ...]:
    """Says so where no sighting lies within the time of the odometry: usually two clocks or two units.

    Errors: DataError where one file has dates and the other has not, so that these are two clocks for sure.
    """
    stamp_s = seen.sightings.stamp_s
    if len(stamp_s) == 0:
        return ()
    first_s, last_s = odometry.controls.stamp_s[0], odometry.controls.stamp_s[-1]
    if stamp_s[-1] >= first_s and stamp_s[0] <= last_s:
        return ()
    if odometry.dated != seen.dated:
        dated, plain = ("odometry", "sightings") if odometry.dated else ("sightings", "odometry")
        message = f"{dated}.csv has dates and {plain}.csv other seconds: give the stamps of both in one clock"
        raise DataError(message, path)
    span = f"{stamp_s[0]:.3f} to {stamp_s[-1]:.3f} s"
    message = f"sightings ({span}) lie outside the odometry ({first_s:.3f} to {last_s:.3f} s): another clock?"
    return (Problem(message, len(stamp_s)),)

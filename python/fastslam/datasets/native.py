"""Reads the native log, a folder of a YAML file and CSV files (`docs/native-log-format.md`)."""

from __future__ import annotations

from pathlib import Path

from ..errors import DataError
from ..log import Controls, Log, Problem, Sightings
from .clean import no_sightings
from .native_odometry import read_controls
from .native_settings import CONFIG_KEYS, read_settings
from .native_sightings import read_sightings
from .native_truth import read_fixes, read_landmarks, read_trajectory
from .options import LoadOptions
from .scans_file import NAME as SCANS
from .scans_file import read_scans

FILES = ("log.yaml", "odometry.csv", "sightings.csv")


def matches(path: Path) -> bool:
    """A folder with any of the files of a native log, so that a missing one is reported by its name."""
    return any((_folder(path) / name).is_file() for name in FILES)


def load(path: Path, options: LoadOptions) -> Log:
    """Read a native log. Errors: DataError with file and line for what a person must repair."""
    path = _folder(path)
    scans, scan_problems = read_scans(path / SCANS)
    only_scans = scans is not None and not (path / "sightings.csv").is_file()
    for name in FILES:
        if not (path / name).is_file() and not (only_scans and name == "sightings.csv"):
            raise DataError(f"the file {name} of a native log is missing", path)
    settings = read_settings(path / "log.yaml")
    controls, control_problems = read_controls(path / "odometry.csv", settings["motion"]["model"])
    sightings, identity_names, class_names, problems = (
        (no_sightings(), (), (), ()) if only_scans else read_sightings(path / "sightings.csv")
    )
    trajectory, truth_problems = read_trajectory(path / "truth_trajectory.tum")
    return Log(
        name=str(settings.get("name", path.resolve().name)),
        source=str(path),
        format="native",
        controls=controls,
        sightings=sightings,
        identity_names=identity_names,
        class_names=class_names,
        truth_trajectory=trajectory,
        truth_landmarks=read_landmarks(
            path / "truth_landmarks.csv", complete=settings.get("truth_landmarks_complete", True)
        ),
        position_fixes=read_fixes(path / "position_fixes.csv"),
        scans=scans,
        config={key: settings[key] for key in CONFIG_KEYS if key in settings},
        problems=control_problems
        + problems
        + scan_problems
        + _clock_problems(controls, sightings)
        + truth_problems,
    )


def _folder(path: Path) -> Path:
    """The log's folder, also where the path is that of its log.yaml."""
    return path.parent if path.name == "log.yaml" and path.is_file() else path


def _clock_problems(controls: Controls, sightings: Sightings) -> tuple[Problem, ...]:
    """Says so where no sighting lies within the time of the odometry: usually two clocks or two units."""
    if len(sightings.stamp_s) == 0:
        return ()
    first_s, last_s = controls.stamp_s[0], controls.stamp_s[-1]
    if sightings.stamp_s[-1] >= first_s and sightings.stamp_s[0] <= last_s:
        return ()
    span = f"{sightings.stamp_s[0]:.3f} to {sightings.stamp_s[-1]:.3f} s"
    message = f"sightings ({span}) lie outside the odometry ({first_s:.3f} to {last_s:.3f} s): another clock?"
    return (Problem(message, len(sightings.stamp_s)),)

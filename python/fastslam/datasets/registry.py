"""The formats that can be read, and `load`, which guesses the format from the contents of a path."""

from __future__ import annotations

import difflib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from ..errors import DataError
from ..log import Log
from . import car_park, city_trees, freiburg, lost_in_the_woods, native, utias, victoria_park, victoria_scans
from .options import LoadOptions


@dataclass(frozen=True)
class DatasetFormat:
    """One format: how to recognise it and how to read it.

    `matches` looks at names and first bytes only, so it is cheap and never raises; `load` may raise
    DataError.
    """

    name: str
    description: str
    matches: Callable[[Path], bool]
    load: Callable[[Path, LoadOptions], Log]
    options: frozenset[str] = frozenset()
    """Names of the `LoadOptions` that it understands."""


FORMATS: dict[str, DatasetFormat] = {
    entry.name: entry
    for entry in (
        DatasetFormat(
            "native",
            "folder with log.yaml, odometry.csv and sightings.csv",
            native.matches,
            native.load,
        ),
        DatasetFormat(
            "utias",
            "UTIAS MR.CLAM data set folder (one of several robots)",
            utias.matches,
            utias.load,
            frozenset({"robot"}),
        ),
        DatasetFormat(
            "lost_in_the_woods",
            "MATLAB file of the Lost in the Woods set, or its folder",
            lost_in_the_woods.matches,
            lost_in_the_woods.load,
            frozenset({"max_range_m"}),
        ),
        DatasetFormat(
            "victoria_park",
            "Victoria Park folder with the extracted tree features",
            victoria_park.matches,
            victoria_park.load,
        ),
        DatasetFormat(
            "victoria_scans",
            "Victoria Park folder ascii_2003 with the raw laser scans",
            victoria_scans.matches,
            victoria_scans.load,
        ),
        DatasetFormat(
            "car_park",
            "folder of the Sydney car park with raw runs (juan3_*.mat)",
            car_park.matches,
            car_park.load,
            frozenset({"run"}),
        ),
        DatasetFormat(
            "city_trees10000",
            "EDGE2/LANDMARK text file of cityTrees10000, or its folder",
            city_trees.matches,
            city_trees.load,
        ),
        DatasetFormat(
            "freiburg",
            "ODOMETRY/SENSOR text file of the Freiburg course, or its folder",
            freiburg.matches,
            freiburg.load,
        ),
    )
}


def load(
    path: Path | str,
    *,
    format: str | None = None,
    robot: int | None = None,
    run: int | None = None,
    max_range_m: float | None = None,
) -> Log:
    """Read a log; the format is guessed from the contents of `path` unless `format` names one of FORMATS.

    `robot`, `run` and `max_range_m` are those of `LoadOptions`. Errors: DataError when the path does not
    exist, no format fits, the format does not know an option, or a file is at fault.
    """
    path = Path(path)
    if not path.exists():
        raise DataError("does not exist", path)
    chosen = _guess(path) if format is None else _by_name(format, path)
    options = LoadOptions(robot=robot, run=run, max_range_m=max_range_m)
    for option in options.given():
        if option not in chosen.options:
            raise DataError(f"logs of format {chosen.name} know no option {option}", path)
    return chosen.load(path, options)


def _by_name(name: str, path: Path) -> DatasetFormat:
    key = name.replace("-", "_")
    if key in FORMATS:
        return FORMATS[key]
    near = difflib.get_close_matches(key, FORMATS, n=1)
    hint = f" (did you mean {near[0]}?)" if near else ""
    raise DataError(f"unknown format {name}{hint}; known: {', '.join(FORMATS)}", path)


def _guess(path: Path) -> DatasetFormat:
    matching = [entry for entry in FORMATS.values() if entry.matches(path)]
    if len(matching) == 1:
        return matching[0]
    if matching:
        names = ", ".join(entry.name for entry in matching)
        raise DataError(f"fits several formats ({names}): name one", path)
    known = "; ".join(f"{entry.name}: {entry.description}" for entry in FORMATS.values())
    raise DataError(f"is no log of a known format{_inner_hint(path)}; known are {known}", path)


def _inner_hint(path: Path) -> str:
    """Names the logs one level below, since giving the folder of a collection is the usual slip."""
    if not path.is_dir():
        return ""
    inner = sorted(
        child.name
        for child in path.iterdir()
        if child.is_dir() and any(entry.matches(child) for entry in FORMATS.values())
    )
    return f" (did you mean {', '.join(inner)} in it?)" if inner else ""

"""The formats that can be read, and `load`, which guesses the format from the contents of a path."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from .._hints import does_not_exist, meant, of_our_own
from ..errors import DataError
from ..log import Log
from . import (
    bag,
    car_park,
    city_trees,
    freiburg,
    g2o,
    labyrinth,
    lost_in_the_woods,
    native,
    plaza,
    pyfg,
    toro,
    utias,
    victoria_park,
    victoria_scans,
)
from .graph_rows import PAGE
from .options import LoadOptions
from .text import children


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
            "plaza",
            "folder with the MATLAB file of a Plaza set (Plaza1_.mat): ranges to radios",
            plaza.matches,
            plaza.load,
        ),
        DatasetFormat(
            "labyrinth",
            "text of the Labyrinth set (*_UWB_Input.txt), or its folder: ranges to modules",
            labyrinth.matches,
            labyrinth.load,
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
        DatasetFormat("g2o", "g2o file of a graph with landmarks in the plane", g2o.matches, g2o.load),
        DatasetFormat(
            "toro", "TORO, iSAM or GTSAM text: EDGE2 or ODOMETRY, LANDMARK or BR", toro.matches, toro.load
        ),
        DatasetFormat(
            "pyfg",
            "PyFG file, one robot of several, with landmarks in the plane",
            pyfg.matches,
            pyfg.load,
            frozenset({"robot"}),
        ),
        DatasetFormat(
            "bag",
            "ROS bag: of ROS 1, or of ROS 2 (sqlite3, MCAP); needs the extra `bags`",
            bag.matches,
            bag.load,
            frozenset({"topics"}),
        ),
    )
}


TABLES_PAGE = "docs/howto/spreadsheet.md"
SPACE_PAGE = "docs/space.md"
FOREIGN = {
    ".rawlog": "an MRPT rawlog",
    ".mat": "a MATLAB file of unknown content",
    ".json": "a JSON file",
    ".pcap": "a packet capture",
}
"""Files that people try, by suffix."""
DEEPEST = 3
"""How many folders deep a log is looked for."""
MOST_FILES = 500
"""How many entries of a folder are looked at."""
MOST_SHOWN = 10


def load(
    path: Path | str,
    *,
    format: str | None = None,
    robot: int | None = None,
    run: int | None = None,
    max_range_m: float | None = None,
    topics: Mapping[str, str] | None = None,
) -> Log:
    """Read a log; the format is guessed from the contents of `path` unless `format` names one of FORMATS.

    `robot`, `run`, `max_range_m` and `topics` (names by role) are those of `LoadOptions`. Errors: DataError
    when the path does not exist, no format fits, the format does not know an option, or a file is at fault.
    A folder that is no log and holds exactly one below it stands for that one.
    """
    path = given = Path(path)
    if not path.exists():
        raise DataError(does_not_exist(path), path)
    from ..space.reading import matches as space_format  # which reads with the tables of this package

    if format is None and space_format(path) is not None:
        raise DataError(
            f"is a log in three dimensions: for `fastslam run` and `info`, and {SPACE_PAGE}", path
        )
    chosen, path = _guess(path) if format is None else (_by_name(format, path), path)
    named = tuple(topics.items()) if topics else None
    options = LoadOptions(robot=robot, run=run, max_range_m=max_range_m, topics=named)
    for option in options.given():
        if option not in chosen.options:
            raise DataError(f"logs of format {chosen.name} know no option {option}", path)
    log = chosen.load(path, options)
    if path == given:
        return log
    return replace(log, notes=(f"read {path}, the only log in {given}", *log.notes))


def _by_name(name: str, path: Path) -> DatasetFormat:
    key = name.replace("-", "_")
    if key in FORMATS:
        return FORMATS[key]
    raise DataError(f"unknown format {name}{meant(key, FORMATS)}; known: {', '.join(FORMATS)}", path)


def _guess(path: Path) -> tuple[DatasetFormat, Path]:
    """The format, and the path of the log: that of the only one below a folder that is none itself."""
    matching = formats_of(path)
    if len(matching) == 1:
        return matching[0], path
    if matching:
        names = ", ".join(entry.name for entry in matching)
        raise DataError(f"fits several formats ({names}): name one", path)
    inner = logs_in(path)
    if len(inner) == 1:
        return _guess(inner[0])
    if inner:
        shown = ", ".join(str(log.relative_to(path)) for log in inner[:MOST_SHOWN])
        more = f" and {len(inner) - MOST_SHOWN} more" if len(inner) > MOST_SHOWN else ""
        raise DataError(f"holds {len(inner)} logs, name one: {shown}{more}", path)
    ours = of_our_own(path)
    if ours is not None:
        raise DataError(f"{ours}; expected a log" if path.is_dir() else ours, path)
    tables = _tables_alone(path)
    if tables:
        raise DataError(
            f"holds tables not called as those of a log ({', '.join(tables[:MOST_SHOWN])}): name that of "
            f"the motion odometry.csv and that of the landmarks sightings.csv; {TABLES_PAGE} shows how",
            path,
        )
    foreign = next((what for suffix, what in FOREIGN.items() if suffix in path.suffixes), None)
    message = "is no log of a known format" if foreign is None else f"is {foreign}, which is not read"
    raise DataError(f"{message}; read are {', '.join(FORMATS)}; {PAGE} says how to convert others", path)


def _tables_alone(path: Path) -> list[str]:
    """Names of the CSV files of a folder that holds nothing else; a log.yaml may lie beside them."""
    if not path.is_dir():
        return []
    names = [child.name for child in children(path)[:MOST_FILES] if not child.name.startswith(".")]
    tables = [name for name in names if name.lower().endswith(".csv")]
    return tables if set(names) <= {*tables, "log.yaml"} else []


def formats_of(path: Path) -> list[DatasetFormat]:
    """The formats that a path fits."""
    return [entry for entry in FORMATS.values() if entry.matches(path)]


def logs_in(folder: Path, *, depth: int = DEEPEST) -> list[Path]:
    """Logs below a folder that is none itself, as unpacking makes them; not those within a log."""
    if not folder.is_dir():
        return []
    found: list[Path] = []
    for child in children(folder)[:MOST_FILES]:
        if child.name.startswith((".", "__MACOSX")):
            continue
        if formats_of(child):
            found.append(child)
        elif depth > 1:
            found += logs_in(child, depth=depth - 1)
    return found

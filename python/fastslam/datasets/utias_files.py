"""Where the files of a MR.CLAM data set lie, in the layouts that people have made of it.

Published: `RobotN_Odometry.dat` beside `Barcodes.dat`. Courses hand out one robot, with a prefix
(`ds1_Odometry.dat`, `ds1_Control.dat`) or without, or with a folder for each robot. All may be compressed.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

from ..errors import DataError
from .text import children

_FILE = re.compile(
    r"(?P<prefix>.*?)(?:Robot_?(?P<robot>\d+)_?)?"
    r"(?P<what>Landmark_?Groundtruth|Barcodes|Odometry|Control|Measurement|Groundtruth)\.(?:dat|txt)(?:\.gz)?",
    re.IGNORECASE,
)
_ROBOT_FOLDER = re.compile(r"robot_?(\d+)", re.IGNORECASE)
_WORDS = {"control": "odometry", "landmark_groundtruth": "landmarks", "landmarkgroundtruth": "landmarks"}
SHARED = ("barcodes", "landmarks")


@dataclass(frozen=True)
class RobotFiles:
    """Files of one robot. `number` is None where the files name no robot, `truth` where there is none."""

    number: int | None
    barcodes: Path
    landmarks: Path
    odometry: Path
    measurement: Path
    truth: Path | None


@dataclass(frozen=True)
class _Found:
    """One file of a data set."""

    prefix: str
    robot: int | None
    what: str
    path: Path


def holds_data_set(path: Path) -> bool:
    """Whether a folder, or the folder of an odometry file, has what makes a data set; it raises nothing."""
    whats = {found.what for found in _of_path(path)}
    return "odometry" in whats and ("barcodes" in whats or "measurement" in whats)


def files_of_robot(path: Path, robot: int | None) -> RobotFiles:
    """Files of a robot, by number where there are several. Errors: DataError for what is not there."""
    found = _of_path(path)
    prefixes = sorted({file.prefix for file in found if file.what == "odometry"})
    if len(prefixes) > 1:
        named = ", ".join(file.path.name for file in found if file.what == "odometry")
        raise DataError(f"holds several data sets: name the odometry file of one ({named})", path)
    robots = sorted({file.robot or 0 for file in found if file.what == "odometry"})
    if robots == [0] and robot in (None, 1):
        return _complete(path, found, None)
    wanted = 1 if robot is None else robot
    if wanted not in robots:
        there = ", ".join(str(number or 1) for number in robots) or "none"
        raise DataError(f"has no robot {wanted}; robots there: {there}", path)
    return _complete(path, found, wanted)


def _complete(path: Path, found: list[_Found], robot: int | None) -> RobotFiles:
    chosen = {file.what: file.path for file in found if file.what in SHARED or file.robot == robot}
    stem = "" if robot is None else f"Robot{robot}_"
    names = {"barcodes": "Barcodes.dat", "landmarks": "Landmark_Groundtruth.dat"}
    names |= {"odometry": f"{stem}Odometry.dat", "measurement": f"{stem}Measurement.dat"}
    for what, name in names.items():
        if what not in chosen:
            wanted = ", ".join(names.values())
            raise DataError(f"the file {name} (or {name}.gz) is missing; wanted: {wanted}", path)
    return RobotFiles(
        robot,
        chosen["barcodes"],
        chosen["landmarks"],
        chosen["odometry"],
        chosen["measurement"],
        chosen.get("groundtruth"),
    )


def _of_path(path: Path) -> list[_Found]:
    """Files of the data set at a path: a folder, or the odometry file of one robot."""
    if path.is_dir():
        return _with_shared(path, _in_folder(path, None))
    match = _FILE.fullmatch(path.name)
    if not path.is_file() or match is None or _word(match["what"]) != "odometry":
        return []
    robot = _number(match["robot"])
    beside = _in_folder(path.parent, None)
    own = [f for f in beside if f.prefix == match["prefix"] and (f.robot == robot or f.what in SHARED)]
    return _with_shared(path.parent, own)


def _in_folder(folder: Path, robot: int | None) -> list[_Found]:
    """Files of a folder and of the folders of single robots in it."""
    found: list[_Found] = []
    for child in children(folder):
        match = _FILE.fullmatch(child.name)
        inner = _ROBOT_FOLDER.fullmatch(child.name) if robot is None else None
        if match is not None and child.is_file():
            number = _number(match["robot"]) or robot
            found.append(_Found(match["prefix"], number, _word(match["what"]), child))
        elif inner is not None and child.is_dir():
            found += _in_folder(child, int(inner[1]))
    return found


def _with_shared(folder: Path, found: list[_Found]) -> list[_Found]:
    """With the files that all robots share from the folder above, where only that has them."""
    missing = [what for what in SHARED if not any(file.what == what for file in found)]
    if not found or not missing or not any(file.what == "odometry" for file in found):
        return found
    above = folder.resolve().parent
    return found + [file for file in _in_folder(above, 0) if file.what in missing]


def _number(text: str | None) -> int | None:
    return None if text is None else int(text)


def _word(what: str) -> str:
    word = what.lower()
    return _WORDS.get(word, word)

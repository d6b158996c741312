"""What people probably meant: the nearest word or file, and what a path of our own is."""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable
from pathlib import Path

__all__ = ["does_not_exist", "in_plain_words", "kind_of_folder", "like_named", "meant", "of_our_own"]

_OURS = {
    "run.json": "a folder of results",
    "log.yaml": "a log",
    "map.yaml": "a kept map",
    "cells.jsonl": "the folder of a sweep",
}
"""What a folder is, by a file in it that no other kind has."""
_PARTS_OF_LOGS = ("odometry.csv", "sightings.csv", "truth_landmarks.csv", "scans.npz")
_SPREADSHEETS = (".xlsx", ".xls", ".ods", ".numbers")
_TABLES = (".csv", ".tsv")

_GOT = re.compile(
    r"(?P<key>\S+: )?(invalid type|invalid value|invalid length): (?P<got>.+), expected (?P<expected>.+)",
    re.S,
)
_VARIANT = re.compile(r"(?P<key>\S+: )?unknown variant `(?P<got>.*)`, expected (?P<expected>.+)", re.S)
_WHOLE = "a whole number from 0 on"
_KINDS = {
    **{"u8": "a whole number from 0 to 255", "u16": "a whole number from 0 to 65,535"},
    **{"u32": "a whole number from 0 to 4,294,967,295", "u64": _WHOLE, "usize": _WHOLE},
    **{"i32": "a whole number", "i64": "a whole number", "f32": "a number", "f64": "a number"},
    **{"a boolean": "true or false", "a string": "text", "a sequence": "a list", "a map": "keys and values"},
}
"""What the core calls a kind of value, and what people call it."""


def meant(word: str, known: Iterable[str]) -> str:
    """`; did you mean X?` for the known word that is nearest, or nothing."""
    by_plain = {name.lower(): name for name in known}
    near = difflib.get_close_matches(word.lower(), by_plain, n=1, cutoff=0.6)
    return f"; did you mean {by_plain[near[0]]}?" if near else ""


def does_not_exist(path: Path) -> str:
    """The message for a path that is not there, with the nearest name beside it."""
    try:
        beside = [entry.name for entry in path.absolute().parent.iterdir()]
    except OSError:
        parent = path.absolute().parent
        return f"does not exist, nor does the folder {parent}" if not parent.exists() else "does not exist"
    near = difflib.get_close_matches(path.name, sorted(beside), n=1, cutoff=0.7)
    return f"does not exist; did you mean {path.with_name(near[0])}?" if near else "does not exist"


def like_named(folder: Path, name: str) -> str:
    """`; rename X to NAME, if that is it` for the file whose name is nearest, or nothing."""
    try:
        beside = {entry.name.lower(): entry.name for entry in folder.iterdir() if entry.is_file()}
    except OSError:
        return ""
    near = difflib.get_close_matches(name, sorted(beside), n=1, cutoff=0.8)
    return f"; rename {beside[near[0]]} to {name}, if that is it" if near else ""


def kind_of_folder(folder: Path) -> str | None:
    """What a folder holds of ours, and the file that shows it."""
    name = next((name for name in _OURS if (folder / name).is_file()), None)
    return None if name is None else f"{_OURS[name]} (it holds {name})"


def of_our_own(path: Path) -> str | None:
    """What a path is that is not what was asked for, with what to do; None where nobody knows."""
    if path.is_dir():
        kind = kind_of_folder(path)
        if kind is not None:
            return f"is {kind}"
        return None if any(path.iterdir()) else "is an empty folder"
    if path.name.removesuffix(".gz") in _PARTS_OF_LOGS and (path.parent / "log.yaml").is_file():
        return f"is one file of a log: name its folder, {path.parent}"
    if path.suffix.lower() in _SPREADSHEETS:
        return "is a spreadsheet: save its sheets as CSV, one for the odometry and one for the sightings"
    if path.suffix.lower() in _TABLES:
        return "is one table: a log is a folder with odometry.csv, sightings.csv and log.yaml"
    return None


def in_plain_words(message: str) -> str:
    """A complaint of the core about the type of a value, for people who wrote YAML."""
    found = _GOT.fullmatch(message)
    if found is not None:
        expected = _kind(found["expected"], (found["key"] or "").removesuffix(": "))
        return f"{found['key'] or ''}got {_value(found['got'])}, expected {expected}"
    found = _VARIANT.fullmatch(message)
    if found is None:
        return message
    known = re.findall(r"`([^`]+)`", found["expected"])
    expected = " or ".join(known) if len(known) < 3 else f"one of {', '.join(known)}"
    return f"{found['key'] or ''}got {found['got']}, expected {expected}{meant(found['got'], known)}"


def _value(written: str) -> str:
    literal = re.fullmatch(r"(integer|floating point|boolean) `(?P<value>.*)`", written, re.S)
    if literal is not None:
        return literal["value"]
    if written.startswith("string "):
        return written.removeprefix("string ")
    return {"null": "nothing", "sequence": "a list", "map": "keys and values"}.get(written, written)


def _kind(expected: str, key: str) -> str:
    if re.match(r"(struct|internally tagged enum|enum) ", expected):
        return f"a section of keys: `fastslam config explain {key}` lists them"
    of_length = re.fullmatch(r"an array of length (\d+)", expected)
    return f"a list of {of_length[1]}" if of_length else _KINDS.get(expected, expected)

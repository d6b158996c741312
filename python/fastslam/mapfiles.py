"""Maps as folders of text: `map.yaml`, and `landmarks.csv` that a spreadsheet can edit."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from ._hints import does_not_exist, of_our_own
from ._yaml import YamlError, parse_yaml
from .csv_cells import guarded, unguarded
from .datasets.csv_table import CsvTable, read_csv
from .datasets.text import read_text
from .errors import ConfigError, DataError
from .identity import nobody_knows
from .limits import OF_SETTINGS
from .log import Floats, Ints
from .maps import ROLES, Map, Role
from .result import LandmarkMap
from .resultfiles import LANDMARK_COLUMNS, LANDMARKS_FILE, csv_text, landmark_rows, to_json, write_atomically

FORMAT_VERSION = 1
MAP_FILE = "map.yaml"
KEYS = ("format_version", "name", "frame", "made_from")
COLUMNS = (*LANDMARK_COLUMNS, "existence", "role", "note")
_PLACE = ("id", "x_m", "y_m")
_COVARIANCE = ("cov_xx_m2", "cov_xy_m2", "cov_yy_m2")


def write_map(chart: Map, folder: Path) -> Path:
    """Writes the two files of a map, each whole or not at all; the table last. Errors: `DataError`."""
    facts = {"format_version": FORMAT_VERSION, "name": chart.name, "frame": chart.frame}
    if chart.made_from:
        facts["made_from"] = chart.made_from
    write_atomically(folder / MAP_FILE, yaml.safe_dump(facts, sort_keys=False, allow_unicode=True))
    write_atomically(folder / LANDMARKS_FILE, _table_text(chart))
    return folder


def _table_text(chart: Map) -> str:
    more = zip(chart.existence, chart.role, chart.note, strict=True)
    rows = (
        (*row, f"{existence:.9g}" if math.isfinite(existence) else "", role, guarded(note))
        for row, (existence, role, note) in zip(landmark_rows(chart.landmarks), more, strict=True)
    )
    return csv_text(COLUMNS, rows)


def read_map(path: Path) -> Map:
    """A map's folder, or a table of landmarks alone. Errors: `DataError` with file and line."""
    if not path.is_dir():
        if not path.exists():
            raise DataError(f"no such map: {does_not_exist(path)}", path)
        return replace(_read_table(path), name=path.stem)
    if not (path / MAP_FILE).exists():
        what = of_our_own(path) or f"holds no {MAP_FILE}"
        raise DataError(f"{what}; expected a map, as `fastslam run --map-out` keeps one", path)
    facts = _facts(path / MAP_FILE)
    chart = _read_table(path / LANDMARKS_FILE)
    return replace(
        chart,
        name=str(facts.get("name", path.stem)),
        frame=str(facts.get("frame", "map")),
        made_from=dict(facts.get("made_from") or {}),
    )


def _facts(path: Path) -> dict[str, Any]:
    try:
        facts, line_of = parse_yaml(read_text(path))
    except YamlError as error:
        raise DataError(error.message, path, error.line) from None
    if not isinstance(facts, dict):
        raise DataError("expected keys and values", path)
    for key in facts:
        if key not in KEYS:
            raise DataError(
                f"{key}: unknown key, expected one of {', '.join(KEYS)}", path, line_of.get(str(key))
            )
    version = facts.get("format_version")
    if version != FORMAT_VERSION:
        raise DataError(
            f"format_version: got {version}, this version reads {FORMAT_VERSION}",
            path,
            line_of.get("format_version"),
        )
    if not isinstance(facts.get("made_from") or {}, dict):
        raise DataError("made_from: expected keys and values", path, line_of.get("made_from"))
    return facts


def _read_table(path: Path) -> Map:
    table = read_csv(path, example=",".join(COLUMNS[:6]), allow_empty=True)
    for name in _PLACE:
        if name not in table.index_of:
            raise DataError(f"the column {name} is missing", path, table.header_line)
    ids = _ids(table)
    covariance = _covariance(table)
    mean_m = np.column_stack([table.finite_numbers(name) for name in _PLACE[1:]]).reshape(-1, 2)
    farthest_m = OF_SETTINGS["position"]
    too_far = np.abs(mean_m).max(axis=1, initial=0.0) > farthest_m
    _refuse(table, too_far, f"more than {farthest_m:g} m from the origin")
    names, classes = _classes(table)
    signature = _column(table, "signature", math.nan)
    confirmed = _column(table, "confirmed", math.nan)
    landmarks = LandmarkMap(
        ids=ids,
        mean_m=mean_m,
        covariance_m2=covariance[:, [0, 1, 1, 2]].reshape(-1, 2, 2),
        sightings=_whole(table, "sightings"),
        confirmed=confirmed != 0.0 if len(ids) and np.isfinite(confirmed).all() else None,
        class_index=classes if names else None,
        signature=signature if np.isfinite(signature).any() else None,
        class_names=names,
    )
    existence = _column(table, "existence", math.nan)
    _refuse(table, (existence < 0.0) | (existence > 1.0), "existence: expected 0 to 1")
    return Map(landmarks, _roles(table, covariance), existence, _texts(table, "note"), path.stem)


def _texts(table: CsvTable, name: str) -> tuple[str, ...]:
    if name not in table.index_of:
        return ("",) * len(table.lines)
    return tuple(unguarded(cell.strip()) for cell in table.texts(name))


def _column(table: CsvTable, name: str, absent: float) -> Floats:
    if name not in table.index_of:
        return np.full(len(table.lines), absent)
    return table.numbers(name, empty=absent)


def _whole(table: CsvTable, name: str) -> Ints:
    values = _column(table, name, 0.0)
    _refuse(
        table,
        ~((values >= 0.0) & (values < 2**32) & (values == np.floor(values))),
        f"{name}: expected a whole number from 0",
    )
    return values.astype(np.int64)


def _ids(table: CsvTable) -> tuple[str, ...]:
    ids = _texts(table, "id")
    line_of: dict[str, int] = {}
    for name, line in zip(ids, table.lines, strict=True):
        if not name:
            raise DataError("id: expected a name", table.path, line)
        if name in line_of:
            raise DataError(f"id: {name} stands in line {line_of[name]} too", table.path, line)
        line_of[name] = line
    return ids


def _covariance(table: CsvTable) -> Floats:
    """(K, 3) as xx, xy, yy; from `std_m` where there is no covariance, and zero without either."""
    present = [name for name in _COVARIANCE if name in table.index_of]
    if present and len(present) < len(_COVARIANCE):
        missing = next(name for name in _COVARIANCE if name not in present)
        raise DataError(f"the column {missing} is missing", table.path, table.header_line)
    if present:
        covariance = np.column_stack([table.finite_numbers(name) for name in _COVARIANCE]).reshape(-1, 3)
    else:
        std = _column(table, "std_m", 0.0)
        _refuse(table, ~(std >= 0.0), "std_m: expected a number from 0")
        covariance = np.column_stack([std**2, np.zeros_like(std), std**2])
    xx, xy, yy = covariance.T
    _refuse(table, (xx < 0.0) | (yy < 0.0) | (xx * yy < xy**2), "the covariance is not positive definite")
    return covariance


def _roles(table: CsvTable, covariance: Floats) -> tuple[Role, ...]:
    """As written; without the column what has a covariance is a prior, and what has none is fixed."""
    written = _texts(table, "role")
    roles: list[Role] = []
    definite = covariance[:, 0] * covariance[:, 2] > covariance[:, 1] ** 2
    for text, sure, line in zip(written, definite, table.lines, strict=True):
        role = next((role for role in ROLES if role == text.lower()), None)
        if text and role is None:
            raise DataError(f"role: got {text}, expected {' or '.join(ROLES)}", table.path, line)
        role = role or ("prior" if sure else "fixed")
        if role == "prior" and not sure:
            raise DataError("a prior landmark needs a positive definite covariance", table.path, line)
        roles.append(role)
    return tuple(roles)


def _classes(table: CsvTable) -> tuple[tuple[str, ...], Ints]:
    texts = ["" if nobody_knows(text) else text for text in _texts(table, "class")]
    names = tuple(sorted({text for text in texts if text}))
    return names, np.array([names.index(text) if text else -1 for text in texts], dtype=np.int64)


def _refuse(table: CsvTable, wrong: Sequence[bool] | np.ndarray, why: str) -> None:
    mask = np.asarray(wrong, dtype=bool)
    if mask.any():
        raise DataError(why, table.path, table.lines[int(np.argmax(mask))])


EXPORTS = ("csv", "geojson", "g2o")


def exported(chart: Map, to: str) -> str:
    """A map as the text of a file for other programs. Errors: `ConfigError` for another format."""
    landmarks = chart.landmarks
    if to == "csv":
        return _table_text(chart)
    if to == "geojson":
        features = landmarks.to_geojson(coordinates="local_metres")
        for feature, role, note in zip(features["features"], chart.role, chart.note, strict=True):
            feature["properties"] |= {"role": role, "note": note or None}
        return to_json({**features, "frame": chart.frame})
    if to == "g2o":
        lines = [f"VERTEX_XY {row} {x!r} {y!r}" for row, (x, y) in enumerate(landmarks.mean_m.tolist())]
        fixed = [f"FIX {row}" for row, role in enumerate(chart.role) if role == "fixed"]
        return "\n".join([*lines, *fixed]) + "\n"
    raise ConfigError(f"--to {to}: expected one of {', '.join(EXPORTS)}")

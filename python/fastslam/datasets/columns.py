"""What the columns of a table mean: names that people use, and units that the names state.

`Range [mm]`, `range_mm` and `distance_mm` are one quantity, and its unit is converted since the name says
it. A name without a unit is taken as SI, which is noted. Nothing is guessed from the values.
"""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from numpy.typing import NDArray

from ..errors import DataError
from .csv_table import CsvTable

_LENGTHS = {"m": 1.0, "mm": 1e-3, "cm": 1e-2, "dm": 0.1, "km": 1e3, "ft": 0.3048, "feet": 0.3048}
_LENGTHS |= {"metre": 1.0, "metres": 1.0, "meter": 1.0, "meters": 1.0}
_ANGLES = {"rad": 1.0, "mrad": 1e-3, "deg": math.pi / 180, "°": math.pi / 180}
_ANGLES |= {"radian": 1.0, "radians": 1.0, "degree": math.pi / 180, "degrees": math.pi / 180}
_TIMES = {"s": 1.0, "sec": 1.0, "secs": 1.0, "second": 1.0, "seconds": 1.0}
_TIMES |= {"ms": 1e-3, "msec": 1e-3, "msecs": 1e-3, "millis": 1e-3, "us": 1e-6, "µs": 1e-6, "usec": 1e-6}
_TIMES |= {"ns": 1e-9, "nsec": 1e-9, "nsecs": 1e-9, "nanosec": 1e-9, "nanosecs": 1e-9}


def _units() -> dict[str, tuple[str, float]]:
    """SI unit and factor to it of every unit, by the text that ends a name or stands in brackets."""
    units = {name: ("s", factor) for name, factor in _TIMES.items()}
    for si, plain in (("m", _LENGTHS), ("rad", _ANGLES)):
        for name, factor in plain.items():
            units[name] = (si, factor)
            for pattern in ("{}_per_s", "{}_s", "{}ps", "{}_per_sec", "{}_sec"):
                units[pattern.format(name)] = (f"{si}_per_s", factor)
            for pattern in ("{}2", "{}²", "{}_2"):
                units[pattern.format(name)] = (f"{si}2", factor**2)
    units |= {text: ("m_per_s", 1 / 3.6) for text in ("km_per_h", "km_h", "kmh", "kph", "kmph")}
    units |= {text: ("rad_per_s", 2 * math.pi / 60) for text in ("rpm", "rev_per_min")}
    units["dps"] = ("rad_per_s", math.pi / 180)
    for length, metres in _LENGTHS.items():
        for angle, radians in _ANGLES.items():
            units[f"{length}_{angle}"] = ("m_rad", metres * radians)
    return units


UNITS = _units()
_LONGEST_UNIT = max(unit.count("_") for unit in UNITS) + 1
_PREFIXES = ("field", "msg", "header", "pose", "twist", "odom", "odometry")
"""Words that a path into a message puts before the name that counts (`twist.twist.linear.x`)."""


@dataclass(frozen=True)
class Quantity:
    """One column that a reader knows: its canonical name, which ends in its SI unit, and other names for it.

    `unit` is empty for text and for numbers without a unit.
    """

    name: str
    aliases: tuple[str, ...] = ()
    unit: str = ""
    is_text: bool = False

    @property
    def words(self) -> tuple[str, ...]:
        """The names without unit."""
        return (self.name.removesuffix(f"_{self.unit}") if self.unit else self.name, *self.aliases)


def plain_name(written: str) -> str:
    """A name in small letters with single underscores: `Linear.X` and `linear x` are `linear_x`."""
    parted = re.sub(r"(?<=[a-z0-9])(?=[A-Z][a-z])", "_", written.strip().lstrip("%"))
    return re.sub(r"[\s.\-/_:]+", "_", parted).strip("_").lower()


def split_unit(written: str) -> tuple[str, str]:
    """Quantity and unit as written: `Range [mm]` and `range_mm` give (`range`, `mm`); no unit gives ''."""
    bracketed = re.fullmatch(r"(.*?)\s*[\[(]\s*([^\])]*?)\s*[\])]\s*", written)
    if bracketed is not None:
        return plain_name(bracketed[1]), plain_name(bracketed[2].replace("^", ""))
    name = plain_name(written)
    parts = name.split("_")
    for length in range(min(_LONGEST_UNIT, len(parts) - 1), 0, -1):
        unit = "_".join(parts[-length:])
        if unit in UNITS:
            return "_".join(parts[:-length]), unit
    return name, ""


def name_columns(table: CsvTable, known: Sequence[Quantity], *, ignored: Iterable[str] = ()) -> CsvTable:
    """The table with canonical names, and with the factor to SI of every column; notes say what was assumed.

    `ignored` are names of columns that nothing is done with. Errors: DataError with the line of the header
    for a column that is not known, has no name or a unit of another kind, or for two of one meaning.
    """
    left_out = {plain_name(name) for name in ignored}
    meanings: dict[str, tuple[Quantity, str]] = {}
    notes = list(table.notes)
    unnamed = _index_column(table)
    for written in table.index_of:
        found = _meaning(written, known)
        if found is not None:
            meanings[written] = found
        elif written == unnamed:
            continue
        elif split_unit(written)[0] in left_out:
            notes.append(f"{table.path.name}: column {written} is not used")
        else:
            raise DataError(_unknown(written, known, meanings), table.path, table.header_line)
    _check_distinct(table, meanings)
    factors = {
        quantity.name: _factor(table, name, quantity, unit) for name, (quantity, unit) in meanings.items()
    }
    notes += [
        f"{table.path.name}: column {written} names no unit: taken as {quantity.name}"
        for written, (quantity, unit) in meanings.items()
        if quantity.unit and not unit
    ]
    named = {quantity.name: written for written, (quantity, _) in meanings.items()}
    return replace(
        table,
        index_of={name: table.index_of[written] for name, written in named.items()},
        factors=factors,
        written_as=named,
        parsed=_parsed(table, {written: quantity for written, (quantity, _) in meanings.items()}),
        notes=tuple(notes),
    )


def _parsed(table: CsvTable, quantities: Mapping[str, Quantity]) -> dict[str, NDArray[Any]]:
    """The known columns of a plain table; none where the table needs a closer look."""
    is_text = [written not in quantities or quantities[written].is_text for written in table.index_of]
    columns = table.body.parse(is_text)
    if columns is None:
        return {}
    found = {quantity.name: columns[table.index_of[written]] for written, quantity in quantities.items()}
    return {name: column for name, column in found.items() if column is not None}


def _check_distinct(table: CsvTable, meanings: Mapping[str, tuple[Quantity, str]]) -> None:
    first_of: dict[str, str] = {}
    for written, (quantity, _) in meanings.items():
        first = first_of.setdefault(quantity.name, written)
        if first != written:
            message = f"columns {first} and {written} both give {quantity.name}: remove one"
            raise DataError(message, table.path, table.header_line)


def _meaning(written: str, known: Sequence[Quantity]) -> tuple[Quantity, str] | None:
    """The quantity that a name stands for, and the unit that it states.

    Where several bear the name, as the speeds of a wheel along and around, the unit decides.
    """
    name, unit = split_unit(written)
    kind = UNITS.get(unit, ("", 1.0))[0]
    for candidate, stated in ((plain_name(written), ""), (name, unit)):
        forms = {candidate, _without_prefixes(candidate)}
        fitting = [q for q in known if (q.unit or not stated) and not forms.isdisjoint(q.words)]
        if fitting:
            return next((q for q in fitting if q.unit == kind), fitting[0]), stated
    return None


def _without_prefixes(name: str) -> str:
    parts = name.split("_")
    while len(parts) > 1 and parts[0] in _PREFIXES:
        parts = parts[1:]
    return "_".join(parts)


def _factor(table: CsvTable, written: str, quantity: Quantity, unit: str) -> float:
    if not unit:
        return 1.0
    kind, factor = UNITS.get(unit, ("", 1.0))
    if kind != quantity.unit:
        message = f"column {written}: got the unit {unit}, expected {quantity.unit} ({quantity.name})"
        raise DataError(message, table.path, table.header_line)
    return factor


def _index_column(table: CsvTable) -> str | None:
    """A column without a name that counts the rows, as data frames write it, or that is empty.

    Errors: DataError for a column without a name that holds anything else.
    """
    unnamed = next((name for name in table.index_of if not name or name.lower().startswith("unnamed:")), None)
    if unnamed is None:
        return None
    texts = [text.strip() for text in table.texts(unnamed)]
    counts = (list(map(str, range(start, start + len(texts)))) for start in (0, 1))
    if any(texts) and texts not in counts:
        raise DataError("a column has no name: name it, or remove it", table.path, table.header_line)
    return unnamed


def _in_unit(quantity: str, unit: str) -> str:
    """A quantity's name with a unit of the same kind as its own, which the rows are in; else as it is."""
    name, own = split_unit(quantity)
    same_kind = unit in UNITS and own in UNITS and UNITS[unit][0] == UNITS[own][0]
    return f"{name}_{unit}" if same_kind else quantity


def _unknown(written: str, known: Sequence[Quantity], present: Mapping[str, tuple[Quantity, str]]) -> str:
    there = {quantity.name for quantity, _ in present.values()}
    open_names = [quantity.name for quantity in known if quantity.name not in there]
    name, unit = split_unit(written)
    words = {word: quantity.name for quantity in known for word in (quantity.name, *quantity.words)}
    near = difflib.get_close_matches(plain_name(written), words, n=1) or difflib.get_close_matches(
        name, words, n=1
    )
    hint = f", did you mean {_in_unit(words[near[0]], unit)}?" if near else ", or remove it"
    shown = written or "(no name)"
    return f"unknown column: got {shown}, expected {','.join(open_names)}{hint}"

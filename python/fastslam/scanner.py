"""A laser scanner on a robot that drives: its turns are rows of the stream, landmarks are detected inside."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ._given import numbers, shown
from ._yaml import YamlError, parse_yaml
from .detection import SCHEMA, configure_detector
from .errors import ConfigError, DataError
from .log import BeamGeometry, Floats, Log

_NUMBERS = tuple(known.name for known in fields(BeamGeometry))


@dataclass(frozen=True)
class Scanner:
    """Where the beams of a laser point, and how landmarks are found in its scans.

    It sits where `sensor.mounting` of the robot's configuration says. `detector` is laid over the defaults of
    `docs/detectors.md`.
    """

    geometry: BeamGeometry
    detector: Mapping[str, Any] = field(default_factory=dict)

    @classmethod
    def of(cls, log: Log) -> Scanner:
        """The scanner of a log with scans. Errors: `DataError` for one without."""
        if log.scans is None:
            raise DataError("the log holds no laser scans", log.source)
        return cls(log.scans.geometry, log.scans.detector)

    @classmethod
    def load(cls, path: Path | str) -> Scanner:
        """The scanner that a YAML file describes: the fields of `BeamGeometry`, and a section `detector`.

        Errors: `ConfigError` for a file that cannot be read, a field that is missing, unknown or no number.
        """
        layer = _read(Path(path))
        detector = layer.pop("detector", {})
        unknown = sorted(set(layer) - set(_NUMBERS))
        if unknown or not isinstance(detector, Mapping):
            what = f"{unknown[0]}: unknown key" if unknown else f"detector: got {shown(detector)}"
            raise ConfigError(f"{path}: {what}; expected {', '.join(_NUMBERS)} and a section detector")
        for name in _NUMBERS[:-1] if layer.get("beam_period_s") is None else _NUMBERS:
            if isinstance(layer.get(name), bool) or not isinstance(layer.get(name), int | float):
                raise ConfigError(f"{path}: {name}: got {shown(layer.get(name))}, expected a number")
        try:
            configure_detector(detector)
        except ConfigError as error:
            raise ConfigError(f"{path}: detector: {error}") from None
        return cls(BeamGeometry(**layer), detector)

    def with_detector(self, detector: Mapping[str, Any]) -> Scanner:
        """The scanner with these settings over those of its detector."""
        return replace(self, detector=SCHEMA.merge(self.detector, detector))

    def to_json(self) -> tuple[str, str]:
        """The settings of the detector and the geometry. Errors: `ConfigError`."""
        return configure_detector(self.detector).to_json(), json.dumps(asdict(self.geometry))


def _read(path: Path) -> dict[str, Any]:
    try:
        layer, _ = parse_yaml(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ConfigError(f"{path}: {error.strerror or error}") from None
    except UnicodeDecodeError as error:
        raise ConfigError(f"{path}: not UTF-8 text ({error.reason} at byte {error.start})") from None
    except YamlError as error:
        raise ConfigError(f"{path}:{error.line or 1}: {error.message}") from None
    if not isinstance(layer, dict):
        raise ConfigError(f"{path}:1: expected lines of `key: value`")
    return layer


def checked_turn(ranges_m: ArrayLike, intensities: ArrayLike | None) -> tuple[Floats, Floats | None]:
    """One turn of a laser as arrays (B,). Errors: `DataError` for another shape, or what is no number."""
    columns = []
    for name, values in (("ranges_m", ranges_m), ("intensities", intensities)):
        column = None if values is None else numbers(name, values)
        if column is not None and column.ndim != 1:
            raise DataError(f"{name}: got shape {column.shape}, expected one number per beam")
        columns.append(column)
    turn, strength = columns
    return np.empty(0) if turn is None else turn, strength

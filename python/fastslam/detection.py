"""From laser scans to sightings of landmarks."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from . import _core
from .config import Config
from .errors import DataError
from .log import Floats, Ints, Log, Scans, Sightings
from .settings import Layer, Schema, Settings
from .several import refuse_several

SCHEMA = Schema(_core.detector_schema, _core.resolve_detector, explained_by="docs/detectors.md")
"""The settings of the detectors."""


@dataclass(frozen=True)
class Detections:
    """What a detector found, in the order of scans and beams, in the sensor frame at the stamp of the scan.

    Shapes: all (D,) but `covariance` (D, 3), that of range and bearing as (m², m·rad, rad²). `signature` is a
    diameter in metres and `intensity` that of the strongest echo; both NaN where unknown.
    """

    scan_index: Ints
    stamp_s: Floats
    range_m: Floats
    bearing_rad: Floats
    covariance: Floats
    signature: Floats
    intensity: Floats
    detection_probability: Floats
    first_beam: Ints
    last_beam: Ints


@dataclass(frozen=True)
class Pieces:
    """What the scans were cut into, in the order of scans and beams, and what became of each piece.

    Shapes: all (P,). A piece spans the beams from `first_beam` to `last_beam`, over the seam of a full turn
    where the last is below the first; beams without an echo lie within. `verdict` indexes VERDICTS.
    """

    scan_index: Ints
    first_beam: Ints
    last_beam: Ints
    verdict: Ints


VERDICTS: tuple[str, ...] = tuple(_core.verdicts())
"""Why a piece of a scan is a landmark, which is the first, or why not."""


def configure_detector(*layers: Layer) -> Settings:
    """Detector settings: `layers` over the defaults, later ones winning. Errors: ConfigError."""
    return SCHEMA.resolve(*layers)


def find(scans: Scans, config: Layer | None = None, *, twists: Floats | None = None) -> Detections:
    """Run the detector that `config` chooses over scans.

    `twists` (N, 3) is the velocity of the sensor at each scan: forward and left in m/s, turn in rad/s, in its
    own frame; it corrects the motion within a scan where the geometry has a `beam_period_s`. Errors:
    ConfigError, DataError for scans whose shapes or geometry make no sense.
    """
    return explain(scans, config, twists=twists)[0]


def explain(
    scans: Scans, config: Layer | None = None, *, twists: Floats | None = None
) -> tuple[Detections, Pieces]:
    """The same as `find`, with what the scans were cut into and why each piece is a landmark or is not."""
    settings = configure_detector(config or {})
    if scans.ranges_m.ndim != 2:
        raise DataError(f"scans: got ranges_m of shape {scans.ranges_m.shape}, expected (N, B)")
    try:
        found, pieces = _core.detect(
            settings.to_json(),
            json.dumps(asdict(scans.geometry)),
            scans.stamp_s,
            scans.ranges_m,
            scans.intensities,
            twists,
        )
    except (ValueError, TypeError) as error:
        raise DataError(f"scans: {error}") from None
    return Detections(**found), Pieces(**pieces)


def detect(log: Log, config: Layer | None = None) -> Log:
    """The log with the detections in its scans as its sightings; identities are unknown.

    `config` is laid over the detector settings of the scans. The sensor's mounting in the log's settings
    becomes that of the scans. Errors: DataError for a log without scans, ConfigError.
    """
    if log.scans is None:
        raise DataError("the log holds no laser scans to detect landmarks in", log.source)
    settings = SCHEMA.merge(log.scans.detector, config or {})
    try:
        detections = find(log.scans, settings, twists=sensor_twists(log))
    except DataError as error:
        raise DataError(str(error), log.source) from None
    unknown = np.full(len(detections.stamp_s), -1, dtype=np.int64)
    sightings = Sightings(
        stamp_s=detections.stamp_s,
        range_m=detections.range_m,
        bearing_rad=detections.bearing_rad,
        identity=unknown,
        class_index=unknown.copy(),
        signature=detections.signature,
        covariance=detections.covariance,
    )
    config = _settings_with(log, log.scans)
    return replace(log, sightings=sightings, identity_names=(), class_names=(), config=config)


def own_settings(log: Log) -> dict[str, Any]:
    """The settings that a log brings to a run; before landmarks are detected those that it has afterwards.

    Detected landmarks have no names, and the sensor sits where the scanner does.
    """
    if log.scans is None or len(log.sightings.stamp_s) > 0:
        return dict(log.config)
    return _settings_with(log, log.scans)


def with_sightings(log: Log) -> Log:
    """The log itself, or with detections where it has scans and no sightings."""
    return detect(log) if log.scans is not None and len(log.sightings.stamp_s) == 0 else log


def _settings_with(log: Log, scans: Scans) -> dict[str, Any]:
    """The log's settings once landmarks are detected in the scans."""
    refuse_several(log.config, "the scans of a laser")
    sensor = {**log.config.get("sensor", {}), "mounting": _mounting(scans)}
    association = {**log.config.get("association", {}), "mode": "unknown"}
    return {**log.config, "sensor": sensor, "association": association}


def sensor_twists(log: Log) -> Floats | None:
    """Velocity of the sensor at each scan from the controls; None where motion within scans is not corrected.

    Shapes: (N, 3) as forward and left in m/s, turn in rad/s, in the sensor frame. A speed counts from its
    stamp on, a displacement from the stamp before up to its own; the robot stands where no row tells. Errors:
    ConfigError for the log's settings.
    """
    if log.scans is None or not log.scans.geometry.beam_period_s:
        return None
    config = Config.resolve(log.config, {"sensor": {"mounting": _mounting(log.scans)}})
    stamp_s = log.scans.stamp_s - config["sensor"]["delay_s"]
    return _core.sensor_twists(config.to_json(), log.controls.stamp_s, log.controls.values, stamp_s)


def _mounting(scans: Scans) -> dict[str, float]:
    return dict(zip(("x_m", "y_m", "yaw_rad"), scans.mounting, strict=True))

"""From laser scans to sightings of landmarks."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from . import _core
from .config import Config, detector_of
from .errors import ConfigError, DataError
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
    becomes that of the scans; its reach and its field of view do, where they are not stated. Errors:
    DataError for a log without scans, ConfigError.
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
    config = _settings_with(log, log.scans, settings)
    scans = replace(log.scans, detector=settings)
    return replace(log, sightings=sightings, identity_names=(), class_names=(), config=config, scans=scans)


def own_settings(log: Log) -> dict[str, Any]:
    """The settings that a log brings to a run; before landmarks are detected those that it has afterwards.

    Detected landmarks have no names, the sensor sits where the scanner does, and it reaches as far as the
    detector looks in its scans.
    """
    if log.scans is None or not detected_in_scans(log):
        return dict(log.config)
    return _settings_with(log, log.scans, log.scans.detector)


def detected_in_scans(log: Log) -> bool:
    """Whether the sightings of a run over a log, as it was read, are what is detected in its scans."""
    return log.scans is not None and len(log.sightings.stamp_s) == 0


def with_sightings(log: Log, config: Layer | None = None) -> Log:
    """The log itself, or with detections where it has scans and no sightings.

    `config` are settings of a run, whose section `detector` counts. Errors: as `with_detector`, `detect`.
    """
    log = with_detector(log, config or {})
    return detect(log) if detected_in_scans(log) else log


def with_detector(log: Log, *layers: Layer) -> Log:
    """The log with what the section `detector` of a run's settings says over the settings of its scans.

    Errors: `ConfigError` where there is such a section and nothing is detected in the log.
    """
    section = detector_of(*layers)
    if not section:
        return log
    if log.scans is None:
        raise ConfigError("detector: the log has no laser scans in which landmarks could be detected")
    settings = SCHEMA.merge(log.scans.detector, section)
    if settings == log.scans.detector:
        return log
    if not detected_in_scans(log):
        raise ConfigError("detector: the log has sightings already, so nothing is detected in its scans")
    return replace(log, scans=replace(log.scans, detector=settings))


def _settings_with(log: Log, scans: Scans, detector: Layer) -> dict[str, Any]:
    """The log's settings once landmarks are detected in the scans."""
    refuse_several(log.config, "the scans of a laser")
    sensor = {**_limits(scans, detector), **log.config.get("sensor", {}), "mounting": _mounting(scans)}
    association = {**log.config.get("association", {}), "mode": "unknown"}
    return {**log.config, "sensor": sensor, "association": association}


def _limits(scans: Scans, detector: Layer) -> dict[str, float]:
    """How far, and how far aside, landmarks are detected in scans; what is in view lies within.

    The middle of a thing lies behind its surface, which is what the detector's reach counts to.
    """
    settings = configure_detector(detector)
    own = settings[settings["kind"]]
    surface_m = min(scans.geometry.max_range_m, own.get("max_range_m", np.inf))
    limits = {"max_range_m": float(surface_m + 0.5 * own.get("max_diameter_m", 0.0))}
    view_rad = _view_rad(scans)
    return limits if view_rad is None else {**limits, "field_of_view_rad": view_rad}


def _view_rad(scans: Scans) -> float | None:
    """The opening angle, centred straight ahead, that the beams fill; None where none points ahead."""
    geometry, turn = scans.geometry, 2.0 * np.pi
    step, span = geometry.angle_step_rad, geometry.angle_step_rad * (scans.ranges_m.shape[-1] - 1)
    if abs(span) + 1.5 * abs(step) >= turn:
        return turn
    ends = sorted((geometry.first_angle_rad, geometry.first_angle_rad + span))
    shift = turn * np.ceil((ends[0] - abs(step)) / turn)
    right, left = ends[0] - shift, ends[1] - shift
    return float(min(turn, 2.0 * min(-right, left))) if right < 0.0 < left else None


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

"""Simulated logs with truth."""

from __future__ import annotations

import json
from functools import cache
from typing import Any

import numpy as np

from . import _core
from ._hints import meant
from .errors import ConfigError
from .log import BeamGeometry, Controls, Log, Scans, Sightings, TruthLandmarks, TruthTrajectory
from .measured import BOTH, measured_alone, measured_columns
from .settings import Layer, Schema, Settings
from .several import each_sensor, sensor_names

SCHEMA = Schema(_core.simulation_schema, _core.resolve_simulation, explained_by="fastslam simulate --explain")
"""The settings of a simulation."""

LEAST_RANGE_STD_M = 1e-3
"""The detector's noise of a perfect laser."""

MOST_CERTAIN = 0.99
"""A filter that was told that its detector never errs would believe the impossible."""


@cache
def presets() -> dict[str, dict[str, Any]]:
    """Complete settings of the ready-made simulations, by name."""
    return {name: json.loads(text) for name, text in _core.simulation_presets()}


def resolve_simulation(*layers: Layer, preset: str | None = None, landmarks: int | None = None) -> Settings:
    """Lays `layers` over a preset or the defaults; `landmarks` then scales the world at the same density.

    Errors: `ConfigError`, its message starting with the dotted key.
    """
    if preset is not None and preset not in presets():
        raise ConfigError(
            f"preset: got {preset}, expected one of {', '.join(presets())}{meant(preset, presets())}"
        )
    base: Layer = {} if preset is None else presets()[preset]
    settings = SCHEMA.resolve(base, *layers)
    if landmarks is None:
        return settings
    if landmarks < 1:
        raise ConfigError(f"landmarks: got {landmarks}, expected at least 1")
    try:
        return SCHEMA.resolve(json.loads(_core.simulation_with_landmarks(settings.to_json(), landmarks)))
    except ValueError as error:
        raise ConfigError(str(error)) from None


def simulate(settings: Layer, *, name: str = "simulated") -> Log:
    """Simulates a log. The same settings, seed included, give the same log to the last bit.

    >>> log = simulate({"seed": 4, "world": {"count": 25}})
    >>> len(log.truth_landmarks.names), log.controls.values.shape[1]
    (25, 2)

    Landmarks are named by their index; with `sensors` each sighting names the one that made it. By a sensor
    with `model: range` sightings have no bearing, with `bearing` no range. Errors: `ConfigError`
    for settings that are out of range or contradict each other (a field too small for its landmarks).
    """
    complete = settings if isinstance(settings, Settings) else SCHEMA.resolve(settings)
    sensors = sensor_names(complete)
    if complete["sensor"]["model"] == "own":
        raise ConfigError("sensor.model: got own, expected range_bearing, range or bearing for a simulation")
    model = complete["sensor"]["model"]
    if model != "range_bearing" and complete["scan"]["laser"] is not None:
        raise ConfigError(f"sensor.model: got {model}, expected range_bearing for a laser (scan.laser)")
    try:
        columns = _core.simulate(complete.to_json())
    except ValueError as error:
        raise ConfigError(str(error)) from None
    scans = _scans(columns, complete)
    names = tuple(str(index) for index in range(len(columns["landmark_position_m"])))
    x_m, y_m, heading_rad = columns["T_world_robot"][0].tolist()
    return Log(
        name=name,
        source="simulation",
        format="native",
        controls=Controls(columns["control_stamp_s"], columns["controls"]),
        sightings=_sightings(columns, complete),
        sensor_names=sensors if len(sensors) > 1 else (),
        # The scans of a laser say nothing of who is who.
        identity_names=names if scans is None else (),
        class_names=tuple(columns["class_names"]),
        truth_trajectory=TruthTrajectory(columns["truth_stamp_s"], columns["T_world_robot"]),
        truth_landmarks=TruthLandmarks(names, columns["landmark_position_m"]),
        scans=scans,
        config={
            "motion": json.loads(columns["motion"]),
            **({"sensors": dict(complete["sensors"])} if sensors else {}),
            **({} if sensors else {"sensor": json.loads(columns["sensor"])}),
            "initial_pose": {"x_m": x_m, "y_m": y_m, "heading_rad": heading_rad},
            **(_colours(complete) if complete["world"]["layout"] == "cones" and scans is None else {}),
        },
    )


def _colours(settings: Settings) -> dict[str, Any]:
    """How often the detector of a cone track tells blue from yellow right."""
    correct = min(1.0 - settings["classes"]["confusion_probability"], MOST_CERTAIN)
    return {"association": {"classes": {"number": 2, "correct_probability": max(correct, 0.5)}}}


def _scans(columns: dict[str, Any], settings: Settings) -> Scans | None:
    """The scans with the mounting and the noise of the simulated laser; None where there are sightings."""
    if "scan_stamp_s" not in columns:
        return None
    mounting, laser = settings["sensor"]["mounting"], settings["scan"]["laser"]
    return Scans(
        stamp_s=columns["scan_stamp_s"],
        ranges_m=columns["scan_ranges_m"],
        geometry=BeamGeometry(**json.loads(columns["scan_geometry"])),
        mounting=(mounting["x_m"], mounting["y_m"], mounting["yaw_rad"]),
        detector={"kind": "trunks", "trunks": {"range_std_m": max(laser["range_std_m"], LEAST_RANGE_STD_M)}},
    )


def _sightings(columns: dict[str, Any], settings: Settings) -> Sightings:
    sensors = each_sensor(settings)
    stamp_s, number = columns["sighting_stamp_s"], columns["sighting_sensor"].astype(np.int64)
    delay_s = np.array([sensor["delay_s"] for sensor in sensors])
    seen = Sightings(
        stamp_s=stamp_s + delay_s[number] if delay_s.any() else stamp_s,
        range_m=columns["range_m"],
        bearing_rad=columns["bearing_rad"],
        identity=columns["identity"],
        class_index=columns["class_index"],
        signature=columns["signature"],
        sensor_index=number if len(sensors) > 1 else None,
    )
    has = np.array([[c in measured_columns(sensor["model"]) for c in BOTH] for sensor in sensors])[number]
    seen = measured_alone(seen, has)
    return seen[np.argsort(seen.stamp_s, kind="stable")] if len(sensors) > 1 else seen

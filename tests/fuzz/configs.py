"""Configurations of runs, simulations and detectors: layers, YAML text and assignments."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from random import Random
from typing import Any

import numpy as np
from fastslam import FastSlam, _core
from fastslam._yaml import write_yaml
from fastslam.config import Config
from fastslam.detection import SCHEMA as DETECTOR
from fastslam.errors import FastSlamError
from fastslam.settings import KeyInfo, Schema
from fastslam.simulation import SCHEMA as SIMULATION
from fastslam.simulation import simulate

from .case import FaultError, check_finite, check_log, check_message
from .draws import WILD_OBJECTS, changed, encoded, wild_number, wild_text

RUN = Schema(_core.config_schema, _core.resolve_config, explained_by="fastslam config explain")
SCHEMAS = {"run": RUN, "simulation": SIMULATION, "detector": DETECTOR}
STARTS: tuple[dict[str, Any], ...] = (
    {},
    {"algorithm": "ekf"},
    {"algorithm": "fastslam1", "association": {"mode": "unknown", "method": "sampled"}},
    {"motion": {"model": "ackermann"}},
    {"motion": {"model": "increments"}},
    {"motion": {"model": "odometry"}},
    {
        "association": {
            "mode": "unknown",
            "detection_probability": 0.9,
            "clutter_density": 0.01,
            "method": "joint",
        }
    },
    {"association": {"classes": {"number": 3}, "signatures": {}}},
    {"sensor": {"tail_degrees_of_freedom": 4.0}, "filter": {"rejuvenation": {"every_steps": 2}}},
)
MOST_PARTICLES = 64
MOST_LANDMARKS, MOST_STEPS, MOST_BEAMS = 200, 400, 400
"""Larger ones are right and take their time: they are checked and not run."""


@dataclass(frozen=True)
class ConfigCase:
    """Settings as a program, a file or the command line gives them; `text` is what stands in a file."""

    schema: str
    layer: dict[str, Any] | None = None
    text: bytes | None = None
    assignments: tuple[str, ...] = ()

    def exercise(self, folder: Path) -> Counter[str]:
        """Reads the settings and works with those that are taken."""
        schema = SCHEMAS[self.schema]
        try:
            layer = self._read(folder, schema)
            settings = schema.resolve(layer)
            _check_values(settings)
        except FastSlamError as error:
            check_message(error)
            return Counter({"mutated": 1, "settings refused": 1})
        values = dict(settings)
        told = Counter({"mutated": 1, "settings taken": 1})
        try:
            if self.schema == "run":
                told["filters run"] += _filter(layer)
            elif self.schema == "simulation":
                told["worlds made"] += _world(values)
        except FastSlamError as error:
            check_message(error)
            told["filters or worlds refused"] += 1
        return told

    def _read(self, folder: Path, schema: Schema) -> Mapping[str, Any]:
        if self.layer is not None:
            return self.layer
        if self.text is None:
            return schema.parse_assignments(self.assignments)
        path = folder / "settings.yaml"
        path.write_bytes(self.text)
        return schema.load(path)

    def files(self) -> dict[str, bytes]:
        """The settings as they are given."""
        if self.text is not None:
            return {f"{self.schema}.yaml": self.text}
        given = self.assignments if self.layer is None else self.layer
        return {f"{self.schema}.txt": repr(given).encode("utf-8", "backslashreplace")}


def make(rng: Random) -> ConfigCase:
    """Settings with one to three changes."""
    name = rng.choice(("run", "run", "run", "simulation", "detector"))
    schema = SCHEMAS[name]
    layer = dict(rng.choice(STARTS)) if name == "run" else {}
    if name == "run":
        layer = schema.merge({"filter": {"particles": rng.randrange(1, 6)}}, layer)
    if name == "simulation":
        layer = {"world": {"count": 8}, "max_duration_s": 5.0}
    kind = rng.random()
    if kind < 0.15:
        return ConfigCase(
            name, assignments=tuple(_assignment(rng, schema) for _ in range(rng.randrange(1, 4)))
        )
    for _ in range(rng.choice((1, 1, 2, 3))):
        key = rng.choice(schema.keys)
        path = key.name.split(".")
        if key.only_for and rng.random() < 0.8:
            name_of_kind, _, kinds = key.only_for.partition(" = ")
            _set(layer, [*path[:-1], name_of_kind], rng.choice(kinds.split(" or ")))
        _set(layer, path, _value(rng, key))
    if kind < 0.75:
        return ConfigCase(name, layer=layer)
    try:
        text = encoded(write_yaml(layer))
    except Exception:  # What YAML cannot write is no file; the layer itself is a case.
        return ConfigCase(name, layer=layer)
    return ConfigCase(name, text=changed(rng, text))


def _value(rng: Random, key: KeyInfo) -> Any:
    """A value for a key: half of the time one that might be meant."""
    default = key.default
    if rng.random() < 0.5:
        if "|" in key.type and rng.random() < 0.9:
            return rng.choice(key.type.split(" | "))
        if isinstance(default, int) and not isinstance(default, bool):
            return rng.choice((0, 1, 2, 3, 5, 10, 100, rng.randrange(1000)))
        return (
            (default or 1.0) * rng.choice((0.0, 0.1, 0.5, 2.0, 10.0, 1e3, 1e-3, 1e9, 1e-9))
            if _is_number(default)
            else 1.0
        )
    kind = rng.random()
    if kind < 0.25:
        return rng.choice(WILD_OBJECTS)
    if kind < 0.4:
        return wild_text(rng)
    if kind < 0.6:
        return rng.choice((0, 1, -1, 2**31, 2**32, 2**53, 2**64, -(2**63), 1.5, 10**400))
    if kind < 0.7:
        return rng.choice(([], {}, None, True, [1.0], {"a": 1}, [0.0, 1.0], {"number": 3}, {"x_m": 1.0}))
    return wild_number(rng)


def _is_number(value: object) -> bool:
    return value is None or (isinstance(value, int | float) and not isinstance(value, bool))


def _set(layer: dict[str, Any], path: list[str], value: Any) -> None:
    for part in path[:-1]:
        below = layer.get(part)
        layer[part] = below = dict(below) if isinstance(below, dict) else {}
        layer = below
    layer[path[-1]] = value


def _assignment(rng: Random, schema: Schema) -> str:
    key = rng.choice(schema.keys)
    value = repr(key.default) if rng.random() < 0.2 else wild_text(rng)
    text = f"{key.name}={value}"
    return changed(rng, encoded(text)).decode("utf-8", "surrogateescape") if rng.random() < 0.3 else text


def _check_values(settings: Mapping[str, Any]) -> None:
    """No number of settings that were taken is infinite or none; JSON would not carry it."""
    try:
        json.dumps(dict(settings), allow_nan=False)
    except ValueError as error:
        raise FaultError(f"settings that are no JSON: {error}") from None


def _filter(layer: Mapping[str, Any]) -> int:
    """A filter with these settings over a short drive; 0 where it is too large to try."""
    config = Config.resolve(layer)
    if config["filter"]["particles"] > MOST_PARTICLES or config["filter"]["threads"] > 4:
        return 0
    robot = FastSlam(layer)
    count = len(_core.control_columns(config.to_json()))
    for step in range(4):
        info = robot.step(
            [0.5, 0.1, 0.05][:count],
            dt_s=0.1,
            range_m=[3.0 - 0.05 * step, 5.0, 2.0],
            bearing_rad=[0.5, -0.4, 1.2],
            identity=["oak", None, "elm"],
        )
        check_finite("step", np.array([info.log_likelihood, info.effective_sample_size, info.nis]))
    found = robot.landmarks
    check_finite("pose", *robot.pose)
    check_finite("landmarks", found.mean_m, found.covariance_m2)
    return 1


def _world(values: Mapping[str, Any]) -> int:
    """A simulated log; 0 where it is too large to try."""
    if _size(values) > 1:
        return 0
    check_log(simulate(values))
    return 1


def _size(values: Mapping[str, Any]) -> float:
    """How large a simulation is, 1 being the largest that is tried."""
    world, scan = values["world"], values["scan"]
    landmarks = world.get("count", world.get("rows", 0) * world.get("columns", 0)) or len(
        world.get("points_m", ())
    )
    if "track_length_m" in world:
        landmarks = world["track_length_m"] / world["spacing_m"]
    steps = (values["max_duration_s"] or float("inf")) / values["control_period_s"]
    laser = scan.get("laser")
    beams = 0.0 if laser is None else 2 * np.pi / laser["angle_step_rad"]
    return float(max(landmarks / MOST_LANDMARKS, steps / MOST_STEPS, beams / MOST_BEAMS))

"""Sequences of live calls with arguments that hurt."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from random import Random
from typing import Any

import numpy as np
from fastslam import FastSlam, run
from fastslam.errors import FastSlamError, NumericalError
from fastslam.log import Log

from .case import FaultError, check_finite, check_log, check_message, check_result
from .draws import WILD_OBJECTS, wild_number, wild_text

MOTIONS: tuple[tuple[dict[str, Any], int], ...] = (
    ({"model": "velocity"}, 2),
    ({"model": "velocity", "lateral_std_m_per_s": 0.1}, 2),
    ({"model": "ackermann"}, 2),
    ({"model": "odometry"}, 3),
    ({"model": "increments"}, 3),
)
ASSOCIATIONS: tuple[dict[str, Any], ...] = (
    {},
    {"mode": "unknown"},
    {"mode": "unknown", "method": "sampled"},
    {"mode": "unknown", "method": "assignment", "detection_probability": 0.9, "clutter_density": 0.01},
    {"mode": "unknown", "method": "joint", "detection_probability": 0.9, "clutter_density": 0.01},
    {"classes": {"number": 3, "correct_probability": 0.9}, "signatures": {}},
    {"mode": "unknown", "existence": {"removal": "when_missed"}, "merging": {"rule": "nearby"}},
)
MUTATED = 0.6
"""Share of the calls in which an argument is changed."""


@dataclass(frozen=True)
class Call:
    """One call by name; `mutated` where an argument is not what a program would pass."""

    name: str
    arguments: dict[str, Any]
    mutated: bool


@dataclass(frozen=True)
class CallCase:
    """A filter, or arrays for a log, and what is called."""

    config: dict[str, Any]
    identities: Any
    calls: tuple[Call, ...]

    def exercise(self, folder: Path) -> Counter[str]:
        """Makes all calls; those refused must leave the filter as it was."""
        told: Counter[str] = Counter()
        robot = FastSlam(self.config, identities=self.identities)
        for call in self.calls:
            told["mutated"] += call.mutated
            if call.name == "from_arrays":
                told[_arrays(call.arguments)] += 1
            else:
                told[_made(robot, call)] += 1
        return told

    def files(self) -> dict[str, bytes]:
        """The filter and its calls as text."""
        calls = "\n".join(f"{call.name} {call.arguments!r}" for call in self.calls)
        return {
            "calls.txt": f"{self.config!r} {self.identities}\n{calls}\n".encode("utf-8", "backslashreplace")
        }


def make(rng: Random) -> CallCase:
    """A filter of any kind and a dozen calls."""
    motion, columns = rng.choice(MOTIONS)
    config: dict[str, Any] = {
        "algorithm": rng.choice(("fastslam1", "fastslam2", "ekf")),
        "seed": rng.randrange(100),
        "filter": {"particles": rng.randrange(1, 9), "store": rng.choice(("dense", "tree", "lineage"))},
        "motion": motion,
        "association": {} if (ekf := rng.random() < 0.3) else rng.choice(ASSOCIATIONS),
    }
    if ekf:
        config["algorithm"], config["association"] = "ekf", rng.choice(({}, {"mode": "unknown"}))
    elif config["algorithm"] == "ekf":
        config["algorithm"] = "fastslam2"
    if rng.random() < 0.3:
        config["sensor"] = {"tail_degrees_of_freedom": rng.uniform(1.0, 9.0)}
    if rng.random() < 0.2 and config["algorithm"] != "ekf":
        config["filter"]["rejuvenation"] = {"every_steps": 3}
    calls = tuple(_calls(rng, columns, rng.randrange(6, 18)))
    return CallCase(config, rng.choice(("all", "some", "none")), calls)


def _calls(rng: Random, columns: int, count: int) -> Iterator[Call]:
    stamp_s = 0.0
    for _ in range(count):
        kind = rng.random()
        mutated = rng.random() < MUTATED
        if kind < 0.02:
            yield Call("from_arrays", _array_arguments(rng, columns, mutated), mutated)
            continue
        if kind < 0.04:
            yield Call("rejuvenate", {}, False)
            continue
        name = "predict" if kind < 0.25 else "update" if kind < 0.65 else "step"
        arguments: dict[str, Any] = {}
        if name != "update":
            arguments |= {"control": [rng.gauss(0.5, 0.5) for _ in range(columns)], "dt_s": 0.1}
            stamp_s += 0.1
        if name != "predict":
            arguments |= _scan(rng, rng.randrange(5), looks=name == "update")
        if name == "update":
            arguments["stamp_s"] = stamp_s
        if mutated:
            key = rng.choice(sorted(arguments))
            arguments[key] = _mutated(rng, arguments[key])
        yield Call(name, arguments, mutated)


def _scan(rng: Random, count: int, *, looks: bool) -> dict[str, Any]:
    scan: dict[str, Any] = {
        "range_m": [rng.uniform(0.5, 20.0) for _ in range(count)],
        "bearing_rad": [rng.uniform(-3.0, 3.0) for _ in range(count)],
    }
    if rng.random() < 0.7:
        scan["identity"] = [rng.choice((None, 0, 1, 2, "oak", "elm")) for _ in range(count)]
    if looks and rng.random() < 0.3:
        scan["covariance"] = [[rng.uniform(0.001, 0.1), 0.0, rng.uniform(1e-5, 0.01)] for _ in range(count)]
    if looks and rng.random() < 0.3:
        scan["class_index"] = [rng.randrange(-1, 3) for _ in range(count)]
        scan["signature"] = [rng.choice((float("nan"), 0.3, 1.0)) for _ in range(count)]
    return scan


def _mutated(rng: Random, value: Any) -> Any:
    """The value with a wild number in it, or another one altogether."""
    if rng.random() < 0.2:
        return rng.choice(WILD_OBJECTS)
    if isinstance(value, list):
        new = list(value)
        kind = rng.random()
        if kind < 0.1 or not new:
            return rng.choice((new[1:], [*new, *new], [new], np.array(new, dtype=object)))
        at = rng.randrange(len(new))
        if isinstance(new[at], list):
            new[at] = _mutated(rng, new[at])
        elif isinstance(new[at], float):
            new[at] = wild_number(rng, near=10.0) if kind < 0.85 else rng.choice(WILD_OBJECTS)
        else:
            new[at] = rng.choice((wild_text(rng), wild_number(rng), rng.choice(WILD_OBJECTS)))
        return new
    return wild_number(rng)


def _array_arguments(rng: Random, columns: int, mutated: bool) -> dict[str, Any]:
    scans, rows = rng.randrange(4), rng.randrange(1, 6)
    arguments: dict[str, Any] = {
        "control_stamp_s": [0.1 * row for row in range(rows)],
        "controls": [[rng.gauss(0.5, 0.5) for _ in range(columns)] for _ in range(rows)],
        "sighting_stamp_s": [rng.uniform(0.0, 0.6) for _ in range(scans)],
        "range_m": [rng.uniform(0.5, 20.0) for _ in range(scans)],
        "bearing_rad": [rng.uniform(-3.0, 3.0) for _ in range(scans)],
        "identities": [rng.choice((None, "a", 1)) for _ in range(scans)],
        "model": {2: "velocity", 3: rng.choice(("odometry", "increments"))}[columns],
    }
    if mutated:
        key = rng.choice([name for name in sorted(arguments) if name != "model"])
        arguments[key] = _mutated(rng, arguments[key])
    return arguments


def _arrays(given: dict[str, Any]) -> str:
    """A log from arrays, and a run of it."""
    try:
        log = Log.from_arrays(
            (given["control_stamp_s"], given["controls"]),
            (given["sighting_stamp_s"], given["range_m"], given["bearing_rad"]),
            identities=given["identities"],
            config={"motion": {"model": given["model"]}},
        )
        check_log(log)
        stamps = np.concatenate([log.controls.stamp_s, log.sightings.stamp_s])
        period_s = max(0.5, float(np.ptp(stamps)) / 500.0) if len(stamps) else 0.5
        check_result(run(log, {"filter": {"particles": 3, "path_period_s": period_s}}))
    except FastSlamError as error:
        check_message(error)
        return "log refused"
    return "log run"


def _made(robot: FastSlam, call: Call) -> str:
    methods: dict[str, Callable[..., Any]] = {
        "predict": robot.predict,
        "update": robot.update,
        "step": robot.step,
        "rejuvenate": robot.rejuvenate,
    }
    before = _state(robot)
    try:
        info = methods[call.name](**call.arguments)
    except FastSlamError as error:
        check_message(error)
        _check_state(robot)
        failed = isinstance(error, NumericalError)
        # The motion of a step whose scan fails stays.
        same = all(map(np.array_equal, before, _state(robot)))
        if not same and not (failed and call.name == "step"):
            raise FaultError(f"{call.name} was refused ({error}) and yet the filter changed") from error
        return "call failed" if failed else "call refused"
    _check_state(robot)
    if call.name in ("update", "step"):
        check_finite("step", np.array([info.log_likelihood, info.effective_sample_size, info.nis]))
    return "call taken"


def _state(robot: FastSlam) -> tuple[np.ndarray, ...]:
    found = robot.landmarks
    flat = np.concatenate([found.mean_m.ravel(), found.covariance_m2.ravel()])
    return (*robot.pose, *robot.particles, np.append(flat, len(robot.path.stamp_s)))


def _check_state(robot: FastSlam) -> None:
    check_finite("pose, particles and landmarks", *_state(robot))
    found = robot.landmarks
    if len(set(found.ids)) != len(found.ids):
        raise FaultError("two landmarks of one id")
    check_finite("path", robot.path.T_world_robot)

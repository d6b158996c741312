"""A log as the events that `fastslam live` reads."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from .errors import DataError
from .log import Floats, Log
from .several import numbers_of, sensor_names


def event_lines(log: Log, config: Mapping[str, Any]) -> Iterator[str]:
    """Lines of JSON in the order of their stamps, odometry before what was seen at the same moment.

    `config` is the complete configuration of a run over the log: where it has `association.classes` sightings
    tell their class, else the name of their landmark. Scans are told where there are no sightings.

    Errors: `DataError` for sightings that are not of range and bearing.
    """
    if config["sensor"]["model"] != "range_bearing":
        raise DataError("events of sightings have a range and a bearing; these have one of them", log.source)
    rows = [*_odometry(log), *(_seen(log, config) if len(log.sightings.stamp_s) else _turns(log))]
    # Sorted by the stamp alone, and stable.
    for _, event in sorted(rows, key=lambda row: row[0]):
        yield json.dumps(event, ensure_ascii=False)


def left_out(log: Log) -> tuple[str, ...]:
    """What a log has that events cannot say."""
    seen = log.sightings
    parts = {
        "covariances of sightings": seen.covariance is not None,
        "signatures": bool(np.isfinite(seen.signature).any()),
        "truth": log.truth_trajectory is not None or log.truth_landmarks is not None,
    }
    return tuple(name for name, there in parts.items() if there)


def _odometry(log: Log) -> Iterator[tuple[float, dict[str, Any]]]:
    covariance = log.controls.covariance
    for row, (stamp_s, values) in enumerate(
        zip(log.controls.stamp_s.tolist(), log.controls.values.tolist(), strict=True)
    ):
        event = {"t": stamp_s, "odom": values}
        if covariance is not None and np.isfinite(covariance[row]).all():
            event["cov"] = _whole(covariance[row]).tolist()
        yield stamp_s, event


def _whole(upper: Floats) -> Floats:
    """A symmetric matrix (3, 3) of its upper triangle by rows (6,)."""
    whole = np.zeros((3, 3))
    whole[np.triu_indices(3)] = upper
    return np.asarray(whole + np.triu(whole, 1).T)


def _seen(log: Log, config: Mapping[str, Any]) -> Iterator[tuple[float, dict[str, Any]]]:
    """A line for all that one sensor saw at one stamp."""
    seen, names = log.sightings, sensor_names(config)
    numbers = numbers_of(log, config)
    by = np.zeros(len(seen.stamp_s), dtype=np.int64) if numbers is None else numbers.astype(np.int64)
    order = np.lexsort((np.arange(len(by)), by, seen.stamp_s))
    stamps, sensors = seen.stamp_s[order], by[order]
    begins = np.flatnonzero(np.append(True, (np.diff(stamps) != 0.0) | (np.diff(sensors) != 0)))
    for rows in np.split(order, begins[1:]):
        event: dict[str, Any] = {
            "t": float(seen.stamp_s[rows[0]]),
            "see": [_sighting(log, row, config) for row in rows.tolist()],
        }
        if names:
            event["sensor"] = names[by[rows[0]]]
        yield event["t"], event


def _sighting(log: Log, row: int, config: Mapping[str, Any]) -> list[Any]:
    seen = log.sightings
    named = config["association"]["classes"] is None
    index = int((seen.identity if named else seen.class_index)[row])
    texts = log.identity_names if named else log.class_names
    label = [texts[index]] if 0 <= index < len(texts) else []
    # What a sensor does not measure is null: JSON has no NaN.
    return [*_beams(np.array([seen.range_m[row], seen.bearing_rad[row]])), *label]


def _turns(log: Log) -> Iterator[tuple[float, dict[str, Any]]]:
    if log.scans is None:
        return
    # What went farther than a laser sees has hit nothing, which JSON has no infinity to say.
    ranges_m, echoes = np.minimum(log.scans.ranges_m, log.scans.geometry.max_range_m), log.scans.intensities
    for row, stamp_s in enumerate(log.scans.stamp_s.tolist()):
        event: dict[str, Any] = {"t": stamp_s, "scan": _beams(ranges_m[row])}
        if echoes is not None:
            event["echo"] = _beams(echoes[row])
        yield stamp_s, event


def _beams(turn: Floats) -> list[float | None]:
    return [one if math.isfinite(one) else None for one in turn.tolist()]

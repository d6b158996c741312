"""The filter step by step, for live streams; `fastslam.run` takes a whole log at once."""

from __future__ import annotations

import json
import math
import threading
from collections import ChainMap
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from . import _core
from .config import Config, detector_of
from .covariances import symmetric
from .errors import ConfigError, DataError, NumericalError
from .health import reason_names, status_name
from .limits import stamp_fault
from .log import Floats
from .maps import Map, StartLike, core_start, first_free_number
from .noise import Told
from .result import LandmarkMap, StepFields, Trajectory
from .scan_call import Identity, Scan, checked_scan, column, measured_scan, number
from .sensor_checks import begun
from .sensors import Adapter, Sensor, adapted, own_layer
from .settings import Layer
from .several import sensor_names, sensor_number
from .unused import Unused


@dataclass(frozen=True)
class StepInfo(StepFields[float, int, bool, str, tuple[str, ...]]):
    """What one update did, with how the innovations lately contradict the configured noise."""

    warnings: tuple[str, ...]

    @property
    def nis_band(self) -> tuple[float, float]:
        """What holds 95 % of the means `nis` when the noise is right."""
        return (self.nis_band_low, self.nis_band_high)


class FastSlam:
    """FastSLAM over a stream: `predict` for every control, `update` for every scan, state as arrays.

    `config` is laid over the defaults. `identities` says whether all sightings of the stream will name their
    landmark, some, or none; with `all` a sighting that does not is skipped and counted. Names and numbers are
    one: `7` and `"7"` are the same landmark.

    >>> robot = FastSlam({"filter": {"particles": 50}})
    >>> robot.predict([1.0, 0.0], dt_s=0.1)
    >>> info = robot.update(0.1, range_m=[2.0, 3.0], bearing_rad=[0.5, -0.4], identity=["oak", "elm"])
    >>> info.new_landmarks, sorted(robot.landmarks.ids)
    (2, ['elm', 'oak'])

    With `map` it begins in a map that was kept, and with `start` at a pose that is not known exactly
    (`fastslam.maps.Start`), or at one of several; the map's landmarks keep their ids. Names count as those of
    sightings, but for running numbers such as `L7`.

    `sensor` is one of your own (`fastslam.sensors.Sensor`): `update` takes the columns that it measures, and
    what it answers wrong, or fails at, is a `ModelError`: at once for what is wrong at most poses, later one
    that changes nothing.

    A call that raises `DataError` changes nothing. A `NumericalError` says that no particle can explain a
    scan, or that it would leave numbers that are none: the filter is as it was before the scan, to the last
    bit, and the stream may go on; the motion before the scan stays.
    `save` and `load` keep a filter in a file; it may be pickled and deep-copied. Whatever goes on from there
    gives the bits that this one would have given.

    Several threads may share one filter: each call sees it between two calls of the others, and the
    interpreter is free while the filter works.

    Errors: `ConfigError` for the configuration, `ModelError` for `sensor`.
    """

    def __init__(
        self,
        config: Layer | None = None,
        *,
        identities: Literal["all", "some", "none"] = "some",
        map: Map | Path | str | None = None,
        start: StartLike = None,
        sensor: Sensor | None = None,
    ) -> None:
        self.config = Config.resolve(config or {}, own_layer(sensor))
        if detector_of(self.config):
            raise ConfigError("detector: FastSlam takes sightings; a Robot with a scanner detects them")
        adapter = begun(sensor)
        with core_errors():
            filter = _core.Filter(self.config.to_json(), identities, adapter)
        chart = Map.load(map) if isinstance(map, Path | str) else map
        columns: _core._MapColumns | None = None
        names: Sequence[str] = ()
        if chart is not None:
            identity, names = chart.identities(())
            columns = chart.core_columns(identity, chart.landmarks.class_names)
        with core_errors():
            filter.begin(columns, core_start(start))
        self._begin(filter, names, () if chart is None else chart.landmarks.ids, adapter)

    def _begin(
        self,
        filter: _core.Filter,
        names: Sequence[str],
        chart_ids: Sequence[str],
        adapter: Adapter | None,
    ) -> None:
        """Everything but the configuration, around a filter of the core at its start."""
        self._filter = filter
        self._adapter = adapter
        self._control_columns = _core.control_columns(self.config.to_json())
        self._index_of = {name: index for index, name in enumerate(names)}
        self._chart_ids = tuple(chart_ids)
        self._stamp_s = 0.0
        self._updated_s = -math.inf
        self._unused = Unused()
        self._told_noise = Told()
        # Held for a whole call, so that names, stamps and the core's state are of one moment.
        self._lock = threading.RLock()

    def save(self, path: Path | str) -> Path:
        """Writes the filter to a file, which is the old one or the new one whatever happens meanwhile.

        Errors: `DataError` where the file cannot be written.
        """
        from .resultfiles import write_atomically

        return write_atomically(Path(path), self._snapshot(), durable=True)

    @classmethod
    def load(cls, path: Path | str, *, sensor: Sensor | None = None) -> FastSlam:
        """The filter of a file that `save` wrote, with its configuration; `sensor` as it was made with.

        Errors: `DataError` for a file that cannot be read, is damaged, is of a format that this version
        does not read, or was written with a sensor of its own where none is given.
        """
        try:
            snapshot = Path(path).read_bytes()
        except OSError as error:
            raise DataError(f"cannot read: {error.strerror or error}", path) from None
        loaded = cls.__new__(cls)
        try:
            loaded._restore(snapshot, sensor)
        except DataError as error:
            raise DataError(str(error), path) from None
        return loaded

    def __getstate__(self) -> bytes | tuple[bytes, Sensor]:
        snapshot = self._snapshot()
        return snapshot if self._adapter is None else (snapshot, self._adapter.sensor)

    def _snapshot(self) -> bytes:
        with self._lock:
            updated_s = self._updated_s if math.isfinite(self._updated_s) else None
            note: dict[str, Any] = {
                "names": list(self._index_of),
                "stamp_s": self._stamp_s,
                "updated_s": updated_s,
            }
            note["unused"] = self._unused.to_json()
            if self._chart_ids:
                note["chart_ids"] = list(self._chart_ids)
            if self._told_noise.kept:
                note["told"] = self._told_noise.kept
            return self._filter.save(json.dumps(note))

    def __setstate__(self, state: bytes | tuple[bytes, Sensor]) -> None:
        self._restore(*((state, None) if isinstance(state, bytes) else state))

    def _restore(self, snapshot: bytes, sensor: Sensor | None) -> None:
        adapter = adapted(sensor)
        with core_errors():
            filter, config, note = _core.Filter.load(snapshot, adapter)
        if not note:
            raise DataError("the snapshot has no names of landmarks: it was not written by FastSlam.save")
        kept = json.loads(note)
        self.config = Config.resolve(json.loads(config))
        self._begin(filter, kept["names"], kept.get("chart_ids", ()), adapter)
        self._stamp_s = kept["stamp_s"]
        self._told_noise = Told(kept.get("told"))
        self._updated_s = -math.inf if kept["updated_s"] is None else kept["updated_s"]
        self._unused = Unused.of_json(kept.get("unused"))

    def predict(self, control: ArrayLike, dt_s: float) -> None:
        """Moves the robot: a control of the motion model (2 or 3 numbers) that acted for `dt_s`.

        Errors: `DataError` for another number of values, values that are not finite, or a motion that no
        robot makes.
        """
        values, seconds = self._control(control), number("dt_s", dt_s)
        with self._lock:
            with core_errors():
                self._filter.predict(values, seconds)
            self._stamp_s += seconds

    def update(
        self,
        stamp_s: float,
        *,
        range_m: ArrayLike | None = None,
        bearing_rad: ArrayLike | None = None,
        identity: Sequence[Identity] | None = None,
        covariance: ArrayLike | None = None,
        class_index: ArrayLike | None = None,
        signature: ArrayLike | None = None,
        sensor: str | None = None,
    ) -> StepInfo:
        """Corrects with the sightings of one scan, in the sensor's frame; none at all is a scan too.

        `sensor` names the one that made it where the configuration has several (`sensors`); two that look at
        one moment make two scans.

        Shapes: all (S,), of range and bearing those that the sensor measures; `covariance` (S, 3) is that of
        each range and bearing as (m², m·rad, rad²), NaN where the sensor's own noise holds. `class_index`
        (-1, NaN, None: none) and `signature` (NaN: none) count where `association.classes` and
        `association.signatures` are configured.
        Errors: `DataError` for columns of different lengths, bearings in degrees, a covariance that is none,
        a class that is not configured, a stamp before the last one or before the end of the last control, a
        sensor that there is not, or an identity that is neither name nor number; `NumericalError` when no
        particle can explain the scan.
        """
        stamp, by = number("stamp_s", stamp_s), sensor_number(self.config, sensor)
        measured = self._measured(range_m, bearing_rad, by)
        scan = checked_scan(self.config, measured, identity, covariance, class_index, signature)
        with self._lock:
            self._check_stamp(stamp)
            return self._told(stamp, scan, lambda columns: self._filter.update(stamp, columns, by))

    def step(
        self,
        control: ArrayLike,
        *,
        dt_s: float,
        range_m: ArrayLike | None = None,
        bearing_rad: ArrayLike | None = None,
        identity: Sequence[Identity] | None = None,
        sensor: str | None = None,
    ) -> StepInfo:
        """`predict`, then `update` at the time that the controls since the last update (or 0) add up to.

        `sensor` is as for `update`. Where the scan is refused the robot has not moved either.
        """
        by = sensor_number(self.config, sensor)
        values, seconds = self._control(control), number("dt_s", dt_s)
        seen = range_m is not None or bearing_rad is not None
        measured = self._measured(range_m, bearing_rad, by) if seen else self._measured((), (), by)
        scan = checked_scan(self.config, measured, identity)
        with self._lock:
            stamp = self._stamp_s + seconds

            def work(columns: _core._ScanColumns) -> dict[str, Any]:
                if not sensor_names(self.config):
                    return self._filter.step(values, seconds, stamp, columns)
                scan.check_lengths()
                self._filter.predict(values, seconds)
                return self._filter.update(stamp, columns, by)

            return self._told(stamp, scan, work, moved_s=seconds)

    def rejuvenate(self) -> bool:
        """Draws all particles anew from the posterior over paths, given the best particle's associations.

        For the end of a log, or a moment when the robot stands; by itself the filter does it as often as
        `filter.rejuvenation` says. Returns False when the filter is not set up for it
        (`filter.rejuvenation.every_steps` is 0), when nothing happened since the last time, or when no
        solution was found.
        """
        with self._lock:
            return self._filter.rejuvenate()

    @property
    def pose(self) -> tuple[Floats, Floats]:
        """Mean `T_world_robot` (3,) as x, y, heading and its covariance (3, 3), over all particles."""
        with self._lock:
            mean, covariance = self._filter.pose()
            return mean, symmetric(covariance)

    @property
    def particles(self) -> tuple[Floats, Floats]:
        """Poses `T_world_robot` (M, 3) and normalised weights (M,)."""
        with self._lock:
            return self._filter.particles()

    @property
    def landmarks(self) -> LandmarkMap:
        """The map of the mixture; landmarks without an identity are named `L<birth number>`."""
        with self._lock:
            return landmark_map(self._filter.map(), tuple(self._index_of), chart_ids=self._chart_ids)

    @property
    def path(self) -> Trajectory:
        """The path of the best particle so far."""
        with self._lock:
            return Trajectory(*self._filter.best_path())

    def _measured(
        self, range_m: ArrayLike | None, bearing_rad: ArrayLike | None, by: int
    ) -> tuple[Floats, Floats]:
        return measured_scan(self.config, self._adapter, range_m, bearing_rad, by)

    def _control(self, control: ArrayLike) -> list[float]:
        return checked_control(control, self._control_columns)

    def _check_stamp(self, stamp_s: float) -> None:
        fault = stamp_fault(stamp_s) if math.isfinite(stamp_s) else None
        if fault is not None:
            raise DataError(f"stamp_s: {fault}")
        if not (math.isfinite(stamp_s) and stamp_s >= self._updated_s):
            raise DataError(f"stamp_s: got {stamp_s}, expected a finite time not before {self._updated_s}")
        # The sum of many dt_s is rounded; a scan between two of them is another matter.
        slack_s = 1e-6 + 1e-9 * abs(self._stamp_s)
        moved = self._stamp_s > max(self._updated_s, 0.0)
        if moved and stamp_s < self._stamp_s - slack_s:
            raise DataError(
                f"stamp_s: got {stamp_s}, but the robot has been moved up to {self._stamp_s} s: "
                "predict only up to the scan, then update, then predict the rest"
            )

    def _told(
        self,
        stamp_s: float,
        scan: Scan,
        work: Callable[[_core._ScanColumns], dict[str, Any]],
        *,
        moved_s: float = 0.0,
    ) -> StepInfo:
        """Gives a scan to the core, perhaps after a motion; of a refused one no names and stamps are kept."""
        index_of = scan.new_names(self._index_of)
        columns = scan.columns(ChainMap(index_of, self._index_of))
        try:
            with core_errors():
                answer = work(columns)
        except NumericalError:
            # The motion of a step stays, and with it the time that it took.
            self._stamp_s += moved_s
            raise
        self._index_of.update(index_of)
        self._stamp_s = self._updated_s = stamp_s
        more = self._unused.of_step(stamp_s, answer, self.config)
        return step_info(answer, self.config, self._told_noise, more)


def step_info(answer: dict[str, Any], config: Config, told: Told, more: tuple[str, ...] = ()) -> StepInfo:
    """What the core says of a step, its codes as names; `told` are earlier warnings, `more` further ones."""
    answer["health"] = status_name(answer["health"])
    answer["health_reasons"] = reason_names(answer["health_reasons"])
    answer["warnings"] = (*told.sentences(answer["warnings"], config), *more)
    return StepInfo(**answer)


def checked_control(control: ArrayLike, columns: Sequence[str]) -> list[float]:
    """A control of the motion model as three numbers. Errors: `DataError` for another number of values."""
    given = column("control", control)
    if given.shape != (len(columns),):
        raise DataError(f"control: got shape {given.shape}, expected {', '.join(columns)}")
    return [*map(float, given), *(0.0,) * (3 - len(given))]


def landmark_map(
    columns: dict[str, np.ndarray],
    identity_names: tuple[str, ...],
    class_names: tuple[str, ...] = (),
    chart_ids: tuple[str, ...] = (),
) -> LandmarkMap:
    """A map of the core, its identities replaced by their names; no two landmarks share an id.

    Landmarks of the map that the filter began with keep the ids that they had there.
    """
    has_class = bool((columns["class_index"] >= 0).any())
    has_signature = bool(np.isfinite(columns["signature"]).any())
    return LandmarkMap(
        ids=_unique_ids(columns["birth"].tolist(), columns["identity"].tolist(), identity_names, chart_ids),
        mean_m=columns["mean_m"],
        covariance_m2=columns["covariance_m2"],
        sightings=columns["sightings"],
        confirmed=columns["confirmed"],
        class_index=columns["class_index"] if has_class else None,
        signature=columns["signature"] if has_signature else None,
        class_names=class_names if has_class else (),
    )


def _unique_ids(
    births: list[int],
    identities: list[int],
    identity_names: tuple[str, ...],
    chart_ids: tuple[str, ...] = (),
) -> tuple[str, ...]:
    """The name of each landmark, else `L<birth number>`; a second of one name gets `#2`, and so on.

    Names go first: a log may call a landmark `L7`, and a map may hold two that were seen under one name.
    Those of a given map, which have the lowest births, keep their ids, and no running number of theirs is
    given again.
    """
    taken: set[str] = set(chart_ids)
    ids = [chart_ids[birth] if birth < len(chart_ids) else "" for birth in births]
    offset = max(0, first_free_number(chart_ids) - len(chart_ids))
    new = (row for row in range(len(births)) if not ids[row])
    for row in sorted(new, key=lambda row: identities[row] < 0):
        name = f"L{births[row] + offset}" if identities[row] < 0 else identity_names[identities[row]]
        number, ids[row] = 1, name
        while ids[row] in taken:
            number += 1
            ids[row] = f"{name}#{number}"
        taken.add(ids[row])
    return tuple(ids)


@contextmanager
def core_errors() -> Iterator[None]:
    try:
        yield
    except ValueError as error:
        raise DataError(str(error)) from None
    except RuntimeError as error:
        raise NumericalError(str(error)) from None

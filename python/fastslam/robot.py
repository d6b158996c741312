"""A robot that drives: rows of odometry and sightings as they come, also late; estimates as arrays."""

from __future__ import annotations

import copy
import json
import threading
from collections import ChainMap
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from numpy.typing import ArrayLike

from . import _core
from ._built import built_version
from ._given import shown
from .config import Config, detector_of, merge
from .covariances import symmetric
from .errors import ConfigError, DataError, NumericalError
from .filter import checked_control, core_errors, landmark_map, step_info
from .log import Floats, Log
from .lost import Lost
from .maps import Anywhere, Changes, Map, StartLike, changes, core_start
from .noise import Told
from .result import LandmarkMap, RunResult, Trajectory
from .rows import Row
from .scan_call import (
    ClassName,
    Identity,
    checked_covariance,
    checked_scan,
    checked_stamp,
    class_numbers,
    measured_scan,
    number,
)
from .scanner import Scanner, checked_turn
from .sensor_checks import begun
from .sensors import Sensor, adapted, own_layer
from .settings import Layer, Partial
from .several import each_sensor, refuse_several, sensor_number
from .so_far import ANEW_S, SoFar
from .trust import KeptPlaces
from .unused import Unused
from .window import Step as Step
from .window import Window as Window

if TYPE_CHECKING:
    from .localisation import Mode
    from .searching import RobotSearch
    from .watching import View


LIVE: Partial = {"filter": {"rejuvenation": {"delay_scans": 10, "keyframes": 5000}}}
"""What a robot sets otherwise than the defaults: no step waits for a draw, and draws stay short for hours."""


class Robot:
    """The filter on a live stream. Every row has the stamp at which it was measured.

    `config` is laid over the defaults and `LIVE`, `identities` as for `FastSlam`. `classes` names the classes
    of `association.classes`; those seen beyond them are numbered as they come.

    >>> robot = Robot({"filter": {"particles": 50}}, window=Window(late_s=0.1))
    >>> steps = robot.odometry(0.0, [1.0, 0.0])
    >>> steps = robot.sightings(0.1, range_m=[2.0, 3.0], bearing_rad=[0.5, -0.4], identity=["oak", "elm"])
    >>> steps = robot.odometry(0.2, [1.0, 0.0]) + robot.odometry(0.4, [1.0, 0.0])
    >>> steps[0].stamp_s, steps[0].info.new_landmarks, robot.pose[0]
    (0.1, 2, 0.4)

    `odometry` and `sightings` return the steps that became possible. The rows of a log, in any order that the
    window allows, give the bits of `fastslam.run` with the robot's `config`. A call that raises `DataError`
    changes nothing. Rows that are late, repeated or too far ahead are refused and counted, and so are scans
    that no particle can explain: see `counts`. `save` and `load` keep the whole state, the rows that wait
    included; pickle works.

    With `map` it drives in a map that was kept, whose landmarks are what their roles say: fixed ones stay,
    prior ones improve, and new ones are added. With `keep` nothing changes that map: all of it is fixed, what
    does not fit is in `changes`, and `Robot.map` is the map that was given. With `start` it begins at
    a pose that is not known exactly (`fastslam.maps.Start`), or one of several. With `start=Anywhere()`, and
    in a map without `start` where `config` states no `initial_pose` either, it
    makes a map of its own until that fits the kept one at one place alone: until then it is `searching`, no
    steps are returned, `modes` says where it may be, and what needs a place in the map is a `DataError`.
    Then the rows so far are taken anew from there, and their steps returned. With a `scanner` it cannot be
    searched for, and begins at the origin instead. A robot in a map that is lost
    for longer than `lost.LOST_S` is searched for again in the same way; so is one by `relocalize`.

    `sensor` is one of your own (`fastslam.sensors.Sensor`), as for `FastSlam`. With `scanner` the robot takes
    raw turns of a laser by `scan`, and detects landmarks in them itself; a section `detector` of `config` is
    laid over that of the scanner.

    A draw of paths that is not done when it is due is waited for, and what comes out depends on nothing but
    the rows. With `late_draws="put_off"` no step waits: the filter goes on until the draw is done, `put_off`
    counts these steps, and what comes out depends on the machine.

    Several threads may share one robot: each call sees it between two calls of the others.

    Errors: `ConfigError` for the configuration, `DataError` for a window, map or start that is none.
    """

    _chart: Map | None
    _keep: bool
    _search: RobotSearch | None
    _step: Step | None
    _scanner: tuple[str, str] | None
    """Settings of the detector, and the geometry of the beams."""
    _late_draws: str
    _kept_places: KeptPlaces | None
    """What a verdict asks of the map that it is in."""
    _recent: tuple[float, tuple[str, ...]] | None
    """The verdict that was told last, and when."""
    _kept: list[Row] | None = None
    """Rows for a result, where somebody wants one."""
    _refused: dict[str, int]
    """By streams before this one."""

    def __init__(
        self,
        config: Layer | None = None,
        *,
        identities: Literal["all", "some", "none"] = "some",
        window: Window | None = None,
        classes: Sequence[str] = (),
        map: Map | Path | str | None = None,
        start: StartLike = None,
        keep: bool = False,
        sensor: Sensor | None = None,
        scanner: Scanner | None = None,
        late_draws: Literal["await", "put_off"] = "await",
    ) -> None:
        self.config = Config.resolve(LIVE, config or {}, own_layer(sensor))
        if (detector := detector_of(self.config)) and scanner is None:
            raise ConfigError("detector: only for turns of a laser, which a scanner describes (`scanner`)")
        if detector and scanner is not None:
            scanner = scanner.with_detector(detector)
        self._scanner = None if scanner is None else scanner.to_json()
        self._adapter = begun(sensor)
        chosen = window or Window()
        chart = Map.load(map) if isinstance(map, Path | str) else map
        if keep and chart is None:
            raise DataError("keep: needs a map that is kept")
        if chart is not None:
            refuse_several(self.config, "a robot in a kept map")
        if scanner is not None:
            refuse_several(self.config, "turns of a laser (`scanner`)")
        if late_draws not in ("await", "put_off"):
            raise DataError(f"late_draws: got {shown(late_draws)}, expected await or put_off")
        self._late_draws = late_draws
        self._kind = identities
        self._window = (number("late_s", chosen.late_s), number("wait_s", chosen.wait_s), chosen.gap_s)
        names: Sequence[str] = ()
        if chart is not None:
            _, names = chart.identities(())
            classes = tuple(dict.fromkeys((*classes, *chart.landmarks.class_names)))
        self._begin(self._fresh_stream(), names=names, classes=classes)
        self._be_in(chart, keep=keep)
        is_told = start is not None or "initial_pose" in merge(config or {})
        if isinstance(start, Anywhere) or (chart is not None and scanner is None and not is_told):
            self._begin_search()
        else:
            self._begin_in_map(start)

    def _fresh_stream(self) -> _core.Stream:
        with core_errors():
            stream = _core.Stream(self.config.to_json(), self._kind, self._window, self._adapter)
            if self._scanner is not None:
                stream.scan_with(*self._scanner)
        self._tell_late_draws(stream)
        if self._kept is not None:
            stream.keep_steps()
        return stream

    def _tell_late_draws(self, stream: _core.Stream) -> None:
        if self._late_draws == "put_off":
            stream.put_off_late_draws()

    def _be_in(self, chart: Map | None, *, keep: bool) -> None:
        """In this map from here on; what a verdict asks of it is made now, not while it drives."""
        self._chart, self._keep = chart, keep
        self._kept_places = None if chart is None else KeptPlaces.of(chart, self.config)

    def _begin_in_map(self, start: StartLike) -> None:
        columns: _core._MapColumns | None = None
        if self._chart is not None:
            identity, _ = self._chart.identities(tuple(self._index_of))
            used = self._chart.with_role("fixed") if self._keep else self._chart
            columns = used.core_columns(identity, tuple(self._index_of_class))
        with core_errors():
            self._stream.begin(columns, core_start(start))

    def _begin_search(self, was_lost_s: float | None = None) -> None:
        from .searching import RobotSearch

        if self._chart is None:
            raise DataError("start: anywhere needs a map to be found in")
        if self._scanner is not None:
            raise DataError("start: anywhere needs sightings; with a scanner, detect them first")
        self._search = RobotSearch(self._chart, self.config, was_lost_s=was_lost_s)

    def _begin(self, stream: _core.Stream, *, names: Sequence[str] = (), classes: Sequence[str] = ()) -> None:
        self._stream = stream
        self._control_columns = _core.control_columns(self.config.to_json())
        self._index_of = {name: index for index, name in enumerate(names)}
        self._index_of_class = {name: index for index, name in enumerate(classes)}
        self._chart, self._keep = None, False
        self._kept_places, self._recent = None, None
        self._search = None
        self._step = None
        self._lost = Lost()
        self._unused = Unused()
        self._so_far = SoFar()
        self._told = Told()
        self._refused = {}
        self._unexplained = 0
        self._ended = False
        self._lock = threading.RLock()

    def odometry(
        self, stamp_s: float, control: ArrayLike, *, covariance: ArrayLike | None = None
    ) -> tuple[Step, ...]:
        """Takes a row of odometry: the numbers of the motion model, and its covariance (3, 3), if any.

        Errors: `DataError` for another number of values, or values that are none.
        """
        values, stamp = checked_control(control, self._control_columns), checked_stamp(stamp_s)
        stated = None if covariance is None else checked_covariance(covariance)
        with self._lock:
            self._check_going_on()
            return self._taken(Row("odometry", stamp, (values, stated)))[1]

    def sightings(
        self,
        stamp_s: float,
        *,
        range_m: ArrayLike | None = None,
        bearing_rad: ArrayLike | None = None,
        identity: Sequence[Identity] | None = None,
        class_name: Sequence[ClassName] | None = None,
        covariance: ArrayLike | None = None,
        signature: ArrayLike | None = None,
        sensor: str | None = None,
    ) -> tuple[Step, ...]:
        """Takes all that a sensor saw at one moment, in its frame; nothing at all is a scan too.

        Shapes and errors as of `FastSlam.update`, but that a stamp that goes back is counted and no error.
        `class_name` is None, or a word such as `unknown`, where nobody knows it; `sensor` names one of
        several. `sensor.delay_s` is taken off the stamp, as in a run.
        """
        by = sensor_number(self.config, sensor)
        stamp = self._when_seen(stamp_s, by)
        with self._lock:
            self._check_going_on()
            classes = self.config["association"]["classes"]
            limit = None if classes is None else classes["number"]
            new_classes, class_index = class_numbers(class_name, self._index_of_class, limit)
            measured = measured_scan(self.config, self._adapter, range_m, bearing_rad, by)
            scan = checked_scan(self.config, measured, identity, covariance, class_index, signature)
            new_names = scan.new_names(self._index_of)
            columns = scan.columns(ChainMap(new_names, self._index_of))
            names = (new_names, new_classes)
            return self._taken(Row("sightings", stamp, columns, by), names)[1]

    def scan(
        self, stamp_s: float, ranges_m: ArrayLike, *, intensities: ArrayLike | None = None
    ) -> tuple[Step, ...]:
        """Takes one turn of the laser (B,), as in `fastslam.log.Scans`: what is detected in it was seen then.

        A turn in which nothing is found is no step. `sensor.delay_s` is taken off the stamp, that of beam 0.
        Errors: `DataError` for a turn that does not fit the scanner, or a robot without one.
        """
        stamp, turn = self._when_seen(stamp_s), checked_turn(ranges_m, intensities)
        with self._lock:
            self._check_going_on()
            return self._taken(Row("scan", stamp, turn))[1]

    def _when_seen(self, stamp_s: float, by: int = 0) -> float:
        stamp, delay_s = checked_stamp(stamp_s), each_sensor(self.config)[by]["delay_s"]
        return stamp - delay_s if delay_s else stamp

    def relocalize(self) -> None:
        """Searches for the robot in its map, from here on and as with `start=Anywhere()`.

        What it learnt on the way since it began in the map is given up. Errors: `DataError` without a map.
        """
        with self._lock:
            self._check_going_on()
            self._search_anew()

    def end(self) -> tuple[Step, ...]:
        """Takes the rows that still wait, and lets the filter learn what it can from the whole drive."""
        with self._lock:
            if self._ended:
                return ()
            found: tuple[Step, ...] = ()
            if self._search is not None and self._search.rows:
                found = self._searched(self._search)
            with core_errors():
                self._stream.end()
            steps = (*found, *self._computed())
            self._stream.finish()
            self._ended, self._recent = True, None
            return () if self.searching else steps

    def keep_result(self) -> None:
        """From here on rows and steps are kept, for `result`; memory then grows with the drive."""
        with self._lock:
            self._kept = [] if self._kept is None else self._kept
            self._stream.keep_steps()

    def result(self, *, name: str = "live") -> tuple[RunResult, Log]:
        """What a run over the rows since `keep_result` would return, and these rows as a log.

        Rows and steps before are not in it; the smoothed path and the map are whole. Errors: `DataError`
        while it is `searching`, and without `keep_result`.
        """
        from .rows import log_of
        from .runner import Given, result_of

        with self._lock:
            self._check_found()
            if self._kept is None:
                raise DataError("nothing was kept: call keep_result before the first row")
            identity_names, class_names, _ = self._names()
            config, columns = dict(self.config), len(self._control_columns)
            log = log_of(self._kept, columns, name=name, config=config, scanner=self._scanner)
            log = replace(log, identity_names=identity_names, class_names=class_names)
            given = Given(self._chart, None, identity_names)
            return result_of(self._stream.output(), log, self.config, given, self._adapter), log

    @property
    def searching(self) -> bool:
        """Whether it is still looked for in its map."""
        return self._search is not None

    @property
    def modes(self) -> tuple[Mode, ...]:
        """Where it may be while it is searched for, the likeliest first; none when that is settled."""
        with self._lock:
            if self._search is None:
                return ()
            with core_errors():
                newest = self._stream.newest_pose()
            return () if newest is None else self._search.now(newest[1])

    @property
    def stamp_s(self) -> float | None:
        """Stamp of the newest row; None before the first."""
        with self._lock, core_errors():
            newest = self._stream.newest_pose()
        return None if newest is None else newest[0]

    @property
    def last_step(self) -> Step | None:
        """The last step that was computed; while it is `searching`, in the robot's own frame."""
        with self._lock:
            if self._step is None or self._search is None:
                return self._step
            return replace(self._step, info=replace(self._step.info, health="searching"))

    @property
    def pose(self) -> tuple[float, Floats, Floats]:
        """Stamp of the newest row, and the pose there: mean (3,) as x, y, heading, covariance (3, 3).

        Before the first row that is 0 and the start. Rows that wait for others are counted in.
        Errors: `DataError` while it is `searching`.
        """
        with self._lock, core_errors():
            self._check_found()
            newest = self._stream.newest_pose()
            stamp_s, mean, covariance = newest or (0.0, *self._stream.computed_pose())
            return stamp_s, mean, symmetric(covariance)

    @property
    def particles(self) -> tuple[Floats, Floats]:
        """Poses `T_world_robot` (M, 3) and normalised weights (M,), as far as steps were computed."""
        with self._lock:
            self._check_found()
            return self._stream.particles()

    @property
    def landmarks(self) -> LandmarkMap:
        """The map; landmarks without an identity are named `L<birth number>`."""
        with self._lock:
            self._check_found()
            return landmark_map(self._stream.map(), *self._names())

    @property
    def map(self) -> Map:
        """The map to keep if the drive ended here, as `RunResult.map`; the robot itself goes on.

        A copy of it is ended: rows that wait are taken, landmarks that are there twice become one. With
        `keep` it is the map that was given. Errors: `DataError` while it is `searching`.
        """
        with self._lock:
            self._check_found()
            if self._keep and self._chart is not None:
                return self._chart
            ended = copy.deepcopy(self)
        ended.end()
        made_from = {"log": "live", "version": built_version(), "seed": self.config["seed"]}
        return Map.of_found(ended.landmarks, self._chart, made_from)

    @property
    def changes(self) -> Changes | None:
        """What it found otherwise than its map says; None without one."""
        with self._lock:
            self._check_found()
            chart = self._chart
            return None if chart is None else self._changed(chart)[1]

    def _changed(self, chart: Map) -> tuple[LandmarkMap, Changes]:
        """The map, and what of it is otherwise than the one that was kept."""
        columns = self._stream.map()
        landmarks = landmark_map(columns, *self._names())
        return landmarks, changes(landmarks, chart, columns, self.config)

    @property
    def verdict(self) -> tuple[str, ...]:
        """What speaks against the drive so far, a sentence each; none while `searching`.

        The part of `RunResult.verdict` that needs what the filter holds and no log, so that it costs the same
        after hours: sightings that could not be used, nothing mapped or seen twice, landmarks that were not
        found again, times in which the filter was lost, innovations larger than the noise explains, and
        landmarks that a kept map lacks. Not in it: what lays all sightings on the map, and names at two
        places. It counts from where the robot began or was found; says nothing of the first 100 sightings.
        """
        with self._lock:
            if self._search is not None:
                return ()
            kept = None
            if self._chart is not None:
                landmarks, found = self._changed(self._chart)
                kept = (landmarks, self._kept_places, found)
            return self._so_far.verdict(self._stream.so_far(), self.config, kept)

    @property
    def recent_verdict(self) -> tuple[str, ...]:
        """`verdict`, at most a second of the stamps old: for what asks at each step."""
        with self._lock:
            stamp_s = 0.0 if self._step is None else self._step.stamp_s
            if self._recent is None or not self._recent[0] <= stamp_s < self._recent[0] + ANEW_S:
                self._recent = (stamp_s, self.verdict)
            return self._recent[1]

    def view(self, step: Step) -> View:
        """What a page that watches draws: what is known now, with the last step that was computed."""
        from .watching import view_of

        with self._lock:
            fields = (step.stamp_s, step.T_world_robot, step.covariance, step.info)
            view = view_of(self._stream.view(), self._names(), fields)
            return replace(view, verdict=self.recent_verdict)

    @property
    def path(self) -> Trajectory:
        """The smoothed path with a pose at every step: that of `RunResult.smoothed`."""
        with self._lock:
            self._check_found()
            return Trajectory(*self._stream.smoothed())

    @property
    def waits(self) -> int:
        """How often a step has waited for a draw of paths beside the filter, on this machine."""
        with self._lock:
            return self._stream.lateness()[0]

    @property
    def put_off(self) -> int:
        """How many steps have gone on without a draw that was due; 0 unless `late_draws` is `put_off`."""
        with self._lock:
            return self._stream.lateness()[1]

    @property
    def counts(self) -> dict[str, int]:
        """Rows refused as `late`, `repeated` or `ahead`, scans `unexplained`, and rows `waiting`."""
        with self._lock:
            counts = {**self._stream.counts(), "unexplained": self._unexplained}
            return {name: count + self._refused.get(name, 0) for name, count in counts.items()}

    def save(self, path: Path | str) -> Path:
        """Writes the robot to a file, which is the old one or the new one whatever happens meanwhile.

        Errors: `DataError` where the file cannot be written.
        """
        from .resultfiles import write_atomically

        return write_atomically(Path(path), self._snapshot(), durable=True)

    @classmethod
    def load(cls, path: Path | str, *, sensor: Sensor | None = None) -> Robot:
        """The robot of a file that `save` wrote; `sensor` as it was made with.

        Errors: `DataError` for a file that cannot be read, is damaged, or is of something else.
        """
        loaded = cls.__new__(cls)
        try:
            loaded._restore(Path(path).read_bytes(), sensor)
        except OSError as error:
            raise DataError(f"cannot read: {error.strerror or error}", path) from None
        except DataError as error:
            raise DataError(str(error), path) from None
        return loaded

    def __getstate__(self) -> bytes | tuple[bytes, Sensor]:
        snapshot = self._snapshot()
        return snapshot if self._adapter is None else (snapshot, self._adapter.sensor)

    def _snapshot(self) -> bytes:
        from .searching import chart_to_json, note

        with self._lock:
            kept = note(
                names=list(self._index_of),
                classes=list(self._index_of_class),
                unexplained=self._unexplained,
                ended=self._ended,
                chart=None if self._chart is None else chart_to_json(self._chart),
                keep=self._keep or None,
                search=None if self._search is None else self._search.to_json(),
                stream=[self._kind, self._window],
                refused=self._refused or None,
                lost_since_s=self._lost.since_s,
                unused=self._unused.to_json(),
                so_far=self._so_far.to_json(),
                scanner=self._scanner,
                told=self._told.kept or None,
                late_draws=self._late_draws if self._late_draws != "await" else None,
            )
            return self._stream.save(kept)

    def __setstate__(self, state: bytes | tuple[bytes, Sensor]) -> None:
        self._restore(*((state, None) if isinstance(state, bytes) else state))

    def _restore(self, snapshot: bytes, sensor: Sensor | None) -> None:
        self._adapter = adapted(sensor)
        with core_errors():
            stream, config, note = _core.Stream.load(snapshot, self._adapter)
        kept = json.loads(note)
        self.config = Config.resolve(json.loads(config))
        self._late_draws = kept.get("late_draws", "await")
        self._tell_late_draws(stream)
        self._begin(stream, names=kept["names"], classes=kept["classes"])
        self._unexplained, self._ended = kept["unexplained"], kept["ended"]
        self._kind, self._window = "some", (0.0, 0.0, 0.0)
        if "stream" in kept:
            self._kind, self._window = kept["stream"][0], tuple(kept["stream"][1])
        self._refused = kept.get("refused", {})
        self._lost = Lost(kept.get("lost_since_s"))
        self._unused = Unused.of_json(kept.get("unused"))
        self._so_far = SoFar.of_json(kept.get("so_far"))
        self._told = Told(kept.get("told"))
        self._scanner = tuple(kept["scanner"]) if "scanner" in kept else None
        if "chart" in kept:
            from .searching import chart_of_json, search_of_json

            self._be_in(chart_of_json(kept["chart"]), keep=kept.get("keep", False))
            if "search" in kept and self._chart is not None:
                self._search = search_of_json(kept["search"], self._chart, self.config)

    def _names(self) -> tuple[tuple[str, ...], tuple[str, ...], tuple[str, ...]]:
        """Of identities, of classes, and the ids of the map that it is in."""
        in_map = self._chart is not None and self._search is None
        chart_ids = self._chart.landmarks.ids if self._chart is not None and in_map else ()
        return tuple(self._index_of), tuple(self._index_of_class), chart_ids

    def _taken(
        self, row: Row, names: tuple[dict[str, int], dict[str, int]] = ({}, {})
    ) -> tuple[str, tuple[Step, ...]]:
        """What became of a row, and the steps that it made possible; `names` are kept where it is taken."""
        with core_errors():
            became = row.put(self._stream)
        if became == "taken":
            self._index_of.update(names[0])
            self._index_of_class.update(names[1])
            if self._search is not None:
                self._search.rows.append(row)
            if self._kept is not None:
                self._kept.append(row)
        steps = self._computed()
        if self._search is None:
            if self._chart is not None and self._lost.is_settled(steps):
                self._search_anew(was_lost_s=self._lost.since_s)
            return became, steps
        due = self._step is not None and self._search.is_due(self._step.stamp_s)
        return became, self._searched(self._search) if due else ()

    def _searched(self, search: RobotSearch) -> tuple[Step, ...]:
        """Looks for the robot; where it is found, takes the rows anew from there."""
        start = search.look(self._stream, self._names()[:2])
        if start is None:
            if search.has_given_up:
                self._search_anew(was_lost_s=search.was_lost_s)
            return ()
        self._renew_stream()
        self._search, self._unexplained = None, 0
        self._begin_in_map(start)
        steps: list[Step] = []
        for row in search.rows:
            with core_errors():
                row.put(self._stream)
            steps += self._computed()
        return tuple(steps)

    def _search_anew(self, *, was_lost_s: float | None = None) -> None:
        """Looks for the robot from the next row on."""
        self._begin_search(was_lost_s)
        self._renew_stream()

    def _renew_stream(self) -> None:
        for name, count in self._stream.counts().items():
            if name != "waiting":
                self._refused[name] = self._refused.get(name, 0) + count
        self._stream, self._step, self._lost = self._fresh_stream(), None, Lost()
        self._unused, self._so_far, self._recent = Unused(), SoFar(), None

    def _computed(self) -> tuple[Step, ...]:
        """The steps that the rows so far allow."""
        steps: list[Step] = []
        while True:
            try:
                with core_errors():
                    answer = self._stream.step()
            except (DataError, NumericalError):
                # The filter is as it was before the scan.
                self._unexplained += 1
                continue
            if answer is None:
                self._step = steps[-1] if steps else self._step
                self._so_far.add(steps)
                return tuple(steps)
            (stamp_s, mean, covariance), fields = answer
            unused = self._unused.of_step(stamp_s, fields, self.config)
            info = step_info(fields, self.config, self._told, unused)
            steps.append(Step(stamp_s, mean, symmetric(covariance), info))

    def _check_found(self) -> None:
        if self._search is None:
            return
        if self._ended:
            raise DataError("the robot was not found in its map: `modes` says where it may be")
        if self._search.was_lost_s is not None:
            since = f"lost since stamp {self._search.was_lost_s:.2f} s and searched for in its map again"
            raise DataError(f"the robot is {since}: see `searching` and `modes`")
        raise DataError("the robot is still searched for in its map: see `searching` and `modes`")

    def _check_going_on(self) -> None:
        if self._ended:
            raise DataError("the stream was ended")

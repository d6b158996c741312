"""The compiled core. Call it through the typed functions of the package."""

from collections.abc import Callable
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from .log import Bools, Floats, Ints, Ranges
from .sensors import Adapter

__version__: str
build_profile: str
"""`release` or `debug`."""

def config_schema() -> str:
    """The JSON Schema of the configuration, with a description of every key."""

def resolve_config(json: str) -> str:
    """Fills in defaults and checks every value; a ValueError's message starts with the dotted key."""

def limits() -> dict[str, float]:
    """The largest size of a setting by the unit that ends its key (`_m`); `position`, `least` and `state`."""

def control_columns(json: str) -> list[str]:
    """Names of the values of a control of the configured motion model."""

def simulation_schema() -> str:
    """The JSON Schema of the settings of a simulation."""

def resolve_simulation(json: str) -> str:
    """As `resolve_config`, for the settings of a simulation."""

def simulation_presets() -> list[tuple[str, str]]:
    """Name and settings (JSON) of each ready-made simulation."""

def simulation_with_landmarks(json: str, landmarks: int) -> str:
    """The same simulation with about this many landmarks, at the same density."""

def simulate(json: str) -> dict[str, Any]:
    """Simulates a log; returns its columns by name. ValueError for settings that contradict each other."""

def space_config_schema() -> str:
    """The JSON Schema of the configuration of a run in space."""

def resolve_space_config(json: str) -> str:
    """As `resolve_config`, for runs in space."""

def run_space(
    config_json: str,
    row_stamp_s: Floats,
    velocity: Floats,
    sighting_stamp_s: Floats,
    value: Floats,
    identity: Ints,
    covariance: Floats | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> dict[str, Any]:
    """Runs the filter over a log in space; see `fastslam.space.run`.

    Ctrl-C, or KeyboardInterrupt from `progress`, ends the run early with what has been computed.
    """

def run(
    config_json: str,
    control_stamps_s: Floats,
    controls: Floats,
    sighting_stamps_s: Floats,
    scan: _ScanColumns,
    progress: Callable[[int, int], None] | None = None,
    control_covariance: Floats | None = None,
    checkpoint: Callable[[bytes], None] | None = None,
    checkpoint_every_s: float = 60.0,
    resume: bytes | None = None,
    map: _MapColumns | None = None,
    start: _Start | None = None,
    watch: Callable[..., tuple[float, float]] | None = None,
    sensor: Adapter | None = None,
    by: NDArray[np.uint8] | None = None,
) -> dict[str, Any]:
    """Runs the filter over a log, or goes on from a snapshot (`resume`) that `checkpoint` got.

    ValueError for a bad log or snapshot, RuntimeError when the filter cannot go on.
    """

def step_fields() -> list[tuple[str, str]]:
    """Name and kind (number, count, flag, status, reasons) of what crosses of a step: the one list."""

def detector_schema() -> str:
    """The JSON Schema of the settings of the detectors."""

def resolve_detector(json: str) -> str:
    """As `resolve_config`, for the settings of the detectors."""

def detect(
    config_json: str,
    geometry_json: str,
    stamp_s: Floats,
    ranges_m: Ranges,
    intensities: Ranges | None = None,
    twists: Floats | None = None,
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Finds landmarks in scans; returns columns by name, of detections and of the pieces of the scans.

    ValueError for a geometry that makes no sense.
    """

def sensor_twists(config_json: str, control_stamps_s: Floats, controls: Floats, stamp_s: Floats) -> Floats:
    """Velocities (N, 3) of the sensor at stamps (N,) in its own frame, by the controls of a log."""

def robot_twists(motion_json: str, control_stamps_s: Floats, controls: Floats) -> Floats:
    """Velocities (C, 3) of the robot from each control until the next; the arcs end where the rows say.

    `motion_json` is the section `motion`. ValueError for a model that is not known, or keys that it lacks.
    """

def verdicts() -> list[str]:
    """What may become of a piece of a scan, by number."""

def scan_arena(
    rocks: Floats,
    walls: Floats,
    T_world_sensor: Floats,
    geometry_json: str,
    beams: int,
    range_std_m: float,
    dropout_probability: float,
    seed: int,
) -> Floats:
    """Casts rays at rocks (x, y, radius) and walls (two ends): ranges, one row per pose of the sensor."""

_ScanColumns: TypeAlias = tuple[Floats, Floats, Ints, Floats | None, Ints | None, Floats | None]
"""Range, bearing and identity of the sightings, then covariance (n, 3), class and signature."""

_MapColumns: TypeAlias = tuple[Floats, Floats, Ints, Ints, Floats, Floats, Ints, Bools]
"""Mean (n, 2), covariance (n, 3), identity, class, signature, log-odds, sightings, whether it is fixed."""

_Start: TypeAlias = tuple[Floats, Floats | None]
"""Poses (n, 3); with a covariance (3, 3) the only one is the mean of a Gaussian."""

_Marks: TypeAlias = tuple[Floats, Floats, Ints]
"""Mean (n, 2), variance (n,), label (n,), -1 where nobody says."""

class Chart:
    """A map in which small ones are looked for; `names`: labels never differ."""

    def __new__(cls, marks: _Marks, names: bool) -> Chart: ...
    def placements(
        self,
        local: _Marks,
        seen: tuple[Floats, float, float],
        effort: tuple[int, int],
    ) -> tuple[Floats, Floats, Floats, Ints]:
        """Poses (k, 3), covariances (k, 3, 3), log-odds and numbers of pairs of the likeliest places.

        `seen` is from where: poses of the sensor (t, 3), reach, half the field of view.
        `effort` is how many are refined, and how many told at most.
        """

class Filter:
    """The filter, one control and one scan at a time; several threads may use it."""

    def __new__(cls, config_json: str, identities: str, sensor: Adapter | None = None) -> Filter: ...
    @staticmethod
    def load(snapshot: bytes, sensor: Adapter | None = None) -> tuple[Filter, str, str]:
        """The filter of a snapshot, its configuration as JSON, its note. ValueError where it is refused."""

    def begin(self, map: _MapColumns | None = None, start: _Start | None = None) -> None:
        """Starts in a map, at a start: before anything else. ValueError for one that makes no sense."""

    def save(self, note: str) -> bytes: ...
    def predict(self, control: list[float], dt_s: float) -> None: ...
    def update(self, stamp_s: float, scan: _ScanColumns, by: int = 0) -> dict[str, Any]: ...
    def step(
        self, control: list[float], dt_s: float, stamp_s: float, scan: _ScanColumns
    ) -> dict[str, Any]: ...
    def pose(self) -> tuple[Floats, Floats]: ...
    def particles(self) -> tuple[Floats, Floats]: ...
    def rejuvenate(self) -> bool: ...
    def map(self) -> dict[str, Any]: ...
    def best_path(self) -> tuple[Floats, Floats]: ...

class LeastSquaresRows:
    """Residuals of sightings and odometry over poses (K, 3), landmarks (L, 2) and errors of both.

    `odometry` holds motions (K - 1, 3) and their derivatives (K - 1, 3, N) by its errors, `sightings` pose
    (S,), landmark (S,), and range and bearing (S, 2). ValueError for numbers that do not fit.
    """

    def __new__(
        cls,
        poses: Floats,
        landmarks_m: Floats,
        sensor: list[float],
        odometry: tuple[Floats, Floats],
        sightings: tuple[Ints, Ints, Floats],
    ) -> LeastSquaresRows: ...
    def residuals(self) -> Floats:
        """(R,): range and bearing of each sighting in turn, then ahead, left and turn of each motion."""

class LeastSquares:
    """The factorised normal equations of rows: unknowns (n,) are poses, then landmarks; N + 5 parameters.

    `whitening` is one over the standard deviations of sightings (S, 2) and roots of the precisions of motions
    (K - 1, 3, 3). `anchors` (n, 2): information on each unknown, and what is known minus the present
    solution; `priors` (N + 5, 2): standard deviations, 0 for held, and the same. ValueError where nothing
    holds the path.
    """

    def __new__(
        cls, rows: LeastSquaresRows, whitening: tuple[Floats, Floats], anchors: Floats, priors: Floats
    ) -> LeastSquares: ...
    def residuals(self) -> Floats:
        """Whitened residuals (R,)."""

    def covariance(self) -> Floats:
        """Of the parameters (N + 5, N + 5)."""

    def step(self) -> tuple[Floats, Floats]:
        """The step of unknowns (n,) and parameters (N + 5,) that explains the rows."""

    def response(self, noise: Floats) -> Floats:
        """How the rows (R,) move with noise (R + n + N + 5,) of rows, anchors and priors."""

    def influence(self) -> Floats:
        """What each row's residual does to the parameters (R, N + 5)."""

_StampedPose: TypeAlias = tuple[float, Floats, Floats]
"""Stamp, mean (3) and covariance (3, 3) of a pose."""

class Stream:
    """The filter on a stream of rows; several threads may use it."""

    def __new__(
        cls,
        config_json: str,
        identities: str,
        window: tuple[float, float, float],
        sensor: Adapter | None = None,
    ) -> Stream: ...
    @staticmethod
    def load(snapshot: bytes, sensor: Adapter | None = None) -> tuple[Stream, str, str]:
        """The stream of a snapshot, its configuration as JSON, its note. ValueError where it is refused."""

    def begin(self, map: _MapColumns | None = None, start: _Start | None = None) -> None:
        """Starts in a map, at a start: before anything else. ValueError for one that makes no sense."""

    def keep_steps(self) -> None:
        """From here on the steps are kept, for `output`."""

    def output(self) -> dict[str, Any]:
        """What it has come to, as `run` returns it; the steps are those that were kept."""

    def so_far(self) -> dict[str, Any]:
        """`noise` and `skipped` of `output`, at a cost that does not grow with the drive."""

    def save(self, note: str) -> bytes: ...
    def odometry(
        self, stamp_s: float, control: list[float], covariance: list[list[float]] | None = None
    ) -> str: ...
    def sightings(self, stamp_s: float, scan: _ScanColumns, by: int = 0) -> str: ...
    def scan_with(self, detector_json: str, geometry_json: str) -> None:
        """From here on scans of a laser are taken. ValueError for settings or a geometry that are none."""

    def scan(self, stamp_s: float, ranges_m: Floats, intensities: Floats | None = None) -> str: ...
    def end(self) -> str: ...
    def step(self) -> tuple[_StampedPose, dict[str, Any]] | None: ...
    def finish(self) -> bool: ...
    def newest_pose(self) -> _StampedPose | None: ...
    def computed_pose(self) -> tuple[Floats, Floats]: ...
    def particles(self) -> tuple[Floats, Floats]: ...
    def view(self) -> dict[str, Any]: ...
    def map(self) -> dict[str, Any]: ...
    def smoothed(self) -> tuple[Floats, Floats]: ...
    def lateness(self) -> tuple[int, int]:
        """How many steps have waited for a draw beside the filter, and how many have gone on without one."""

    def put_off_late_draws(self) -> None:
        """From here on no step waits for a draw."""

    def counts(self) -> dict[str, int]: ...

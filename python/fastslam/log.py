"""A log in memory: controls, sightings and truth as arrays, whatever file format they came from."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

if TYPE_CHECKING:
    from .frames import Backend

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]
Ranges = NDArray[np.float32] | NDArray[np.float64]


@dataclass(frozen=True)
class Controls:
    """Odometry or commands, in time order.

    For the `velocity` (speed_m_per_s, yaw_rate_rad_per_s) and `ackermann` (speed_m_per_s, steering_rad)
    motion models row i holds from `stamp_s[i]` until the next row (zero-order hold). For `odometry` and
    `increments` row i is (dx_m, dy_m, dheading_rad), the pose at `stamp_s[i]` in the frame of the pose at
    `stamp_s[i - 1]` (the first row: in the frame of the start).

    `covariance` (N, 6) is that of each row of `odometry` and `increments`, as the upper triangle (xx, xy, xh,
    yy, yh, hh) in m², m·rad and rad² in the frame of `values`, where the source knows it; None or NaN leaves
    it to the motion settings. It stands in place of all noise in them (`proportional` too), and is widened
    where no diffusion is as narrow (`docs/equations.md`).

    Shapes: `stamp_s` (N,) strictly increasing; `values` (N, 2) or (N, 3).
    """

    stamp_s: Floats
    values: Floats
    covariance: Floats | None = None


@dataclass(frozen=True)
class Sightings:
    """Detections of point landmarks in the sensor frame, in time order; equal stamps of a sensor are a step.

    Shapes: all (S,). `identity` indexes `Log.identity_names`; -1 where nobody says which landmark it is.
    `class_index` indexes `Log.class_names` (-1: none); `signature` is a scalar such as a trunk's diameter in
    metres (NaN: none). `bearing_rad` is NaN throughout where the sensor measures ranges alone. `covariance`
    (S, 3) is that of each range and bearing, as (m², m·rad, rad²), where the source of the sightings knows
    it; None or NaN leaves it to the sensor settings. `sensor_index` indexes `Log.sensor_names` where the
    robot has several sensors (`sensors` in the configuration; -1: not said).
    """

    stamp_s: Floats
    range_m: Floats
    bearing_rad: Floats
    identity: Ints
    class_index: Ints
    signature: Floats
    covariance: Floats | None = None
    sensor_index: Ints | None = None

    def __getitem__(self, rows: slice | Ints | Bools) -> Sightings:
        """Some of them, by mask, indices or slice, in that order."""
        return Sightings(
            stamp_s=self.stamp_s[rows],
            range_m=self.range_m[rows],
            bearing_rad=self.bearing_rad[rows],
            identity=self.identity[rows],
            class_index=self.class_index[rows],
            signature=self.signature[rows],
            covariance=None if self.covariance is None else self.covariance[rows],
            sensor_index=None if self.sensor_index is None else self.sensor_index[rows],
        )


@dataclass(frozen=True)
class TruthTrajectory:
    """True robot poses in the world frame. Shapes: `stamp_s` (T,), `T_world_robot` (T, 3) as x, y, heading.

    `heading_known` is False where only positions are true (averaged or GPS data).
    """

    stamp_s: Floats
    T_world_robot: Floats
    heading_known: bool = True


@dataclass(frozen=True)
class TruthLandmarks:
    """True landmark positions. Shapes: `names` (K), `position_m` (K, 2) in the world frame.

    Names match `Log.identity_names` where the identities are known. `complete` is False when the world holds
    landmarks that nobody surveyed, so that an unmatched estimate is no false landmark.
    """

    names: tuple[str, ...]
    position_m: Floats
    complete: bool = True


@dataclass(frozen=True)
class PositionFixes:
    """GPS-like fixes, possibly with outliers, in a frame related to the world by a rigid transform.

    Shapes: `stamp_s` (T,), `position_m` (T, 2).
    """

    stamp_s: Floats
    position_m: Floats


@dataclass(frozen=True)
class BeamGeometry:
    """Where the beams of a planar laser point and how far they reach.

    Beam i points at `first_angle_rad + i * angle_step_rad`, counter-clockwise from straight ahead of the
    sensor. `beam_period_s` is the time from one beam to the next, where it is known and motion within a scan
    is to be corrected.
    """

    first_angle_rad: float
    angle_step_rad: float
    min_range_m: float
    max_range_m: float
    beam_period_s: float | None = None


@dataclass(frozen=True)
class Scans:
    """Laser scans, in time order; `stamp_s` is the time of beam 0.

    Shapes: `stamp_s` (N,), `ranges_m` (N, B) in 32 or 64 bits, `intensities` the same or None. A range of
    infinity or of `geometry.max_range_m` and more says that nothing was hit; NaN, zero or less that nothing
    is known. `mounting` is (x_m, y_m, yaw_rad), the pose of the sensor in the robot's frame. `detector` holds
    the detector settings that suit these scans.
    """

    stamp_s: Floats
    ranges_m: Ranges
    geometry: BeamGeometry
    intensities: Ranges | None = None
    mounting: tuple[float, float, float] = (0.0, 0.0, 0.0)
    detector: dict[str, Any] = field(default_factory=dict)


REPEATED_STAMPS = "repeated-stamps"
"""Code of the problem that several rows of odometry have one stamp."""


@dataclass(frozen=True)
class Problem:
    """Something found while reading: what, where, and how many rows were skipped or repaired for it.

    `code` is there where the examination of a log asks for it.
    """

    message: str
    count: int = 1
    code: str = ""


@dataclass(frozen=True)
class Log:
    """Everything that was read from one log."""

    name: str
    source: str
    """Path that it was read from."""
    format: str
    controls: Controls
    sightings: Sightings
    identity_names: tuple[str, ...] = ()
    class_names: tuple[str, ...] = ()
    sensor_names: tuple[str, ...] = ()
    """Of the sensors that made the sightings, where these say it."""
    truth_trajectory: TruthTrajectory | None = None
    truth_landmarks: TruthLandmarks | None = None
    position_fixes: PositionFixes | None = None
    edited_fixes: PositionFixes | None = None
    """Fixes that somebody has picked as good, in a frame of their own."""
    scans: Scans | None = None
    """Laser scans, from which `fastslam.detection.detect` makes sightings."""
    config: dict[str, Any] = field(default_factory=dict)
    """The log's own settings (`motion`, `sensor`, `association`, ...): a partial configuration."""
    problems: tuple[Problem, ...] = ()
    notes: tuple[str, ...] = ()
    """What the reader took for granted where the files leave it open."""

    @classmethod
    def from_arrays(
        cls,
        controls: tuple[ArrayLike, ArrayLike],
        sightings: tuple[ArrayLike, ArrayLike, ArrayLike] | tuple[ArrayLike, ArrayLike],
        *,
        identities: Sequence[object] | None = None,
        sensors: Sequence[str] | None = None,
        config: Mapping[str, Any] | None = None,
        name: str = "arrays",
    ) -> Log:
        """A log from arrays, or columns of a data frame; nothing given is kept or changed.

        `controls` are `stamp_s` (N,), which grows, and values (N, 2) or (N, 3), as the motion model of
        `config` takes them (see `Controls`). `sightings` are `stamp_s`, `range_m`, `bearing_rad`, all (S,),
        in any order; without bearings where `config` has `sensor: {model: range}`. `identities` (S) names the
        landmark of each; None, NaN or the empty text where unknown. `sensors` (S) names the sensor that made
        each where `config` has several (`sensors`); what one of them does not measure is NaN or None.

        >>> log = Log.from_arrays(
        ...     ([0.0, 0.1], [[1.0, 0.0], [1.0, 0.2]]), ([0.1], [4.2], [0.3]), identities=["post"]
        ... )
        >>> log.identity_names, log.sightings.identity.tolist()
        (('post',), [0])

        Errors: `DataError` for arrays that do not fit each other or hold what is no finite number.
        """
        from .arrays import log_from_arrays

        names = (identities, sensors)
        return log_from_arrays(controls, sightings, names=names, config=config, name=name)

    @classmethod
    def from_dataframe(
        cls,
        odometry: object,
        sightings: object,
        *,
        config: Mapping[str, Any] | None = None,
        name: str = "frames",
    ) -> Log:
        """A log from two data frames of pandas, Polars or PyArrow, read as the tables of a native log are.

        Columns may have any of the names and units of `odometry.csv` and `sightings.csv` (`range_mm`, `v`,
        `Bearing [deg]`; dates as stamps); columns of odometry choose the motion model. `config` holds what
        `log.yaml` would: `motion`, `sensor`, `association`, `filter`, `initial_pose`, `wheels`. What was
        repaired is in `problems`, what was assumed in `notes`. Needs `pip install narwhals`.

        Errors: `DataError` with frame, row (from 0) and column; `ConfigError` where narwhals is missing.
        """
        from .frames import log_from_frames

        return log_from_frames(odometry, sightings, config=config, name=name)

    def to_dataframes(self, backend: Backend = "pandas") -> tuple[Any, Any]:
        """Odometry and sightings as data frames, which `from_dataframe` takes; columns are those of files.

        Errors: `DataError` for a log without motion model; `ConfigError` for a backend that is not there.
        """
        from .datasets.native_columns import odometry_columns, sightings_columns
        from .frames import to_frame

        return to_frame(odometry_columns(self), backend), to_frame(sightings_columns(self), backend)

    def __repr__(self) -> str:
        from .cards import log_card

        return log_card(self)

    def _repr_html_(self) -> str:
        from .cards import card_html, log_card, log_picture

        return card_html(log_card(self), log_picture(self))

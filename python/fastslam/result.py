"""What a run of the filter gives back, as arrays."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Generic, Literal, TypeVar

import numpy as np

from .errors import ConfigError
from .log import Bools, Floats, Ints

if TYPE_CHECKING:
    from pathlib import Path

    from .frames import Backend
    from .maps import Changes, Map
    from .trust import Doubt

Columns = dict[str, Any]
"""Columns by name, all of one length: arrays, and lists of texts."""


class Table(ABC):
    """What has a row for each pose, landmark or step, under the names of the files of a run."""

    @abstractmethod
    def to_columns(self) -> Columns:
        """The columns by name: `pandas.DataFrame`, `polars.DataFrame` and `pyarrow.table` take them."""

    def to_dataframe(self, backend: Backend = "pandas") -> Any:
        """A data frame of `pandas`, the default, `polars` or `pyarrow`. Needs `pip install narwhals`.

        Errors: `ConfigError` for another backend, or for one that is not installed.
        """
        from .frames import to_frame

        return to_frame(self.to_columns(), backend)


@dataclass(frozen=True)
class Trajectory(Table):
    """Poses in the world frame. Shapes: `stamp_s` (T,), `T_world_robot` (T, 3) as x_m, y_m, heading_rad.

    `covariance` (T, 3, 3), in the order x, y, heading, is that of the whole mixture (within plus between
    particles); None for a single path.
    """

    stamp_s: Floats
    T_world_robot: Floats
    covariance: Floats | None = None

    def to_tum(self) -> str:
        """Lines `stamp_s x_m y_m z_m qx qy qz qw`, as `trajectory.tum` has them."""
        from .resultfiles import tum_text

        return tum_text(self)

    def to_csv(self) -> str:
        """A table for spreadsheets: `stamp_s`, `x_m`, `y_m`, `heading_rad`, a line per pose."""
        from .resultfiles import path_csv_text

        return path_csv_text(self)

    def to_columns(self) -> Columns:
        """`stamp_s`, `x_m`, `y_m`, `heading_rad`, and the covariance under the names of its file."""
        from .resultfiles import covariance_columns

        names = ("x_m", "y_m", "heading_rad")
        columns = {"stamp_s": self.stamp_s, **dict(zip(names, self.T_world_robot.T, strict=True))}
        return columns if self.covariance is None else columns | covariance_columns(self.covariance)


@dataclass(frozen=True)
class Residuals:
    """How far the sightings of each landmark lie off the map along the best path, measured minus expected.

    Each is divided by the standard deviation that the sensor's noise says, so that 1 is expected of `rms` and
    0 of `mean`; both have no unit, and are NaN for a landmark of which nothing was compared. `kind` is
    `range` or `bearing`: the column of the sightings, whatever a sensor of one's own has in it.
    Shapes: `count` (how many sightings were compared), `rms` and `mean` (K,).
    """

    kind: str
    count: Ints
    rms: Floats
    mean: Floats

    def __getitem__(self, rows: slice | Ints | Bools) -> Residuals:
        """Those of some landmarks, in that order."""
        return Residuals(self.kind, self.count[rows], self.rms[rows], self.mean[rows])

    def to_columns(self) -> Columns:
        """`range_residuals`, `range_residual_rms` and `range_residual_mean`, or the same of bearings."""
        names = (f"{self.kind}_residual{more}" for more in ("s", "_rms", "_mean"))
        return dict(zip(names, (self.count, self.rms, self.mean), strict=True))


@dataclass(frozen=True)
class LandmarkMap(Table):
    """Estimated landmarks. Shapes: `ids` (K), `mean_m` (K, 2), `covariance_m2` (K, 2, 2), the others (K,).

    `ids` are identity names where those are known, else `L<birth number>`. The covariance is that of the
    mixture over the particles that hold the landmark. `confirmed` is False for landmarks that are provisional
    (None: nobody says). `class_index` indexes `class_names` (-1: none) and `signature` is NaN where unknown;
    both are None where the run used none.
    """

    ids: tuple[str, ...]
    mean_m: Floats
    covariance_m2: Floats
    sightings: Ints
    confirmed: Bools | None = None
    class_index: Ints | None = None
    signature: Floats | None = None
    class_names: tuple[str, ...] = ()
    residuals: tuple[Residuals, ...] = ()

    def class_name(self, row: int) -> str:
        """The class of one landmark; empty where it has none."""
        index = -1 if self.class_index is None else int(self.class_index[row])
        if index < 0:
            return ""
        return self.class_names[index] if index < len(self.class_names) else str(index)

    def to_columns(self) -> Columns:
        """Columns of `landmarks.csv`, but for those of which the run has nothing."""
        columns: Columns = {"id": list(self.ids), "x_m": self.mean_m[:, 0], "y_m": self.mean_m[:, 1]}
        for name, row, column in (("xx", 0, 0), ("xy", 0, 1), ("yy", 1, 1)):
            columns[f"cov_{name}_m2"] = self.covariance_m2[:, row, column]
        columns["sightings"] = self.sightings
        if self.confirmed is not None:
            columns["confirmed"] = self.confirmed
        if self.class_index is not None:
            columns["class"] = [self.class_name(row) or None for row in range(len(self.ids))]
        if self.signature is not None:
            columns["signature"] = self.signature
        for residuals in self.residuals:
            columns |= residuals.to_columns()
        return columns

    def to_geojson(self, *, coordinates: Literal["local_metres"]) -> dict[str, Any]:
        """The landmarks as a GeoJSON FeatureCollection of points, with id, sightings and standard deviations.

        GeoJSON means longitude and latitude unless both sides agree on something else (RFC 7946, section 4).
        `coordinates="local_metres"` says that you know that these are x and y in the world of the run.
        Errors: `ConfigError` for anything else.
        """
        if coordinates != "local_metres":
            raise ConfigError(f"coordinates: got {coordinates}, expected local_metres")
        features = [self._feature(row) for row in range(len(self.ids))]
        return {"type": "FeatureCollection", "coordinate_system": coordinates, "features": features}

    def _feature(self, row: int) -> dict[str, Any]:
        x_std_m, y_std_m = np.sqrt(np.diag(self.covariance_m2[row])).tolist()
        properties: dict[str, Any] = {"id": self.ids[row], "sightings": int(self.sightings[row])}
        properties |= {"x_std_m": x_std_m, "y_std_m": y_std_m, "class": self.class_name(row) or None}
        properties["confirmed"] = None if self.confirmed is None else bool(self.confirmed[row])
        point = {"type": "Point", "coordinates": self.mean_m[row].tolist()}
        return {"type": "Feature", "id": self.ids[row], "geometry": point, "properties": properties}

    def __repr__(self) -> str:
        from .cards import map_card

        return map_card(self)

    def _repr_html_(self) -> str:
        from .cards import card_html, map_card, map_picture

        return card_html(map_card(self), map_picture(self))


Number = TypeVar("Number")
Count = TypeVar("Count")
Flag = TypeVar("Flag")
Status = TypeVar("Status")
Reasons = TypeVar("Reasons")


@dataclass(frozen=True)
class StepFields(Generic[Number, Count, Flag, Status, Reasons]):
    """What the filter says of a step: once for one step (`StepInfo`) and once for many (`Steps`).

    The fields are those of the core, in its order: `_core.step_fields()`, to which a test holds this class.
    """

    step: Count
    """Number of the step, from 0; messages of errors name it."""
    sightings: Count
    """Sightings used."""
    skipped: Count
    """Sightings not finite, too near, too far, without identity or with a bad covariance."""
    matched: Count
    """Sightings of landmarks that were known, in the best particle."""
    new_landmarks: Count
    ignored: Count
    """Sightings that were neither associated nor new."""
    landmarks: Count
    """Landmarks in the map of the best particle (filler steps repeat the last value)."""
    removed: Count
    """Landmarks that the best particle removed from its map."""
    merged: Count
    """Landmarks that the best particle merged with another one."""
    particles: Count
    effective_sample_size: Number
    log_likelihood: Number
    """Increment of the log evidence."""
    resampled: Flag
    rejuvenated: Flag
    """Whether all particles were drawn anew from the posterior over paths."""
    sampled: Flag
    """Whether the poses are samples now; without sightings FastSLAM 2.0 waits."""
    repaired: Count
    """Landmark covariances that lost definiteness, over all particles."""
    fell_back: Count
    """Particles for which the scan was too large for joint association."""
    nis: Number
    """Mean normalised innovation squared per two numbers (a sighting of range and bearing), sliding window; 2
    is expected, 0 before the first."""
    nis_band_low: Number
    """From here to `nis_band_high` lie 95 % of such means when the noise is right."""
    nis_band_high: Number
    health: Status
    """`initializing`, `ok`, `degraded`, `lost` or `searching`; in arrays `fastslam.health.HealthStatus`."""
    health_reasons: Reasons
    """Names in `fastslam.health.REASONS`; in arrays bits, which `fastslam.health.reason_names` names."""


@dataclass(frozen=True)
class Steps(StepFields[Floats, Ints, Bools, Ints, Ints], Table):
    """One row per filter step (a stamp with sightings, or a filler in a long gap). Shapes: all (T,).

    Read back from the files of an older version, a column that it did not write holds -1, NaN or False.
    """

    stamp_s: Floats
    latency_us: Floats
    """Computing time of the step with the motion before it."""

    def to_columns(self) -> Columns:
        """Columns of `steps.csv`, health and its reasons as names."""
        from .resultfiles import step_columns

        return step_columns(self)


@dataclass(frozen=True)
class Try:
    """One of several runs over a log that differ in the seed."""

    seed: int
    log_evidence: float
    """See `RunResult.log_evidence`."""
    landmarks: int
    agreement: float | None = None
    """How far it agrees with the run that was kept (`fastslam.opinion.agreement`), where that was asked."""


@dataclass(frozen=True)
class RunResult:
    """The outcome of one run over a log."""

    log_name: str
    config: dict[str, Any]
    """The effective configuration, seed included."""
    version: str
    trajectory: Trajectory
    """Live estimates: what the filter knew at each stamp."""
    smoothed: Trajectory
    """Path of the best particle, from the path posterior at the end."""
    landmarks: LandmarkMap
    steps: Steps
    filter_seconds: float
    peak_memory_bytes: int
    interrupted: bool = False
    """True when the run was stopped early; everything above is then valid up to the last stamp."""
    map_rows: int = 0
    """Rows of the store at the end: one per landmark and distinct copy of it among the particles."""
    map_bytes: int = 0
    """What the maps of all particles (the joint covariance of EKF-SLAM) occupy at the end."""
    counts: dict[str, int] = field(default_factory=dict)
    """Skips and repairs that were counted: name to number."""
    verdict: tuple[str, ...] = ()
    """What the run comes to where that is less than a map and a path, and why; a sentence each."""
    doubts: tuple[Doubt, ...] = field(default=(), repr=False, compare=False)
    """What was held against the map for the verdict, strongest first, all of it (`fastslam.trust.doubts`)."""
    warnings: tuple[str, ...] = ()
    """What the innovations say against the noise configured, and how often the filter was not ok."""
    findings: tuple[dict[str, str], ...] = ()
    """What the examination of the log found before the run: code, severity, message and remedy of each."""
    noise: dict[str, Any] = field(default_factory=dict)
    """The figures behind that: mean NIS with its band, and a factor for each standard deviation."""
    calibration: dict[str, float] = field(default_factory=dict)
    """What a run on ranges alone, or with a sensor of one's own, learned of scale and bias of its numbers, in
    their units: `range_scale` and `range_bias_m`, with `range_scale_std` and `range_bias_std_m`. Empty where
    nothing was to be learned."""
    chart: Map | None = None
    """The map that the run began with."""
    changes: Changes | None = None
    """What it found otherwise in it."""
    tries: tuple[Try, ...] = ()
    """The runs of which this one was kept, where there were several."""

    @property
    def log_evidence(self) -> float:
        """Logarithm of how probable the run made the sightings, each told by those before it, in nats.

        Comparable between runs over one log whose settings of the sensor are the same.
        """
        return float(np.nansum(self.steps.log_likelihood))

    @property
    def path(self) -> Trajectory:
        """The best path there is: the smoothed one, the live one where a run has none."""
        return self.smoothed if len(self.smoothed.stamp_s) else self.trajectory

    @property
    def map(self) -> Map:
        """The landmarks as a map to be kept: the confirmed ones."""
        from .maps import Map

        return Map.of_result(self)

    def to_geojson(self, *, coordinates: Literal["local_metres"]) -> dict[str, Any]:
        """Landmarks, as `LandmarkMap.to_geojson` has them, and the path as a line with the id `path`.

        Errors: `ConfigError` for other coordinates.
        """
        found = self.landmarks.to_geojson(coordinates=coordinates)
        line = {"type": "LineString", "coordinates": self.path.T_world_robot[:, :2].tolist()}
        properties = {"log": self.log_name, "stamps_s": self.path.stamp_s.tolist()}
        if len(self.path.stamp_s) > 1:
            feature = {"type": "Feature", "id": "path", "geometry": line, "properties": properties}
            found["features"].append(feature)
        return found

    def to_tum(self, *, path: Literal["live", "smoothed"] = "live") -> str:
        """The text of `trajectory.tum` or `smoothed.tum`. Errors: `ConfigError` for another path."""
        paths = {"live": self.trajectory, "smoothed": self.smoothed}
        if path not in paths:
            raise ConfigError(f"path: got {path}, expected live or smoothed")
        return paths[path].to_tum()

    def to_mcap(self, path: Path | str) -> Path:
        """Writes an MCAP file that viewers open: pose, transforms, path and landmarks (`fastslam.mcap`).

        Needs `pip install rosbags`. Errors: `DataError`.
        """
        from .mcap import write_mcap

        return write_mcap(self, path)

    def __repr__(self) -> str:
        from .cards import result_card

        return result_card(self)

    def _repr_html_(self) -> str:
        from .cards import card_html, map_picture, result_card

        return card_html(result_card(self), map_picture(self.landmarks, self.path.T_world_robot[:, :2]))

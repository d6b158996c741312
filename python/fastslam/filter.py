"""The filter step by step, for live streams; `fastslam.run` takes a whole log at once."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from . import _core
from .config import Config
from .errors import DataError, NumericalError
from .health import reason_names, status_name
from .identity import nobody_knows
from .log import Floats, Ints
from .noise import noise_sentences
from .result import LandmarkMap, Trajectory
from .settings import Layer

Identity = str | float | None
"""Name or number (from 0) of a landmark; None, -1, NaN and some words where nobody says which one it is
(`fastslam.identity.NOBODY_KNOWS`)."""


@dataclass(frozen=True)
class StepInfo:
    """What one update did; `skipped` counts sightings not finite, too near, too far or without identity.

    `health` is `initializing`, `ok`, `degraded` or `lost`, `health_reasons` says why
    (`fastslam.health.REASONS`), and `warnings` how the innovations lately contradict the configured noise.
    """

    step: int
    sightings: int
    new_landmarks: int
    ignored: int
    skipped: int
    effective_sample_size: float
    resampled: bool
    rejuvenated: bool
    log_likelihood: float
    landmarks: int
    matched: int
    """Sightings of landmarks that were known, in the best particle."""
    removed: int
    repaired: int
    """Landmark covariances that lost definiteness, over all particles."""
    particles: int
    nis: float
    """Mean normalised innovation squared per sighting, sliding window; 2 is expected, 0 before the first."""
    nis_band: tuple[float, float]
    """What holds 95 % of such means when the noise is right."""
    health: str
    health_reasons: tuple[str, ...]
    warnings: tuple[str, ...]


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

    Errors: `ConfigError` for the configuration.
    """

    def __init__(
        self, config: Layer | None = None, *, identities: Literal["all", "some", "none"] = "some"
    ) -> None:
        self.config = Config.resolve(config or {})
        self._filter = _core.Filter(self.config.to_json(), identities)
        self._control_columns = _core.control_columns(self.config.to_json())
        self._index_of: dict[str, int] = {}
        self._stamp_s = 0.0
        self._updated_s = -np.inf

    def predict(self, control: ArrayLike, dt_s: float) -> None:
        """Moves the robot: a control of the motion model (2 or 3 numbers) that acted for `dt_s`.

        Errors: `DataError` for another number of values, or values that are not finite.
        """
        values = np.zeros(3)
        given = np.atleast_1d(np.asarray(control, dtype=np.float64))
        if given.shape != (len(self._control_columns),):
            raise DataError(f"control: got shape {given.shape}, expected {', '.join(self._control_columns)}")
        values[: len(given)] = given
        with _core_errors():
            self._filter.predict(values.tolist(), dt_s)
        self._stamp_s += dt_s

    def update(
        self,
        stamp_s: float,
        *,
        range_m: ArrayLike,
        bearing_rad: ArrayLike,
        identity: Sequence[Identity] | None = None,
        covariance: ArrayLike | None = None,
        class_index: ArrayLike | None = None,
        signature: ArrayLike | None = None,
    ) -> StepInfo:
        """Corrects with the sightings of one scan, in the sensor's frame; none at all is a scan too.

        Shapes: all (S,); `covariance` (S, 3) is that of each range and bearing as (m², m·rad, rad²), NaN
        where the sensor's own noise holds. `class_index` (-1: none) and `signature` (NaN: none) count where
        `association.classes` and `association.signatures` are configured. Errors: `DataError` for columns of
        different lengths, a stamp before the last one, or an identity that is neither name nor number;
        `NumericalError` when the filter cannot go on.
        """
        if not (np.isfinite(stamp_s) and stamp_s >= self._updated_s):
            raise DataError(f"stamp_s: got {stamp_s}, expected a finite time not before {self._updated_s}")
        ranges = np.atleast_1d(np.asarray(range_m, dtype=np.float64))
        bearings = np.atleast_1d(np.asarray(bearing_rad, dtype=np.float64))
        noise = None if covariance is None else np.asarray(covariance, dtype=np.float64).reshape(-1, 3)
        classes = None if class_index is None else np.atleast_1d(np.asarray(class_index, dtype=np.int64))
        signatures = None if signature is None else np.atleast_1d(np.asarray(signature, dtype=np.float64))
        with _core_errors():
            columns = self._filter.update(
                stamp_s,
                ranges,
                bearings,
                self._indices(identity, len(ranges)),
                noise,
                classes,
                signatures,
            )
        self._stamp_s = self._updated_s = stamp_s
        columns["health"] = status_name(columns["health"])
        columns["health_reasons"] = reason_names(columns["health_reasons"])
        columns["warnings"] = noise_sentences(columns["warnings"], self.config)
        return StepInfo(**columns)

    def rejuvenate(self) -> bool:
        """Draws all particles anew from the posterior over paths, given the best particle's associations.

        For the end of a log, or a moment when the robot stands; by itself the filter does it as often as
        `filter.rejuvenation` says. Returns False when `filter.rejuvenation.every_steps` is 0, when nothing
        happened since the last time, or when no solution was found.
        """
        return self._filter.rejuvenate()

    def step(
        self,
        control: ArrayLike,
        *,
        dt_s: float,
        range_m: ArrayLike = (),
        bearing_rad: ArrayLike = (),
        identity: Sequence[Identity] | None = None,
    ) -> StepInfo:
        """`predict`, then `update` at the time that the controls since the last update (or 0) add up to."""
        self.predict(control, dt_s)
        return self.update(self._stamp_s, range_m=range_m, bearing_rad=bearing_rad, identity=identity)

    @property
    def pose(self) -> tuple[Floats, Floats]:
        """Mean `T_world_robot` (3,) as x, y, heading and its covariance (3, 3), over all particles."""
        return self._filter.pose()

    @property
    def particles(self) -> tuple[Floats, Floats]:
        """Poses `T_world_robot` (M, 3) and normalised weights (M,)."""
        return self._filter.particles()

    @property
    def landmarks(self) -> LandmarkMap:
        """The map of the mixture; landmarks without an identity are named `L<birth number>`."""
        return landmark_map(self._filter.map(), tuple(self._index_of))

    @property
    def path(self) -> Trajectory:
        """The path of the best particle so far."""
        return Trajectory(*self._filter.best_path())

    def _indices(self, identity: Sequence[Identity] | None, count: int) -> Ints:
        if identity is None:
            return np.full(count, -1, dtype=np.int64)
        names = [_name(value) for value in identity]
        return np.array(
            [-1 if name is None else self._index_of.setdefault(name, len(self._index_of)) for name in names],
            dtype=np.int64,
        )


def _name(identity: Identity) -> str | None:
    """A landmark's name as text; what logs write for nobody knows must not become a name."""
    if identity is None or (
        isinstance(identity, str | float | int | np.number) and nobody_knows(str(identity))
    ):
        return None
    number = isinstance(identity, int | np.integer) and not isinstance(identity, bool)
    if isinstance(identity, str) or (number and int(identity) >= 0):
        return str(identity)
    raise DataError(f"identity: got {identity!r}, expected a name, a number from 0, or None for unknown")


def landmark_map(
    columns: dict[str, np.ndarray], identity_names: tuple[str, ...], class_names: tuple[str, ...] = ()
) -> LandmarkMap:
    """A map of the core, its identities replaced by their names."""
    has_class = bool((columns["class_index"] >= 0).any())
    has_signature = bool(np.isfinite(columns["signature"]).any())
    return LandmarkMap(
        ids=tuple(
            f"L{birth}" if identity < 0 else identity_names[identity]
            for birth, identity in zip(columns["birth"], columns["identity"], strict=True)
        ),
        mean_m=columns["mean_m"],
        covariance_m2=columns["covariance_m2"],
        sightings=columns["sightings"],
        confirmed=columns["confirmed"],
        class_index=columns["class_index"] if has_class else None,
        signature=columns["signature"] if has_signature else None,
        class_names=class_names if has_class else (),
    )


@contextmanager
def _core_errors() -> Iterator[None]:
    try:
        yield
    except ValueError as error:
        raise DataError(str(error)) from None
    except RuntimeError as error:
        raise NumericalError(str(error)) from None

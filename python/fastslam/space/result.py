"""What a run in space found."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ..log import Floats, Ints


@dataclass(frozen=True)
class SpacePath:
    """Poses by time. Shapes: `stamp_s` (T,), `T_world_robot` (T, 7): x, y, z and the quaternion w, x, y, z.

    `covariance` (T, 6, 6), where there is one, is that of a shift (m) and a turn (rad) in the robot's axes.
    """

    stamp_s: Floats
    T_world_robot: Floats
    covariance: Floats | None = None

    def to_tum(self) -> str:
        """Lines `stamp x y z qx qy qz qw`; stamps come back to the bit."""
        columns = self.T_world_robot[:, [0, 1, 2, 4, 5, 6, 3]]
        lines = (
            " ".join([repr(float(stamp)), *(f"{value:.9g}" for value in row)]) + "\n"
            for stamp, row in zip(self.stamp_s, columns, strict=True)
        )
        return "# stamp_s x_m y_m z_m qx qy qz qw (T_world_robot)\n" + "".join(lines)


@dataclass(frozen=True)
class SpaceMap:
    """Landmarks. Shapes: `ids` (K), `mean_m` (K, 3), `covariance_m2` (K, 3, 3), `sightings` (K,)."""

    ids: tuple[str, ...]
    mean_m: Floats
    covariance_m2: Floats
    sightings: Ints


@dataclass(frozen=True)
class NoiseRatios:
    """Squared residuals over what the noise explains, 1 where it is right.

    Shapes: `motion` (6,), shift and turn by axis; `sensor` (3,), by number of a sighting.
    """

    motion: Floats
    sensor: Floats


@dataclass(frozen=True)
class Hold:
    """How well path and map hold together where no odometry holds the path.

    `misfit` is the squared residuals of the least squares over what the noise explains; `shape_std_m` how
    surely landmarks lie where they do to each other, as the root of the mean variance of a place.
    """

    misfit: float
    shape_std_m: float


@dataclass(frozen=True)
class SpaceResult:
    """A run: the path as it was known on the way, and path and map given the whole log."""

    log_name: str
    config: dict[str, Any]
    version: str
    trajectory: SpacePath
    smoothed: SpacePath
    landmarks: SpaceMap
    steps: dict[str, Any]
    filter_seconds: float
    interrupted: bool = False
    counts: dict[str, int] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()
    ratios: NoiseRatios | None = None
    """What the residuals say of the noise, where the least squares had a solution."""
    hold: Hold | None = None
    """Of a log without odometry whose least squares had a solution."""

    @property
    def log_evidence(self) -> float:
        """Logarithm of how probable the run made the sightings, each told by those before it, in nats."""
        return float(np.sum(self.steps["log_likelihood"]))

    @property
    def innovation_ratio(self) -> float:
        """Squared innovations over what the noise explains: 1 where the noise is right, NaN without any."""
        numbers = float(np.sum(self.steps["degrees_of_freedom"]))
        return float(np.sum(self.steps["nis"])) / numbers if numbers else float("nan")

"""Sensors of one's own: a class that says what it should measure, and a suite that checks it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike

from .answers import Given, checked, in_one_line, read_only, shape_text
from .errors import ModelError
from .log import Floats
from .measured import BOTH
from .settings import Partial

MEASURES = (("range_m",), ("bearing_rad",), BOTH)
"""Columns of sightings that may hold the numbers of a sensor."""

_STEP = 1e-5
"""Of differences, metres and radians: rounding and curvature both stay near 1e-9 of a sensor's numbers."""


class Sensor(Protocol):
    """What a class needs to be a sensor; all of it is called on arrays, a row for each pose and landmark.

    It may have more: `jacobian(poses, landmarks)` gives the derivatives of `expected` by the landmark
    (n, Z, 2) and by the pose (n, Z, 3); without it they are taken by differences. `innovation(measured,
    expected)` (n, Z) is measured minus expected; without it the difference, wrapped where the column is an
    angle. `births(poses, measured)` gives where a landmark may be that was sighted once: shares (n, K) that
    sum to 1, means (n, K, 2), covariances (n, K, 2, 2); without it the ring of a range. Numbers in the column
    `range_m` lie within the limits of the configuration, as those of ranges do.

    Poses (n, 3) are those of the sensor in the world as x, y, heading; landmarks (n, 2) are in the world.
    """

    @property
    def measures(self) -> tuple[str, ...]:
        """Which columns of the sightings it measures: one of `MEASURES`; their number is Z."""

    @property
    def noise(self) -> ArrayLike:
        """Covariance (Z, Z) of what it measures."""

    def expected(self, poses: Floats, landmarks: Floats) -> ArrayLike:
        """What it should measure, (n, Z)."""


class Adapter:
    """A sensor as the core asks it: checked answers, and an error in one line where it fails.

    Errors: `ModelError` for a class without `measures`, `noise` and `expected`, and from then on for every
    answer of another shape than it should have, or with what is no number.
    """

    def __init__(self, sensor: Sensor) -> None:
        if isinstance(sensor, type):
            name = sensor.__name__
            raise ModelError(f"{name}: got the class, expected an instance of it: {name}(...)")
        self.sensor = sensor
        self.name = type(sensor).__name__
        for part in ("measures", "noise", "expected"):
            if not hasattr(sensor, part):
                raise ModelError(f"{self.name}.{part} is missing: a sensor has measures, noise and expected")
        measures = sensor.measures
        self.measures = (measures,) if isinstance(measures, str) else tuple(measures)
        if self.measures not in MEASURES:
            known = " or ".join(str(columns) for columns in MEASURES)
            raise ModelError(f"{self.name}.measures: got {self.measures}, expected {known}")
        self.size = len(self.measures)
        self.noise = self._answer("noise", lambda: sensor.noise, (self.size, self.size))
        if not (self.noise == self.noise.T).all() or not (np.linalg.eigvalsh(self.noise) > 0.0).all():
            raise ModelError(f"{self.name}.noise: got {self.noise.tolist()}, expected a covariance")
        self.columns = [BOTH.index(column) for column in self.measures]
        self.has_births = hasattr(sensor, "births")
        if not self.has_births and self.measures != ("range_m",):
            raise ModelError(
                f"{self.name}.births is missing: only for measures = ('range_m',) is there one to go without"
            )

    def look(
        self, poses: Floats, landmarks: Floats, measured: Floats, scale: Floats, bias: Floats
    ) -> tuple[Floats, Floats, Floats, Floats]:
        """Innovation (n, Z), true first number (n,), derivatives by landmark (n, Z, 2) and pose (n, Z, 3).

        What is reported for the first number of a true measurement is scale times it plus bias.
        """
        expected, by_landmark, by_pose = self.linearized(poses, landmarks)
        first = expected[:, 0].copy()
        reported = expected.copy()
        reported[:, 0] = scale * first + bias
        by_landmark[:, 0] *= scale[:, None]
        by_pose[:, 0] *= scale[:, None]
        return self.innovation(measured, reported), first, by_landmark, by_pose

    def linearized(self, poses: Floats, landmarks: Floats) -> tuple[Floats, Floats, Floats]:
        """Expected measurement and its derivatives, of which the caller may change the numbers."""
        if hasattr(self.sensor, "jacobian"):
            expected = self.expected(poses, landmarks)
            return (expected, *self.jacobian(poses, landmarks))
        return self.differences(poses, landmarks)

    def differences(self, poses: Floats, landmarks: Floats) -> tuple[Floats, Floats, Floats]:
        """As `linearized`, without asking the class for derivatives."""
        count = len(poses)
        # All in one call: as they are, then each of five variables a little more and a little less.
        moved = np.concatenate([np.zeros((1, 5)), _STEP * np.eye(5), -_STEP * np.eye(5)])
        rows = np.concatenate([poses, landmarks], axis=1)[None] + moved[:, None]
        rows = rows.reshape(-1, 5)
        several = self.expected(rows[:, :3], rows[:, 3:]).reshape(11, count, self.size)
        ahead, back = several[1:6].reshape(-1, self.size), several[6:].reshape(-1, self.size)
        slopes = self.innovation(ahead, back).reshape(5, count, self.size) / (2.0 * _STEP)
        by = np.moveaxis(slopes, 0, 2)
        return several[0].copy(), by[..., 3:].copy(), by[..., :3].copy()

    def expected(self, poses: Floats, landmarks: Floats) -> Floats:
        """What the sensor should measure (n, Z)."""
        given = read_only(poses, landmarks)
        asked = (("pose", given[0]), ("landmark", given[1]))
        return self._answer("expected", lambda: self.sensor.expected(*given), (len(poses), self.size), asked)

    def innovation(self, measured: Floats, expected: Floats) -> Floats:
        """Measured minus expected (n, Z)."""
        own: Callable[[Floats, Floats], ArrayLike] | None = getattr(self.sensor, "innovation", None)
        if own is None:
            off = measured - expected
            for place, column in enumerate(self.measures):
                if column.endswith("_rad"):
                    off[:, place] -= 2.0 * np.pi * np.round(off[:, place] / (2.0 * np.pi))
            return off
        ask, given = own, read_only(measured, expected)
        asked = (("measured", given[0]), ("expected", given[1]))
        return self._answer("innovation", lambda: ask(*given), measured.shape, asked)

    def jacobian(self, poses: Floats, landmarks: Floats) -> tuple[Floats, Floats]:
        """The sensor's own derivatives by landmark (n, Z, 2) and pose (n, Z, 3)."""
        shapes = tuple((len(poses), self.size, variables) for variables in (2, 3))
        asked = (("pose", poses), ("landmark", landmarks))
        by_landmark, by_pose = self._answers("jacobian", asked, shapes)
        return by_landmark, by_pose

    def births(self, poses: Floats, measured: Floats) -> tuple[Floats, Floats, Floats]:
        """The sensor's own births: shares (n, K), means (n, K, 2), covariances (n, K, 2, 2)."""
        count = len(poses)
        shapes = ((count, -1), (count, -1, 2), (count, -1, 2, 2))
        asked = (("pose", poses), ("measured", measured))
        share, mean, covariance = self._answers("births", asked, shapes)
        return share, mean, covariance

    def _answers(self, method: str, given: Given, shapes: tuple[tuple[int, ...], ...]) -> list[Floats]:
        """What a method answers that gives several arrays; -1 stands for one number, the same in all."""
        with in_one_line(f"{self.name}.{method}"):
            answer: Any = getattr(self.sensor, method)(*read_only(*(rows for _, rows in given)))
        if not isinstance(answer, tuple | list) or len(answer) != len(shapes):
            expected = " and ".join(shape_text(shape) for shape in shapes)
            raise ModelError(f"{self.name}.{method}: expected {len(shapes)} arrays, {expected}")
        free = np.shape(answer[0])[1] if -1 in shapes[0] and np.ndim(answer[0]) == 2 else 0
        wanted = [tuple(free if size == -1 else size for size in shape) for shape in shapes]
        return [
            checked(f"{self.name}.{method}", array, shape, given)
            for array, shape in zip(answer, wanted, strict=True)
        ]

    def _answer(
        self, part: str, ask: Callable[[], ArrayLike], shape: tuple[int, ...], given: Given = ()
    ) -> Floats:
        with in_one_line(f"{self.name}.{part}"):
            answer = ask()
        return checked(f"{self.name}.{part}", answer, shape, given)


def check(sensor: Sensor, *, range_m: tuple[float, float] = (0.5, 60.0)) -> int:
    """Puts a sensor through its conformance suite; returns the number of cases that it saw.

    Landmarks lie in all directions, `range_m` away. Shapes and finiteness of every answer; a row alone
    gives what it gives among others; the innovation of a measurement with itself is nothing, of one that is
    a little more it is that little, and a heading one turn further is the same; the derivatives against
    differences; the births are covariances whose shares sum to 1, the landmark is near one of them, and each
    explains the sighting. Numbers in the column `range_m` lie within the default limits of ranges, beyond
    which a run skips them. It begins with the part of the suite that holds wherever a sensor sees.

    >>> class Beacons:
    ...     measures, noise = ("range_m",), [[0.09]]
    ...     def expected(self, poses, landmarks):
    ...         return np.linalg.norm(landmarks - poses[:, :2], axis=1)[:, None]
    >>> check(Beacons())
    300

    Errors: `ModelError` in one line, for the first thing that is wrong.
    """
    from .sensor_checks import check_adapter

    return check_adapter(Adapter(sensor), range_m)


def adapted(sensor: Sensor | None) -> Adapter | None:
    """A sensor as the core asks it. Errors: `ModelError`."""
    return None if sensor is None else Adapter(sensor)


def own_layer(sensor: object | None) -> Partial:
    """The setting that a filter is for a sensor of one's own, where there is one."""
    return {} if sensor is None else {"sensor": {"model": "own"}}

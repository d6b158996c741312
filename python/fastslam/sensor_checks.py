"""The suite of sensors of one's own, `fastslam.sensors.check`, and what of it a run begins with."""

from __future__ import annotations

import numpy as np

from .config import sensor_of
from .errors import ModelError
from .log import Floats
from .sensors import Adapter, Sensor, adapted

_CASES = 300
_FEW = 16
"""Poses at the start of a run."""
_NEAR_M = (2.0, 20.0)
"""Distances at the start of a run, where most sensors see."""
_SLOPE_TOLERANCE = 1e-5
"""Of a derivative against differences: a hundred times what rounding leaves of them at 100 m."""
_SAME = 1e-9
_ROUNDED = 1e-5
"""As far off are numbers of 32 bits."""
_STEPS = 1e-3
"""By which a measurement is more than expected, in standard deviations of the noise."""
_ROUGHLY = 0.3
"""At the start of a run a derivative, or a distance, this far off for most poses is a wrong one."""
_FAR_BIRTH = 100.0
"""The same of the squared distance from the nearest birth, in its standard deviations."""
_FARTHEST_BIRTH = 1.5
"""Squared distance of the landmark from the nearest birth, in its standard deviations: half way to a next."""


def check_adapter(adapter: Adapter, range_m: tuple[float, float]) -> int:
    """See `fastslam.sensors.check`."""
    poses, landmarks = _geometries(range_m)
    expected = adapter.expected(poses, landmarks)
    _check_rows(adapter, poses, landmarks, expected)
    _check_sign(adapter, expected)
    _check_innovation(adapter, poses, landmarks, expected)
    _check_jacobian(adapter, poses, landmarks)
    if adapter.has_births:
        _check_births(adapter, poses, landmarks, expected)
    else:
        _check_ring(adapter, poses, landmarks, expected)
    _check_limits(adapter, expected)
    return _CASES


def begun(sensor: Sensor | None) -> Adapter | None:
    """A sensor as the core asks it, at the start of a run: what is wrong wherever it looks is said at once.

    **Why so little:** nobody says where the class holds, so only answers count that are wrong by far for most
    of a few poses, or that nothing excuses.

    Errors: `ModelError` in one line with the method.
    """
    adapter = adapted(sensor)
    if adapter is not None:
        poses, landmarks = _geometries(_NEAR_M, _FEW)
        expected = adapter.expected(poses, landmarks)
        _check_sign(adapter, expected)
        _check_slopes_roughly(adapter, poses, landmarks)
        if adapter.has_births:
            share, mean, covariance = adapter.births(poses, expected)
            _check_mixtures(adapter, share, covariance, _ROUNDED)
            _check_births_roughly(adapter, landmarks, (share, mean, covariance))
        else:
            _check_ring_roughly(adapter, poses, landmarks, expected)
    return adapter


def _geometries(range_m: tuple[float, float], count: int = _CASES) -> tuple[Floats, Floats]:
    """Poses, every fifth with a heading near π, and landmarks around them."""
    random = np.random.default_rng(20)
    heading = random.uniform(-3.1, 3.1, count)
    heading[::5] = np.pi - random.uniform(-1e-6, 1e-6, len(heading[::5]))
    poses = np.column_stack([random.uniform(-30.0, 30.0, (count, 2)), heading])
    distance, direction = random.uniform(*range_m, count), random.uniform(-np.pi, np.pi, count)
    towards = np.column_stack([np.cos(direction), np.sin(direction)])
    return poses, poses[:, :2] + distance[:, None] * towards


def _fail(adapter: Adapter, part: str, message: str) -> ModelError:
    return ModelError(f"{adapter.name}.{part}: {message}")


def _check_limits(adapter: Adapter, expected: Floats) -> None:
    """Numbers that a run skips: what is no range between the limits, in the column of ranges."""
    if adapter.measures[0] != "range_m":
        return
    section = sensor_of({"sensor": {}})
    nearest, farthest = section["min_range_m"], section["max_range_m"]
    skipped = (expected[:, 0] < nearest) | (expected[:, 0] > farthest)
    if skipped.any():
        row = int(np.argmax(skipped))
        raise _fail(
            adapter,
            "expected",
            f"row {row} is {expected[row, 0]:.4g} in the column range_m, of which a run skips all below "
            f"sensor.min_range_m = {nearest:g} and above sensor.max_range_m = {farthest:g}: take another "
            "unit or the other sign, or check where it sees (range_m=)",
        )


def _check_rows(adapter: Adapter, poses: Floats, landmarks: Floats, expected: Floats) -> None:
    """A row depends on no other: the core asks for as many at once as it likes."""
    for row in (0, _CASES // 2, _CASES - 1):
        alone = adapter.expected(poses[row : row + 1], landmarks[row : row + 1])
        if not np.abs(alone[0] - expected[row]).max() <= _SAME * (1.0 + np.abs(alone).max()):
            raise _fail(
                adapter, "expected", f"row {row} alone gives {alone[0]}, among others {expected[row]}"
            )


def _check_sign(adapter: Adapter, expected: Floats) -> None:
    """A measurement a little more than expected has that little as innovation, not less or something else."""
    for place, variance in enumerate(np.diagonal(adapter.noise)):
        more = _STEPS * variance**0.5 * (np.arange(adapter.size) == place)
        found = adapter.innovation(expected + more, expected)
        off = np.abs(found - more).max(axis=1)
        if (off > 0.01 * more[place] + _SAME * (1.0 + np.abs(expected).max(axis=1))).any():
            row = int(np.argmax(off))
            raise _fail(
                adapter,
                "innovation",
                f"of a measurement {more[place]:.3g} more than expected in number {place} is "
                f"{found[row, place]:.3g}: expected measured minus expected",
            )


def _check_slopes_roughly(adapter: Adapter, poses: Floats, landmarks: Floats) -> None:
    """Derivatives of the class that have another sign, or another size by far, than differences."""
    if not hasattr(adapter.sensor, "jacobian"):
        return
    _, *found = adapter.linearized(poses, landmarks)
    slopes = adapter.differences(poses, landmarks)[1:]
    for whose, own, slope in zip(("landmark", "pose"), found, slopes, strict=True):
        # Against the largest derivative by the same: others are rounding beside it.
        size = np.abs(slope).max(axis=(1, 2), keepdims=True)
        wrong = (np.abs(own - slope) > _ROUGHLY * size).any(axis=(1, 2))
        if np.mean(wrong) > 0.5:
            row = int(np.argmax(wrong))
            raise _fail(
                adapter,
                "jacobian",
                f"by the {whose} in row {row}: got {np.round(own[row], 6).tolist()}, "
                f"differences give {np.round(slope[row], 6).tolist()}",
            )


def _check_births_roughly(adapter: Adapter, landmarks: Floats, births: tuple[Floats, Floats, Floats]) -> None:
    """Births of which none is near the landmark: in another frame, or of another number."""
    squared = _nearest(landmarks, births)
    if np.median(squared) > _FAR_BIRTH:
        row = int(np.argmax(squared))
        far = f"the landmark of row {row} is {squared[row] ** 0.5:.3g} standard deviations from the nearest"
        raise _fail(
            adapter, "births", f"{far}: expected means in the world, where expected gives what was measured"
        )


def _check_ring_roughly(adapter: Adapter, poses: Floats, landmarks: Floats, expected: Floats) -> None:
    distance = np.linalg.norm(landmarks - poses[:, :2], axis=1)
    if np.median(np.abs(expected[:, 0] - distance) / distance) > _ROUGHLY:
        raise _no_ring(adapter, distance, expected, row=0)


def _check_innovation(adapter: Adapter, poses: Floats, landmarks: Floats, expected: Floats) -> None:
    own = adapter.innovation(expected, expected)
    if np.abs(own).max() > 0.0:
        row = int(np.argmax(np.abs(own).max(axis=1)))
        raise _fail(adapter, "innovation", f"of {expected[row]} with itself is {own[row]}, expected 0")
    turned = adapter.expected(poses + np.array([0.0, 0.0, 2.0 * np.pi]), landmarks)
    off = np.abs(adapter.innovation(expected, turned))
    if off.max() > _SAME:
        row = int(np.argmax(off.max(axis=1)))
        raise _fail(adapter, "innovation", f"a turn of 2π changes row {row} by {off[row]}: wrap the angles")


def _check_jacobian(adapter: Adapter, poses: Floats, landmarks: Floats) -> None:
    """The sensor's derivatives against differences, one variable at a time."""
    _, by_landmark, by_pose = adapter.linearized(poses, landmarks)
    variables = ("x of the pose", "y of the pose", "the heading", "x of the landmark", "y of the landmark")
    rows = np.concatenate([poses, landmarks], axis=1)
    for place, variable in enumerate(variables):
        step = 1e-5 * (np.arange(5) == place)
        ahead, back = ((rows + sign * step) for sign in (1.0, -1.0))
        slope = adapter.innovation(
            adapter.expected(ahead[:, :3], ahead[:, 3:]), adapter.expected(back[:, :3], back[:, 3:])
        )
        slope = slope / 2e-5
        found = by_pose[:, :, place] if place < 3 else by_landmark[:, :, place - 3]
        off = np.abs(found - slope) / (1.0 + np.abs(slope))
        if off.max() > _SLOPE_TOLERANCE:
            row, number = np.unravel_index(int(np.argmax(off)), off.shape)
            raise _fail(
                adapter,
                "jacobian",
                f"number {number} by {variable} in row {row}: got {found[row, number]:.6g}, "
                f"differences give {slope[row, number]:.6g}",
            )


def _check_births(adapter: Adapter, poses: Floats, landmarks: Floats, expected: Floats) -> None:
    share, mean, covariance = adapter.births(poses, expected)
    _check_mixtures(adapter, share, covariance, _SAME)
    squared = _nearest(landmarks, (share, mean, covariance))
    if squared.max() > _FARTHEST_BIRTH:
        row = int(np.argmax(squared))
        far = squared[row] ** 0.5
        raise _fail(
            adapter, "births", f"the landmark of row {row} is {far:.3g} standard deviations from the nearest"
        )
    used = share > 0.0
    rows, _ = np.nonzero(used)
    _check_explained(adapter, (poses[rows], mean[used], covariance[used]), expected[rows])


def _check_mixtures(adapter: Adapter, share: Floats, covariance: Floats, same: float) -> None:
    """Shares that sum to 1, and covariances."""
    if (share < 0.0).any() or np.abs(share.sum(axis=1) - 1.0).max() > same:
        row = int(np.argmax(np.abs(share.sum(axis=1) - 1.0)))
        raise _fail(adapter, "births", f"the shares of row {row} sum to {share[row].sum():.6g}, expected 1")
    symmetric = np.abs(covariance - np.swapaxes(covariance, -1, -2)).max() <= same * np.abs(covariance).max()
    if not symmetric or not (np.linalg.eigvalsh(covariance[share > 0.0]) > 0.0).all():
        raise _fail(adapter, "births", "expected covariances, symmetric and positive definite")


def _nearest(landmarks: Floats, births: tuple[Floats, Floats, Floats]) -> Floats:
    """Squared distance of each landmark from the nearest of its births, in standard deviations."""
    share, mean, covariance = births
    used, off = share > 0.0, landmarks[:, None] - mean
    squared = np.full(share.shape, np.inf)
    squared[used] = np.einsum(
        "na,na->n", off[used], np.linalg.solve(covariance[used], off[used][..., None])[..., 0]
    )
    return np.asarray(squared.min(axis=1))


def _check_ring(adapter: Adapter, poses: Floats, landmarks: Floats, expected: Floats) -> None:
    """Without births of its own a sensor must measure a distance, around which there is a ring."""
    distance = np.linalg.norm(landmarks - poses[:, :2], axis=1)
    off = np.abs(expected[:, 0] - distance)
    if off.max() > _SAME * (1.0 + distance.max()):
        raise _no_ring(adapter, distance, expected, row=int(np.argmax(off)))


def _no_ring(adapter: Adapter, distance: Floats, expected: Floats, *, row: int) -> ModelError:
    return _fail(
        adapter,
        "births",
        f"is missing, and the ring of a range does not do: row {row} is {distance[row]:.6g} m away, "
        f"and expected says {expected[row, 0]:.6g}",
    )


def _check_explained(adapter: Adapter, births: tuple[Floats, Floats, Floats], measured: Floats) -> None:
    """Each birth explains its sighting to within what its width and the noise allow."""
    poses, mean, covariance = births
    expected, by_landmark, _ = adapter.linearized(poses, mean)
    innovation = adapter.innovation(measured, expected)
    spread = by_landmark @ covariance @ np.swapaxes(by_landmark, 1, 2) + adapter.noise
    fit = np.einsum("nz,nz->n", innovation, np.linalg.solve(spread, innovation[..., None])[..., 0])
    if fit.max() > 1.0:
        row = int(np.argmax(fit))
        raise _fail(
            adapter, "births", f"a birth at {mean[row]} does not explain its sighting {measured[row]}"
        )

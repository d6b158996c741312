"""The conformance suite of sensors of one's own: what `fastslam.sensors.check` runs."""

from __future__ import annotations

import numpy as np

from .errors import ModelError
from .log import Floats
from .sensors import Adapter

_CASES = 300
_SLOPE_TOLERANCE = 1e-5
"""Of a derivative against differences: a hundred times what rounding leaves of them at 100 m."""
_SAME = 1e-9
_FARTHEST_BIRTH = 1.5
"""Squared distance of the landmark from the nearest birth, in its standard deviations: half way to a next."""


def check_adapter(adapter: Adapter, range_m: tuple[float, float]) -> int:
    """See `fastslam.sensors.check`."""
    poses, landmarks = _geometries(range_m)
    expected = adapter.expected(poses, landmarks)
    _check_rows(adapter, poses, landmarks, expected)
    _check_innovation(adapter, poses, landmarks, expected)
    _check_jacobian(adapter, poses, landmarks)
    if adapter.has_births:
        _check_births(adapter, poses, landmarks, expected)
    else:
        _check_ring(adapter, poses, landmarks, expected)
    return _CASES


def _geometries(range_m: tuple[float, float]) -> tuple[Floats, Floats]:
    """Poses, every fifth with a heading near π, and landmarks around them."""
    random = np.random.default_rng(20)
    heading = random.uniform(-3.1, 3.1, _CASES)
    heading[::5] = np.pi - random.uniform(-1e-6, 1e-6, len(heading[::5]))
    poses = np.column_stack([random.uniform(-30.0, 30.0, (_CASES, 2)), heading])
    distance, direction = random.uniform(*range_m, _CASES), random.uniform(-np.pi, np.pi, _CASES)
    towards = np.column_stack([np.cos(direction), np.sin(direction)])
    return poses, poses[:, :2] + distance[:, None] * towards


def _fail(adapter: Adapter, part: str, message: str) -> ModelError:
    return ModelError(f"{adapter.name}.{part}: {message}")


def _check_rows(adapter: Adapter, poses: Floats, landmarks: Floats, expected: Floats) -> None:
    """A row depends on no other: the core asks for as many at once as it likes."""
    for row in (0, _CASES // 2, _CASES - 1):
        alone = adapter.expected(poses[row : row + 1], landmarks[row : row + 1])
        if not np.abs(alone[0] - expected[row]).max() <= _SAME * (1.0 + np.abs(alone).max()):
            raise _fail(
                adapter, "expected", f"row {row} alone gives {alone[0]}, among others {expected[row]}"
            )


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
    if (share < 0.0).any() or np.abs(share.sum(axis=1) - 1.0).max() > _SAME:
        row = int(np.argmax(np.abs(share.sum(axis=1) - 1.0)))
        raise _fail(adapter, "births", f"the shares of row {row} sum to {share[row].sum():.6g}, expected 1")
    used = share > 0.0
    rows, _ = np.nonzero(used)
    symmetric = np.abs(covariance - np.swapaxes(covariance, -1, -2)).max() <= _SAME * np.abs(covariance).max()
    if not symmetric or not (np.linalg.eigvalsh(covariance[used]) > 0.0).all():
        raise _fail(adapter, "births", "expected covariances, symmetric and positive definite")
    off = landmarks[:, None] - mean
    distance = np.full(share.shape, np.inf)
    distance[used] = np.einsum(
        "na,na->n", off[used], np.linalg.solve(covariance[used], off[used][..., None])[..., 0]
    )
    if distance.min(axis=1).max() > _FARTHEST_BIRTH:
        row = int(np.argmax(distance.min(axis=1)))
        far = distance[row].min() ** 0.5
        raise _fail(
            adapter, "births", f"the landmark of row {row} is {far:.3g} standard deviations from the nearest"
        )
    _check_explained(adapter, (poses[rows], mean[used], covariance[used]), expected[rows])


def _check_ring(adapter: Adapter, poses: Floats, landmarks: Floats, expected: Floats) -> None:
    """Without births of its own a sensor must measure a distance, around which there is a ring."""
    distance = np.linalg.norm(landmarks - poses[:, :2], axis=1)
    off = np.abs(expected[:, 0] - distance)
    if off.max() > _SAME * (1.0 + distance.max()):
        row = int(np.argmax(off))
        raise _fail(
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

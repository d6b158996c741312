"""Variances from residuals over the posterior: a step of expectation and maximisation.

With e the residuals at the mode, v their variance and h the share of it that the solution follows, the
evidence of v = sum_k q_k f_k is stationary where for each part k

    sum f_k e^2 / v^2 = sum f_k (1 - h) / v,

which is what the residuals of draws say as well, for E[r^2] = e^2 + h v. Each step multiplies q_k by the
ratio of the two sides to a power; a prior worth PRIOR_ROWS residuals holds what no residual tells.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..log import Floats, Ints
from .problem import Noise, Problem, Rows

PRIOR_ROWS = 3.0
POWER = 0.8
MOST_CHANGE = 4.0
TAILS = (3.0, 4.0, 5.0, 7.0, 10.0, 20.0)
"""Degrees of freedom that are tried beside a normal tail."""
TAIL_GAIN = 5.0
"""So many nats a tail must gain over a normal one, or there is none."""


def learned_noise(problem: Problem, rows: Rows, followed: Floats, noise: Noise, start: Noise) -> Noise:
    """The variances one step further from those under which the rows were whitened; `start` is the prior."""
    sightings = rows.seen.size
    left = 1.0 - followed
    left_seen, left_moved = left[:sightings].reshape(-1, 2), left[sightings:].reshape(-1, 3)
    seen = noise.seen * _ratio(
        np.sum(rows.seen**2, axis=0), np.sum(left_seen, axis=0), start.seen / noise.seen
    )
    squares = noise.squares.copy()
    share = problem.links.share * problem.joined[:, None]
    for part, axis in enumerate(problem.axes):
        # What a residual says about a part grows with the part's share of its variance.
        own = share[:, part] * noise.squares[part] / rows.variance[:, axis]
        squares[part] *= _ratio(
            np.array(own @ rows.moved[:, axis] ** 2),
            np.array(own @ left_moved[:, axis]),
            start.squares[part] / noise.squares[part],
        )
    return replace(noise, seen=seen, squares=squares)


def change_of(problem: Problem, rows: Rows, before: Noise, after: Noise) -> float:
    """The largest change of a variance, as a logarithm; of a part of motion by its share of the variance.

    What has hardly a share may shrink for ever, and nothing depends on it.
    """
    own = problem.links.share * before.squares / rows.variance[:, problem.axes]
    share = own[problem.joined].mean(axis=0)
    moved = share * np.abs(np.log(after.squares / before.squares))
    return float(max(np.abs(np.log(after.seen / before.seen)).max(), moved.max()))


def _ratio(found: Floats, expected: Floats, prior: Floats) -> Floats:
    ratio = (found + PRIOR_ROWS * prior) / (np.maximum(expected, 0.0) + PRIOR_ROWS)
    bounded: Floats = np.clip(ratio, 1 / MOST_CHANGE, MOST_CHANGE) ** POWER
    return bounded


def fitted_tail(rows: Rows, followed: Floats) -> float | None:
    """Degrees of freedom of the sightings' noise, by the likelihood of their residuals; None for normal."""
    left = np.clip(1 - followed[: rows.seen.size], 0.05, 1.0).reshape(-1, 2).mean(axis=0)
    squared = np.sum(rows.seen**2 / rows.weights[:, None] / left, axis=1)
    normal = _log_likelihood(squared, None)
    likelihoods = {tail: _log_likelihood(squared, tail) for tail in TAILS}
    best = max(likelihoods, key=likelihoods.__getitem__)
    return best if likelihoods[best] > normal + TAIL_GAIN and best < TAILS[-1] else None


def _log_likelihood(squared: Floats, tail: float | None) -> float:
    """Of squared distances in two dimensions under the scale that suits them best."""
    scale = float(np.mean(squared)) / 2 if tail is None else float(np.median(squared)) / 1.4
    if tail is None:
        return float(-len(squared) * (np.log(scale) + 1.0))
    for _ in range(30):
        scale = float(np.mean((tail + 2) / (tail + squared / scale) * squared)) / 2
    density = -0.5 * (tail + 2) * np.log1p(squared / scale / tail)
    return float(np.sum(density) - len(squared) * np.log(scale))


def correlation_of(rows: Rows, landmark: Ints, stamp_s: Floats) -> float:
    """1 + 2 sum of the autocorrelations of a landmark's residuals from one sighting to the next.

    So many sightings tell as much as one would whose errors did not repeat. Summed up to the first lag that
    correlates by less than LEAST_CORRELATION.
    """
    order = np.lexsort((stamp_s, landmark))
    values, of = rows.seen[order], landmark[order]
    values = values - np.median(values, axis=0)
    total = np.ones(2)
    going = np.ones(2, dtype=bool)
    power = np.mean(values**2, axis=0)
    for lag in range(1, min(MOST_LAGS, len(values) - 1) + 1):
        same = of[lag:] == of[:-lag]
        if int(same.sum()) < LEAST_PAIRS:
            break
        correlation = np.mean((values[lag:] * values[:-lag])[same], axis=0) / power
        going &= correlation > LEAST_CORRELATION
        total += 2 * np.where(going, correlation, 0.0)
        if not going.any():
            break
    return float(np.sqrt(np.prod(total)))


MOST_LAGS = 40
LEAST_PAIRS = 100
LEAST_CORRELATION = 0.1

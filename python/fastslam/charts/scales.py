"""From numbers to places on paper: ranges, round numbers on them."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ..log import Floats
from .panel import Range


@dataclass(frozen=True)
class Scale:
    """One direction of a panel: the numbers at its ends, and where these ends lie on paper, in points."""

    values: Range
    ends: Range
    log: bool = False

    def at(self, numbers: Floats) -> Floats:
        """Where numbers lie; on a logarithmic scale such as are not positive at the lower end."""
        low, high = self.values
        if self.log:
            numbers, low, high = np.log(np.maximum(numbers, low)), math.log(low), math.log(high)
        begin, end = self.ends
        return np.asarray(begin + (numbers - low) * ((end - begin) / (high - low)))

    def length(self, numbers: Floats) -> Floats:
        """How long differences are on paper; of a scale that is not logarithmic."""
        (low, high), (begin, end) = self.values, self.ends
        return np.asarray(numbers * abs((end - begin) / (high - low)))

    def ticks(self, most: int) -> list[float]:
        """Round numbers within the range, about as many as `most` at most."""
        low, high = sorted(self.values)
        found = _log_ticks(low, high) if self.log else _even_ticks(low, high, most)
        return [tick for tick in found if low <= tick <= high]


def tick_texts(ticks: list[float]) -> list[str]:
    """Ticks as text, with as many decimals as they need and a true minus."""
    decimals = 0
    while decimals < 12 and any(abs(round(tick, decimals) - tick) > 1e-9 * abs(tick) for tick in ticks):
        decimals += 1
    return [f"{tick:,.{decimals}f}".replace("-", "−") for tick in ticks]


def widened(x: Range, y: Range, width: float, height: float) -> tuple[Range, Range]:
    """The ranges, one of them widened about its middle so that both have the same scale on paper."""
    scale = max((x[1] - x[0]) / width, (y[1] - y[0]) / height)
    return _about(x, scale * width), _about(y, scale * height)


def _about(values: Range, length: float) -> Range:
    middle = 0.5 * (values[0] + values[1])
    return middle - 0.5 * length, middle + 0.5 * length


def _even_ticks(low: float, high: float, most: int) -> list[float]:
    least = (high - low) / max(most, 1)
    power = 10.0 ** math.floor(math.log10(least))
    step = next(factor * power for factor in (1.0, 2.0, 5.0, 10.0) if factor * power >= least * (1.0 - 1e-9))
    # `+ 0.0` makes minus zero zero.
    return [round(k * step, 12) + 0.0 for k in range(math.ceil(low / step), math.floor(high / step) + 1)]


def _log_ticks(low: float, high: float) -> list[float]:
    """1, 2, 5, 10, ...; more in a decade, over two powers of ten alone, over very many few of those."""
    first, last = math.floor(math.log10(low)), math.ceil(math.log10(high))
    stride = max(1, math.ceil((last - first) / 10))
    factors: tuple[float, ...] = (1.0, 2.0, 5.0) if high / low > 10.0 else (1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 7.0)
    if high / low > 100.0:
        factors = (1.0,)
    return [factor * 10.0**power for power in range(first, last + 1, stride) for factor in factors]

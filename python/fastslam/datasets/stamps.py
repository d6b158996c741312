"""Stamps of a table as seconds: plain, or dates by ISO 8601."""

from __future__ import annotations

import re
from collections.abc import Sequence
from datetime import datetime, timedelta, timezone

import numpy as np

from ..log import Floats

ISO_STAMP = re.compile(
    r"(\d{4}-\d\d-\d\d)[T ](\d\d:\d\d:\d\d)(?:[.,](\d+))?\s*(?:(Z|UTC)|([+-])(\d\d):?(\d\d))?", re.IGNORECASE
)
_EPOCH = datetime(1970, 1, 1, tzinfo=timezone.utc)


def iso_seconds(texts: Sequence[str]) -> Floats:
    """Seconds since 1970 of dates; UTC where no zone is given; NaN for a text that is no such date."""
    return np.array([_seconds(text.strip()) for text in texts], dtype=np.float64)


def _seconds(text: str) -> float:
    match = ISO_STAMP.fullmatch(text)
    if match is None:
        return float("nan")
    day, time, fraction, _, sign, hours, minutes = match.groups()
    try:
        moment = datetime.fromisoformat(f"{day}T{time}").replace(tzinfo=timezone.utc)
    except ValueError:
        return float("nan")
    if sign is not None:
        ahead = timedelta(hours=int(hours), minutes=int(minutes))
        moment = moment - ahead if sign == "+" else moment + ahead
    return (moment - _EPOCH).total_seconds() + (float(f"0.{fraction}") if fraction else 0.0)

"""The kinds of cases, and how many of each make a good mixture."""

from __future__ import annotations

from . import calls, configs, logs
from .case import Maker

KINDS: dict[str, Maker] = {"logs": logs.make, "configs": configs.make, "calls": calls.make}
SHARES = {"logs": 1, "configs": 2, "calls": 7}
"""Of ten mutated inputs; a log takes as long as several configurations, and each as long as several calls."""

"""Landmark SLAM by Rao-Blackwellized particle filtering: from a log to a map and a path."""

from ._core import __version__
from .config import Config
from .conversion import convert
from .datasets import load
from .errors import FastSlamError
from .filter import FastSlam, StepInfo
from .log import Log
from .result import RunResult
from .runner import run, run_many

__all__ = [
    "Config",
    "FastSlam",
    "FastSlamError",
    "Log",
    "RunResult",
    "StepInfo",
    "__version__",
    "convert",
    "load",
    "run",
    "run_many",
]

"""What the cells of the tests of sweeps do besides running: found by name in the worker processes."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path
from typing import Any

FLAG = "FASTSLAM_TEST_FLAG"


def slow(result: Any, log: Any) -> dict[str, float]:
    """Takes long enough for somebody to be killed in the meantime, and says who did it."""
    time.sleep(0.3)
    return {"pid": os.getpid()}


def die_once(result: Any, log: Any) -> dict[str, float]:
    """Kills its process if nobody has done so before."""
    flag = Path(os.environ[FLAG])
    if result.config["seed"] == 2 and not flag.exists():
        flag.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return {}


def die_always(result: Any, log: Any) -> dict[str, float]:
    """Kills every process that tries seed 1."""
    if result.config["seed"] == 1:
        os.kill(os.getpid(), signal.SIGKILL)
    return {}

"""What loading settings takes in memory, seen in a process of its own."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

_CODE = """
import resource, sys
from fastslam.config import load_config
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
try:
    load_config(sys.argv[1])
except Exception as error:
    print(type(error).__name__)
print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before)
"""


def refused_with_kilobytes(path: Path) -> tuple[str, int]:
    """The name of the error that `load_config` raises for a file, and by how much the process grew."""
    done = subprocess.run([sys.executable, "-c", _CODE, path], capture_output=True, text=True, check=True)
    error, kilobytes = done.stdout.split()
    return error, int(kilobytes)

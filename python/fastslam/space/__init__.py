"""Three dimensions: a robot that moves and turns in space, and landmarks in space that are known by name."""

from __future__ import annotations

from typing import TYPE_CHECKING

from .._lazy import lazy_names

# Readers of logs in the plane ask for single modules of this package: nothing else is loaded for them.
if TYPE_CHECKING:
    from .config import SpaceConfig
    from .evaluation import evaluate
    from .log import SpaceLog, SpaceTruth
    from .outputs import write_outputs
    from .reading import load, matches
    from .result import SpaceMap, SpacePath, SpaceResult
    from .runner import run

__all__ = [
    "SpaceConfig",
    "SpaceLog",
    "SpaceMap",
    "SpacePath",
    "SpaceResult",
    "SpaceTruth",
    "evaluate",
    "load",
    "matches",
    "run",
    "write_outputs",
]

_MODULE_OF = {
    "SpaceConfig": "config",
    "SpaceLog": "log",
    "SpaceMap": "result",
    "SpacePath": "result",
    "SpaceResult": "result",
    "SpaceTruth": "log",
    "evaluate": "evaluation",
    "load": "reading",
    "matches": "reading",
    "run": "runner",
    "write_outputs": "outputs",
}
__getattr__ = lazy_names(__name__, _MODULE_OF)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})

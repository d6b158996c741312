"""Landmark SLAM by Rao-Blackwellized particle filtering: from a log to a map and a path."""

from ._lazy import lazy_names

# The program comes through here before it can answer Ctrl-C: nothing is loaded, `typing` neither.
TYPE_CHECKING = False
if TYPE_CHECKING:
    from ._core import __version__
    from .automatic import run
    from .config import Config
    from .conversion import convert
    from .datasets import load
    from .errors import FastSlamError
    from .filter import FastSlam, StepInfo
    from .localisation import Localisation, localize
    from .log import Log
    from .maps import Anywhere, Map, Start
    from .opinion import best_of, second_opinion
    from .result import RunResult
    from .robot import Robot
    from .runner import run_many
    from .tuning import tune

__all__ = [
    "Anywhere",
    "Config",
    "FastSlam",
    "FastSlamError",
    "Localisation",
    "Log",
    "Map",
    "Robot",
    "RunResult",
    "Start",
    "StepInfo",
    "__version__",
    "best_of",
    "convert",
    "load",
    "localize",
    "run",
    "run_many",
    "second_opinion",
    "tune",
]

_MODULE_OF = {
    "Anywhere": "maps",
    "Config": "config",
    "FastSlam": "filter",
    "FastSlamError": "errors",
    "Localisation": "localisation",
    "Log": "log",
    "Map": "maps",
    "Robot": "robot",
    "RunResult": "result",
    "Start": "maps",
    "StepInfo": "filter",
    "__version__": "_core",
    "convert": "conversion",
    "load": "datasets",
    "localize": "localisation",
    "run": "automatic",
    "best_of": "opinion",
    "run_many": "runner",
    "second_opinion": "opinion",
    "tune": "tuning",
}
_MODULES = (
    *(
        "automatic",
        "calibration",
        "config",
        "conversion",
        "datasets",
        "detection",
        "errors",
        "evaluation",
        "filter",
        "health",
        "localisation",
        "log",
        "maps",
    ),
    "live",
    *(
        "monte_carlo",
        "motions",
        "opinion",
        "outputs",
        "plots",
        "report",
        "result",
        "resultfiles",
        "robot",
        "runner",
        "sensors",
        "settings",
    ),
    *("simulation", "sweep", "tuning"),
)
__getattr__ = lazy_names(__name__, _MODULE_OF, modules=_MODULES)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__, *_MODULES})

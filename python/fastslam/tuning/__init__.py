"""Finding the noise and the systematic errors of a log from the log itself."""

from .doctor import Diagnosis, Verdict, diagnose
from .session import Attempt, Tuning, tune

__all__ = ["Attempt", "Diagnosis", "Tuning", "Verdict", "diagnose", "tune"]

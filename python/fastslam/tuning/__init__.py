"""Finding the noise and the systematic errors of a log from the log itself."""

from .session import Attempt, Tuning, tune

__all__ = ["Attempt", "Tuning", "tune"]

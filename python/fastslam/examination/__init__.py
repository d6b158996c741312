"""Examines a log before any filter runs: clocks, units, conventions, duplicates, names, settings."""

from .finding import Finding, Severity
from .registry import CHECKS, Check, examine

__all__ = ["CHECKS", "Check", "Finding", "Severity", "examine"]

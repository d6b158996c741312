"""What stands in a log, or comes from a detector, where nobody knows landmark or class of a sighting."""

from __future__ import annotations

NOBODY_KNOWS = frozenset({"", "-1", "-1.0", "nan", "none", "null", "unknown"})
"""Words for that, in lower case."""


def nobody_knows(text: str) -> bool:
    """Whether the text for an identity or a class is one of `NOBODY_KNOWS`, in any case, blanks aside."""
    return text.strip().lower() in NOBODY_KNOWS

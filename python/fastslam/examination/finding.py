"""What a check says about a log."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Literal, TypeAlias

Severity: TypeAlias = Literal["error", "problem", "note"]
"""`error`: a run over this log means nothing. `problem`: a run will go wrong. `note`: worth knowing."""


@dataclass(frozen=True)
class Finding:
    """One thing that is wrong with a log: what, the evidence in numbers, and what to do about it.

    `code` is that of the check's documentation; `remedy` is a configuration key with its value, a command, or
    what to change in the file.
    """

    code: str
    severity: Severity
    message: str
    remedy: str

    @property
    def line(self) -> str:
        """All of it in one line."""
        return f"{self.message} [{self.code}]; {self.remedy}"

    def to_dict(self) -> dict[str, str]:
        """The members by name, for JSON."""
        return asdict(self)

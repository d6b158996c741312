"""Text for terminals and redirections whose encoding lacks a sign: ASCII instead of an error."""

from __future__ import annotations

import codecs
import json
import sys
import unicodedata
from typing import Any

import typer

_SIGNS = {
    **{"≤": "<=", "≥": ">=", "≠": "!=", "≈": "~", "±": "+-", "−": "-", "×": "x", "·": "*", "→": "->"},
    **{"⌊": "[", "⌋": "]", "√": "sqrt", "∞": "inf", "°": " deg", "⁻": "-", "ᵀ": "'", "Σ": "sum"},
    **{"σ": "sigma", "χ": "chi", "π": "pi", "α": "alpha", "µ": "u", "μ": "u"},
    **{"–": "-", "—": "-", "…": "...", "‘": "'", "’": "'", "“": '"', "”": '"', "•": "*"},
    **{"│": "|", "─": "-", "━": "-", "┃": "|", "█": "#"},
}
_HANDLER = "fastslam.ascii"


def to_ascii(text: str) -> str:
    """The text with every sign beyond ASCII replaced by what people write where they lack it."""
    return text if text.isascii() else "".join(_ascii_sign(sign) for sign in text)


def _ascii_sign(sign: str) -> str:
    if sign.isascii():
        return sign
    known = _SIGNS.get(sign)
    if known is not None:
        return known
    # `é` becomes e, `²` becomes 2; what has no such form becomes a question mark.
    return unicodedata.normalize("NFKD", sign).encode("ascii", "ignore").decode() or "?"


def as_document(text: str) -> str:
    """Text that is to be read again as UTF-8, for stdout: in ASCII where stdout has another encoding."""
    return text if _stdout_is_utf() else to_ascii(text)


def print_json(value: Any) -> None:
    """One JSON document on stdout; signs beyond ASCII are escaped where stdout is not UTF-8, none is lost."""
    from ..resultfiles import to_json

    text = to_json(value)
    if not _stdout_is_utf():
        text = json.dumps(json.loads(text), indent=2) + "\n"
    typer.echo(text, nl=False)


def _stdout_is_utf() -> bool:
    encoding = getattr(sys.stdout, "encoding", None) or "utf-8"
    return codecs.lookup(encoding).name.startswith("utf")


def never_fail_to_print() -> None:
    """From now on stdout and stderr write ASCII where their encoding lacks a sign, rather than fail."""
    codecs.register_error(_HANDLER, _replace)
    for stream in (sys.stdout, sys.stderr):
        reconfigure = getattr(stream, "reconfigure", None)
        if reconfigure is not None:
            reconfigure(errors=_HANDLER)


def _replace(error: UnicodeError) -> tuple[str, int]:
    if not isinstance(error, UnicodeEncodeError):
        raise error
    return to_ascii(error.object[error.start : error.end]), error.end

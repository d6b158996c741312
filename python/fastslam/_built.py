"""Which build of the core this is."""

from __future__ import annotations

from . import _core


def built_version() -> str:
    """The version that results name; a build for tests, which is slower, says that it is one."""
    return _core.__version__ + (" (debug build)" if _core.build_profile == "debug" else "")

"""Names of a package that are imported when they are first asked for (PEP 562)."""

from __future__ import annotations

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence
    from typing import Any


def lazy_names(
    package: str, module_of: Mapping[str, str], *, modules: Sequence[str] = ()
) -> Callable[[str], Any]:
    """A `__getattr__` for a package: the names of `module_of` from their modules, and `modules` themselves.

    A program that uses one part of the package does not wait for SciPy or Matplotlib, which another needs.
    """

    def find(name: str) -> Any:
        from importlib import import_module

        if name in module_of:
            return getattr(import_module(f"{package}.{module_of[name]}"), name)
        if name in modules:
            return import_module(f"{package}.{name}")
        raise AttributeError(f"module {package!r} has no attribute {name!r}")

    return find

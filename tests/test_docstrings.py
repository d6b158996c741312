"""Every example in a docstring of the package runs and gives what it says."""

from __future__ import annotations

import doctest
import importlib
import pkgutil
from pathlib import Path

import fastslam
import pytest

MODULES = sorted(
    info.name
    for info in pkgutil.walk_packages(fastslam.__path__, "fastslam.")
    if not info.name.endswith(("__main__", "_core"))
)
WITH_EXAMPLES = {"fastslam.config", "fastslam.filter", "fastslam.runner", "fastslam.simulation"}


@pytest.mark.slow
def test_examples_in_docstrings_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    attempted = {}
    for name in MODULES:
        results = doctest.testmod(importlib.import_module(name))
        assert results.failed == 0, name
        attempted[name] = results.attempted
    assert len(MODULES) >= 30
    assert {name for name, count in attempted.items() if count} >= WITH_EXAMPLES
    assert sum(attempted.values()) >= 11


def test_everything_that_the_package_exports_is_documented() -> None:
    exported = [getattr(fastslam, name) for name in fastslam.__all__ if name != "__version__"]
    assert len(exported) >= 9
    assert all(item.__doc__ for item in exported)

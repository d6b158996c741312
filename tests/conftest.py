"""Fixtures that several tests use."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--short", action="store_true", help="skip what is marked as slow, and say so")


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """With `--short` slow tests are skipped, not left out: the list of what was skipped names their files.

    Of a test with parameters `slow(but="id")` is run with these.
    """
    if not config.getoption("--short"):
        return
    left_out = pytest.mark.skip(reason="slow: `make test-all` runs it")
    for item in items:
        slow = item.get_closest_marker("slow")
        if slow is not None and not item.name.endswith(f"[{slow.kwargs.get('but')}]"):
            item.add_marker(left_out)


@pytest.fixture(scope="session")
def data_dir() -> Path:
    """Folder of the real logs: FASTSLAM_DATA, else ../shared/data. Skips the test where there is none."""
    folder = Path(os.environ.get("FASTSLAM_DATA", ROOT.parent / "shared" / "data"))
    if not folder.is_dir():
        pytest.skip(
            f"real logs are absent ({folder}): `fastslam datasets list` says where they come from, "
            "`fastslam datasets download` fetches one, FASTSLAM_DATA names their folder"
        )
    return folder


@pytest.fixture(scope="session")
def cases() -> Path:
    """Folder of the small faulty logs: FASTSLAM_CASES, else ../shared/cases. Skips the test without it."""
    folder = Path(os.environ.get("FASTSLAM_CASES", ROOT.parent / "shared" / "cases"))
    if not folder.is_dir():
        pytest.skip(f"logs with faults are absent ({folder}): set FASTSLAM_CASES")
    return folder

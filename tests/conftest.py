"""Fixtures that several tests use."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]


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

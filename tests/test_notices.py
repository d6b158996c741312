"""The licences of what wheels hold of others."""

from __future__ import annotations

import importlib.util
import shutil
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

ROOT = Path(__file__).parent.parent


@pytest.fixture(scope="module")
def script() -> ModuleType:
    spec = importlib.util.spec_from_file_location("notices", ROOT / "scripts" / "notices.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def crate(folder: Path, license: str, **files: str) -> dict[str, Any]:
    folder.mkdir()
    for name, text in files.items():
        (folder / name).write_text(text)
    manifest = str(folder / "Cargo.toml")
    return {
        "name": folder.name,
        "version": "1.0.0",
        "license": license,
        "authors": [],
        "repository": "a place",
        "manifest_path": manifest,
    }


@pytest.mark.skipif(shutil.which("cargo") is None, reason="cargo is not here")
def test_every_crate_that_is_compiled_in_is_named_with_its_terms(script: ModuleType) -> None:
    packages = script.compiled_in(script.metadata(ROOT))
    names = {package["name"] for package in packages}
    assert {"amd", "pyo3", "numpy", "rayon", "serde_json"} <= names
    assert not names & {"proptest", "regex-syntax", "fastslam-core"}
    text = script.notices(packages)
    assert all(f"{package['name']} {package['version']} (" in text for package in packages)
    assert "Redistributions in binary form must reproduce the above copyright" in text


def test_one_text_stands_once_and_that_of_mit_is_chosen(script: ModuleType, tmp_path: Path) -> None:
    both = {"LICENSE-MIT": "may be used", "LICENSE-APACHE": "a long text"}
    packages = [crate(tmp_path / name, "MIT OR Apache-2.0", **both) for name in ("a", "b")]
    text = script.notices(packages)
    assert text.count("may be used") == 1 and "a long text" not in text
    assert "a 1.0.0 (MIT OR Apache-2.0)\nb 1.0.0 (MIT OR Apache-2.0)\n" in text


def test_terms_that_stand_nowhere_are_an_error(script: ModuleType, tmp_path: Path) -> None:
    assert "Copyright a place" in script.notices([crate(tmp_path / "bare", "MIT")])
    with pytest.raises(ValueError, match=r"odd .BSD-3-Clause. brings no licence file"):
        script.notices([crate(tmp_path / "odd", "BSD-3-Clause")])

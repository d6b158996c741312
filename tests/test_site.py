"""The documentation site (`make site`) has every page, and its reference every public module."""

from __future__ import annotations

import runpy
from importlib import import_module
from typing import Any

import fastslam
import yaml
from doc_pages import ROOT

CONFIG: dict[str, Any] = yaml.safe_load((ROOT / "mkdocs.yml").read_text(encoding="utf-8"))
DATA = runpy.run_path(str(ROOT / "docs" / "site" / "pages.py"))


def nav_pages(entries: list[Any]) -> list[str]:
    found = []
    for entry in entries:
        value = next(iter(entry.values())) if isinstance(entry, dict) else entry
        found += nav_pages(value) if isinstance(value, list) else [value]
    return found


def test_the_navigation_has_every_page_once() -> None:
    docs = ROOT / "docs"
    pages = [page.relative_to(docs).as_posix() for page in docs.glob("**/*.md")]
    pages += [*DATA["PAGES"], *(f"reference/{name}.md" for name in DATA["REFERENCE"])]
    assert sorted(nav_pages(CONFIG["nav"])) == sorted(pages) and len(pages) > 45


def test_pages_from_elsewhere_are_there() -> None:
    files = [*DATA["PAGES"].values(), *DATA["OTHERS"].values()]
    assert len(files) >= 7
    assert [file for file in files if not (ROOT / file).is_file()] == []


def test_the_reference_has_every_public_module() -> None:
    shown = [module for _, *modules in DATA["REFERENCE"].values() for module in modules]
    assert len(shown) == len(set(shown)) and all(
        (import_module(name).__doc__ or "").strip() for name in shown
    )
    assert {f"fastslam.{name}" for name in fastslam._MODULES} <= set(shown)


def test_the_site_asks_no_other_host() -> None:
    theme = CONFIG["theme"]
    assert theme["font"] is False and CONFIG["strict"] is True
    assert not any("://" in str(CONFIG.get(key, "")) for key in ("extra_css", "extra_javascript", "hooks"))

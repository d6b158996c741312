"""The documentation site (`make site`) has every page, and its reference every public module."""

from __future__ import annotations

import re
import runpy
from importlib import import_module
from pathlib import Path
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


def test_links_that_lead_nowhere_are_found(tmp_path: Path) -> None:
    faults = runpy.run_path(str(ROOT / "docs" / "site" / "links.py"))["faults"]
    (tmp_path / "rust" / "core").mkdir(parents=True)
    (tmp_path / "rust" / "core" / "index.html").write_text('<p id="f"><a href="gone.html">')
    (tmp_path / "b.html").write_text('<h1 id="top"></h1><img src="missing.png">')
    links = ("b.html", "b.html#top", "b.html#bottom", "rust/core", "rust/core/index.html#f", "c%20d.html")
    text = "".join(f'<a href="{link}"></a>' for link in (*links, "https://example.org", "#here"))
    (tmp_path / "a.html").write_text(text)
    wrong, seen = faults(tmp_path)
    assert wrong == ["a.html: #here", "a.html: b.html#bottom", "a.html: c%20d.html", "b.html: missing.png"]
    assert seen == len(links) + 2


def test_the_page_of_the_crates_names_modules_that_there_are() -> None:
    text = (ROOT / "docs" / "rust.md").read_text(encoding="utf-8")
    library = (ROOT / "crates" / "fastslam-core" / "src" / "lib.rs").read_text(encoding="utf-8")
    named = re.findall(r"rust/fastslam_core/(\w+)/index\.html", text)
    assert len(named) > 5 and [name for name in named if f"pub mod {name};" not in library] == []

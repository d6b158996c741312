"""Fails where a page of the built site links to what is not there: `python docs/site/links.py site`.

MkDocs checks links between Markdown files; this looks at what came out, with the reference of the crates.
Pages below `rust/` are targets only: rustdoc checks its own.
"""

from __future__ import annotations

import sys
from functools import cache
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

ELSEWHERE = ("http", "https", "mailto", "data", "javascript")


class Page(HTMLParser):
    """What a page links to, and the anchors that it has."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.links: set[str] = set()
        self.anchors: set[str] = set()
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        for name, value in attrs:
            if value and name in ("href", "src"):
                self.links.add(value)
            elif value and (name == "id" or (tag == "a" and name == "name")):
                self.anchors.add(value)


@cache
def page(path: Path) -> Page:
    return Page(path.read_text(encoding="utf-8"))


def faults(site: Path) -> tuple[list[str], int]:
    """Links that lead nowhere, and how many were followed."""
    wrong, seen = [], 0
    pages = (path for path in sorted(site.rglob("*.html")) if path.relative_to(site).parts[0] != "rust")
    for path in pages:
        for link in sorted(page(path).links):
            parts = urlsplit(link)
            # The page that is shown for what is not there counts from the root.
            if parts.scheme in ELSEWHERE or link.startswith("/") or path.name == "404.html":
                continue
            seen += 1
            target = (path.parent / unquote(parts.path)).resolve() if parts.path else path
            target = target / "index.html" if target.is_dir() else target
            anchor = unquote(parts.fragment)
            missing = not target.is_file()
            if missing or (anchor and target.suffix == ".html" and anchor not in page(target).anchors):
                wrong.append(f"{path.relative_to(site)}: {link}")
    return wrong, seen


def main() -> None:
    site = Path(sys.argv[1]).resolve()
    wrong, seen = faults(site)
    print(*wrong, sep="\n", end="\n" if wrong else "")
    print(f"{seen:,} links followed, {len(wrong)} lead nowhere")
    sys.exit(1 if wrong or seen < 1000 else 0)


if __name__ == "__main__":
    main()

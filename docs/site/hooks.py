"""What the site needs beyond the pages: those outside `docs/`, the Python reference, links, formulas.

MkDocs calls the functions named `on_...`. Links to files that are no pages become their paths as text, for
the site has no sources beside it. Formulas become MathML, which browsers draw without a script.
"""

from __future__ import annotations

import html
import os
import re
import runpy
from pathlib import Path
from typing import Any

from latex2mathml.converter import convert
from mkdocs.exceptions import PluginError
from mkdocs.structure.files import File, Files

ROOT = Path(__file__).resolve().parents[2]
_DATA = runpy.run_path(str(Path(__file__).with_name("pages.py")))
PAGES, OTHERS, REFERENCE = _DATA["PAGES"], _DATA["OTHERS"], _DATA["REFERENCE"]
MODULE = """\
## {module}

::: {module}
    options: {{show_root_heading: false, show_root_toc_entry: false}}
"""
WEB = "target/web/fastslam.html"
"""The page with the filter in it, which `make web` builds."""
LONG = 45
"""Characters of LaTeX from which a formula may be wider than a phone."""

_FENCE = re.compile(r"(^```.*?^```[ ]*$)", re.MULTILINE | re.DOTALL)
_LINK = re.compile(r"(!?)\[((?:[^\[\]]|\[[^\]]*\])*)\]\(([^)\s]+)\)")
_PICTURE = re.compile(r'<img [^>]*src="([^"]+)"[^>]*>')
_FORMULA = re.compile(r'<(span|div) class="arithmatex">(.*?)</\1>', re.DOTALL)


def on_files(files: Files, config: Any) -> Files:
    """Adds the pages that do not lie in `docs/`."""
    for uri, source in {**PAGES, **OTHERS}.items():
        files.append(File.generated(config, uri, abs_src_path=str(ROOT / source)))
    files.append(File.generated(config, "browser/fastslam.html", abs_src_path=str(ROOT / WEB)))
    for name, (title, *modules) in REFERENCE.items():
        parts = [f"# {title}\n", *(MODULE.format(module=module) for module in modules)]
        files.append(File.generated(config, f"reference/{name}.md", content="\n".join(parts)))
    return files


def on_page_markdown(markdown: str, *, page: Any, config: Any, files: Files) -> str:
    """Turns links between files of the repository into links between pages."""
    uri = page.file.src_uri
    source = ROOT / PAGES.get(uri, f"docs/{uri}")
    uri_of = {(ROOT / path).resolve(): uri for uri, path in {**PAGES, **OTHERS}.items()}

    def link(match: re.Match[str]) -> str:
        picture, text, target = match.groups()
        path, _, anchor = target.partition("#")
        if not path or ":" in path:
            return match[0]
        file = (source.parent / path).resolve()
        if not file.exists():
            return match[0]  # reported by MkDocs
        to = uri_of.get(file)
        if to is None and file.is_relative_to(ROOT / "docs"):
            to = file.relative_to(ROOT / "docs").as_posix()
        if to is None:
            return f"`{file.relative_to(ROOT).as_posix()}`"
        place = os.path.relpath(to, os.path.dirname(uri) or ".").replace(os.sep, "/")
        return f"{picture}[{text}]({place}{'#' + anchor if anchor else ''})"

    parts = _FENCE.split(markdown)
    return "".join(part if place % 2 else _LINK.sub(link, part) for place, part in enumerate(parts))


def on_page_content(content: str, **_: Any) -> str:
    """Turns formulas into MathML, and pictures into links to themselves, to enlarge them on a phone."""
    content = _PICTURE.sub(r'<a class="picture" href="\1">\g<0></a>', content)
    return _FORMULA.sub(_mathml, content)


def _mathml(match: re.Match[str]) -> str:
    tag, text = match.groups()
    latex = html.unescape(text).strip()[2:-2]  # without \( \) or \[ \]
    latex = latex.replace(r"\arg\max", r"\operatorname{arg}\max")
    formula = convert(latex, display="block" if tag == "div" else "inline")
    if "\\" in formula:
        raise PluginError(f"formula {latex}: a command that latex2mathml does not know")
    # A line of text cannot break inside a formula: a long one scrolls on a phone.
    return f'<span class="formula">{formula}</span>' if len(latex) > LONG else formula

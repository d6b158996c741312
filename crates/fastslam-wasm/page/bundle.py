"""Puts the page together: one file that opens from anywhere, with styles, scripts and the filter in it."""

from __future__ import annotations

import base64
import re
import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent


def bundle(wasm: Path) -> str:
    """The page as HTML text."""
    page = (HERE / "index.html").read_text(encoding="utf-8")
    code = base64.b64encode(wasm.read_bytes()).decode("ascii")

    def style(match: re.Match[str]) -> str:
        return f"<style>\n{(HERE / match[1]).read_text(encoding='utf-8')}</style>"

    def script(match: re.Match[str]) -> str:
        return f"<script>\n{(HERE / match[1]).read_text(encoding='utf-8')}</script>"

    page, styles = re.subn(r'<link rel="stylesheet" href="([\w.]+)">', style, page)
    page, scripts = re.subn(r'<script src="([\w.]+)"></script>', script, page)
    page, places = re.subn(r'(id="wasm">)(</script>)', rf"\g<1>{code}\g<2>", page)
    if (styles, scripts, places) != (1, 4, 1):
        raise SystemExit(f"index.html: {styles} styles, {scripts} scripts, {places} places for the code")
    return page


def main() -> None:
    """`bundle.py fastslam.wasm page.html`."""
    wasm, out = map(Path, sys.argv[1:])
    out.parent.mkdir(parents=True, exist_ok=True)
    out.write_text(bundle(wasm), encoding="utf-8")
    print(f"{out}: {out.stat().st_size / 1e6:.1f} MB")


if __name__ == "__main__":
    main()

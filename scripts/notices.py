"""Writes the licences of what the compiled module holds of others, for wheels: python scripts/notices.py FILE

Cargo says which crates are compiled into it. Most bring their licence files along; the terms of one
that does not have to be among those of which wheels hold the text anyway.
"""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

MODULE = "fastslam-py"
TARGETS = ("x86_64-unknown-linux-gnu", "aarch64-unknown-linux-gnu")
KNOWN = ("MIT", "Apache-2.0")
FILES = ("LICEN[CS]E*", "COPYING*", "NOTICE*", "UNLICENSE*", "licen[cs]e*")


def metadata(folder: Path) -> dict[str, Any]:
    """What cargo says of the crates of a checkout."""
    command = ["cargo", "metadata", "--format-version", "1"]
    command += [part for target in TARGETS for part in ("--filter-platform", target)]
    answer = subprocess.run(command, cwd=folder, check=True, capture_output=True, text=True)
    return dict(json.loads(answer.stdout))


def compiled_in(found: dict[str, Any]) -> list[dict[str, Any]]:
    """The crates of others that the module is made of, by name; not those for tests or the build alone."""
    packages = {package["id"]: package for package in found["packages"]}
    needs = {node["id"]: node["deps"] for node in found["resolve"]["nodes"]}
    todo = [id for id, package in packages.items() if package["name"] == MODULE]
    seen = set(todo)
    while todo:
        for need in needs[todo.pop()]:
            kinds = {kind["kind"] for kind in need["dep_kinds"]}
            if None in kinds and need["pkg"] not in seen:
                seen.add(need["pkg"])
                todo.append(need["pkg"])
    others = (packages[id] for id in seen if packages[id]["source"] is not None)
    return sorted(others, key=lambda package: (package["name"], package["version"]))


def terms(package: dict[str, Any]) -> str:
    """The text of a crate's licence; of several to choose from that of MIT, which is the shortest.

    Errors: ValueError where its terms stand nowhere.
    """
    folder = Path(package["manifest_path"]).parent
    files = sorted({path for pattern in FILES for path in folder.glob(pattern) if path.is_file()})
    if "MIT OR" in package["license"] or "OR MIT" in package["license"]:
        files = [path for path in files if "MIT" in path.name] or files
    if files:
        return "\n\n".join(path.read_text(encoding="utf-8", errors="replace").strip() for path in files)
    if not any(known in package["license"] for known in KNOWN):
        raise ValueError(f"{package['name']} ({package['license']}) brings no licence file")
    names = ", ".join(package["authors"]) or package["repository"] or "its authors"
    return f"Copyright {names}; the terms are those of the licence of that name."


def notices(packages: list[dict[str, Any]]) -> str:
    """Each text once, under the crates that it is for."""
    crates: dict[str, list[str]] = {}
    for package in packages:
        named = f"{package['name']} {package['version']} ({package['license']})"
        crates.setdefault(terms(package), []).append(named)
    parts = ("\n".join(names) + "\n" + "-" * 60 + "\n\n" + text for text, names in crates.items())
    return "\n\n\n".join(["The compiled module of fastslam holds parts of these crates.", *parts]) + "\n"


def main() -> None:
    """Writes the file that is named."""
    packages = compiled_in(metadata(Path(__file__).parent.parent))
    try:
        text = notices(packages)
    except ValueError as error:
        sys.exit(f"error: {error}")
    Path(sys.argv[1]).write_text(text, encoding="utf-8")
    print(f"{sys.argv[1]}: licences of {len(packages)} crates")


if __name__ == "__main__":
    main()

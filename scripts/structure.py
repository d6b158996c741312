#!/usr/bin/env python3
"""Measures the Rust crates: rooms, large structs, long functions, many parameters, circles of files, copies.

    python3 scripts/structure.py              # a table
    python3 scripts/structure.py --check      # fails on a circle of files, a large struct, a long function,
                                              or one of many parameters

A room is a file or a folder at the top of a crate's `src/`. Tests are left out: files named `tests.rs`,
and everything under `#[cfg(test)]`. A file depends on another when it names something that is defined there,
through `use` or in full (`crate::math::ln`); names that a module re-exports count for the file that defines
them, and a module that only declares or re-exports its children does not depend on them. Needs nothing but
Python.
"""

from __future__ import annotations

import argparse
import re
import sys
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

MOST_FIELDS = 12
MOST_LINES = 40
MOST_PARAMETERS = 5
"""Of a function, `self` apart; a tuple counts as its parts. What Python calls by keywords may have more."""
_FLAT = (
    "each field is a key of configuration files that stands there without a section; serde does not support "
    "`flatten` together with `deny_unknown_fields`, whose errors list the keys there are"
)
#: Structs that may have more fields, and why.
EXCEPTIONS = {"Trunks": _FLAT, "SensorSettings": _FLAT, "AssociationConfig": _FLAT}
#: So many equal lines of code in a row count as copied.
COPIED_LINES = 6

NOT_CODE = re.compile(
    r"""//[^\n]*|/\*.*?\*/|(?:b?r)(\#*)".*?"\1|b?"(?:\\.|[^"\\])*"|b?'(?:\\(?:x..|u\{\w+\}|.)|[^'\\\n])'""",
    re.DOTALL,
)
USE = re.compile(r"^\s*(pub(?:\([^)]*\))?\s+)?use\s+([^;]+);", re.MULTILINE)
PATH = re.compile(r"(?<![\w:])(?:crate|super|self)(?:::\w+)+")
FUNCTION = re.compile(r"\bfn\s+(\w+)")
STRUCT = re.compile(r"\bstruct\s+(\w+)[^;{(]*\{")


@dataclass
class Source:
    """One file without comments, strings and tests; `module` is its path inside the crate."""

    path: Path
    module: tuple[str, ...]
    code: str
    #: What each name in it stands for, as `use` says.
    names: dict[str, tuple[str, ...]] = field(default_factory=dict)
    #: Names that `pub use` hands on.
    handed_on: set[str] = field(default_factory=set)
    #: Modules of which it takes everything.
    globs: list[tuple[str, ...]] = field(default_factory=list)


def blanked(match: re.Match[str]) -> str:
    """As many lines of nothing."""
    return "\n" * match.group().count("\n")


def closing(code: str, start: int) -> int:
    """Where the brace at `start` closes."""
    depth = 0
    for at in range(start, len(code)):
        depth += {"{": 1, "}": -1}.get(code[at], 0)
        if depth == 0:
            return at
    return len(code) - 1


def without_tests(code: str) -> str:
    """The code without what stands under `#[cfg(test)]` or `#[cfg(doctest)]`."""
    while (found := re.search(r"#\[cfg\((?:doc)?test\)\]", code)) is not None:
        brace, semicolon = code.find("{", found.end()), code.find(";", found.end())
        to_brace = brace >= 0 and not 0 <= semicolon < brace
        end = closing(code, brace) if to_brace else semicolon
        gone = code[found.start() : end + 1]
        code = code[: found.start()] + "\n" * gone.count("\n") + code[end + 1 :]
    return code


def read(source_folder: Path) -> list[Source]:
    """All files of a crate."""
    sources = []
    for path in sorted(source_folder.rglob("*.rs")):
        inside = path.relative_to(source_folder)
        if "tests" in (inside.stem, *inside.parts[:-1]):
            continue
        parts = [*inside.parts[:-1], *([] if inside.stem in ("mod", "lib") else [inside.stem])]
        code = without_tests(NOT_CODE.sub(blanked, path.read_text(encoding="utf-8")))
        sources.append(Source(path, tuple(parts), code))
    return sources


def leaves(tree: str) -> Iterator[tuple[str, str]]:
    """The (path, name) pairs of a `use` tree such as `a::{b, c::{self, d as e}}`."""
    tree = tree.strip()
    brace = tree.find("{")
    if brace < 0:
        path, _, alias = (part.strip() for part in tree.partition(" as "))
        path = path.removesuffix("::self")
        yield path, alias or path.rsplit("::", 1)[-1]
        return
    prefix, inner, depth, begin = tree[:brace], tree[brace + 1 : closing(tree, brace)], 0, 0
    for at, character in enumerate(inner + ","):
        depth += {"{": 1, "}": -1}.get(character, 0)
        if character == "," and depth == 0:
            if inner[begin:at].strip():
                yield from leaves(prefix + inner[begin:at].strip())
            begin = at + 1


def absolute(path: str, module: tuple[str, ...]) -> tuple[str, ...] | None:
    """A path from the crate's root; `None` for what another crate defines."""
    parts = path.replace(" ", "").split("::")
    if parts[0] == "crate":
        return tuple(parts[1:])
    at = module
    if parts[0] not in ("self", "super"):
        return None
    while parts and parts[0] in ("self", "super"):
        at = at[:-1] if parts[0] == "super" else at
        parts = parts[1:]
    return (*at, *parts)


def note_names(source: Source, modules: dict[tuple[str, ...], Source]) -> None:
    """Works out what the names of a file stand for."""
    for visibility, tree in USE.findall(source.code):
        for path, name in leaves(tree):
            target = absolute(path, source.module)
            child = (*source.module, path.split("::")[0])
            if target is None and child in modules:
                target = (*source.module, *path.split("::"))
            if target is None:
                continue
            if name == "*":
                source.globs.append(target[:-1])
                continue
            source.names[name] = target
            if visibility:
                source.handed_on.add(name)


def definer(path: tuple[str, ...], modules: dict[tuple[str, ...], Source], depth: int = 0) -> Source | None:
    """The file that defines what a path from the crate's root names."""
    for length in range(len(path), -1, -1):
        source = modules.get(path[:length])
        if source is None:
            continue
        rest = path[length:]
        if rest and rest[0] in source.names and depth < 8:
            return definer((*source.names[rest[0]], *rest[1:]), modules, depth + 1)
        return source
    return None


def imports(sources: list[Source]) -> dict[Path, dict[Path, set[str]]]:
    """Which names each file takes from which other file."""
    modules = {source.module: source for source in sources}
    for source in sources:
        note_names(source, modules)
    found: dict[Path, dict[Path, set[str]]] = {source.path: defaultdict(set) for source in sources}
    for source in sources:
        taken = {path for name, path in source.names.items() if name not in source.handed_on}
        taken.update(source.globs)
        code = USE.sub(blanked, source.code)
        taken.update(path for text in PATH.findall(code) if (path := absolute(text, source.module)))
        for path in taken:
            target = definer(path, modules)
            if target is not None and target is not source:
                found[source.path][target.path].add(path[-1] if path else "")
    return found


def circles(graph: dict[Path, dict[Path, set[str]]]) -> list[list[Path]]:
    """Sets of files that all reach each other (Tarjan's strongly connected components), the largest first."""
    number: dict[Path, int] = {}
    low: dict[Path, int] = {}
    stack: list[Path] = []
    found: list[list[Path]] = []

    def visit(file: Path) -> None:
        number[file] = low[file] = len(number)
        stack.append(file)
        for other in graph[file]:
            if other not in number:
                visit(other)
            if other in stack:
                low[file] = min(low[file], low[other])
        if low[file] == number[file]:
            at = stack.index(file)
            if len(stack) - at > 1:
                found.append(sorted(stack[at:]))
            del stack[at:]

    for file in graph:
        if file not in number:
            visit(file)
    return sorted(found, key=len, reverse=True)


def fields(code: str) -> Iterator[tuple[str, int]]:
    """Names of structs with the number of their fields."""
    for found in STRUCT.finditer(code):
        body = code[found.end() : closing(code, found.end() - 1)]
        body = re.sub(r"#\[[^\]]*\]", "", body)
        yield found.group(1), len(re.findall(r"(?<!:)\b\w+\s*:(?!:)", body))


def functions(code: str) -> Iterator[tuple[str, int]]:
    """Names of functions with their lines, from `fn` to the closing brace."""
    for found in FUNCTION.finditer(code):
        brace, semicolon = code.find("{", found.end()), code.find(";", found.end())
        # A semicolon first is a function of a trait without a body, unless it stands in an array's type.
        while 0 <= semicolon < brace and code[:semicolon].count("[") > code[:semicolon].count("]"):
            semicolon = code.find(";", semicolon + 1)
        if brace < 0 or 0 <= semicolon < brace:
            continue
        yield found.group(1), code[found.start() : closing(code, brace) + 1].count("\n") + 1


def split_at_commas(text: str) -> list[str]:
    """The parts of a list of parameters or types."""
    parts, depth, begin = [], 0, 0
    for at, character in enumerate(text + ","):
        arrow = character == ">" and text[at - 1 : at] in ("-", "=")
        if not arrow:
            depth += (character in "([<{") - (character in ")]>}")
        if character == "," and depth == 0:
            parts.append(text[begin:at].strip())
            begin = at + 1
    return [part for part in parts if part]


def parameters(code: str) -> Iterator[tuple[str, int]]:
    """Names of functions with the number of their parameters, those that Python calls apart."""
    for found in FUNCTION.finditer(code):
        before = max(code.rfind(mark, 0, found.start()) for mark in "};")
        attributes = code[before + 1 : found.start()]
        start = code.find("(", found.end())
        # Bounds of generic parameters may have parentheses, which follow a name or `Fn`.
        while (head := code[found.end() : start]).count("<") > len(re.findall(r"(?<![-=])>", head)):
            start = code.find("(", start + 1)
        if "#[pyfunction]" in attributes:
            continue
        depth, end = 1, start + 1
        while depth:
            depth += {"(": 1, ")": -1}.get(code[end], 0)
            end += 1
        count = 0
        for parameter in split_at_commas(code[start + 1 : end - 1]):
            name, _, kind = (part.strip() for part in parameter.partition(": "))
            if kind or not re.search(r"\bself$", name):
                inside = re.fullmatch(r"\((.*)\)", kind, re.DOTALL)
                count += len(split_at_commas(inside.group(1))) if inside else 1
        yield found.group(1), count


def copied_lines(sources: list[Source]) -> int:
    """Lines of code in a run of at least `COPIED_LINES` that occurs elsewhere as well; imports apart."""
    places: dict[tuple[str, ...], list[tuple[Path, int]]] = defaultdict(list)
    for source in sources:
        code = USE.sub("", source.code)
        lines = [line.strip() for line in code.splitlines() if re.search(r"\w", line)]
        for at in range(len(lines) - COPIED_LINES + 1):
            places[tuple(lines[at : at + COPIED_LINES])].append((source.path, at))
    copied = {
        (path, at + offset)
        for group in places.values()
        if len(group) > 1
        for path, at in group
        for offset in range(COPIED_LINES)
    }
    return len(copied)


def report(source_folder: Path) -> int:
    """Prints what was found of one crate; returns how much of it must not be."""
    sources = read(source_folder)
    if not sources:
        raise SystemExit(f"{source_folder}: no Rust files")
    rooms: dict[str, list[int]] = defaultdict(list)
    for source in sources:
        room = source.module[0] if source.module else "lib"
        rooms[room].append(sum(1 for line in source.code.splitlines() if line.strip()))
    total = sum(map(sum, rooms.values()))
    print(f"{source_folder.parent.name}: {len(sources)} files, {total} lines of code")
    print("\n  lines of code per room (files)")
    for room, sizes in sorted(rooms.items(), key=lambda item: -sum(item[1])):
        print(f"    {sum(sizes):5}  {room} ({len(sizes)})")
    large, excused, long = large_structs(sources), excused_structs(sources), long_functions(sources)
    show(f"structs of more than {MOST_FIELDS} fields", large, source_folder)
    show("structs of more fields for a reason", excused, source_folder)
    for reason in sorted({EXCEPTIONS[name] for _, name, _ in excused}):
        print(f"      {reason}")
    show(f"functions of more than {MOST_LINES} lines", long, source_folder)
    many = many_parameters(sources)
    show(f"functions of more than {MOST_PARAMETERS} parameters, tuples taken apart", many, source_folder)
    found = show_circles(sources, source_folder)
    print(f"\n  copied lines (in runs of {COPIED_LINES} or more): {copied_lines(sources)}\n")
    return found + len(large) + len(long) + len(many)


def large_structs(sources: list[Source]) -> list[tuple[int, str, Path]]:
    """Structs of more than `MOST_FIELDS` fields without an exception: fields, name, file."""
    return [found for found in _structs(sources) if found[1] not in EXCEPTIONS]


def excused_structs(sources: list[Source]) -> list[tuple[int, str, Path]]:
    """Structs of more than `MOST_FIELDS` fields with an exception."""
    return [found for found in _structs(sources) if found[1] in EXCEPTIONS]


def _structs(sources: list[Source]) -> list[tuple[int, str, Path]]:
    return [(n, name, s.path) for s in sources for name, n in fields(s.code) if n > MOST_FIELDS]


def long_functions(sources: list[Source]) -> list[tuple[int, str, Path]]:
    """Functions of more than `MOST_LINES` lines: lines, name, file."""
    return [(n, name, s.path) for s in sources for name, n in functions(s.code) if n > MOST_LINES]


def many_parameters(sources: list[Source]) -> list[tuple[int, str, Path]]:
    """Functions of more than `MOST_PARAMETERS` parameters: parameters, name, file."""
    return [(n, name, s.path) for s in sources for name, n in parameters(s.code) if n > MOST_PARAMETERS]


def show_circles(sources: list[Source], source_folder: Path) -> int:
    """Prints the circles of files with the names that tie them; returns their number."""
    graph = imports(sources)
    found = circles(graph)
    print(f"\n  circles of files: {len(found)}")
    for circle in found:
        print(f"    {len(circle)} files:")
        for file in circle:
            for other in sorted(set(graph[file]) & set(circle)):
                arrow = f"{file.relative_to(source_folder)} -> {other.relative_to(source_folder)}"
                print(f"      {arrow}: {', '.join(sorted(graph[file][other]))}")
    return len(found)


def show(title: str, found: list[tuple[int, str, Path]], source_folder: Path) -> None:
    """Prints a list of what is too large."""
    print(f"\n  {title}: {len(found)}")
    for count, name, path in sorted(found, key=lambda item: -item[0]):
        print(f"    {count:5}  {name} ({path.relative_to(source_folder)})")


def main() -> int:
    """The command."""
    root = Path(__file__).resolve().parent.parent
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--check", action="store_true", help="exit with 1 when a rule is broken")
    parser.add_argument("crate", nargs="*", help="names of crates (default: all)")
    arguments = parser.parse_args()
    crates = arguments.crate or [path.name for path in sorted((root / "crates").iterdir()) if path.is_dir()]
    found = 0
    for crate in crates:
        folder = root / "crates" / crate / "src"
        if not folder.is_dir():
            parser.error(f"no crate {crate}: {folder} is no folder")
        found += report(folder)
    if arguments.check and found:
        print(
            f"{found} circles, large structs, long functions and ones of many parameters",
            file=sys.stderr,
        )
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())

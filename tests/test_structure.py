"""The script that measures the structure of the crates sees what is there."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).parent.parent


@pytest.fixture(scope="module")
def structure() -> ModuleType:
    spec = importlib.util.spec_from_file_location("structure", ROOT / "scripts" / "structure.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["structure"] = module
    spec.loader.exec_module(module)
    return module


FILES = {
    "lib.rs": "mod low;\nmod room;\nmod top;\n#[cfg(test)]\nmod tests { use crate::top::Top; }\n",
    "low.rs": "pub const ONE: f64 = 1.0; // use crate::top::Top;\n",
    "room/mod.rs": "mod left;\nmod right;\npub use left::Left;\npub use right::Right;\n",
    "room/left.rs": "use super::Right;\nuse crate::low::{self, ONE};\npub struct Left { a: Right }\n",
    "room/right.rs": "pub struct Right;\nfn f() -> f64 { 'x'; crate::room::left::g(\"{\") }\n",
    "top.rs": "use crate::room::Left;\npub struct Top { left: Left }\npub fn h() {\n    let _ = 1;\n}\n",
}


def test_circles_are_found_through_reexports_and_full_paths(structure: ModuleType, tmp_path: Path) -> None:
    for name, text in FILES.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(text)
    sources = structure.read(tmp_path)
    assert len(sources) == len(FILES)
    graph = structure.imports(sources)
    named = {
        (str(file.relative_to(tmp_path)), str(other.relative_to(tmp_path)))
        for file, others in graph.items()
        for other in others
    }
    assert named == {
        ("room/left.rs", "room/right.rs"),
        ("room/left.rs", "low.rs"),
        ("room/right.rs", "room/left.rs"),
        ("top.rs", "room/left.rs"),
    }
    circles = structure.circles(graph)
    assert [[path.name for path in circle] for circle in circles] == [["left.rs", "right.rs"]]


def test_fields_and_lines_are_counted_without_comments_and_strings(structure: ModuleType) -> None:
    code = (
        "struct A<'a> {\n #[serde(default)]\n x: &'a str,\n pub y: std::ops::Range<u8>,\n}\nstruct B(f64);\n"
    )
    assert list(structure.fields(code)) == [("A", 2)]
    code = "trait T {\n fn none(&self, a: [f64; 2]);\n fn some(&self) {\n  if true {}\n }\n}\n"
    assert list(structure.functions(code)) == [("some", 3)]


def test_parameters_are_counted_with_the_parts_of_tuples(structure: ModuleType) -> None:
    code = (
        "fn plain(&self, a: [f64; 2], b: &dyn Fn(usize) -> (u8, u8)) {}\n"
        "fn packed((a, b): (usize, &[Vec<u32>]), at: ([f64; 2], f64), c: Option<(u8, u8)>) {}\n"
        "fn bound<F: Fn(u8, u8) -> bool, const N: usize>(mut self, f: F, g: impl Fn(u8, u8) -> u8) {}\n"
        "fn none() {}\n#[pyfunction]\n#[pyo3(signature = (a, b=None))]\nfn python(a: u8, b: u8) {}\n"
        "trait T { fn open(&mut self, a: u8) -> u8; }\n"
    )
    found = [("plain", 2), ("packed", 5), ("bound", 2), ("none", 0), ("open", 1)]
    assert list(structure.parameters(code)) == found


def test_what_is_too_large_is_found_unless_there_is_a_reason(structure: ModuleType, tmp_path: Path) -> None:
    many = ", ".join(f"f{i}: u8" for i in range(structure.MOST_FIELDS + 1))
    lines = "    let _ = 1;\n" * (structure.MOST_LINES - 1)
    (tmp_path / "lib.rs").write_text(
        f"struct Large {{ {many} }}\nstruct SensorSettings {{ {many} }}\nstruct Few {{ a: u8 }}\n"
        f"fn long() {{\n{lines}}}\nfn short() {{\n{lines[: -len('    let _ = 1;') - 1]}}}\n"
    )
    sources = structure.read(tmp_path)
    assert [(n, name) for n, name, _ in structure.large_structs(sources)] == [(13, "Large")]
    assert [(n, name) for n, name, _ in structure.excused_structs(sources)] == [(13, "SensorSettings")]
    assert [(n, name) for n, name, _ in structure.long_functions(sources)] == [(41, "long")]


def test_structs_and_functions_are_within_the_limits(structure: ModuleType) -> None:
    excused, files = set(), 0
    for folder in sorted((ROOT / "crates").glob("*/src")):
        sources = structure.read(folder)
        files += len(sources)
        assert not structure.large_structs(sources)
        assert not structure.long_functions(sources)
        assert not structure.many_parameters(sources)
        excused.update(name for _, name, _ in structure.excused_structs(sources))
    assert files > 80, f"{files} files"
    assert excused == set(structure.EXCEPTIONS), "an exception that nothing needs goes"


def test_no_file_of_the_crates_imports_itself_through_others(structure: ModuleType) -> None:
    files, crates = 0, 0
    for folder in sorted((ROOT / "crates").glob("*/src")):
        sources = structure.read(folder)
        files, crates = files + len(sources), crates + 1
        circles = structure.circles(structure.imports(sources))
        assert not circles, [[path.name for path in circle] for circle in circles]
    assert crates >= 3 and files > 80, f"{files} files of {crates} crates"


def drawn_rooms() -> dict[str, tuple[int, int]]:
    """Line and place of each room in the drawing of ARCHITECTURE.md."""
    text = (ROOT / "ARCHITECTURE.md").read_text(encoding="utf-8")
    drawing = text[text.index("The rooms of the core.") :].split("\n\n")[1]
    rooms = {path.stem for path in (ROOT / "crates/fastslam-core/src").iterdir()}
    places: dict[str, tuple[int, int]] = {}
    for line, words in enumerate(map(str.split, drawing.splitlines())):
        # What follows the rooms of a line says what they are for.
        for place, word in enumerate(words):
            if word not in rooms:
                break
            places.setdefault(word, (line, place))
    return places


def test_the_drawing_of_the_rooms_is_what_the_files_import(structure: ModuleType) -> None:
    src = ROOT / "crates/fastslam-core/src"
    sources = structure.read(src)
    graph, places = structure.imports(sources), drawn_rooms()

    def room(path: Path) -> str:
        return path.relative_to(src).parts[0].removesuffix(".rs")

    assert {room(source.path) for source in sources} - set(places) == {"lib"}
    upward = {
        (str(file.relative_to(src)), room(other))
        for file, others in graph.items()
        for other in others
        if room(file) != room(other) != "lib" and places[room(file)] >= places[room(other)]
    }
    assert len(graph) > 150 and upward == {("association/rules.rs", "config")}

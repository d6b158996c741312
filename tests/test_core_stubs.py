"""The stubs of the compiled module name exactly what it holds."""

from __future__ import annotations

import ast
from pathlib import Path

from fastslam import _core


def public(names: list[str]) -> set[str]:
    return {name for name in names if not name.startswith("_")}


def test_stubs_and_module_hold_the_same_names() -> None:
    stubs = ast.parse((Path(_core.__file__).parent / "_core.pyi").read_text())
    functions = [node.name for node in stubs.body if isinstance(node, ast.FunctionDef)]
    classes = {node.name: node for node in stubs.body if isinstance(node, ast.ClassDef)}
    constants = [
        node.target.id
        for node in stubs.body
        if isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name)
    ]
    assert len(functions) >= 5 and classes
    assert public([*functions, *classes, *constants]) == public(dir(_core))
    for name, node in classes.items():
        methods = [member.name for member in node.body if isinstance(member, ast.FunctionDef)]
        assert public(methods) == public(dir(getattr(_core, name))), name

"""The stubs of the compiled module say exactly what it holds, and the package wraps all of it."""

from __future__ import annotations

import ast
import inspect
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from fastslam import _core

PACKAGE = Path(_core.__file__).parent
STUBS = ast.parse((PACKAGE / "_core.pyi").read_text())
FUNCTIONS = {node.name: node for node in STUBS.body if isinstance(node, ast.FunctionDef)}
CLASSES = {node.name: node for node in STUBS.body if isinstance(node, ast.ClassDef)}
CONSTANTS = [
    node.target.id
    for node in STUBS.body
    if isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name)
]


def methods(node: ast.ClassDef) -> dict[str, ast.FunctionDef]:
    return {member.name: member for member in node.body if isinstance(member, ast.FunctionDef)}


def public(names: list[str]) -> set[str]:
    return {name for name in names if not name.startswith("_")}


def stub_parameters(node: ast.FunctionDef) -> list[tuple[str, bool]]:
    """Name and whether it may be left out, without `self` and `cls`."""
    names = [argument.arg for argument in (*node.args.posonlyargs, *node.args.args)]
    needed = len(names) - len(node.args.defaults)
    listed = [(name, position >= needed) for position, name in enumerate(names)]
    return [entry for entry in listed if entry[0] not in ("self", "cls")]


def compiled_parameters(function: Callable[..., Any]) -> list[tuple[str, bool]]:
    parameters = inspect.signature(function).parameters.values()
    listed = [(p.name, p.default is not inspect.Parameter.empty) for p in parameters]
    return [entry for entry in listed if entry[0] != "self"]


def test_stubs_and_module_hold_the_same_names() -> None:
    assert len(FUNCTIONS) >= 9 and CLASSES
    assert public([*FUNCTIONS, *CLASSES, *CONSTANTS]) == public(dir(_core))
    for name, node in CLASSES.items():
        assert public(list(methods(node))) == public(dir(getattr(_core, name))), name


@pytest.mark.parametrize("name", sorted(FUNCTIONS))
def test_functions_have_the_parameters_of_their_stubs(name: str) -> None:
    assert stub_parameters(FUNCTIONS[name]) == compiled_parameters(getattr(_core, name))


@pytest.mark.parametrize("name", sorted(CLASSES))
def test_classes_have_the_parameters_of_their_stubs(name: str) -> None:
    compiled = getattr(_core, name)
    stubs = methods(CLASSES[name])
    assert stub_parameters(stubs.pop("__new__")) == compiled_parameters(compiled)
    assert stubs
    for method, node in stubs.items():
        assert stub_parameters(node) == compiled_parameters(getattr(compiled, method)), method


def test_the_package_wraps_every_compiled_name() -> None:
    sources = "\n".join(path.read_text() for path in PACKAGE.rglob("*.py"))
    unused = [name for name in public(dir(_core)) if f"_core.{name}" not in sources]
    assert unused == []

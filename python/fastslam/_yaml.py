"""Strict YAML: safe, without duplicate keys, with the line of every key, and `1e-3` is a number."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import yaml


class YamlError(Exception):
    """Text that is not the YAML expected: what is wrong, and the line where known."""

    def __init__(self, message: str, line: int | None = None) -> None:
        super().__init__(message)
        self.message = message
        self.line = line


def parse_yaml(text: str) -> tuple[Any, dict[str, int]]:
    """Returns the value and the line (from 1) of every mapping key, by dotted name.

    Errors: `YamlError` with a message of one line for a syntax error or a duplicate key.
    """
    try:
        loader = _Loader(text)
        return loader.get_single_data(), loader.line_of_key
    except yaml.MarkedYAMLError as error:
        line = None if error.problem_mark is None else error.problem_mark.line + 1
        raise YamlError(error.problem or "not valid YAML", line) from None
    except (yaml.YAMLError, ValueError) as error:
        raise YamlError(f"not valid YAML ({' '.join(str(error).split())})") from None


def line_of_key(path: Path, key: str) -> int | None:
    """The line (from 1) of a dotted key in a YAML file, or of the section that it is missing in.

    None where there is no such file or neither stands in it.
    """
    try:
        lines = parse_yaml(path.read_text(encoding="utf-8-sig"))[1]
    except (OSError, ValueError, YamlError):
        return None
    parts = key.split(".")
    names = (".".join(parts[:count]) for count in range(len(parts), 0, -1))
    return next((lines[name] for name in names if name in lines), None)


class _Loader(yaml.SafeLoader):
    def __init__(self, text: str) -> None:
        super().__init__(text)
        self.line_of_key: dict[str, int] = {}

    def construct_document(self, node: yaml.Node) -> Any:
        self._visit(node, "")
        return super().construct_document(node)

    def _visit(self, node: yaml.Node, prefix: str) -> None:
        if not isinstance(node, yaml.MappingNode):
            return
        for key_node, value_node in node.value:
            dotted = f"{prefix}{key_node.value}"
            if dotted in self.line_of_key:
                first = self.line_of_key[dotted]
                message = f"{dotted}: duplicate key, first given in line {first}"
                raise yaml.constructor.ConstructorError(None, None, message, key_node.start_mark)
            self.line_of_key[dotted] = key_node.start_mark.line + 1
            self._visit(value_node, dotted + ".")


class _Dumper(yaml.SafeDumper):
    """The safe dumper, which must know the form of numbers below to quote texts that look like it."""


# YAML 1.1 wants a point and a signed exponent in such numbers; people do not.
_FLOAT = re.compile(r"^[-+]?(\d+\.?\d*|\.\d+)[eE][-+]?\d+$")
for _side in (_Loader, _Dumper):
    _side.add_implicit_resolver("tag:yaml.org,2002:float", _FLOAT, list("-+.0123456789"))


def write_yaml(value: Any, *, flow: bool = False) -> str:
    """YAML text that `parse_yaml` turns into the same value; keys keep their order. `flow`: in one line."""
    layout: dict[str, Any] = {"default_flow_style": True, "width": 10_000} if flow else {}
    text: str = yaml.dump(value, Dumper=_Dumper, sort_keys=False, allow_unicode=True, **layout)
    return text.removesuffix("...\n") if flow else text

"""Strict YAML: safe, bounded, without duplicate keys, with the line of every key, and `1e-3` is a number."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import yaml

MOST_CHARACTERS = 1_000_000
"""Longest text, and most that its aliases may make of it: settings are a hundred lines."""
DEEPEST = 50
"""Most levels of nesting; settings have five."""


class YamlError(Exception):
    """Text that is not the YAML expected: what is wrong, and the line where known."""

    def __init__(self, message: str, line: int | None = None) -> None:
        super().__init__(message)
        self.message = message
        self.line = line


def parse_yaml(text: str) -> tuple[Any, dict[str, int]]:
    """Returns the value and the line (from 1) of every mapping key, by dotted name.

    Errors: `YamlError` with a message of one line for a syntax error, a duplicate key, an alias of itself,
    and for text that is longer, deeper nested or more often repeated by aliases than settings can be.
    """
    if len(text) > MOST_CHARACTERS:
        raise YamlError(f"too long for settings: {len(text):,} characters, at most {MOST_CHARACTERS:,}")
    try:
        loader = _Loader(text)
        return loader.get_single_data(), loader.line_of_key
    except yaml.MarkedYAMLError as error:
        line = None if error.problem_mark is None else error.problem_mark.line + 1
        raise YamlError(" ".join((error.problem or "not valid YAML").split()), line) from None
    # A tag such as `!!int` before what is none makes the library fail in any of these ways.
    except (yaml.YAMLError, ValueError, TypeError, LookupError, AttributeError, OverflowError) as error:
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
        self._level = 0
        # What each finished node takes when written out: characters, and levels below it.
        self._size: dict[int, tuple[int, int]] = {}

    def fetch_flow_collection_start(self, TokenClass: Any) -> None:
        """Counts brackets already here: the scanner, which looks ahead, takes long over many."""
        if self.flow_level >= DEEPEST:
            self._refuse(f"nested deeper than {DEEPEST} levels", self.get_mark())
        super().fetch_flow_collection_start(TokenClass)

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
        """Measures every node as it is made, before anything walks through what its aliases repeat."""
        is_alias, mark = self.check_event(yaml.AliasEvent), self.get_mark()
        if self._level >= DEEPEST:
            self._refuse(f"nested deeper than {DEEPEST} levels", mark)
        self._level += 1
        node = super().compose_node(parent, index)
        self._level -= 1
        if node is not None and not is_alias:
            self._size[id(node)] = self._measured(node, mark)
        elif node is not None and id(node) not in self._size:
            self._refuse("an alias of what it is part of", mark)
        return node

    def _measured(self, node: yaml.Node, mark: yaml.Mark) -> tuple[int, int]:
        if isinstance(node, yaml.ScalarNode):
            return len(node.value) + 1, 0
        members = node.value
        if isinstance(node, yaml.MappingNode):
            members = [member for pair in node.value for member in pair]
        sizes = [self._size[id(member)] for member in members]
        characters = 1 + sum(size for size, _ in sizes)
        levels = 1 + max((level for _, level in sizes), default=0)
        if characters > MOST_CHARACTERS:
            self._refuse(f"aliases make more than {MOST_CHARACTERS:,} characters of it", mark)
        if levels > DEEPEST:
            self._refuse(f"nested deeper than {DEEPEST} levels", mark)
        return characters, levels

    def _refuse(self, message: str, mark: yaml.Mark) -> None:
        raise yaml.constructor.ConstructorError(None, None, message, mark)

    def construct_document(self, node: yaml.Node) -> Any:
        self._visit(node, "")
        return super().construct_document(node)

    def _visit(self, node: yaml.Node, prefix: str) -> None:
        if not isinstance(node, yaml.MappingNode):
            return
        for key_node, value_node in node.value:
            if not isinstance(key_node, yaml.ScalarNode):
                self._refuse("expected a name before the colon", key_node.start_mark)
            dotted = f"{prefix}{key_node.value}"
            if dotted in self.line_of_key:
                first = self.line_of_key[dotted]
                self._refuse(f"{dotted}: duplicate key, first given in line {first}", key_node.start_mark)
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

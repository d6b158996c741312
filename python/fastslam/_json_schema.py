"""Reads a JSON Schema of settings: which keys there are and what they mean."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

Node = Mapping[str, Any]


@dataclass(frozen=True)
class KeyInfo:
    """What the schema says about one configuration key (its unit, if any, ends its name)."""

    name: str
    """Dotted: `filter.particles`."""
    type: str
    """`number`, `integer`, `a | b` for a choice, ...; `or null` where it may be left empty."""
    default: Any
    description: str
    only_for: str = ""
    """`model = velocity`, say, where the key exists (or counts) for one kind of section only."""
    section_descriptions: Mapping[str, str] = field(default_factory=dict, repr=False)
    """Of the sections above the key, by dotted name."""


@dataclass(frozen=True)
class _Walk:
    """A place in the schema: the section's dotted path, what its keys are limited to, texts met above it."""

    path: tuple[str, ...] = ()
    only_for: str = ""
    texts: Mapping[str, str] = field(default_factory=dict)

    def below(self, name: str, description: str) -> _Walk:
        path = (*self.path, name)
        return _Walk(path, self.only_for, {**self.texts, ".".join(path): description})


def flatten(schema: Node, defaults: Mapping[str, Any]) -> tuple[KeyInfo, ...]:
    """Lists every key that a configuration may have, with the default of each.

    `defaults` is the configuration that the core fills in by itself; keys of a kind of section that is not
    the default one take theirs from the schema.
    """
    return tuple(_keys_of_section(schema, schema, defaults, _Walk()))


def discriminators(schema: Node) -> Mapping[tuple[str, ...], str]:
    """Maps each section that comes in kinds to the key that names its kind: `("motion",)` to `model`."""
    return dict(_find_discriminators(schema, schema, ()))


def suggestion(key: str, known: Iterable[str]) -> str | None:
    """Returns the known key that `key` was most likely meant to be, or None."""
    names = sorted(known)
    near = difflib.get_close_matches(key, names, n=1, cutoff=0.75)
    if near:
        return near[0]
    # `particles` for `filter.particles`: the right word in the wrong (or no) section.
    word = key.rpartition(".")[2]
    by_word = {name.rpartition(".")[2]: name for name in reversed(names)}
    near = difflib.get_close_matches(word, by_word, n=1, cutoff=0.75)
    return by_word[near[0]] if near else None


def _expand(root: Node, node: Node) -> Node:
    """Follows a reference and drops an `or null`; what stands beside a reference wins over what it names."""
    while "$ref" in node:
        target: Any = root
        for part in node["$ref"].removeprefix("#/").split("/"):
            target = target[part]
        node = {**target, **{key: value for key, value in node.items() if key != "$ref"}}
    variants = [variant for variant in node.get("anyOf", ()) if variant.get("type") != "null"]
    if len(variants) == 1:
        beside = {key: value for key, value in node.items() if key != "anyOf"}
        return {**_expand(root, variants[0]), **beside, "nullable": True}
    return node


def _kinds(root: Node, node: Node) -> list[Node]:
    """The kinds of a section whose keys depend on a discriminator; empty for any other node."""
    kinds = [_expand(root, kind) for kind in node.get("oneOf", ())]
    return kinds if kinds and all("properties" in kind for kind in kinds) else []


def _discriminator(kinds: list[Node]) -> str:
    """The property that every kind fixes to a constant."""
    names = [
        name
        for name in kinds[0]["properties"]
        if all("const" in kind["properties"].get(name, {}) for kind in kinds)
    ]
    return str(names[0])


def _find_discriminators(
    root: Node, node: Node, path: tuple[str, ...]
) -> Iterator[tuple[tuple[str, ...], str]]:
    node = _expand(root, node)
    kinds = _kinds(root, node)
    if kinds:
        yield path, _discriminator(kinds)
    for section in [node, *kinds]:
        for name, child in section.get("properties", {}).items():
            yield from _find_discriminators(root, child, (*path, name))


def _keys_of_section(root: Node, node: Node, defaults: Any, walk: _Walk) -> Iterator[KeyInfo]:
    kinds = _kinds(root, node)
    if kinds:
        yield from _keys_of_kinds(root, kinds, defaults, walk)
    for name, child in _in_order(node, defaults):
        yield from _keys_of_child(root, (name, child), defaults, walk)


def _in_order(node: Node, defaults: Any) -> list[tuple[str, Node]]:
    """Properties in the order of the defaults, which is the author's; the schema sorts by name."""
    order = list(defaults) if isinstance(defaults, Mapping) else []
    children = node.get("properties", {}).items()
    return sorted(children, key=lambda child: order.index(child[0]) if child[0] in order else len(order))


def _keys_of_kinds(root: Node, kinds: list[Node], defaults: Any, walk: _Walk) -> Iterator[KeyInfo]:
    discriminator = _discriminator(kinds)
    names = [str(kind["properties"][discriminator]["const"]) for kind in kinds]
    default = defaults.get(discriminator) if isinstance(defaults, Mapping) else None
    about = " ".join(f"{name}: {_text(kind)}" for name, kind in zip(names, kinds, strict=True))
    dotted = ".".join((*walk.path, discriminator))
    yield KeyInfo(dotted, " | ".join(names), default, about, walk.only_for, walk.texts)
    found: list[tuple[str, KeyInfo]] = []
    for name, kind in zip(names, kinds, strict=True):
        only = _Walk(walk.path, f"{discriminator} = {name}", walk.texts)
        known = defaults if name == default else None
        for child_name, child in _in_order(kind, known):
            if child_name != discriminator:
                found += [(name, info) for info in _keys_of_child(root, (child_name, child), known, only)]
    yield from _shared(found, discriminator, len(kinds), walk.only_for)


def _shared(
    found: list[tuple[str, KeyInfo]], discriminator: str, kinds: int, only_for: str
) -> Iterator[KeyInfo]:
    """What several kinds have in common once, without a limit where all have it."""
    groups: dict[str, list[tuple[str, KeyInfo]]] = {}
    for name, info in found:
        alike = repr((info.name, info.type, info.default, info.description))
        groups.setdefault(alike, []).append((name, info))
    for group in groups.values():
        names = [name for name, _ in group]
        if len(names) == kinds:
            yield replace(group[0][1], only_for=only_for)
        else:
            yield replace(group[0][1], only_for=f"{discriminator} = {' | '.join(names)}")


def _keys_of_child(root: Node, child: tuple[str, Node], defaults: Any, walk: _Walk) -> Iterator[KeyInfo]:
    name, node = child[0], _expand(root, child[1])
    # What may hold any number of sections is empty by default.
    default = node.get("default", {} if node.get("additionalProperties") else None)
    if isinstance(defaults, Mapping) and name in defaults:
        default = defaults[name]
    if "properties" in node or _kinds(root, node):
        yield from _keys_of_section(root, node, default, walk.below(name, _text(node)))
        return
    description = " ".join([_text(node), *_choice_texts(node)]).strip()
    dotted = ".".join((*walk.path, name))
    only_for = walk.only_for or str(node.get("x-only-for", ""))
    yield KeyInfo(dotted, _type(root, node), default, description, only_for, walk.texts)


def _text(node: Node) -> str:
    return " ".join(str(node.get("description", "")).split())


def _choice_texts(node: Node) -> Iterator[str]:
    for choice in node.get("oneOf", ()):
        if "const" in choice and _text(choice):
            yield f"{choice['const']}: {_text(choice)}"


def _type(root: Node, node: Node) -> str:
    suffix = " or null" if node.get("nullable") else ""
    options = [*node.get("oneOf", ()), node]
    choices = [value for option in options for value in option.get("enum", [option.get("const")])]
    choices = [str(choice) for choice in choices if choice is not None]
    for option in options[:-1]:
        fields = [f"{name}: {_type(root, child)}" for name, child in option.get("properties", {}).items()]
        choices += [f"{{{', '.join(fields)}}}"] if fields else []
    if choices:
        return " | ".join(choices) + suffix
    types = node.get("type", "any")
    if isinstance(types, list):
        suffix = " or null" if "null" in types else suffix
        types = " or ".join(kind for kind in types if kind != "null")
    if types == "array":
        types = _array_type(root, node)
    return f"{types}{suffix}"


def _array_type(root: Node, node: Node) -> str:
    item = _type(root, _expand(root, node["items"])) if isinstance(node.get("items"), Mapping) else "value"
    length = node.get("minItems")
    fixed = length is not None and length == node.get("maxItems")
    return f"{length} × {item}" if fixed else f"list of {item}"

"""YAML from anywhere: a value or one line, at once and in little memory."""

from __future__ import annotations

import time
from pathlib import Path

import pytest
from fastslam._yaml import YamlError, parse_yaml
from fastslam.config import load_config
from fastslam.errors import ConfigError
from yaml_memory import refused_with_kilobytes

DOUBLING = "a0: &a0 {x: 1, y: 2}\n" + "".join(
    f"a{i}: &a{i} {{x: *a{i - 1}, y: *a{i - 1}}}\n" for i in range(1, 26)
)
MERGING = "a0: &a0 {k: 1}\n" + "".join(f"a{i}: &a{i} {{<<: [*a{i - 1}, *a{i - 1}]}}\n" for i in range(1, 26))
HOSTILE = {
    "aliases that multiply": (DOUBLING, "aliases make more than", 18),
    "merges that multiply": (MERGING, "aliases make more than", 18),
    "a long text many times": (
        'a: &a "' + "x" * 90_000 + '"\nb: [' + ", ".join(["*a"] * 30) + "]",
        "aliases",
        2,
    ),
    "an alias of itself": ("filter: &a {particles: 3, adaptive: *a}", "an alias of what it is part of", 1),
    "a list within itself": ("a: &x\n  - *x\n", "an alias of what it is part of", 3),
    "brackets in brackets": ("filter: " + "{a: " * 2000, "nested deeper than 50", 1),
    "very many brackets": ("[" * 200_000, "nested deeper than 50", 1),
    "dashes in dashes": ("- " * 2000, "nested deeper than 50", 1),
    "aliases in aliases": (
        "a0: &a0 [1]\n" + "".join(f"a{i}: &a{i} [*a{i - 1}]\n" for i in range(1, 200)),
        "nested deeper than 50",
        51,
    ),
    "too much of it": ("a: 1\n" * 300_000, "too long for settings", None),
    "no integer": ('a: !!int ""', "not valid YAML", None),
    "no time": ("a: !!timestamp soon", "not valid YAML", None),
    "no truth": ("a: !!bool maybe", "not valid YAML", None),
    "a call": ('a: !!python/object/apply:os.system ["true"]', "could not determine a constructor", 1),
    "a list as a key": ("? [a, b]\n: 1\n", "expected a name before the colon", 1),
}


@pytest.mark.parametrize("case", HOSTILE)
def test_hostile_text_is_one_line_at_once(case: str) -> None:
    text, says, line = HOSTILE[case]
    started = time.process_time()
    with pytest.raises(YamlError) as raised:
        parse_yaml(text)
    assert time.process_time() - started < 1.0
    assert says in raised.value.message and "\n" not in raised.value.message
    assert raised.value.line == line


def test_honest_aliases_and_merges_still_work() -> None:
    value, lines = parse_yaml("a: &a {x: 1, y: [2, 3]}\nb:\n  <<: *a\n  y: 4\nc: *a\n")
    assert value == {"a": {"x": 1, "y": [2, 3]}, "b": {"x": 1, "y": 4}, "c": {"x": 1, "y": [2, 3]}}
    assert lines["b.y"] == 4


def test_a_bomb_takes_little_memory(tmp_path: Path) -> None:
    path = tmp_path / "bomb.yaml"
    path.write_text(DOUBLING)
    with pytest.raises(ConfigError, match=r"bomb\.yaml:\d+: aliases make more than"):
        load_config(path)
    error, kilobytes = refused_with_kilobytes(path)
    assert error == "ConfigError" and kilobytes < 50_000

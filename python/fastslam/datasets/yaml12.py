"""YAML in which `1e-3` is a number, as in YAML 1.2 and as people expect; PyYAML alone takes it for text."""

from __future__ import annotations

import re
from typing import Any

import yaml

_FLOAT = re.compile(r"^[-+]?(\d+\.?\d*|\.\d+)[eE][-+]?\d+$")


class _Loader(yaml.SafeLoader):
    """The safe loader with one more form of numbers."""


class _Dumper(yaml.SafeDumper):
    """The safe dumper, which must know that form to quote texts that look like it."""


for _side in (_Loader, _Dumper):
    _side.add_implicit_resolver("tag:yaml.org,2002:float", _FLOAT, list("-+.0123456789"))


def read_yaml(text: str) -> Any:
    """The value of a YAML text. Errors: yaml.YAMLError."""
    return yaml.load(text, Loader=_Loader)


def write_yaml(value: Any) -> str:
    """YAML text that `read_yaml` turns into the same value; keys keep their order."""
    return yaml.dump(value, Dumper=_Dumper, sort_keys=False, allow_unicode=True)

"""Writes the reference pages that come from the code: `python docs/generate.py` (or `make docs`).

- `cli.md` from the command line itself;
- `configuration.md`, `simulation.md` and `detectors.md` from the schemas of the core;
- `python/README.md`, what a package index shows, from the README.
"""

from __future__ import annotations

import inspect
import json
import math
import re
import textwrap
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import typer
from fastslam import config, detection, simulation
from fastslam.cli import application
from fastslam.limits import OF_SETTINGS
from fastslam.settings import KeyInfo

DOCS = Path(__file__).parent
NOTE = "<!-- Written by docs/generate.py: change the code, then run `make docs`. -->\n"


def cli_page() -> str:
    """Every command with its arguments and options."""
    group = typer.main.get_command(application())
    parts = [f"# Command line\n\n{NOTE}\n{group.help}\n\n{group.epilog}\n"]
    parts += [_command_section(f"fastslam {name}", command) for name, command in _commands(group)]
    return "\n".join(parts)


def _commands(group: Any) -> Iterator[tuple[str, Any]]:
    for name, command in group.commands.items():
        inner = getattr(command, "commands", None)
        if inner is None:
            yield name, command
        else:
            yield from ((f"{name} {child}", leaf) for child, leaf in inner.items())


def _command_section(name: str, command: Any) -> str:
    text, _, examples = inspect.cleandoc(command.help).partition("\b\n")
    arguments = [p for p in command.params if p.param_type_name == "argument"]
    options = [p for p in command.params if p.param_type_name == "option" and not p.hidden and p.help]
    usage = " ".join([name, *(["[OPTIONS]"] if options else []), *(p.metavar for p in arguments)])
    lines = [f"## {name}\n", f"    {usage}\n", text.strip(), ""]
    rows = [(f"`{p.metavar}`", p.help) for p in arguments]
    rows += [(f"`{_option_text(p)}`", p.help) for p in options]
    if rows:
        lines += [*_table(("argument or option", "meaning"), rows), ""]
    if examples:
        lines += ["```text", textwrap.dedent(examples.removeprefix("Examples:").strip("\n")), "```", ""]
    return "\n".join(lines)


def _option_text(option: Any) -> str:
    value = "" if option.is_flag else f" {option.metavar or option.name.upper()}"
    return ", ".join(option.opts) + value


def settings_page(title: str, introduction: str, keys: Iterable[KeyInfo]) -> str:
    """A table of keys for each section of a schema."""
    parts = [f"# {title}\n\n{NOTE}\n{introduction}\n"]
    sections: dict[str, list[KeyInfo]] = {}
    for info in keys:
        sections.setdefault(info.name.rpartition(".")[0], []).append(info)
    for section, found in sections.items():
        heading = section or "Top level"
        about = found[0].section_descriptions.get(section, "")
        rows = [(f"`{_leaf(k)}`", k.type, f"`{json.dumps(k.default)}`", _meaning(k)) for k in found]
        table = "\n".join(_table(("key", "type", "default", "meaning"), rows))
        parts.append(f"## {heading}\n\n{about}\n\n{table}\n" if about else f"## {heading}\n\n{table}\n")
    return "\n".join(parts)


def _leaf(info: KeyInfo) -> str:
    return info.name.rpartition(".")[2]


def _meaning(info: KeyInfo) -> str:
    return f"Only for `{info.only_for}`. {info.description}" if info.only_for else info.description


def _table(headings: tuple[str, ...], rows: Iterable[tuple[str, ...]]) -> list[str]:
    def line(cells: tuple[str, ...]) -> str:
        return "| " + " | ".join(_cell(cell) for cell in cells) + " |"

    return [line(headings), "|" + "---|" * len(headings), *map(line, rows)]


def _cell(text: str) -> str:
    return " ".join(text.split()).replace("|", "\\|").replace("<", "\\<")


CONFIGURATION = """\
Every key that a run can be given, as `--set section.key=value`, in a YAML file (`--config`), in the
`log.yaml` of a native log (some sections) or as a dictionary in Python. Later ones win: defaults <
the log's own < file < command line. An unknown key is an error. Units end the names: SI and
radians. `fastslam config dump` prints a complete file, `fastslam config explain KEY` one entry."""

UNITS = {
    "_m": "lengths",
    "_rad": "angles",
    "_s": "durations",
    "_per_s": "speeds and rates",
    "_per_sqrt_m": "noise per root metre",
    "_per_sqrt_rad": "noise per root radian",
    "": "numbers without a unit",
}
OTHERS = {"position": "coordinates in the world (of poses and points)"}


def bounds() -> str:
    """What no setting exceeds, by the unit that ends its key."""
    ends = {unit: f"{words} (`{unit}`)" if unit else words for unit, words in UNITS.items()} | OTHERS
    listed = ", ".join(f"{words} {_power(OF_SETTINGS[unit])}" for unit, words in ends.items())
    text = (
        f"Beyond these sizes a number is refused, with a line that names its key: {listed}. "
        f"What must be positive is at least {_power(OF_SETTINGS['least'])}."
    )
    return "\n\n" + "\n".join(textwrap.wrap(text, 100))


def _power(value: float) -> str:
    return f"1e{round(math.log10(value))}"


SIMULATION = """\
Every key of `fastslam simulate` (`--set`, `--config`) and of `fastslam.simulation.simulate`.
`--preset` lays a ready-made simulation under them; `simulation.yaml` beside a simulated log holds
the complete settings that made it.

`cones` is the track of a Formula Student event: three laps of 300 m between 150 cones in pairs 4 m
apart, seen ahead only, 10 % of them missed, one sighting in five scans false, one colour in twenty
wrong, and nobody to say which cone is which. The `log.yaml` of such a log tells the noise, the sensor's
limits and how often colours are right. With that, all else by default, seeds 1 to 40 (median, worst):

| identities | live path [m] | smoothed path [m] | map [m] | cones found | false |
|---|---|---|---|---|---|
| none | 0.55 (0.93) | 0.060 (0.101) | 0.062 (0.106) | 150 (150) of 150 | 0 (0) |
| all but clutter | 0.46 (0.97) | 0.059 (0.101) | 0.061 (0.105) | 150 (150) of 150 | 0 (0) |

The live path holds the drift of the first lap, which nothing can know before the loop closes. Of forty single
runs with other seeds of the filter than of the world one loses the loop, and its verdict says so; from such a
map `fastslam run` learns, and comes to 150 cones there too."""

DETECTORS = """\
Every key of the detectors that find landmarks in laser scans: `fastslam.detection.detect(log, settings)`,
or `detector_json` in the `scans.npz` of a native log ([bags](howto/orchard.md#from-a-bag))."""


def package_readme() -> str:
    """The README as a package index shows it: without pictures, links and what only a checkout has."""
    text = (DOCS.parent / "README.md").read_text(encoding="utf-8")
    text = re.sub(r"<!-- checkout -->\n.*?<!-- /checkout -->\n+", "", text, flags=re.DOTALL)
    # Links within the project lead nowhere on an index: those in brackets go, of others the words stay.
    text = re.sub(r"\s*\(\[[^\]]+\]\((?!https?://)[^)]*\)\)", "", text)
    text = re.sub(r"\[([^\]]+)\]\((?!https?://)[^)]*\)", r"\1", text)
    return NOTE + "\n" + text


def pages() -> dict[str, str]:
    """File name to text of every generated page."""
    return {
        "../python/README.md": package_readme(),
        "cli.md": cli_page(),
        "configuration.md": settings_page("Configuration", CONFIGURATION + bounds(), config.explain()),
        "simulation.md": settings_page(
            "Simulation settings", SIMULATION + bounds(), simulation.SCHEMA.explain()
        ),
        "detectors.md": settings_page("Detector settings", DETECTORS + bounds(), detection.SCHEMA.explain()),
    }


if __name__ == "__main__":
    for name, text in pages().items():
        path = (DOCS / name).resolve()
        path.write_text(text, encoding="utf-8")
        print(path)

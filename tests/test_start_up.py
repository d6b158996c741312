"""What the program loads before it does anything: the modules, for times depend on the machine."""

from __future__ import annotations

import functools
import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import fastslam
import pytest
from fastslam.cli import application
from typer.main import get_command

HEAVY = {"numpy", "scipy", "matplotlib", "mpl_toolkits", "distributed", "dask", "pandas", "yaml", "pydantic"}

RUN_COMMAND = """
import json, sys
from fastslam.cli import main
sys.argv = ["fastslam", *sys.argv[1:]]
try:
    main()
except SystemExit:
    pass
print("\\n" + json.dumps(sorted({name.partition(".")[0] for name in sys.modules})))
"""


def loaded(*arguments: str, code: str = RUN_COMMAND, env: dict[str, str] | None = None) -> set[str]:
    """The top-level modules that a fresh interpreter has loaded after `code`."""
    run = subprocess.run(
        [sys.executable, "-c", code, *arguments],
        capture_output=True,
        text=True,
        encoding="utf-8",
        env={**os.environ, "PYTHONIOENCODING": "utf-8", **(env or {})},
        check=True,
    )
    modules = set(json.loads(run.stdout.splitlines()[-1]))
    assert {"sys", "json"} <= modules
    return modules - loaded_by_python()


def loaded_modules(*arguments: str) -> set[str]:
    """The modules of this package that a fresh interpreter has loaded after a command."""
    code = RUN_COMMAND.replace('name.partition(".")[0]', "name")
    return {name for name in loaded(*arguments, code=code) if name.startswith("fastslam")}


def group(*words: str | None) -> Any:
    """The program as made for the words of a command line; whole for None."""
    return get_command(application(None if None in words else [word for word in words if word is not None]))


@functools.cache
def loaded_by_python() -> frozenset[str]:
    """Heavy names that an interpreter holds before it runs anything: matplotlib 3.7 has a .pth file."""
    code = "import sys; print(*{name.partition('.')[0] for name in sys.modules})"
    return frozenset(HEAVY) & set(subprocess.check_output([sys.executable, "-c", code], text=True).split())


@pytest.mark.parametrize(
    "arguments",
    ["--version", "--help", "", "run --help", "simulate --help", "eval --help", "config --help"],
)
def test_help_and_version_load_nothing_heavy(arguments: str) -> None:
    modules = loaded(*arguments.split())
    assert "typer" in modules
    assert not modules & (HEAVY | {"rich"})


def test_a_run_of_a_small_log_with_truth_and_report_does_without_scipy_and_matplotlib(tmp_path: Path) -> None:
    log, results = str(tmp_path / "log"), str(tmp_path / "results")
    small = ["--set", "max_duration_s=20", "--set", "world.count=20"]
    assert loaded("simulate", log, *small) >= {"numpy"}
    modules = loaded("run", log, "--out", results)
    assert (tmp_path / "results" / "report.html").exists()
    assert "numpy" in modules and not modules & {"matplotlib", "mpl_toolkits", "scipy"}


def test_only_the_named_command_is_made() -> None:
    assert list(group("config", "dump").commands) == ["config"]
    for words in ([], ["--help"], ["nonsense"], ["--", "config"]):
        assert len(group(*words).commands) > 15, words
    # What is only listed reads as what can be run, and whatever a word may name can be.
    context = {"info_name": "fastslam"}
    listed, whole = (made.get_help(made.context_class(made, **context)) for made in (group(), group(None)))
    assert listed == whole and listed.count("\n") > 25
    assert group("--", "config").commands["config"].commands.keys() == {"dump", "validate", "explain"}
    modules = loaded_modules("--help")
    assert "fastslam.cli.app" in modules and not {"fastslam.cli.run", "fastslam.cli.config"} & modules
    modules = loaded_modules("config", "explain", "filter.particles")
    assert "fastslam.cli.config" in modules and not {"fastslam.cli.run", "fastslam.cli.maps"} & modules
    # `--help` before a command is help of all; a command that nobody knows is told beside those that exist.
    asked = [sys.executable, "-m", "fastslam", "config", "--help"]
    assert "Usage: fastslam config" in subprocess.check_output(asked, text=True)


def test_completion_loads_nothing_heavy() -> None:
    words = {"COMP_WORDS": "fastslam run --", "COMP_CWORD": "2", "_FASTSLAM_COMPLETE": "complete_bash"}
    modules = loaded(env=words)
    assert "typer" in modules
    assert not modules & (HEAVY | {"rich"})


@pytest.mark.parametrize("arguments", ["config explain filter.particles", "config explain"])
def test_explaining_keys_loads_nothing_heavy(arguments: str) -> None:
    modules = loaded(*arguments.split())
    assert "typer" in modules
    assert not modules & (HEAVY | {"rich"})


def test_importing_the_package_loads_nothing_heavy() -> None:
    code = "import json, sys, fastslam\nprint(json.dumps(sorted({m.partition('.')[0] for m in sys.modules})))"
    modules = loaded(code=code)
    assert "fastslam" in modules
    assert not modules & (HEAVY | {"rich", "typer"})


def test_running_the_filter_needs_neither_scipy_nor_matplotlib() -> None:
    code = (
        "import json, sys, fastslam\n"
        "log = fastslam.simulation.simulate({'seed': 3, 'world': {'count': 15}})\n"
        "assert len(fastslam.run(log, {'filter': {'particles': 5}}).landmarks.ids) > 5\n"
        "print(json.dumps(sorted({m.partition('.')[0] for m in sys.modules})))"
    )
    modules = loaded(code=code)
    assert "numpy" in modules
    assert not modules & {"scipy", "matplotlib", "rich", "typer", "distributed"}


def test_reading_a_log_and_scoring_leaves_scipy_and_matplotlib_alone(tmp_path: Path) -> None:
    code = (
        "import json, sys, fastslam\n"
        "from fastslam.evaluation import evaluate\n"
        "from fastslam.simulation import simulate\n"
        "log = simulate({'seed': 3, 'world': {'count': 15}})\n"
        "fastslam.datasets.write_native(log, sys.argv[1])\n"
        "log = fastslam.load(sys.argv[1])\n"
        "assert evaluate(fastslam.run(log), log)['landmark_matched'] > 5\n"
        "print(json.dumps(sorted({m.partition('.')[0] for m in sys.modules})))"
    )
    modules = loaded(str(tmp_path / "log"), code=code)
    assert "numpy" in modules
    assert not modules & {"scipy", "matplotlib", "rich"}


def test_all_names_of_the_package_can_be_reached() -> None:
    names = dir(fastslam)
    assert set(fastslam.__all__) < set(names)
    reached = {name for name in names if getattr(fastslam, name) is not None}
    assert reached == set(names) and len(reached) > 25
    with pytest.raises(AttributeError, match="no attribute 'nonsense'"):
        _ = fastslam.nonsense

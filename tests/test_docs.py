"""Everything that the documentation shows is run, and everything that it points to is there."""

from __future__ import annotations

import doctest
import re
import runpy
import shlex
from pathlib import Path

import pytest
import yaml
from cli_runner import fastslam
from doc_pages import PAGES, ROOT, Block, blocks, commands, links, name_of
from fastslam.config import Config

# Not run: `text` and `csv` show files and output; the doctests of fastslam-core run `rust`.
SHOWN = {"text", "csv", "rust"}
RUN = {"python", "sh", "console", "yaml"}
WITH_BLOCKS = [page for page in PAGES if any(block.language in RUN for block in blocks(page))]
# At least so many blocks are run on these pages, so that a page cannot lose its examples unseen.
LEAST_BLOCKS = {
    "README.md": 3,
    "docs/tutorial.md": 9,
    "docs/start.md": 3,
    "docs/howto/spreadsheet.md": 4,
    "docs/howto/cone-car.md": 6,
    "docs/howto/orchard.md": 4,
    "docs/howto/reflectors.md": 3,
    "docs/howto/tags.md": 4,
    "docs/howto/beacons.md": 4,
    "docs/howto/ros2-bag.md": 5,
    "docs/native-log-format.md": 1,
    "docs/concepts.md": 2,
    "docs/tuning.md": 2,
    "docs/faq.md": 2,
    "docs/scans.md": 2,
    "docs/formats.md": 2,
    "docs/python.md": 9,
    "docs/own-sensor.md": 5,
}
SLOW_PAGES = {
    *("docs/maps.md", "docs/rejuvenation.md", "docs/scans.md", "docs/localisation.md", "docs/python.md"),
    *("docs/howto/orchard.md", "docs/howto/cone-car.md", "docs/range-only.md", "docs/bearing-only.md"),
    *("docs/self-calibration.md", "docs/space.md", "docs/space-without-odometry.md"),
}
# Commands that set up or change the checkout; that their targets exist is checked below.
MAKE_TARGETS = set(re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(), re.MULTILINE))
EXAMPLES = sorted((ROOT / "examples").glob("*.py"))
KEY = re.compile(r"`([a-z]+[12]\d{3}[a-z]+)`")


def run_commands(block: Block, where: str) -> None:
    """Runs `fastslam ...`; of `make TARGET` only checks that there is such a target."""
    checker = doctest.OutputChecker()
    for command in commands(block):
        program, *arguments = shlex.split(command.line, comments=True)
        if program == "make":
            assert arguments and set(arguments) <= MAKE_TARGETS, f"{where}: {command.line}"
            continue
        assert program == "fastslam", f"{where}: {command.line}: no way to test this"
        target = arguments.pop() if ">" in arguments else None
        outcome = fastslam(*(argument for argument in arguments if argument != ">"))
        assert outcome.exit_code == 0, f"{where}: {command.line}: {outcome.stderr}"
        if target is not None:
            Path(target).write_text(outcome.stdout)
        flags = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE
        shown = not command.output or checker.check_output(command.output, outcome.stdout, flags)
        assert shown, f"{where}: {command.line} printed\n{outcome.stdout}"


@pytest.mark.parametrize(
    "page",
    [
        pytest.param(page, marks=[pytest.mark.slow] if name_of(page) in SLOW_PAGES else [], id=name_of(page))
        for page in WITH_BLOCKS
    ],
)
def test_code_blocks_run(page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The blocks of a page run in order in one folder, those of Python in one namespace."""
    monkeypatch.chdir(tmp_path)
    namespace: dict[str, object] = {"__name__": "__docs__"}
    ran = 0
    for block in blocks(page):
        where = f"{name_of(page)}:{block.line}"
        if block.language == "python":
            # Padded, so that a traceback shows the line of the page.
            exec(compile("\n" * block.line + block.text, str(page), "exec"), namespace)
        elif block.language in ("sh", "console"):
            run_commands(block, where)
        elif block.language == "yaml":
            Config.resolve(yaml.safe_load(block.text))
        else:
            assert block.language in SHOWN, f"{where}: unknown language {block.language!r}"
            continue
        ran += 1
    assert ran >= LEAST_BLOCKS.get(name_of(page), 1)


def test_the_pages_that_must_have_examples_have_some() -> None:
    assert set(LEAST_BLOCKS) | SLOW_PAGES <= set(map(name_of, WITH_BLOCKS))


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda path: path.stem)
def test_examples_run(
    example: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    runpy.run_path(str(example), run_name="__main__")
    assert capsys.readouterr().out.strip()


def test_there_are_examples() -> None:
    assert [path.name[:3] for path in EXAMPLES] == ["01_", "02_", "03_", "04_", "05_"]


def test_generated_pages_are_up_to_date() -> None:
    pages = runpy.run_path(str(ROOT / "docs" / "generate.py"))["pages"]()
    assert len(pages) == 5
    for name, text in pages.items():
        assert (ROOT / "docs" / name).read_text(encoding="utf-8") == text, f"{name}: run `make docs`"


def test_the_readme_of_the_package_needs_no_checkout() -> None:
    text = (ROOT / "python" / "README.md").read_text(encoding="utf-8").partition("-->")[2]
    assert "# fastslam\n" in text and "```python" in text and "fastslam info my-log" in text
    assert "![" not in text and "](" not in text.replace("](https://", "")
    assert "make demo" not in text and "`make" not in text
    assert "checkout -->" not in text and "tutorial" not in text


def test_links_lead_somewhere() -> None:
    seen = 0
    for page in PAGES:
        for target in links(page):
            if target.startswith(("https://", "#")):
                continue
            seen += 1
            assert (page.parent / target.partition("#")[0]).exists(), f"{name_of(page)}: {target}"
    assert seen >= 30


def slug(heading: str) -> str:
    """The anchor of a heading, as Markdown makes it."""
    return re.sub(r"[-\s]+", "-", re.sub(r"[^\w\s-]", "", heading).strip().lower())


def test_anchors_are_headings() -> None:
    seen = 0
    for page in PAGES:
        for target in links(page):
            path, _, anchor = target.partition("#")
            if not anchor or target.startswith("https://"):
                continue
            seen += 1
            text = (page.parent / path if path else page).read_text(encoding="utf-8")
            headings = {slug(found) for found in re.findall(r"^#+ (.*)$", text, re.MULTILINE)}
            assert anchor in headings, f"{name_of(page)}: {target}"
    assert seen >= 10


def test_paths_named_in_the_pages_exist() -> None:
    path = re.compile(r"`((?:crates|python|tests|docs|examples|scripts|benchmarks|experiments)/[\w./*-]*)`")
    seen = 0
    for page in PAGES:
        for name in path.findall(page.read_text(encoding="utf-8")):
            seen += 1
            assert list(ROOT.glob(name.rstrip("/"))), f"{name_of(page)}: {name}"
    assert seen >= 15


def test_every_page_is_in_the_index() -> None:
    index = ROOT / "docs" / "README.md"
    listed = {(index.parent / target).resolve() for target in links(index)}
    pages = [*(ROOT / "docs").glob("*.md"), *(ROOT / "docs" / "howto").glob("*.md")]
    missing = [page.name for page in pages if page != index and page not in listed]
    assert missing == [] and len(pages) > 30


def test_equations_name_code_that_exists() -> None:
    """Rows say `name` in [file](path): the file must define that function, type or constant."""
    page = ROOT / "docs" / "equations.md"
    named = re.findall(r"`([A-Za-z_0-9:]+)` in \[[^\]]+\]\(([^)]+)\)", page.read_text(encoding="utf-8"))
    assert len(named) >= 20
    for name, path in named:
        last = name.rpartition("::")[2]
        source = (page.parent / path).read_text(encoding="utf-8")
        assert re.search(rf"\b(fn|struct|enum|trait|const) {last}\b", source), f"{name} in {path}"


def test_sources_cited_in_the_code_are_in_the_bibliography() -> None:
    sources = [*ROOT.glob("crates/*/src/**/*.rs"), *ROOT.glob("python/**/*.py"), *PAGES]
    cited = {key for path in sources for key in KEY.findall(path.read_text(encoding="utf-8"))}
    entries = re.findall(r"^@\w+\{(\w+),", (ROOT / "docs" / "references.bib").read_text(), re.MULTILINE)
    assert len(cited) >= 6
    assert len(entries) == len(set(entries))
    assert cited == set(entries)


def test_rust_blocks_are_compiled_by_the_core() -> None:
    """rustdoc compiles the blocks of exactly those pages that `fastslam-core` includes."""
    with_rust = {page.name for page in PAGES if any(block.language == "rust" for block in blocks(page))}
    library = (ROOT / "crates" / "fastslam-core" / "src" / "lib.rs").read_text()
    assert with_rust == set(re.findall(r'include_str!\("../../../docs/([\w-]+\.md)"\)', library))
    assert "add-a-measurement-model.md" in with_rust

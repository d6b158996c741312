"""`fastslam reproduce`: the paper's experiments."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from .console import make_table, progress_bar, stdout
from .sweep import Processes

if TYPE_CHECKING:
    from ..sweep import Progress


def reproduce_figure(
    figure: Annotated[str, typer.Argument(help="Name of a figure, or all.", metavar="FIGURE")],
    quick: Annotated[bool, typer.Option("--quick", help="Fewer seeds, particles and landmarks.")] = False,
    out: Annotated[Path, typer.Option(help="Folder for figures and data.")] = Path("results/reproduce"),
    processes: Processes = None,
) -> None:
    """Remake figures of the FastSLAM paper: PNG, SVG, CSV, and what it reports beside what was measured.

    FIGURE is figure4, figure5, figure6a, figure6b, landmarks (50,000 of them), growth (time and memory
    against K), error-against-time, or all. Stopped at any time, the same command goes on where it was.

    \b
    Examples:
      fastslam reproduce all --quick
      fastslam reproduce figure6b
    """
    # Matplotlib takes a second to load and is needed only here.
    from ..reproduce import claims_table, reproduce
    from ..resultfiles import write_atomically

    with ExitStack() as stack:

        def advance(title: str) -> Progress:
            stack.close()
            return stack.enter_context(progress_bar(title, unit="runs"))

        claims = reproduce([figure], out, quick=quick, processes=processes, progress=advance)
    folder = out / ("quick" if quick else "full")
    if figure == "all":
        write_atomically(folder / "claims.md", claims_table(claims, quick=quick))
    rows = [(claim.statement, claim.paper, claim.ours) for found in claims.values() for claim in found]
    stdout().print(make_table("", ("claim", "the paper", "measured"), rows))
    stdout().print(f"figures: {folder}", soft_wrap=True, highlight=False, markup=False)

"""`fastslam datasets`: the public logs that are known, and fetching them."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from .console import make_table, stdout

app = typer.Typer()


@app.command("list", short_help="List formats and public logs.")
def list_datasets() -> None:
    """List the formats that can be read and the public logs that are known."""
    from ..datasets.download import catalogue
    from ..datasets.registry import FORMATS

    console = stdout()
    formats = [(entry.name, entry.description) for entry in FORMATS.values()]
    console.print(make_table("formats", ("format", "what it is"), formats))
    logs = [
        (entry.name, "download" if entry.files else "by hand", entry.home) for entry in catalogue().values()
    ]
    console.print(make_table("public logs", ("log", "how to get it", "home"), logs))


@app.command("download", short_help="Fetch a public log and check it.")
def download_dataset(
    name: Annotated[str, typer.Argument(help="Name of the log, as listed.", metavar="NAME")],
    out: Annotated[Path, typer.Option(help="Folder that the log's folder goes into.")] = Path("data"),
    base_url: Annotated[str | None, typer.Option(help="Mirror to fetch from.", metavar="URL")] = None,
) -> None:
    """Fetch a public log, check it against its checksums and say where it lies.

    \b
    Examples:
      fastslam datasets download lost_in_the_woods
      fastslam run data/lost_in_the_woods
    """
    from ..datasets.download import download

    typer.echo(download(name, out, base_url=base_url))

"""`--watch`: a page on this machine that draws a filter at work."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING, Annotated, Literal, TypeAlias

import typer

from .console import stderr

if TYPE_CHECKING:
    from ..config import Config
    from ..watching import Watcher

DEFAULT_PORT = 8080
FIRST_PAGE_S = 30.0
"""How long somebody at a terminal has to open the page of a run that is over."""

Watching: TypeAlias = Annotated[
    bool, typer.Option("--watch", help="Serve a page that draws it, for browsers of this machine.")
]
WatchPort: TypeAlias = Annotated[
    int, typer.Option("--watch-port", metavar="PORT", help="Port of that page; 0 takes any that is free.")
]


@contextmanager
def watched(
    name: str, config: Config, *, port: int | None, kind: Literal["run", "live"]
) -> Iterator[Watcher | None]:
    """Serves the page while the context lasts; nothing without a port.

    A page that is open keeps what it has drawn. Where nobody at a terminal has opened that of a run when the
    run is over, there is half a minute for it.
    """
    if port is None:
        yield None
        return
    from ..watch_server import served
    from ..watching import Watcher

    watcher = Watcher(name, config, kind=kind)
    console = stderr()
    with served(watcher, port=port) as address:
        console.print(f"watch: {address}", highlight=False, markup=False, soft_wrap=True)
        yield watcher
        if kind == "run" and console.is_terminal and not watcher.was_watched:
            console.print(f"{address} can still be opened for {FIRST_PAGE_S:.0f} s", highlight=False)
            with suppress(KeyboardInterrupt):
                watcher.wait_for_page(FIRST_PAGE_S)

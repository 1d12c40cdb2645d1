"""The command that opens the map as a page."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from . import terminal
from .library_commands import MovedLibraryOption
from .model_commands import DEFAULT_MODEL, ModelOption


def register(app: typer.Typer) -> None:
    """Add the commands of this module."""
    app.command(
        "explore",
        short_help="Explore the map in a page: drag a point and look.",
        epilog="Example: manifold explore --html map.html",
    )(explore)


def explore(
    html: Annotated[
        Path,
        typer.Option("--html", help="Write the page as one file that needs no network.", metavar="FILE"),
    ] = Path("map.html"),
    model: ModelOption = DEFAULT_MODEL,
    library: MovedLibraryOption = None,
) -> None:
    """Make a page of the map: drag a point, and see the ball, slices, reflectance and neighbours of the prediction."""
    from manifold.workflows import explore

    results = terminal.Results()
    with terminal.progress("Tabulating") as step:
        size = explore.write_page(model, html, library=library, on_progress=step)
    results.rows(f"Written {html}", {"size": terminal.megabytes(size)})

"""The command of the interactive map."""

from __future__ import annotations

import sys
import webbrowser
from pathlib import Path
from typing import Annotated

import typer

from manifold import progress

from . import options, terminal
from .application import app
from .outputs import written


@app.command(
    "explore",
    short_help="Explore the map in a web page or notebook.",
    epilog="Example: manifold explore, or manifold explore --html map.html",
)
def explore(
    output: Annotated[
        Path | None,
        written("--html", help="Write the page as one file that needs no network, and stop.", metavar="FILE"),
    ] = None,
    model: options.ModelOption = options.DEFAULT_MODEL,
    library: options.MovedLibraryOption = None,
    folder: Annotated[
        Path, typer.Option(help="Folder for the files that the page writes.", metavar="FOLDER")
    ] = Path(),
    port: Annotated[
        int, typer.Option(help="Port of the server; 0 selects a free one.", metavar="N", min=0, max=65535)
    ] = 0,
    browser: Annotated[
        bool, typer.Option("--browser/--no-browser", help="Open the page in the browser.")
    ] = True,
) -> None:
    """Explore the map in a web page: drag a point to see the ball, slices, reflectance and nearest materials.

    The page is served on the loopback interface only, until Ctrl-C; it can also write .bsdf files, render, fit,
    export, locate files and complete readings. For the notebook widget, see docs/how-to/explore.md.
    """
    from manifold.page import explore

    results = terminal.Results()
    with progress.shown("Tabulating"):
        if output is not None:
            size = explore.write_page(model, output, library=library)
            results.rows(f"Written {output}", {"size": terminal.megabytes(size)})
            return
        served = explore.server(model, library=library, folder=folder, port=port)

    def ready(address: str) -> None:
        results.text(f"{address}\n")
        sys.stdout.flush()
        if browser:
            webbrowser.open(address)

    explore.serve_until_interrupted(served, ready)

"""Implements `manifold explore`: writes the page as one file, or serves it on the loopback interface."""

from __future__ import annotations

import signal
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from manifold.core import disk, shipped
from manifold.core.errors import MissingFileError
from manifold.core.extras import require
from manifold.library.identity import require_outside_libraries
from manifold.model.blend_space import require_blends
from manifold.model.manifold import Manifold
from manifold.page.commands import Context
from manifold.page.page import make_page
from manifold.page.page_data import tabulate, to_document
from manifold.page.server import ExplorerServer
from manifold.registries import TARGETS
from manifold.surface.written import read_surface


def write_page(
    model: Path,
    output: Path,
    *,
    library: Path | None = None,
    surfaces: Sequence[Path] = (),
) -> int:
    """Write the page of a map of blends as one HTML file that needs no network; return its size in bytes.

    `library` is the path of the model's library, if it was moved; `surfaces` are folders that `manifold surface`
    wrote, or their JSON files.
    """
    disk.require_writable(output)
    page = make_page(_document(_load(model, library), surfaces))
    disk.write_text(output, page)
    return len(page.encode())


def server(
    model: Path,
    *,
    library: Path | None = None,
    folder: Path = Path(),
    port: int = 0,
    surfaces: Sequence[Path] = (),
) -> ExplorerServer:
    """Return a server of the page that listens on the loopback interface; `serve_until_interrupted` runs it.

    Commands of the page write into `folder`; port 0 selects a free port; `library` and `surfaces` are as in
    `write_page`.
    """
    if not folder.is_dir():
        raise MissingFileError(f"{folder}: no such folder; make it, or name another")
    require("jsonschema")  # requests are checked with it
    require_outside_libraries(folder, into=True)
    loaded = _load(model, library)
    context = Context(
        folder.resolve(), shipped.resolved(model), loaded.library.path, loaded.names, loaded.X.shape[1],
        loaded.bands.is_rgb,
    )  # fmt: skip
    targets = [[target.name, target.title] for target in TARGETS.values()]
    page = make_page(_document(loaded, surfaces) | {"served": {"targets": targets}})
    return ExplorerServer(page, context, port)


def serve_until_interrupted(served: ExplorerServer, on_ready: Callable[[str], Any]) -> None:
    """Answer requests until Ctrl-C, SIGTERM or SIGHUP, then cancel the commands that run or wait.

    `on_ready` is called with the address of the page.
    """
    _handle_signals(signal.default_int_handler)
    try:
        on_ready(served.address)
        served.serve_forever()
    except KeyboardInterrupt:
        pass
    finally:
        _handle_signals(signal.SIG_IGN)  # closing takes less than a second, and removes files
        served.server_close()
        _handle_signals(signal.default_int_handler)


def _handle_signals(handler: Any) -> None:
    """Handle Ctrl-C, SIGTERM and SIGHUP in the same way."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, handler)


def _load(model: Path, library: Path | None) -> Manifold:
    loaded = Manifold.load(model, library)
    require_blends(loaded.space)
    return loaded


def _document(model: Manifold, surfaces: Sequence[Path]) -> dict[str, Any]:
    read = [read_surface(path) for path in surfaces]  # before what takes longer
    return to_document(model, tabulate(model), read)

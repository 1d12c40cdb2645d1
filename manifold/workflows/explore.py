"""The work behind `manifold explore`: the page of a map, as one file."""

from __future__ import annotations

from pathlib import Path

from manifold import atomic
from manifold.explorer.page import make_page
from manifold.explorer.tables import require_blends, tabulate, to_document
from manifold.model.manifold import Manifold
from manifold.records import Progress


def write_page(
    model: Path, output: Path, *, library: Path | None = None, on_progress: Progress | None = None
) -> int:
    """Write the page of a map of blends as one HTML file that asks for nothing; its size in bytes.

    Args:
        model: path of a model.
        output: the file.
        library: where the model's library is now, if not where the model remembers it.
        on_progress: called with (done, total, what) while materials are read.
    Raises:
        UsageError: the map is no map of blends, or the file cannot be written.
        ModelError, LibraryError: the model or its library cannot be read.
    """
    atomic.require_writable(output)
    loaded = Manifold.load(model, library)
    require_blends(loaded)
    page = make_page(to_document(loaded, tabulate(loaded, on_progress)))
    atomic.write_text(output, page)
    return len(page.encode())

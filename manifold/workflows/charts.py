"""Charts of libraries: paths in, a chart out."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from manifold.experiments.chart.experiment import Chart, make_chart
from manifold.library.store import Library
from manifold.model.manifold import Manifold
from manifold.records import Progress


def chart(
    library: Path | None = None,
    model: Path | None = None,
    only: Sequence[str] = (),
    on_progress: Progress | None = None,
) -> Chart:
    """Measure settings on the materials of a library.

    Args:
        library: the library; of a model, where its library is now.
        model: a fitted model, in whose library and materials the chart is made.
        only: keys of settings; all by default.
        on_progress: called with (done, total, title).
    Raises:
        UsageError, LibraryError: as `make_chart`, `Manifold.load` and `Library.open`.
    """
    if model is not None:
        loaded = Manifold.load(model, library)
        opened, names = loaded.library, loaded.names
    else:
        opened = Library.open(Path("library.zarr") if library is None else library)
        names = opened.names
    return make_chart([opened.read(name) for name in names], only, on_progress)

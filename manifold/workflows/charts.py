"""Charts of libraries: paths in, a chart out."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from manifold.experiments.chart.experiment import Chart, make_chart
from manifold.experiments.readings.curve import Curve, measure_curves
from manifold.library.store import Library
from manifold.model.completion.samples import LibrarySamples
from manifold.model.manifold import Manifold
from manifold.records import Progress


def chart(
    library: Path | None = None,
    model: Path | None = None,
    only: Sequence[str] = (),
    on_progress: Progress | None = None,
    neural: str | None = None,
    on_result: Callable[[Chart], None] | None = None,
) -> Chart:
    """Measure settings on the materials of a library; an interrupted run is continued.

    Args:
        library: the library; of a model, where its library is now.
        model: a fitted model, in whose library and materials the chart is made.
        only: keys of settings; all by default.
        on_progress: called with (done, total, title).
        neural: file, zip file or folder of published neural fits, to show beside.
        on_result: called with the chart, to write it: a run that is interrupted until then is continued, too.
    Raises:
        UsageError, LibraryError: as `make_chart`, `Manifold.load` and `Library.open`.
    """
    if model is not None:
        loaded = Manifold.load(model, library)
        opened, names = loaded.library, loaded.names
    else:
        opened = Library.open(Path("library.zarr") if library is None else library)
        names = opened.names
    files = [opened.read(name) for name in names]
    return make_chart(files, only, on_progress, neural=neural, library=opened, on_result=on_result)


def readings_chart(
    library: Path | None = None,
    only: Sequence[str] = (),
    on_progress: Progress | None = None,
    on_result: Callable[[list[Curve]], None] | None = None,
) -> list[Curve]:
    """Errors of left-out materials of a library, completed from n readings; an interrupted run is continued.

    Args:
        library: `library.zarr` by default.
        only: keys of methods; all by default.
        on_progress: called with (done, total, name).
        on_result: called with the curves, to write them: a run that is interrupted until then is continued, too.
    Raises:
        UsageError, LibraryError: as `measure_curves` and `Library.open`.
    """
    opened = Library.open(Path("library.zarr") if library is None else library)
    samples = LibrarySamples.of_library(opened)
    return measure_curves(samples, only=only, on_progress=on_progress, library=opened, on_result=on_result)

"""The work behind `manifold embed` and `manifold report`.

Reports, figures and choices are imported where they are used: with scikit-learn and matplotlib they take two seconds.
"""

from __future__ import annotations

from collections.abc import Collection
from concurrent.futures import Executor
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from manifold import disk, progress, work
from manifold.brdf.measured import MeasuredBRDF
from manifold.brdf.unmeasured import fill_unmeasured
from manifold.errors import ManifoldError, UsageError
from manifold.library.store import Library
from manifold.model.manifold import Manifold
from manifold.model.materials import names_without
from manifold.model.settings import Settings
from manifold.names import counted

if TYPE_CHECKING:
    from manifold.evaluate.report import Report
    from manifold.evaluate.selection import Candidate


def embed(
    library: Path,
    model: Path,
    settings: Settings,
    *,
    without: Collection[str] = (),
    auto_mapping: bool = False,
    auto_latent_dim: bool = False,
    workers: Executor | None = None,
) -> tuple[Manifold, list[Candidate]]:
    """Fit a manifold to a library, `without` some of its materials, and save it; `auto` as in `selection.choose`.

    The whole is one task, whose progress workers do not tell.

    Returns:
        The manifold, and the settings that were tried, where any was to be chosen.
    Raises:
        ManifoldError: it failed where it ran, or the worker was lost.
    """
    if workers is not None:
        task = partial(
            _embed_there, library, settings=settings, without=tuple(without), auto_mapping=auto_mapping,
            auto_latent_dim=auto_latent_dim,
        )  # fmt: skip
        with progress.shown("Embedding"):
            ((_, tried, failure),) = work.run(task, [model], workers)
        if tried is None:
            raise ManifoldError(failure)
        return Manifold.load(model, library), tried
    disk.require_writable(model)
    opened = Library(library)
    names = names_without(opened, without)
    candidates: list[Candidate] = []
    if auto_mapping or auto_latent_dim:
        from manifold.evaluate import selection

        with progress.shown("Reading materials"):
            read = progress.each(names, str)
            materials = [MeasuredBRDF(fill_unmeasured(opened.read(name))) for name in read]
        with progress.shown("Leaving materials out"):
            settings, candidates = selection.choose(
                materials, settings, mapping=auto_mapping, latent_dim=auto_latent_dim
            )
    with progress.shown("Embedding"):
        fitted = Manifold.fit(opened, settings, names=names)
    fitted.save(model)
    return fitted, candidates


def _embed_there(library: Path, model: Path, **how: Any) -> list[Candidate]:
    return embed(library, model, **how)[1]


def report(
    model: Path,
    *,
    library: Path | None = None,
    grid: str = "default",
    compare: bool = False,
    all_bands: bool = False,
    principled: bool = False,
    picture: Path | None = None,
    workers: Executor | None = None,
) -> Report:
    """Evaluate a model and other methods, see `make_report`; with `picture`, also draw the map of its latents."""
    from manifold.evaluate.report import make_report
    from manifold.plots import figures, map_figure

    if picture is not None:
        figures.require_writable(picture)
    loaded = Manifold.load(model, library)
    if len(loaded.names) < 3:
        found = counted(len(loaded.names), "material")
        raise UsageError(f"{model}: found {found}, expected at least 3 to leave one out; import more")
    if picture is not None:  # first: an interruption then costs little
        figures.save(map_figure.latent_map(loaded), picture)
    return make_report(
        loaded,
        grid,
        compare=compare,
        all_bands=all_bands,
        principled=principled,
        workers=workers,
        file=model,
    )

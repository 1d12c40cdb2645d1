"""Embedding of a library, with mapping and number of dimensions chosen by held-out error where they are not given.

The materials are dealt into folds. Every candidate is fitted without a fold, embeds its materials from their data,
and is judged by what it decodes; up to twenty materials every fold holds one, which is leave-one-out.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from manifold.brdf.measured import MeasuredBRDF
from manifold.brdf.unmeasured_cells import fill_unmeasured
from manifold.core import disk, progress, work
from manifold.core.errors import ManifoldError, UsageError
from manifold.core.names import counted
from manifold.core.pairs import RusinkiewiczGrid
from manifold.core.records import evenly_spaced
from manifold.evaluate.cross_validation import cross_validate, leave_out, wall_clock
from manifold.evaluate.errors import MethodErrors, measure_errors
from manifold.evaluate.latent_models import fit_settings
from manifold.evaluate.method_data import Data
from manifold.library.store import Library
from manifold.model.manifold import Manifold
from manifold.model.materials import MaterialTable, names_without
from manifold.model.settings import Settings
from manifold.registries import MAPPINGS

GRID = RusinkiewiczGrid(24, 12, 8)  # a fifth of the pairs of the default grid
MAX_BANDS = 12  # evenly spaced, besides those that are samples
MAX_DIMENSIONS = 6
PAYS = 0.05  # an added dimension has to take this share off the error
LEAVE_ONE_OUT_UP_TO = 20  # materials; more are dealt into FOLDS
FOLDS = 5
_TOLERANCE = 1e-4  # tolerance of fits: finer ones move no error by more than it varies between folds


@dataclass(frozen=True, kw_only=True)
class Candidate(MethodErrors):
    """One setting and its held-out errors.

    Attributes: those of `MethodErrors`, and
        mapping, latent_dim: the setting.
        error: geometric mean over materials of the linear error, which the choice is made by.
        seconds: of fitting and encoding all folds.
        is_chosen: whether it won.
    """

    mapping: str
    latent_dim: int
    error: float
    seconds: float
    is_chosen: bool = False


def choose(
    materials: Sequence[MeasuredBRDF],
    settings: Settings,
    *,
    mapping: bool,
    latent_dim: bool,
) -> tuple[Settings, list[Candidate]]:
    """Choose a mapping at the settings' number of dimensions, then the number of dimensions under that mapping.

    There must be at least four materials of the same bands. Return the chosen settings, and all candidates
    that were tried, in order.
    """
    if len(materials) < 4:
        raise UsageError(
            f"found {counted(len(materials), 'material')}, expected at least 4 to choose by held-out error; "
            "choose mapping and dimensions yourself, or import more"
        )
    trials = _Trials(materials, settings)
    most = min(MAX_DIMENSIONS, len(materials) - 2)
    tried: dict[tuple[str, int], Candidate] = {}
    mappings = list(MAPPINGS) if mapping and settings.kind != "blend" else [settings.mapping]
    total = len(mappings) * mapping + most * latent_dim

    def attempt(name: str, count: int) -> Candidate:
        if (name, count) not in tried:
            with progress.listen(None):
                tried[name, count] = trials.run(name, count)
            progress.report(len(tried), max(total, len(tried)), tried[name, count].title)
        return tried[name, count]

    start = min(settings.latent_dim, most)
    best = min((attempt(name, start) for name in mappings), key=lambda c: c.error)
    if latent_dim:
        best = attempt(best.mapping, 1)
        for count in range(2, most + 1):
            more = attempt(best.mapping, count)
            if more.error < (1.0 - PAYS) * best.error:
                best = more
            elif count > best.latent_dim + 1:
                break  # two in a row that did not pay
    chosen = replace(settings, mapping=best.mapping, latent_dim=best.latent_dim)
    return chosen, [replace(c, is_chosen=c is best) for c in tried.values()]


class _Trials:
    """Values of all materials, and their held-out errors under any setting."""

    def __init__(self, materials: Sequence[MeasuredBRDF], settings: Settings) -> None:
        n_bands, N = materials[0].bands.count, len(materials)
        bands = np.union1d(evenly_spaced(n_bands, MAX_BANDS), evenly_spaced(n_bands, settings.sample_bands))
        self._settings = settings
        self._data = Data.evaluate(materials, GRID, bands, stride=1)
        self._table = MaterialTable(materials, bands)
        self._splits = leave_out(N, N if N <= LEAVE_ONE_OUT_UP_TO else FOLDS)

    def run(self, name: str, latent_dim: int) -> Candidate:
        """Return the held-out errors of one setting."""
        fit = fit_settings(replace(self._settings, mapping=name, latent_dim=latent_dim), tolerance=_TOLERANCE)
        encoded, seconds = wall_clock(lambda: cross_validate(self._data, fit, self._splits))
        found = encoded.combinations
        (errors,) = measure_errors([found], self._data.bands, [self._data])
        of_each = self._table.looks(found) | errors.of_values()
        mean = float(np.exp(np.mean(np.log(np.maximum(of_each.linear, 1e-12)))))
        return Candidate(
            key=f"{name}_{latent_dim}", title=f"{name}, {latent_dim} dimensions", errors=of_each, mapping=name,
            latent_dim=latent_dim, error=mean, seconds=seconds,
        )  # fmt: skip


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
    """Fit a manifold to a library, `without` some of its materials, and save it; `auto` as in `choose`.

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
        with progress.shown("Reading materials"):
            read = progress.each(names, str)
            materials = [MeasuredBRDF(fill_unmeasured(opened.read(name))) for name in read]
        with progress.shown("Leaving materials out"):
            settings, candidates = choose(
                materials, settings, mapping=auto_mapping, latent_dim=auto_latent_dim
            )
    with progress.shown("Embedding"):
        fitted = Manifold.fit(opened, settings, names=names)
    fitted.save(model)
    return fitted, candidates


def _embed_there(library: Path, model: Path, **how: Any) -> list[Candidate]:
    return embed(library, model, **how)[1]

"""Refits of a report without each material, shared among workers."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from concurrent.futures import Executor
from functools import lru_cache, partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from manifold import progress, work
from manifold.brdf.measured import MeasuredBRDF
from manifold.errors import ManifoldError
from manifold.evaluate.cross_validation import Encoded, Method, cross_validate, leave_out
from manifold.evaluate.latent_models import SAMPLE_BANDS
from manifold.evaluate.methods import standard_methods
from manifold.evaluate.model_methods import model_methods
from manifold.evaluate.tabulated import MAX_BANDS, Data
from manifold.gpr import IsolatedLatentsWarning
from manifold.model.manifold import Manifold
from manifold.pairs import RusinkiewiczGrid
from manifold.records import evenly_spaced

_PARTS = 8  # tasks of a method


class _Refits(NamedTuple):
    """The key of a method, and the first and last of the materials that are left out, one after the other."""

    method: str
    first: int
    last: int


def tabulate(model: Manifold, materials: Sequence[MeasuredBRDF]) -> Data:
    """The data of all methods, in about 20 bands, among them the samples of blends."""
    count = model.bands.count
    bands = np.union1d(evenly_spaced(count, MAX_BANDS), evenly_spaced(count, SAMPLE_BANDS))
    return Data.evaluate(materials, RusinkiewiczGrid.named("default"), bands)


def refit_there(
    workers: Executor, methods: Sequence[Method], n_materials: int, model: Path, library: Path | None,
) -> dict[str, Encoded]:  # fmt: skip
    """Predictions of every material by methods that are fitted without it, by their keys.

    Args:
        workers: see `work.run`; they read the materials, and fit.
        methods: those of a model and standard ones.
        n_materials: of the model.
        model: its file.
        library: if it was moved.
    """
    size = -(-n_materials // _PARTS)
    starts = range(0, n_materials, size)
    tasks = [_Refits(method.key, first, first + size) for method in methods for first in starts]
    parts: dict[_Refits, Encoded] = {}
    for k, encoded, failure in work.run(partial(_refit, model=model, library=library), tasks, workers):
        if encoded is None:
            raise ManifoldError(failure)
        parts[tasks[k]] = encoded
        progress.report(len(parts), len(tasks), tasks[k].method)
    of_method = {m.key: [parts[task] for task in tasks if task.method == m.key] for m in methods}
    return {key: _joined(encoded) for key, encoded in of_method.items()}


def _refit(task: _Refits, *, model: Path, library: Path | None) -> Encoded:
    data, methods = _refitting(model, library)
    splits = leave_out(data.n_materials)[task.first : task.last]
    with warnings.catch_warnings():  # of fits to compare with, whose maps nobody uses
        warnings.simplefilter("ignore", IsolatedLatentsWarning)
        return cross_validate(data, methods[task.method].fit, splits)


@lru_cache(maxsize=1)
def _refitting(model: Path, library: Path | None) -> tuple[Data, dict[str, Method]]:
    loaded = Manifold.load(model, library)
    methods = {method.key: method for method in [*standard_methods(), *model_methods(loaded)]}
    return tabulate(loaded, loaded.materials.with_negative_values()), methods


def _joined(parts: Sequence[Encoded]) -> Encoded:
    return Encoded(
        tuple(c for part in parts for c in part.combinations),
        tuple(t for part in parts for t in part.fit_times),
        tuple(t for part in parts for t in part.encode_times),
    )

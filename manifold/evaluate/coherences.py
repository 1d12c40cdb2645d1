"""Compares the coherence of a model's map with that of the published GPLVM and of principal components."""

from __future__ import annotations

import warnings
from collections.abc import Callable

from manifold.core.records import Array
from manifold.evaluate.baselines import principal_components
from manifold.evaluate.latent_models import AFTER_PUBLISHED, fit_map
from manifold.evaluate.method_data import Data
from manifold.gpr import IsolatedLatentsWarning
from manifold.model.coherence import Coherence, Pair, measure_coherence
from manifold.model.combination import Combination
from manifold.model.expected_error import coherence_of
from manifold.model.manifold import Manifold
from manifold.model.materials import MaterialTable

THIS_MODEL = "this model"
"""Title of the model that a report evaluates."""

_PCA_MAPPING = "cube-root"


def coherences(
    model: Manifold, data: Data, table: MaterialTable, *, is_published_shown: bool = True
) -> tuple[dict[str, Coherence], list[Pair]]:
    """Return the coherence of a model and of other maps of its materials, by title, and the model's pairs.

    The map of principal components has the model's number of dimensions, the published GPLVM two. Maps without
    detours are left out.
    """
    of_model, pairs = coherence_of(model.space, table, model.mapping)
    found = {THIS_MODEL: of_model}
    if is_published_shown:
        with warnings.catch_warnings():  # a fit to compare with: nobody uses its map
            warnings.simplefilter("ignore", IsolatedLatentsWarning)
            found["GPLVM after Hikichi & Iwasaki"] = measure_map(*fit_map(AFTER_PUBLISHED, data), table)[0]
    count = min(model.settings.latent_dim, data.n_materials - 1)
    title = f"{count} principal components, cube root"
    found[title] = measure_map(*principal_components(_PCA_MAPPING, count, data), table)[0]
    return {title: measured for title, measured in found.items() if measured is not None}, pairs


def measure_map(
    X: Array, at: Callable[[Array], Combination], table: MaterialTable
) -> tuple[Coherence | None, list[Pair]]:
    """Return the coherence of a map with latents X (N, Q), and its pairs; `at` predicts at a latent (Q,)."""
    return measure_coherence(X, table.balls.__getitem__, lambda x: table.ball(at(x)))

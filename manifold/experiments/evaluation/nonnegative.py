"""Combinations of samples and analytic lobes with weights >= 0, as methods; see docs/explanation/reconstruction.md."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from manifold.experiments.evaluation.cross_validation import Encode, Fit
from manifold.experiments.evaluation.tabulated import Data
from manifold.latent.decoder import EncodingPairs
from manifold.mapping import Identity
from manifold.model.combination import Combination
from manifold.model.reconstruction import DICTIONARY, MAX_BANDS, ComparedValues
from manifold.records import Array, Indices

NUMBERS_PER_BAND = 26  # of a reconstruction: about 13 weights and which atoms they are of; none is fixed


def few_numbers(B: int) -> int:
    """What three atoms with a weight per band take: 12 for RGB."""
    return 3 * (min(B, MAX_BANDS) + 1)


def fit_nonnegative(sample_bands: int, numbers: Callable[[int], int] | None = None) -> Fit:
    """All samples and lobes: `manifold.model.reconstruction`.

    Args:
        sample_bands: bands per material that are samples.
        numbers: at most so many of B bands, see `few_atoms`; by default as many as it takes.
    """

    def fit(data: Data, training: Indices) -> Encode:
        bands = data.available_bands(sample_bands)

        def compare() -> tuple[ComparedValues, Array]:
            compared = ComparedValues(EncodingPairs(data.wi[:: data.stride], data.wo[:: data.stride]))
            return compared, compared.of_atoms([m.select_bands(bands.tolist()) for m in data.materials])

        compared, atoms = data.cached(("reconstruction", sample_bands), compare)
        n_samples = data.n_materials * len(bands)
        of_training = np.isin(np.arange(n_samples) // len(bands), training)
        most = None if numbers is None else numbers(data.n_bands)
        columns = np.append(
            np.tile(of_training, len(DICTIONARY.exponents)), np.ones(len(DICTIONARY.lobes), bool)
        )

        def encode(i: int) -> Combination:
            weights = np.zeros((data.n_bands, len(atoms)))
            weights[:, columns] = compared.weights(atoms[columns], data.materials[i], most)
            return Combination(Identity(), weights, bands, dictionary=DICTIONARY)

        return encode

    return fit

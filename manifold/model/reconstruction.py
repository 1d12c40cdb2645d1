"""Reconstruction of a new material by non-negative least squares over all samples and analytic lobes."""

from __future__ import annotations

import numpy as np

from manifold.brdf.measured import BRDF, all_isotropic
from manifold.errors import UsageError
from manifold.mapping import CubeRoot
from manifold.model.combination import Combination, Values
from manifold.model.materials import MaterialCache
from manifold.model.prediction import PredictedBRDF
from manifold.models.decoder import EncodingPairs
from manifold.models.dictionary import Dictionary
from manifold.models.picture_terms import picture_rows
from manifold.models.reconstruction_weights import reconstruction_weights
from manifold.records import Array


def reconstruct(materials: MaterialCache, sample_bands: Array, brdf: BRDF) -> PredictedBRDF:
    """Combine bands of all materials, and lobes, with weights that may only add: see `reconstruction_weights`.

    Args:
        materials: of the library.
        sample_bands: which of their bands are samples, increasing, shape (B_s,).
        brdf: the material, in the bands of the library.
    Raises:
        UsageError: it is black.
    """
    dictionary, mapping = Dictionary(), CubeRoot()
    sampled = materials.in_bands(sample_bands.tolist())
    pairs = EncodingPairs.default(all_isotropic([brdf, *sampled]))
    wi, wo = pairs.wi, pairs.wo
    values = Values(np.stack([material.eval(wi, wo) for material in sampled]), wi, wo)
    roots = values.mapped_samples(mapping, np.arange(len(sample_bands)))
    atoms = dictionary.atoms(roots, values.lobe_roots(dictionary.lobes))
    targets = np.ascontiguousarray(mapping.forward(brdf.eval(wi, wo)).T)
    weights = reconstruction_weights(atoms, targets, values.cosines, picture_rows(wi, wo))
    if not np.any(weights):
        raise UsageError(
            "the material to reconstruct is black: found no value above 0 at any direction pair, expected some light"
        )
    combination = Combination(mapping, weights, sample_bands, dictionary=dictionary)
    return PredictedBRDF(sampled, combination, brdf.bands)

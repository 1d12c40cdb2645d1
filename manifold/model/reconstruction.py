"""A material as a non-negative combination of samples and analytic lobes: of all, or of few."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

import numpy as np

from manifold.analytic.free_lobes import Lobes
from manifold.brdf.measured import BRDF, all_isotropic, values_at
from manifold.colour import panel
from manifold.encoding import encoding_pairs
from manifold.errors import UsageError
from manifold.mapping import Identity
from manifold.model.combination import Combination
from manifold.model.dictionary import Dictionary
from manifold.model.estimator import explain
from manifold.model.few_atoms import few_atoms
from manifold.model.materials import MaterialCache
from manifold.model.observation import LEAST, Observation
from manifold.model.prediction import PredictedBRDF
from manifold.pairs import Pairs
from manifold.records import Array, Indices, evenly_spaced

DICTIONARY = Dictionary((1.0, 2.0 / 3.0, 1.0 / 3.0), Lobes(soft_degree=4))
"""Atoms of reconstructions: roots of samples have the broader lobes that sums of values lack."""

MAX_BANDS = 20
"""In which weights of few atoms are found."""

_SAMPLES_AT_ONCE = 300  # materials among which weights are found together
_OF_VALUES = 0.25  # how much the squared error of values counts beside that of pixels


class ComparedValues:
    """What a reconstruction compares: values at direction pairs, and the pixels of the ball in the fitted lights.

    Attributes:
        pixel_weights: how much each pixel counts, so that all lights count the same, shape (K,); the K pixels are the
            last of the values.
    """

    def __init__(self, pairs: Pairs) -> None:
        """Compare BRDFs at direction pairs (P, 3)."""
        self._lights = panel.fitted()
        self._pairs, self._cosines = pairs + self._lights, pairs.cosines
        self.pixel_weights = self._lights.pixel_weights
        self._lobes = self._of_values(DICTIONARY.lobes.values(self._pairs.wi, self._pairs.wo))

    @classmethod
    @cache
    def default(cls, is_isotropic: bool) -> ComparedValues:
        """At the encoding pairs."""
        return cls(encoding_pairs(is_isotropic))

    def weights(self, atoms: Array, brdf: BRDF, numbers: int | None = None) -> Array:
        """Weights (B, n) of n atoms, the last of which are the lobes of `DICTIONARY`, for a BRDF of B bands.

        Args:
            atoms: rows of `of_atoms`.
            brdf: what they describe.
            numbers: at most so many, see `few_atoms`, of `MAX_BANDS` bands, between which weights are linear; by
                default as many weights as it takes.
        """
        material = self.of(brdf)
        if numbers is None:
            return explain(observations(atoms, material, self.pixel_weights))
        bands = evenly_spaced(len(material), MAX_BANDS)
        lambertian = len(atoms) - len(DICTIONARY.lobes)
        found = few_atoms(observations(atoms, material[bands], self.pixel_weights), numbers, lambertian)
        weights = np.zeros((len(material), len(atoms)))
        for k in np.flatnonzero(found.any(axis=0)):
            weights[:, k] = np.interp(np.arange(len(material)), bands, found[:, k])
        return weights

    def of(self, brdf: BRDF) -> Array:
        """Those of a BRDF of B bands, shape (B, R)."""
        return self._of_values(values_at(brdf, self._pairs).T)

    def of_atoms(self, materials: Sequence[BRDF]) -> Array:
        """Those of the atoms of `DICTIONARY`, of N materials in the sample bands (B_s,): shape (n', R)."""
        samples = [np.maximum(values_at(brdf, self._pairs).T, 0.0) for brdf in materials]
        powers = [self._of_values(f**exponent) for exponent in DICTIONARY.exponents for f in samples]
        return np.vstack([*powers, self._lobes])

    def _of_values(self, f: Array) -> Array:
        """From f in 1/sr, shape (n, P + P_ball)."""
        P = len(self._cosines)
        return np.hstack([f[:, :P] * self._cosines, self._lights.of(f[:, P:].T).T])


def observations(atoms: Array, material: Array, pixel_weights: Array) -> list[Observation]:
    """What is seen of a material (B, R), never negative, by functionals, the last of them pixels, of atoms (n, R).

    Errors of cube roots are relative, over all bands, among values and among pixels of weights (K,). Pixels brighter
    than display white do not count.
    """
    material = np.maximum(material, 0.0)
    n_values = material.shape[1] - len(pixel_weights)
    is_pixel = np.arange(material.shape[1]) >= n_values
    each = np.concatenate([np.ones(n_values), pixel_weights])
    counts = np.where(is_pixel & (material >= 1.0), 0.0, each * np.where(is_pixel, 1.0, _OF_VALUES))
    squares = np.sum((counts > 0.0) * each * material ** (2.0 / 3.0), axis=0)
    for rows in (is_pixel, ~is_pixel):
        counts[:, rows] /= max(float(squares[rows].sum()), LEAST)
    no_bound = np.zeros(material.shape[1], bool)
    return [Observation(atoms, *each, no_bound) for each in zip(material, counts, strict=True)]


def reconstruct(
    materials: MaterialCache,
    sample_bands: Indices,
    brdf: BRDF,
    numbers: int | None = None,
) -> PredictedBRDF:
    """Combine bands of materials, and lobes, with weights that may only add: see `estimator.explain`.

    Of more than 300 materials, weights are found among 300 after 300, each time beside those that had any before.

    Args:
        materials: of the library.
        sample_bands: which of their bands are samples, increasing, shape (B_s,).
        brdf: the material, in the bands of the library.
        numbers: that may describe it, see `ComparedValues.weights`; by default as many as it takes.
    """
    if numbers is not None and numbers < 1:
        raise UsageError(f"found {numbers} numbers to describe a material by, expected at least 1")
    sampled, N = list[BRDF](), len(materials.names)
    for first in range(0, N, _SAMPLES_AT_ONCE):
        new = materials.names[first : first + _SAMPLES_AT_ONCE]
        sampled += materials.in_bands(sample_bands.tolist(), new)
        compared, is_last = (
            ComparedValues.default(all_isotropic([brdf, *sampled])),
            first + _SAMPLES_AT_ONCE >= N,
        )
        weights = compared.weights(compared.of_atoms(sampled), brdf, numbers if is_last else None)
        if not is_last:
            of_samples = weights[:, : -len(DICTIONARY.lobes)].any(axis=0)
            has_any = of_samples.reshape(-1, len(sampled), len(sample_bands)).any(axis=(0, 2))
            sampled = [sampled[k] for k in np.flatnonzero(has_any)]
    if not np.any(weights):
        raise UsageError(
            "the material to reconstruct is black: found no value above 0 at any direction pair, expected some light"
        )
    combination = Combination(Identity(), weights, sample_bands, dictionary=DICTIONARY)
    return PredictedBRDF(sampled, combination, brdf.bands)

"""Evaluates predictions, which are weighted sums `T^-1(sum of weights * T(samples))`, on any direction pairs.

Every method of this package, baselines included, predicts in this form. A method finds its weights once; this module
applies them to measured values, block by block, on grids of any size.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from manifold.analytic.free_lobes import Lobes
from manifold.brdf.measured import MeasuredBRDF
from manifold.core.errors import ShapeError
from manifold.core.mapping import ValueMapping
from manifold.core.pairs import Pairs, cosine_weight
from manifold.core.records import Array, Indices


@dataclass(frozen=True, eq=False)
class Values:
    """Measured values f (N, P, B) in 1/sr of N materials at P direction pairs of unit vectors (P, 3), in B bands."""

    f: Array
    wi: Array
    wo: Array
    _mapped: dict[ValueMapping, Array] = field(default_factory=dict, repr=False, kw_only=True)
    _samples: dict[tuple[ValueMapping, tuple[int, ...]], Array] = field(
        default_factory=dict, repr=False, kw_only=True
    )
    _lobes: dict[tuple[ValueMapping, Lobes], Array] = field(default_factory=dict, repr=False, kw_only=True)

    @classmethod
    def at(cls, materials: Sequence[MeasuredBRDF], pairs: Pairs) -> Values:
        """Return the values of N materials of the same bands at direction pairs."""
        f = np.empty((len(materials), len(pairs), materials[0].bands.count))
        for k, material in enumerate(materials):
            f[k] = material.eval_at(pairs)
        return Values(f, pairs.wi, pairs.wo)

    @cached_property
    def cosines(self) -> Array:
        """Return cos(theta_i) cos(theta_o) of every direction pair, shape (P,)."""
        return cosine_weight(self.wi, self.wo)

    def mapped(self, mapping: ValueMapping) -> Array:
        """Return the mapped values T(f) of all materials, shape (N, P, B); the result is cached."""
        if mapping not in self._mapped:
            self._mapped[mapping] = mapping.forward(self.f, self.cosines[:, None])
        return self._mapped[mapping]

    @cached_property
    def roots(self) -> Array:
        """Return `(w f)^(1/3)` of all materials, shape (N, P, B), from which cube-root errors are computed."""
        return np.cbrt(self.cosines)[:, None] * np.cbrt(self.f)

    def mapped_samples(self, mapping: ValueMapping, bands: Indices) -> Array:
        """Return T(f) of single bands (B_s,), material by material, shape (N * B_s, P); the result is cached."""
        key = (mapping, tuple(int(b) for b in bands))
        if key not in self._samples:
            f = np.ascontiguousarray(np.moveaxis(self.f[..., list(key[1])], 2, 1))  # [N, B_s, P]
            self._samples[key] = mapping.forward(f.reshape(-1, f.shape[2]), self.cosines)
        return self._samples[key]

    def mapped_lobes(self, mapping: ValueMapping, lobes: Lobes) -> Array:
        """Return T(f) of analytic lobes, shape (n_l, P); the result is cached."""
        key = mapping, lobes
        if key not in self._lobes:
            self._lobes[key] = mapping.forward(lobes.values(self.wi, self.wo))
        return self._lobes[key]


@dataclass(frozen=True, eq=False)
class Combination:
    """One prediction in B bands, made of N measured materials.

    Attributes:
        mapping: the mapping T.
        weights: weights of the materials, the same in all bands, shape (N,); or weights of single bands (samples) for
            every predicted band, shape (B, N * B_s), where sample n * B_s + s is band `sample_bands[s]` of material
            n; or weights of the atoms that `dictionary` makes of these samples, shape (B, n').
        sample_bands: indices of the bands that are samples, shape (B_s,); None if whole materials are combined.
        is_clipped: whether negative values are cut to 0.
        variance: the method's own estimate of the variance of the mapped values, a number or one per band (B,); None
            if the method has no such estimate.
        dictionary: the dictionary of atoms; None if the samples themselves are combined.
    """

    mapping: ValueMapping
    weights: Array
    sample_bands: Indices | None = None
    is_clipped: bool = True
    variance: float | Array | None = None
    dictionary: Dictionary | None = None

    @property
    def source(self) -> int | None:
        """Return the index of the only material with a weight if this weight is 1, otherwise None."""
        if self.sample_bands is None and np.count_nonzero(self.weights) == 1:
            material = int(np.argmax(self.weights))
            return material if self.weights[material] == 1.0 else None
        return None

    @property
    def used(self) -> tuple[Indices, Combination]:
        """Return the indices (n,) of the materials with nonzero weight, and the prediction made of only these.

        It does not support predictions with a dictionary.
        """
        if self.sample_bands is None:
            used = np.flatnonzero(self.weights)
            return used, replace(self, weights=self.weights[used])
        of_materials = self.weights.reshape(len(self.weights), -1, len(self.sample_bands))
        used = np.flatnonzero(np.any(of_materials, axis=(0, 2)))
        return used, replace(self, weights=of_materials[:, used].reshape(len(self.weights), -1))

    def in_bands(self, bands: Indices) -> Combination:
        """Return the prediction in some of the bands (B',)."""
        if self.sample_bands is None:
            return self
        missing = np.setdiff1d(self.sample_bands, bands)
        if missing.size:
            raise ShapeError(
                f"bands {missing.tolist()} are needed by the prediction, but missing from the values"
            )
        variance = self.variance[bands] if isinstance(self.variance, np.ndarray) else self.variance
        position = np.searchsorted(bands, self.sample_bands)
        return replace(self, weights=self.weights[bands], sample_bands=position, variance=variance)

    def mapped(self, values: Values) -> Array:
        """Return the mapped prediction T(f), shape (P, B)."""
        if self.sample_bands is None:
            return np.tensordot(self.weights, values.mapped(self.mapping), axes=1)
        samples = values.mapped_samples(self.mapping, self.sample_bands)
        if self.dictionary is None:
            return (self.weights @ samples).T
        lobes = values.mapped_lobes(self.mapping, self.dictionary.lobes)
        return self.dictionary.combine(self.weights, samples, lobes).T

    def evaluate(self, values: Values) -> Array:
        """Return the prediction f in 1/sr, shape (P, B).

        A single material of weight 1 gives its measured values exactly.
        """
        (predicted,) = evaluate([self], values)
        return predicted


def evaluate(combinations: Sequence[Combination], values: Values, *, clip: bool = True) -> Array:
    """Return predictions f in 1/sr at the direction pairs of measured values, shape (M, P, B).

    Without `clip`, negative values are kept even if `is_clipped` is set.
    """
    predicted = np.empty((len(combinations), *values.f.shape[1:]))
    for group in _alike(combinations):
        first = combinations[group[0]]
        if first.sample_bands is None:
            mapped = values.mapped(first.mapping)
            weights = np.stack([combinations[m].weights for m in group])
            combined = (weights @ mapped.reshape(len(mapped), -1)).reshape(len(group), *mapped.shape[1:])
            predicted[group] = first.mapping.inverse(combined, values.cosines[:, None])
        else:
            for m in group:
                predicted[m] = first.mapping.inverse(combinations[m].mapped(values), values.cosines[:, None])
    for m, combination in enumerate(combinations):
        if combination.source is not None:
            predicted[m] = values.f[combination.source]
        elif clip and combination.is_clipped:
            np.maximum(predicted[m], 0.0, out=predicted[m])
    return predicted


def _alike(combinations: Sequence[Combination]) -> list[list[int]]:
    """Return groups of indices of combinations that one product evaluates; measured materials are in no group."""
    groups: dict[tuple[ValueMapping, bool], list[int]] = {}
    for m, combination in enumerate(combinations):
        if combination.source is None:
            key = (combination.mapping, combination.sample_bands is None)
            groups.setdefault(key, []).append(m)
    return list(groups.values())


@dataclass(frozen=True)
class Dictionary:
    """A set of atoms (basis functions) in a mapped domain: powers of the samples, then analytic lobes.

    Samples, with negative values set to 0, are raised to each exponent, which makes measured lobes broader or
    narrower.
    """

    exponents: tuple[float, ...] = (1.0,)
    lobes: Lobes = field(default_factory=Lobes)

    def size(self, n_samples: int) -> int:
        """Return the number of atoms for a number of samples."""
        return len(self.exponents) * n_samples + len(self.lobes)

    def combine(self, weights: Array, samples: Array, lobes: Array) -> Array:
        """Return the weighted sum of the atoms made of samples (n, P) and lobes (n_l, P), shape (B, P).

        `weights` is (B, n'); atoms without weights are not computed.
        """
        combined = weights[:, len(self.exponents) * len(samples) :] @ lobes
        for k, exponent in enumerate(self.exponents):
            part = weights[:, k * len(samples) : (k + 1) * len(samples)]
            used = np.flatnonzero(part.any(axis=0))
            if used.size:
                combined += part[:, used] @ np.maximum(samples[used], 0.0) ** exponent
        return combined

"""Predictions as weighted sums: `T^-1(sum of weights * T(samples))`, on any direction pairs.

Every method of this package, baselines included, predicts so. It finds its weights once; here they meet
measured values, block by block, on grids of any size.
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
        """cos(theta_i) cos(theta_o) per direction pair, shape (P,)."""
        return cosine_weight(self.wi, self.wo)

    def mapped(self, mapping: ValueMapping) -> Array:
        """Return t(f) of all materials, shape (N, P, B); cached."""
        if mapping not in self._mapped:
            self._mapped[mapping] = mapping.forward(self.f, self.cosines[:, None])
        return self._mapped[mapping]

    @cached_property
    def roots(self) -> Array:
        """`(w f)^(1/3)` of all materials, shape (N, P, B): where the cube-root error is measured."""
        return np.cbrt(self.cosines)[:, None] * np.cbrt(self.f)

    def mapped_samples(self, mapping: ValueMapping, bands: Indices) -> Array:
        """Return T(f) of bands (B_s,) as samples, material by material, shape (N * B_s, P); cached."""
        key = (mapping, tuple(int(b) for b in bands))
        if key not in self._samples:
            f = np.ascontiguousarray(np.moveaxis(self.f[..., list(key[1])], 2, 1))  # [N, B_s, P]
            self._samples[key] = mapping.forward(f.reshape(-1, f.shape[2]), self.cosines)
        return self._samples[key]

    def mapped_lobes(self, mapping: ValueMapping, lobes: Lobes) -> Array:
        """Return t(f) of analytic lobes, shape (n_l, P); cached."""
        key = mapping, lobes
        if key not in self._lobes:
            self._lobes[key] = mapping.forward(lobes.values(self.wi, self.wo))
        return self._lobes[key]


@dataclass(frozen=True, eq=False)
class Combination:
    """One prediction in B bands, made of N measured materials.

    Attributes:
        mapping: T.
        weights: of the materials, alike in all bands, shape (N,); or of single bands, band by band, shape
            (B, N * B_s), where sample n * B_s + s is band `sample_bands[s]` of material n; or of the atoms that a
            dictionary makes of these samples, (B, n').
        sample_bands: which bands are samples, shape (B_s,); None where whole materials are.
        is_clipped: whether negative values are cut to 0.
        variance: of the mapped values, as the method itself believes it: a number, or one per band (B,); None
            where the method has no such belief.
        dictionary: None where the samples are what is combined.
    """

    mapping: ValueMapping
    weights: Array
    sample_bands: Indices | None = None
    is_clipped: bool = True
    variance: float | Array | None = None
    dictionary: Dictionary | None = None

    @property
    def source(self) -> int | None:
        """Index of the only material with a weight, if that weight is 1; None otherwise."""
        if self.sample_bands is None and np.count_nonzero(self.weights) == 1:
            material = int(np.argmax(self.weights))
            return material if self.weights[material] == 1.0 else None
        return None

    @property
    def used(self) -> tuple[Indices, Combination]:
        """The materials with nonzero weight, (n,), and the prediction made of these only; not of a dictionary."""
        if self.sample_bands is None:
            used = np.flatnonzero(self.weights)
            return used, replace(self, weights=self.weights[used])
        of_materials = self.weights.reshape(len(self.weights), -1, len(self.sample_bands))
        used = np.flatnonzero(np.any(of_materials, axis=(0, 2)))
        return used, replace(self, weights=of_materials[:, used].reshape(len(self.weights), -1))

    def in_bands(self, bands: Indices) -> Combination:
        """Return the prediction in some bands (B',), for comparison with values in these bands."""
        if self.sample_bands is None:
            return self
        missing = np.setdiff1d(self.sample_bands, bands)
        if missing.size:
            raise ShapeError(
                f"bands {missing.tolist()} are needed by the prediction, and the values lack them"
            )
        variance = self.variance[bands] if isinstance(self.variance, np.ndarray) else self.variance
        position = np.searchsorted(bands, self.sample_bands)
        return replace(self, weights=self.weights[bands], sample_bands=position, variance=variance)

    def mapped(self, values: Values) -> Array:
        """Return T of the prediction, shape (P, B)."""
        if self.sample_bands is None:
            return np.tensordot(self.weights, values.mapped(self.mapping), axes=1)
        samples = values.mapped_samples(self.mapping, self.sample_bands)
        if self.dictionary is None:
            return (self.weights @ samples).T
        lobes = values.mapped_lobes(self.mapping, self.dictionary.lobes)
        return self.dictionary.combine(self.weights, samples, lobes).T

    def evaluate(self, values: Values) -> Array:
        """Return the prediction f in 1/sr, shape (P, B); at a unit vector the measured values, bit for bit."""
        (predicted,) = evaluate([self], values)
        return predicted


def evaluate(combinations: Sequence[Combination], values: Values, *, clip: bool = True) -> Array:
    """Return predictions f in 1/sr at the direction pairs of measured values, shape (M, P, B).

    Without `clip`, negative values are kept, whatever a combination says.
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
    """Atoms in a mapped domain: powers of the samples, then analytic lobes.

    Samples, cut at 0, are raised to every exponent in turn, which makes measured lobes broader or narrower.
    """

    exponents: tuple[float, ...] = (1.0,)
    lobes: Lobes = field(default_factory=Lobes)

    def size(self, n_samples: int) -> int:
        """Return the number of atoms that n samples make."""
        return len(self.exponents) * n_samples + len(self.lobes)

    def combine(self, weights: Array, samples: Array, lobes: Array) -> Array:
        """Return the sum of all atoms by their weights (B, n'), shape (B, P), of samples (n, P) and lobes (n_l, P).

        Atoms without weights are not computed.
        """
        combined = weights[:, len(self.exponents) * len(samples) :] @ lobes
        for k, exponent in enumerate(self.exponents):
            part = weights[:, k * len(samples) : (k + 1) * len(samples)]
            used = np.flatnonzero(part.any(axis=0))
            if used.size:
                combined += part[:, used] @ np.maximum(samples[used], 0.0) ** exponent
        return combined

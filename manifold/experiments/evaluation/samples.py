"""Samples of latent variable models: whole materials, or single bands of them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from manifold.experiments.evaluation.tabulated import Data
from manifold.mapping import Mapping
from manifold.model.combination import Combination
from manifold.models.criteria import OF_VALUES
from manifold.models.decoder import Decoder
from manifold.models.encoder import Encoder
from manifold.models.gp_weights import GPWeights
from manifold.records import Array


@dataclass(frozen=True, eq=False)
class Samples:
    """Mapped values of N materials, sample by sample.

    Attributes:
        data: the values.
        mapping: T.
        bands: which bands are samples of their own, shape (B_s,), counted among all; None where whole materials are
            samples.
    """

    data: Data
    mapping: Mapping
    bands: Array | None

    @property
    def group(self) -> int:
        """Samples per material."""
        return 1 if self.bands is None else len(self.bands)

    @property
    def n_outputs(self) -> int:
        """D: values per sample."""
        return self.data.n_outputs if self.bands is None else len(self.data.cosines)

    def rows(self, materials: Array) -> Array:
        """Indices of the samples of materials (n,), shape (n * group,)."""
        return (materials[:, None] * self.group + np.arange(self.group)).reshape(-1)

    @cached_property
    def gram(self) -> Array:
        """Inner products of all samples weighted by the cosines, shape (N * group, N * group)."""
        return self.data.gram(self.mapping, self.bands)

    def gram_of(self, materials: Array) -> Array:
        """Inner products of the samples of some materials."""
        rows = self.rows(materials)
        return self.gram[np.ix_(rows, rows)]

    def decoder(self, gp: GPWeights, materials: Array) -> Decoder:
        """The decoder of a process on the samples of some materials, at the pairs used to encode."""
        some = slice(None, None, self.data.stride)
        if self.bands is None:
            mapped = self.data.mapped(self.mapping)[materials, some].reshape(len(materials), -1)
            cosines = np.repeat(self.data.cosines[some], self.data.f.shape[2])
        else:
            mapped = np.ascontiguousarray(
                self.data.samples(self.mapping, self.bands)[self.rows(materials), some]
            )
            cosines = self.data.cosines[some]
        return Decoder(gp, mapped, self.mapping, cosines)

    def combination(
        self, materials: Array, weights: Array, variance: Array, *, is_clipped: bool
    ) -> Combination:
        """The prediction by weights of the samples of some materials, (1, n), or (B, n) where bands are samples.

        `variance` of the mapped values, one per row.
        """
        spread = np.zeros((len(weights), len(self.gram)))
        spread[:, self.rows(materials)] = weights
        if self.bands is None:
            return Combination(self.mapping, spread[0], None, is_clipped, float(variance[0]))
        return Combination(self.mapping, spread, self.bands, is_clipped, variance)


@dataclass(frozen=True, eq=False)
class LatentProcess:
    """A Gaussian process on latents of the samples of some materials, and what encodes any material in it.

    Attributes:
        gp: of the latents.
        n_structure: leading coordinates that all samples of a material share.
        samples: what the samples are.
        training: the materials, shape (n,).
        prior: weight of the Gaussian prior on latents, or one per axis.
        criterion: by which latents of a material are found; see `Encoder`.
        known_variance: output variance s^2 of the mapped values, where it is not that of the training materials.
    """

    gp: GPWeights
    n_structure: int
    samples: Samples
    training: Array
    prior: float | Array
    criterion: str = "decoded"
    known_variance: float | None = None

    def encode(self, i: int, *, is_clipped: bool = True) -> Combination:
        """The prediction of material i, its latents found from its data."""
        find = self._by_values if self.criterion in OF_VALUES else self._by_products
        return self.at(find(i), is_clipped=is_clipped)

    def at(self, latents: Array, weights: Array | None = None, *, is_clipped: bool = True) -> Combination:
        """The prediction at latents: (1, Q) of a whole material, (B, Q) of all bands.

        `weights` (1 or B, n) stand in for those of the process where they are given.
        """
        weights = self.gp.weights(latents) if weights is None else weights
        variance = self.output_variance * self.gp.variance(latents)
        return self.samples.combination(self.training, weights, variance, is_clipped=is_clipped)

    @cached_property
    def _gram(self) -> Array:
        return self.samples.gram_of(self.training)

    @cached_property
    def output_variance(self) -> float:
        """s^2 of the mapped values."""
        if self.known_variance is not None:
            return self.known_variance
        return self.gp.output_variance(self._gram, self.samples.n_outputs)

    @cached_property
    def _encoder(self) -> Encoder:
        Qs, samples, by = self.n_structure, self.samples, self.criterion
        if by in OF_VALUES:
            decoder = samples.decoder(self.gp, self.training)
            return Encoder.of_decoder(decoder, Qs, samples.group, self.prior, by)
        return Encoder(self.gp, self._gram, samples.n_outputs, Qs, samples.group, self.prior, by)

    def _by_values(self, i: int) -> Array:
        """Latents by decoded values: of sample bands together, then the colour of every band.

        Two and more colour coordinates are searched for in the data's bands, and the curve between these is linear.
        """
        data, bands, Qs = self.samples.data, self.samples.bands, self.n_structure
        if bands is None:
            return self._encoder.encode(data.f[i, :: data.stride].reshape(1, -1))
        values = np.ascontiguousarray(data.full_values(i).T)  # [B, P_s]
        latents = self._encoder.encode(values[bands])
        if len(bands) == data.n_bands:
            return latents
        structure = latents[0, :Qs]
        if self.gp.X.shape[1] - Qs == 1:
            colours = self._encoder.encode_colours(structure, values)
        else:
            colours = data.interpolated(self._encoder.encode_colours(structure, values[data.bands]))
        return np.hstack([np.tile(structure, (data.n_bands, 1)), colours])

    def _by_products(self, i: int) -> Array:
        """Latents by inner products: structure and the colours of the data's bands together, linear between these."""
        data, samples = self.samples.data, self.samples
        rows = samples.rows(self.training)
        if samples.bands is None:
            return self._encoder.encode_products(samples.gram[[i]][:, rows], samples.gram[[i], [i]])
        T = data.mapped(samples.mapping)[i].T  # [B', P]
        cross = (T * data.cosines) @ data.samples(samples.mapping, samples.bands)[rows].T
        return data.interpolated(self._encoder.encode_products(cross, (T * T) @ data.cosines))

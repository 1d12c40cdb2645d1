"""Latent variable models as held-out methods: fitted to some materials, they encode others."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np

from manifold.experiments.evaluation.cross_validation import Encode, Fit
from manifold.experiments.evaluation.tabulated import Data
from manifold.gplvm import GPLVM
from manifold.latent.criteria import OF_VALUES
from manifold.latent.decoder import Decoder
from manifold.latent.encoder import Encoder
from manifold.latent.gp_weights import GPWeights
from manifold.latent.per_band import MonochromeGPLVM
from manifold.mapping import CubeRoot, Mapping, mapping_named
from manifold.model.appearance import roots_at
from manifold.model.blend_fitting import BlendTables
from manifold.model.blend_space import PlaceSearch
from manifold.model.combination import Combination
from manifold.model.settings import Settings
from manifold.records import Array, Indices

SAMPLE_BANDS = Settings().sample_bands
_TOLERANCE = 1e-5  # of fits that are made once per left-out material


def fit_settings(s: Settings, criterion: str | None = None, tolerance: float = _TOLERANCE) -> Fit:
    """The model that a manifold of these settings has, of fewer dimensions where there are not enough materials.

    Args:
        s: of the model.
        criterion: by which materials are encoded; that of the settings if None.
        tolerance: of the fit, where its kind takes one.
    """
    return _FITS[s.kind](s, criterion or s.criterion, tolerance)


def fit_published(data: Data, training: Indices) -> Encode:
    """As Hikichi & Iwasaki: raw values, 2-D, mu = 1e-4, direct local search; the latent by mapped residual."""
    settings = Settings("material", 2, "identity", mu=1e-4, optimizer="dls")
    return _fit_gplvm(settings, "mapped", _TOLERANCE, is_clipped=False)(data, training)


def _fit_gplvm(s: Settings, criterion: str, tolerance: float, *, is_clipped: bool = True) -> Fit:
    def fit(data: Data, training: Indices) -> Encode:
        samples = Samples(data, mapping_named(s.mapping), None)
        Q = min(s.latent_dim, len(training) - 1)
        model = GPLVM(
            Q, mu=s.mu, length_scale=s.length_scale, kernel=s.kernel, prior=s.prior, optimizer=s.optimizer,
            tol=tolerance,
        ).fit_gram(samples.gram_of(training), samples.n_outputs)  # fmt: skip
        process = LatentProcess(model.gp_, Q, samples, training, s.prior, criterion)
        return partial(process.encode, is_clipped=is_clipped)

    return fit


def fit_monochrome(s: Settings, criterion: str, tolerance: float = _TOLERANCE, *, n_colour: int = 1) -> Fit:
    """The monochrome GPLVM; `n_colour` colour coordinates per band, else as `fit_settings`."""

    def fit(data: Data, training: Indices) -> Encode:
        samples = Samples(data, mapping_named(s.mapping), data.available_bands(s.sample_bands))
        Qs = min(s.latent_dim, len(training) - 1)
        model = MonochromeGPLVM(
            Qs, n_colour, mu=s.mu, length_scale=s.length_scale, kernel=s.kernel, prior=s.prior
        ).fit_gram(samples.gram_of(training), len(training), samples.n_outputs)  # fmt: skip
        return LatentProcess(model.gp_, Qs, samples, training, s.prior, criterion).encode

    return fit


def _fit_blend(s: Settings, criterion: str, tolerance: float) -> Fit:
    def fit(data: Data, training: Indices) -> Encode:
        bands = data.available_bands(s.sample_bands)
        every: BlendTables = data.cached(
            ("blend", s.sample_bands), lambda: BlendTables.of(data.materials, bands)
        )
        tables, rows = every.subset(training), every.samples.rows(training)
        space, _ = tables.fit(min(s.latent_dim, len(training) - 1), s.covariance())
        roots, pairs = tables.samples.roots, tables.samples.pairs
        search = PlaceSearch(space, roots, pairs.weight(roots))

        def encode(i: int) -> Combination:
            x, colours, _ = search.find(roots_at([data.materials[i]], pairs.pairs), bands)
            spread = np.zeros((data.n_bands, len(every.samples.roots)))
            spread[:, rows] = space.weights(x, colours)
            return Combination(CubeRoot(), spread, bands)

        return encode

    return fit


_FITS = {"blend": _fit_blend, "material": _fit_gplvm, "monochrome": fit_monochrome}


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
    bands: Indices | None

    @property
    def group(self) -> int:
        """Samples per material."""
        return 1 if self.bands is None else len(self.bands)

    @property
    def n_outputs(self) -> int:
        """D: values per sample."""
        return self.data.n_outputs if self.bands is None else len(self.data.cosines)

    def rows(self, materials: Indices) -> Indices:
        """Indices of the samples of materials (n,), shape (n * group,)."""
        return (materials[:, None] * self.group + np.arange(self.group)).reshape(-1)

    @cached_property
    def gram(self) -> Array:
        """Inner products of all samples weighted by the cosines, shape (N * group, N * group)."""
        return self.data.gram(self.mapping, self.bands)

    def gram_of(self, materials: Indices) -> Array:
        """Inner products of the samples of some materials."""
        rows = self.rows(materials)
        return self.gram[np.ix_(rows, rows)]

    def decoder(self, gp: GPWeights, materials: Indices) -> Decoder:
        """The decoder of a process on the samples of some materials, at the pairs used to encode."""
        some, data = slice(None, None, self.data.stride), self.data
        if self.bands is None:
            mapped = data.mapped(self.mapping)[materials, some].reshape(len(materials), -1)
            return Decoder(gp, mapped, self.mapping, np.repeat(data.cosines[some], data.f.shape[2]))
        mapped = np.ascontiguousarray(data.samples(self.mapping, self.bands)[self.rows(materials), some])
        return Decoder(gp, mapped, self.mapping, data.cosines[some])

    def combination(
        self, materials: Indices, weights: Array, variance: Array, *, is_clipped: bool
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
    training: Indices
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

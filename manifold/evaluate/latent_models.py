"""Latent variable models as held-out methods: fitted to some materials, they encode others."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from manifold.brdf.interface import all_isotropic
from manifold.core.mapping import CubeRoot, ValueMapping
from manifold.core.records import Array, Indices
from manifold.evaluate.cross_validation import Encode, Fit
from manifold.evaluate.method_data import Data
from manifold.gp.encoding import Decoder, Encoder
from manifold.gplvm import GPLVM
from manifold.gpr import GaussianProcess
from manifold.model.blend_fitting import BlendTables
from manifold.model.blend_space import PlaceSearch
from manifold.model.combination import Combination
from manifold.model.decoding import appearance_pairs, appearance_weight, roots_at
from manifold.model.settings import Settings
from manifold.registries import MAPPINGS

SAMPLE_BANDS = Settings().sample_bands
_TOLERANCE = 1e-5  # tolerance of fits that are made once per left-out material


def fit_settings(s: Settings, tolerance: float = _TOLERANCE) -> Fit:
    """Return the fit of a manifold with these settings, with fewer dimensions if there are too few materials.

    `tolerance` is that of the fit of a GPLVM.
    """
    return (
        _fit_blend(s)
        if s.kind == "blend"
        else lambda data, training: _process(s, data, training, tolerance).encode
    )


def fit_after_published(data: Data, training: Indices) -> Encode:
    """Fit a model after Hikichi & Iwasaki: raw values, 2-D, mu = 1e-4, direct local search.

    Directions are weighted by their cosines, and the output variance maximises the likelihood.

    They give no rule for the latent of a new material; cube roots, by which all models are searched, look best.
    """
    settings = Settings("gplvm", 2, "identity", mu=1e-4, optimizer="dls")
    return _process(settings, data, training).encode


def _process(s: Settings, data: Data, training: Indices, tolerance: float = _TOLERANCE) -> LatentProcess:
    mapping, power = MAPPINGS[s.mapping], 0.0 if s.as_published else 1.0
    model = GPLVM(
        min(s.latent_dim, len(training) - 1), mu=s.mu, length_scale=s.length_scale, kernel=s.kernel, prior=s.prior,
        optimizer=s.optimizer, tol=tolerance, output_variance=1.0 if s.as_published else None,
        farthest_first=not s.as_published,
    ).fit_gram(data.gram(mapping, power=power)[np.ix_(training, training)], data.n_outputs)  # fmt: skip
    return LatentProcess(
        model.gp_, data, mapping, training, s.prior, model.output_variance, is_clipped=not s.as_published
    )


def _fit_blend(s: Settings) -> Fit:
    def fit(data: Data, training: Indices) -> Encode:
        bands = data.available_bands(s.sample_bands)
        every: BlendTables = data.cached(
            ("blend", s.sample_bands), lambda: BlendTables.of(data.materials, bands)
        )
        tables, rows = every.subset(training), every.samples.rows(training)
        space, _ = tables.fit(min(s.latent_dim, len(training) - 1), s.covariance())
        roots, pairs = tables.samples.roots, appearance_pairs(all_isotropic(data.materials))
        search = PlaceSearch(space, roots, appearance_weight(roots))

        def encode(i: int) -> Combination:
            x, colours, _ = search.find(roots_at([data.materials[i]], pairs), bands)
            spread = np.zeros((data.n_bands, len(every.samples.roots)))
            spread[:, rows] = space.weights(x, colours)
            return Combination(CubeRoot(), spread, bands)

        return encode

    return fit


@dataclass(frozen=True, eq=False)
class LatentProcess:
    """A Gaussian process on latents of some materials, which encodes any material.

    Attributes:
        data: values of all N materials.
        mapping: T.
        training: the materials of the process, shape (n,).
        prior: weight of the Gaussian prior on latents.
        known_variance: output variance s^2 of the mapped values, where it is not that of the training materials.
        is_clipped: whether negative values of predictions of `encode` are cut to 0.
    """

    gp: GaussianProcess
    data: Data
    mapping: ValueMapping
    training: Indices
    prior: float
    known_variance: float | None = None
    is_clipped: bool = True

    def encode(self, i: int) -> Combination:
        """Predict material i at the latent whose decoded values are nearest to its own, in cube roots."""
        return self.at(
            self._encoder.by_values(self._decoder, self.data.f[i, :: self.data.stride].reshape(-1))
        )

    def at(self, latent: Array, weights: Array | None = None) -> Combination:
        """Predict at a latent (Q,); given weights (n,) replace those of the process."""
        weights = self.gp.weights(latent[None])[0] if weights is None else weights
        spread = np.zeros(self.data.n_materials)
        spread[self.training] = weights
        variance = self.output_variance * float(self.gp.variance(latent[None])[0])
        return Combination(self.mapping, spread, None, self.is_clipped, variance)

    @cached_property
    def _gram(self) -> Array:
        """Inner products of the training materials, weighted by the cosines, shape (n, n)."""
        return self.data.gram(self.mapping)[np.ix_(self.training, self.training)]

    @cached_property
    def output_variance(self) -> float:
        """s^2 of the mapped values."""
        if self.known_variance is not None:
            return self.known_variance
        return self.gp.output_variance(self._gram, self.data.n_outputs)

    @cached_property
    def _decoder(self) -> Decoder:
        """Return the decoder at the direction pairs used to encode."""
        some, data = slice(None, None, self.data.stride), self.data
        mapped = data.mapped(self.mapping)[self.training, some].reshape(len(self.training), -1)
        return Decoder(self.gp, mapped, self.mapping, np.repeat(data.cosines[some], data.f.shape[2]))

    @cached_property
    def _encoder(self) -> Encoder:
        return Encoder.of_decoder(self._decoder, self.prior)

"""Latent variable models as methods that are fitted to some materials and predict others."""

from __future__ import annotations

from collections.abc import Callable
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
from manifold.model.settings import BlendSettings, GplvmSettings, Settings
from manifold.registries import MAPPINGS

_TOLERANCE = 1e-5  # tolerance of fits that are made once per left-out material
AFTER_PUBLISHED = GplvmSettings(mapping="identity")
"""The settings of `fit_after_published`."""


def fit_settings(s: Settings, tolerance: float = _TOLERANCE) -> Fit:
    """Return the method that fits a manifold with these settings, with fewer dimensions if there are too few materials.

    `tolerance` ends the fit of a GPLVM.
    """
    if isinstance(s, BlendSettings):
        return _fit_blend(s)
    assert isinstance(s, GplvmSettings)
    return lambda data, training: _process(s, data, training, tolerance).encode


def fit_after_published(data: Data, training: Indices) -> Encode:
    """Fit a model after Hikichi & Iwasaki: raw values, two dimensions, direct local search.

    Directions are weighted by their cosines, and the output variance maximises the likelihood. The publication has no
    rule for the latent of a new material; as for all models here, the search compares cube roots.
    """
    return _process(AFTER_PUBLISHED, data, training).encode


def _process(s: GplvmSettings, data: Data, training: Indices, tolerance: float = _TOLERANCE) -> LatentProcess:
    mapping, power = MAPPINGS[s.mapping], 0.0 if s.as_published else 1.0
    model = GPLVM(
        min(s.latent_dim, len(training) - 1), mu=s.mu, length_scale=s.length_scale, kernel=s.kernel, prior=s.prior,
        optimizer=s.optimizer, tol=tolerance, output_variance=s.output_variance,
        farthest_first=not s.as_published,
    ).fit_gram(data.gram(mapping, power=power)[np.ix_(training, training)], data.n_outputs)  # fmt: skip
    return LatentProcess(
        model.gp_, data, mapping, training, s.prior, model.output_variance, is_clipped=not s.as_published
    )


def fit_map(s: Settings, data: Data) -> tuple[Array, Callable[[Array], Combination]]:
    """Return the latents (N, Q) of all materials on a map, and a function that predicts at a latent (Q,)."""
    if isinstance(s, BlendSettings):
        space = _tables(s, data).fit(s.latent_dim, s.covariance())
        return space.X, lambda x: space.combination(x, None, CubeRoot())
    assert isinstance(s, GplvmSettings)
    process = _process(s, data, np.arange(data.n_materials))
    return process.gp.X, process.at


def _tables(s: BlendSettings, data: Data) -> BlendTables:
    """Return the distances and samples of all materials, cached."""
    bands = data.available_bands(s.sample_bands)
    tables: BlendTables = data.cached(
        ("blend", s.sample_bands), lambda: BlendTables.of(data.materials, bands)
    )
    return tables


def _fit_blend(s: BlendSettings) -> Fit:
    def fit(data: Data, training: Indices) -> Encode:
        bands, every = data.available_bands(s.sample_bands), _tables(s, data)
        tables, rows = every.subset(training), every.samples.rows(training)
        space = tables.fit(min(s.latent_dim, len(training) - 1), s.covariance())
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
        mapping: the mapping T.
        training: indices of the training materials, shape (n,).
        prior: weight of the Gaussian prior on latents.
        known_variance: output variance s^2 of the mapped values; None estimates it from the training materials.
        is_clipped: whether `encode` sets negative predicted values to 0.
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
        """Predict at a latent (Q,); `weights` (n,) replace the weights of the process."""
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
        """Output variance s^2 of the mapped values."""
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

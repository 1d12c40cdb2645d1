"""The latent space of the GPLVM, the method of Hikichi & Iwasaki."""

from __future__ import annotations

from collections.abc import Mapping as Fields
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from manifold.core.records import AnyArray, Array, Indices, evenly_spaced
from manifold.gp.encoding import Decoder, Encoder
from manifold.gp.kernels import Kernel
from manifold.gp.likelihood import LatentObjective, centre_gram, require_start
from manifold.model.combination import Combination
from manifold.model.decoding import decoder_at
from manifold.model.gram import cached_gram
from manifold.model.latent_space import Embedded, LatentSpace, LeftOutSearch, Statistics, require_shapes
from manifold.model.materials import MaterialCache, MaterialTable
from manifold.model.settings import LEARNT_BANDS, GplvmSettings, Settings

_SAME = 1e-2  # cube-root error below which a file is that material; compact libraries keep it by default


@dataclass(frozen=True, eq=False, repr=False)
class GplvmSpace(LatentSpace):
    """The latent space of kind `gplvm`, whose predictions have the same weights in all bands (Hikichi & Iwasaki).

    Attributes:
        X: latents of the materials, shape (N, Q).
        S: Gram matrix of the mapped materials, not centred, shape (N, N).
        n_outputs: D, the number of outputs from which S was computed.
    """

    X: Array
    S: Array
    n_outputs: int
    kernel: Kernel
    kind: ClassVar[str] = "gplvm"

    def without(self, material: int) -> GplvmSpace:
        """Return the space without one of its materials."""
        others = np.delete(np.arange(len(self.X)), material)
        return replace(self, X=self.X[others], S=self.S[np.ix_(others, others)])

    @property
    def arrays(self) -> dict[str, AnyArray]:
        """The arrays that a file stores, by name."""
        return {"X": self.X, "S": self.S, "n_outputs": np.array(self.n_outputs)}

    @classmethod
    def from_arrays(cls, stored: Fields[str, Array], kernel: Kernel, n_bands: int) -> GplvmSpace:
        """Restore the space from a file's arrays. Raises ValueError if their shapes do not fit each other."""
        X = stored["X"]
        S, n_outputs = require_shapes(stored, {"S": (len(X), len(X)), "n_outputs": ()})
        if not n_outputs >= 1:
            raise ValueError(f"dataset 'n_outputs' holds {n_outputs}, expected a count")
        return cls(X, S, int(n_outputs), kernel)

    def weights(self, x: Array, colours: Array | None) -> Array:
        """Return the weights of the materials at x (Q,), shape (N,)."""
        return self.gp.weights(x[None])[0]

    def material_weights(self, X: Array, colours: Array | None) -> Array:
        """Return the weights of the materials at latents X (M, Q), shape (M, N)."""
        return self.gp.weights(X)

    def embedding_bands(self, n_bands: int) -> Indices:
        """Return the indices of a few evenly spaced bands, whose values are compared to locate a material."""
        return evenly_spaced(n_bands, LEARNT_BANDS)

    def samples(self, mapped: Array, cosines: Array) -> tuple[Array, Array]:
        """Return mapped values (N, B_e, P) as one training sample (B_e P,) per material, and their cosines (B_e P,)."""
        return mapped.reshape(len(mapped), -1), np.tile(cosines, mapped.shape[1])

    def embed(self, decoder: Decoder, f: Array, settings: Settings) -> Embedded:
        """Return the latent of a material with values f (B, P) in all bands.

        A material of the library gets its own latent. A search cannot find it, because the search uses the smooth
        posterior, without the kernel's delta term that makes the prediction there equal to the data.
        """
        values = f[self.embedding_bands(len(f))].reshape(-1)
        own, error = decoder.nearest_sample(np.maximum(values, 0.0))
        if error <= _SAME:
            error = decoder.relative_error(self.X[own][None], values[None])
            return Embedded(self.X[own], None, error, error)
        assert isinstance(settings, GplvmSettings)
        latent = Encoder.of_decoder(decoder, settings.prior).by_values(decoder, values)
        error = decoder.relative_error(latent[None], values[None])
        return Embedded(latent, None, error, error)

    def left_out_search(
        self, table: MaterialTable, materials: MaterialCache, settings: Settings
    ) -> LeftOutSearch:
        """Return a function that locates each material with the Gaussian process fitted to the others."""
        pairs = self.embedding_pairs(materials.is_isotropic)
        whole = decoder_at(pairs, self, materials, settings)
        brdfs = materials.filled()

        def find(i: int) -> tuple[Array, Combination, float]:
            others, rest = np.delete(np.arange(len(self.X)), i), self.without(i)
            decoder = Decoder(rest.gp, whole.mapped[others], whole.mapping, whole.cosines)
            found = rest.embed(decoder, brdfs[i].eval(pairs.wi, pairs.wo).T, settings)
            every = np.zeros(len(self.X))
            every[others] = rest.weights(found.latent, None)
            return found.latent, Combination(whole.mapping, every), found.residual

        return find


def fit_gplvm(
    materials: MaterialCache, s: GplvmSettings, latents: Array | None = None
) -> tuple[GplvmSpace, Statistics]:
    """Fit a GPLVM to all materials of a cache, or use given latents (N, Q); return its space and the objectives.

    Source: Hikichi & Iwasaki, section 3.4.
    """
    from manifold.gplvm import GPLVM  # imports scikit-learn, most of a second that predictions need not spend

    matrix, kernel = cached_gram(materials, s), s.covariance()
    if latents is not None:
        X = require_start(latents, len(materials.names), s.latent_dim)
        objective = LatentObjective(
            centre_gram(matrix.S), matrix.n_outputs, kernel, s.prior, output_variance=s.output_variance
        )
        start = end = objective.value(X)
    else:
        fitted = GPLVM(
            s.latent_dim, mu=s.mu, length_scale=s.length_scale, kernel=s.kernel, optimizer=s.optimizer, prior=s.prior,
            output_variance=s.output_variance, farthest_first=not s.as_published,
        ).fit_gram(matrix.S, matrix.n_outputs)  # fmt: skip
        X, start, end = fitted.embedding_, float(fitted.objective_start_), float(fitted.objective_)
    return GplvmSpace(X, matrix.S, matrix.n_outputs, kernel), {"objective_start": start, "objective": end}

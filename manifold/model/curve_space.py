"""Materials as curves of a latent space over their bands: every band is a point."""

from __future__ import annotations

from collections.abc import Mapping as Fields
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from scipy.spatial.distance import cdist

from manifold.latent.decoder import Decoder
from manifold.latent.kernels import Kernel
from manifold.latent.per_band import join_latents
from manifold.model.latent_space import Embedded, require_bands, require_shapes
from manifold.model.process_space import ProcessSpace
from manifold.model.settings import Settings
from manifold.records import AnyArray, Array, Indices


@dataclass(frozen=True, eq=False, repr=False)
class CurveSpace(ProcessSpace):
    """Materials as curves over their bands: structure is shared by the bands, colour is a band's own.

    The training samples are a few bands of each material.

    Attributes:
        X: structure coordinates, shape (N, Q).
        sample_colours: colour coordinates of the monochrome samples, shape (N, B_s).
        sample_bands: which bands they are, increasing, shape (B_s,).
        own_colours: colour coordinates of all bands, shape (N, B).
        reflectances: of the materials at 8 degrees, specular included, shape (N, B).
        kernel: covariance function on the latents, structure first, colour last.
    """

    X: Array
    sample_colours: Array
    sample_bands: Indices
    own_colours: Array
    reflectances: Array
    kernel: Kernel
    kind: ClassVar[str] = "monochrome"
    takes_colours: ClassVar[bool] = True
    needs_colours: ClassVar[bool] = True

    def without(self, material: int) -> CurveSpace:
        """The same curves less that of one material."""
        names = ("X", "sample_colours", "own_colours", "reflectances")
        return replace(self, **{name: np.delete(getattr(self, name), material, axis=0) for name in names})

    @property
    def arrays(self) -> dict[str, AnyArray]:
        """The arrays that a file stores, by name."""
        return {
            "X": self.X, "sample_colours": self.sample_colours, "sample_bands": self.sample_bands,
            "colours": self.own_colours, "reflectances": self.reflectances,
        }  # fmt: skip

    @classmethod
    def from_arrays(cls, stored: Fields[str, Array], kernel: Kernel, n_bands: int) -> CurveSpace:
        """The space of a file's arrays. Raises ValueError where they do not fit each other or the number of bands."""
        X, bands = stored["X"], require_bands(stored, "sample_bands", n_bands)
        shape = (len(X), n_bands)
        shapes = {"sample_colours": (len(X), len(bands)), "colours": shape, "reflectances": shape}
        sample_colours, own_colours, reflectances = require_shapes(stored, shapes)
        return cls(X, sample_colours, bands, own_colours, reflectances, kernel)

    def sample_rows(self, materials: Indices) -> Indices:
        """Indices of the training samples of some materials, material by material."""
        count = len(self.sample_bands)
        return (np.asarray(materials)[:, None] * count + np.arange(count)).reshape(-1)

    def latents_of(self, materials: Indices) -> Array:
        """Latents of the samples of some materials, shape (n B_s, Q + 1)."""
        return _joined(self.X[materials], self.sample_colours[materials])

    def own_latents(self, material: int) -> Array:
        """Latents of one material in every band, shape (B, Q + 1)."""
        return _joined(self.X[material : material + 1], self.own_colours[material : material + 1])

    def join(self, X: Array, colours: Array | None) -> Array:
        """Latents at structures X (M, Q) in all bands of colours (B,), or in the sample bands where there are none.

        Without colours, those of the materials are averaged with weights that fall with the fourth power of the
        distance: continuous, and a material's own at its latent.
        """
        if colours is not None:
            return _joined(X, np.broadcast_to(colours, (len(X), len(colours))))
        distance = cdist(X, self.X)
        nearest = distance.min(axis=1, keepdims=True)
        share = np.divide(nearest, distance, out=np.ones_like(distance), where=distance > 0) ** 4
        at = np.flatnonzero(nearest[:, 0] == 0)
        share[at] = np.eye(len(self.X))[distance[at].argmin(axis=1)]
        return _joined(X, share @ self.sample_colours / share.sum(axis=1, keepdims=True))

    def weights(self, x: Array, colours: Array | None) -> Array:
        """Weights of the samples in every band at structure x (Q,), shape (B, N B_s)."""
        return self.gp.weights(self.join(x[None], colours))

    def material_weights(self, X: Array, colours: Array | None) -> Array:
        """Weights at structures X (M, Q) summed over the samples of a material, averaged over bands, shape (M, N)."""
        V = self.gp.weights(self.join(X, colours))
        weights = V.reshape(len(X), -1, len(self.X), len(self.sample_bands)).sum(axis=3).mean(axis=1)
        index = self.training_indices(X, colours)
        weights[index >= 0] = np.eye(len(self.X))[index[index >= 0]]
        return np.asarray(weights)

    def training_index(self, x: Array, colours: Array | None) -> int | None:
        """The material with structure x (Q,) and colours (B,), or None."""
        if colours is None:
            return None
        same = np.all(x == self.X, axis=1) & np.all(colours == self.own_colours, axis=1)
        return int(np.argmax(same)) if np.any(same) else None

    def embedding_bands(self, n_bands: int) -> Indices:
        """Bands whose values are compared to find a latent: the sample bands."""
        return self.sample_bands

    def embed(self, decoder: Decoder, f: Array, settings: Settings) -> Embedded:
        """The structure and colours of a material with values f (B, P) in all bands."""
        encoder = self.encoder(decoder, settings)
        structure = encoder.encode(f[self.sample_bands])[0, : self.X.shape[1]]
        colours = encoder.encode_colours(structure, f)[:, 0]
        latents = _joined(structure[None], colours[None])
        error = decoder.relative_error(latents, f)
        return Embedded(structure, colours, error, error)


def _joined(X: Array, colours: Array) -> Array:
    """Latents (M B, Q + 1) of structures X (M, Q) in colours (M, B)."""
    return join_latents(X, colours[:, :, None]).reshape(-1, X.shape[1] + 1)

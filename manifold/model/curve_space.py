"""Materials as curves of a latent space over their bands: every band is a point."""

from __future__ import annotations

from collections.abc import Mapping as Fields
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from scipy.spatial.distance import cdist

from manifold.model.latent_space import Embedded, checked_colours, require_bands, require_shape
from manifold.model.process_space import ProcessSpace
from manifold.models.encoder import Encoder
from manifold.models.kernels import Kernel
from manifold.models.per_band import join_latents
from manifold.records import Array


@dataclass(frozen=True, eq=False, repr=False)
class CurveSpace(ProcessSpace):
    """Materials as curves over their bands: structure is shared by the bands, colour is a band's own.

    Attributes:
        X: structure coordinates, shape (N, Q).
        sample_colours: colour coordinates of the monochrome samples, shape (N, B_s).
        sample_bands: which bands they are, increasing, shape (B_s,).
        colours: colour coordinates of all bands, shape (N, B).
        reflectances: of the materials at 8 degrees, specular included, shape (N, B).
        kernel: covariance function on the latents, structure first, colour last.
    """

    X: Array
    sample_colours: Array
    sample_bands: Array
    colours: Array
    reflectances: Array
    kernel: Kernel
    kind: ClassVar[str] = "monochrome"
    takes_colours: ClassVar[bool] = True
    needs_colours: ClassVar[bool] = True

    def without(self, material: int) -> CurveSpace:
        """The same curves less that of one material."""
        X, own, colours, reflectances = (
            np.delete(values, material, axis=0)
            for values in (self.X, self.sample_colours, self.colours, self.reflectances)
        )
        return replace(self, X=X, sample_colours=own, colours=colours, reflectances=reflectances)

    @property
    def arrays(self) -> dict[str, Array]:
        """The arrays that a file stores, by name."""
        names = ("X", "sample_colours", "sample_bands", "colours", "reflectances")
        return {name: getattr(self, name) for name in names}

    @classmethod
    def from_arrays(cls, stored: Fields[str, Array], kernel: Kernel, n_bands: int) -> CurveSpace:
        """The space of a file's arrays.

        Raises:
            ValueError: the arrays do not fit each other, or the number of bands.
        """
        X, bands = stored["X"], require_bands("sample_bands", stored["sample_bands"], n_bands)
        require_shape("sample_colours", stored["sample_colours"], (len(X), len(bands)))
        for name in ("colours", "reflectances"):
            require_shape(name, stored[name], (len(X), n_bands))
        return cls(X, stored["sample_colours"], bands, stored["colours"], stored["reflectances"], kernel)

    def numbers(self, n_bands: int) -> int:
        """How many numbers describe a material: its structure, and a colour per band."""
        return self.X.shape[1] + n_bands

    def sample_rows(self, materials: Array) -> Array:
        """Indices of the training samples of some materials, material by material."""
        count = len(self.sample_bands)
        return (np.asarray(materials)[:, None] * count + np.arange(count)).reshape(-1)

    def latents_of(self, materials: Array) -> Array:
        """Latents of the samples of some materials, shape (n B_s, Q + 1)."""
        return self._joined(self.X[materials], self.sample_colours[materials])

    def own_latents(self, material: int) -> Array:
        """Latents of one material in every band, shape (B, Q + 1)."""
        return self._joined(self.X[material : material + 1], self.colours[material : material + 1])

    def join(self, X: Array, colours: Array | None) -> Array:
        """Latents at structures X (M, Q) in all bands of colours (B,), or in the sample bands where there are none.

        Without colours, those of the materials are averaged with weights that fall with the fourth power of the
        distance: continuous, and a material's own at its latent.
        """
        colours = self.require_colours(colours)
        if colours is not None:
            return self._joined(X, np.broadcast_to(colours, (len(X), len(colours))))
        distance = cdist(X, self.X)
        nearest = distance.min(axis=1, keepdims=True)
        share = np.divide(nearest, distance, out=np.ones_like(distance), where=distance > 0) ** 4
        at = np.flatnonzero(nearest[:, 0] == 0)
        share[at] = np.eye(len(self.X))[distance[at].argmin(axis=1)]
        return self._joined(X, share @ self.sample_colours / share.sum(axis=1, keepdims=True))

    def _joined(self, X: Array, colours: Array) -> Array:
        """Latents (M B, Q + 1) of structures X (M, Q) in colours (M, B)."""
        return join_latents(X, colours[:, :, None]).reshape(-1, X.shape[1] + 1)

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
        same = np.all(x == self.X, axis=1) & np.all(self.require_colours(colours) == self.colours, axis=1)
        return int(np.argmax(same)) if np.any(same) else None

    def colour_table(self) -> tuple[Array, Array]:
        """Colour coordinates and reflectances of the materials in all bands, shape (N, B) each."""
        return self.colours, self.reflectances

    def require_colours(self, colours: Array | None) -> Array | None:
        """Colours (B,) as float64.

        Raises:
            ShapeError: they are not (B,) or not finite.
        """
        return checked_colours(colours, (self.colours.shape[1],))

    def embedding_bands(self, n_bands: int) -> Array:
        """Bands whose values are compared to find a latent: the sample bands."""
        return self.sample_bands

    def samples(self, mapped: Array, cosines: Array) -> tuple[Array, Array]:
        """Training samples from mapped values (N, B_s, P): a row holds one band of a material."""
        return mapped.reshape(-1, mapped.shape[2]), cosines

    def embed(self, encoder: Encoder, f: Array) -> Embedded:
        """The structure and colours of a material with values f (B, P) in all bands."""
        structure = encoder.encode(f[self.sample_bands])[0, : self.X.shape[1]]
        colours = encoder.encode_colours(structure, f)[:, 0]
        latents = self._joined(structure[None], colours[None])
        return Embedded(structure, colours, encoder.relative_error(latents, f))

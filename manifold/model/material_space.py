"""Whole materials as points of a latent space, the method of Hikichi & Iwasaki."""

from __future__ import annotations

from collections.abc import Mapping as Fields
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from manifold.errors import UsageError
from manifold.model.latent_space import Embedded, require_shape
from manifold.model.process_space import ProcessSpace
from manifold.models.encoder import Encoder
from manifold.models.kernels import Kernel
from manifold.records import Array, evenly_spaced

_EMBEDDING_BANDS = 20  # of a whole material that serve to embed it, evenly spaced


@dataclass(frozen=True, eq=False, repr=False)
class MaterialSpace(ProcessSpace):
    """Whole materials as points, the method of Hikichi & Iwasaki.

    Attributes:
        X: latents, shape (N, Q).
        S: Gram matrix of the mapped materials, not centred, shape (N, N).
        n_outputs: D, the outputs behind S.
        kernel: covariance function on the latents.
    """

    X: Array
    S: Array
    n_outputs: int
    kernel: Kernel
    sample_bands: None = None
    kind: ClassVar[str] = "material"
    takes_colours: ClassVar[bool] = False

    def without(self, material: int) -> MaterialSpace:
        """The same latents less that of one material."""
        others = np.delete(np.arange(len(self.X)), material)
        return replace(self, X=self.X[others], S=self.S[np.ix_(others, others)])

    @property
    def arrays(self) -> dict[str, Array]:
        """The arrays that a file stores, by name."""
        return {"X": self.X, "S": self.S, "n_outputs": np.array(self.n_outputs)}

    @classmethod
    def from_arrays(cls, stored: Fields[str, Array], kernel: Kernel, n_bands: int) -> MaterialSpace:
        """The space of a file's arrays.

        Raises:
            ValueError: the arrays do not fit each other.
        """
        X, S = stored["X"], stored["S"]
        require_shape("S", S, (len(X), len(X)))
        if stored["n_outputs"].shape != () or not stored["n_outputs"] >= 1:
            raise ValueError(f"dataset 'n_outputs' holds {stored['n_outputs']}, expected a count")
        return cls(X, S, int(stored["n_outputs"]), kernel)

    def colour_table(self) -> tuple[Array, Array]:
        """Refuse: whole materials have fixed colours.

        Raises:
            UsageError: always.
        """
        raise UsageError("colours cannot be chosen on a manifold of kind material; embed with --kind blend")

    def numbers(self, n_bands: int) -> int:
        """How many numbers describe a material."""
        return self.X.shape[1]

    def join(self, X: Array, colours: Array | None) -> Array:
        """X as it is, shape (M, Q): colours are part of a material's place."""
        self.require_colours(colours)
        return X

    def weights(self, x: Array, colours: Array | None) -> Array:
        """Weights of the materials at x (Q,), shape (N,)."""
        return self.gp.weights(self.join(x[None], colours))[0]

    def material_weights(self, X: Array, colours: Array | None) -> Array:
        """Weights of the materials at latents X (M, Q), shape (M, N)."""
        return self.gp.weights(self.join(X, colours))

    def require_colours(self, colours: Array | None) -> None:
        """Refuse colours.

        Raises:
            UsageError: there are any.
        """
        if colours is not None:
            self.colour_table()

    def embedding_bands(self, n_bands: int) -> Array:
        """Bands whose values are compared to find a latent: a few, evenly spaced."""
        return evenly_spaced(n_bands, _EMBEDDING_BANDS)

    def samples(self, mapped: Array, cosines: Array) -> tuple[Array, Array]:
        """Training samples from mapped values (N, B_e, P): a row holds all bands of a material."""
        return mapped.reshape(len(mapped), -1), np.tile(cosines, mapped.shape[1])

    def embed(self, encoder: Encoder, f: Array) -> Embedded:
        """The latent of a material with values f (B, P) in all bands."""
        values = f[self.embedding_bands(len(f))].reshape(1, -1)
        latent = encoder.encode(values)
        return Embedded(latent[0], None, encoder.relative_error(latent, values))

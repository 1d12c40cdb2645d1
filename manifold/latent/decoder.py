"""Decode latents: BRDF values at some outputs as `T^-1(V T(F))`, with weights V of the training samples."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np

from manifold.gpr import GaussianProcess
from manifold.mapping import Mapping
from manifold.metrics import RusinkiewiczGrid, cosine_weight, relative_error
from manifold.records import Array

PAIR_STRIDE = 6  # one in this many of a grid's direction pairs is used to find a latent


@dataclass(frozen=True, eq=False)
class EncodingPairs:
    """The direction pairs at which a material is compared with what latents decode.

    Attributes:
        wi, wo: unit vectors above the horizon, shape (P, 3).
    """

    wi: Array
    wo: Array

    @classmethod
    def of_grid(cls, grid: RusinkiewiczGrid, stride: int = PAIR_STRIDE) -> EncodingPairs:
        """The pairs of a grid above the horizon, one in every `stride` of them."""
        wi, wo, above = grid.directions()
        return cls(wi[above][::stride], wo[above][::stride])

    @classmethod
    @cache
    def default(cls, is_isotropic: bool = True) -> EncodingPairs:
        """Those of the default grid, at which new materials are compared with predictions; do not write to them.

        Args:
            is_isotropic: whether all of them are; for others half vectors have all azimuths.
        """
        return cls.of_grid(RusinkiewiczGrid.named("default").suited_to(is_isotropic))

    @property
    def cosines(self) -> Array:
        """cos(theta_i) cos(theta_o), shape (P,)."""
        return cosine_weight(self.wi, self.wo)


@dataclass(frozen=True, eq=False)
class Decoder:
    """Maps latents to BRDF values at P outputs: direction pairs of one band, or pairs and bands.

    Attributes:
        gp: of the n training samples.
        mapped: T of the training samples, shape (n, P).
        mapping: T.
        cosines: cos(theta_i) cos(theta_o) of each output, shape (P,).
    """

    gp: GaussianProcess
    mapped: Array
    mapping: Mapping
    cosines: Array

    def decode(self, latents: Array) -> Array:
        """Values f in 1/sr at latents (R, Q), at least 0, shape (R, P)."""
        mapped = (self.gp.weights(latents) @ self.mapped)[..., None]
        return np.maximum(self.mapping.inverse(mapped, self._row_cosines(len(mapped)))[..., 0], 0.0)

    def combine(self, V: Array) -> tuple[Array, Array]:
        """Values (R, P) of weights V (R, n), possibly negative, and their derivatives by the mapped values, (R, P)."""
        rows = self._row_cosines(len(V))
        values = self.mapping.inverse((V @ self.mapped)[..., None], rows)
        return values[..., 0], self.mapping.slope(values, rows)[..., 0]

    def map(self, f: Array) -> Array:
        """T of values f (R, P), same shape."""
        return self.mapping.forward(f[..., None], self._row_cosines(len(f)))[..., 0]

    def relative_error(self, latents: Array, f: Array) -> float:
        """Error of the values decoded at latents (R, Q) against f (R, P); see `metrics.relative_error`."""
        return relative_error(f.T, self.decode(latents).T, self.cosines)

    def _row_cosines(self, rows: int) -> Array:
        return np.broadcast_to(self.cosines, (rows, self.cosines.size))

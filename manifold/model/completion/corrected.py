"""A mixture of samples, times what readings say of the directions near them."""

from __future__ import annotations

import numpy as np

from manifold.brdf.plausibility import quadrature_albedo
from manifold.directions import require_directions
from manifold.model.prediction import PredictedBRDF
from manifold.models.nearby import NearbyFactors, places
from manifold.records import Array, Bands


class CorrectedBRDF:
    """A predicted BRDF whose cube roots are multiplied by factors, direction by direction.

    Sampled as the prediction is: factors are between 1/2 and 2.
    """

    def __init__(self, predicted: PredictedBRDF, factors: NearbyFactors):
        """Factors are in the bands of the prediction."""
        self._predicted, self._factors = predicted, factors
        self.sample, self.pdf = predicted.sample, predicted.pdf

    @property
    def bands(self) -> Bands:
        """The spectral axis."""
        return self._predicted.bands

    @property
    def is_isotropic(self) -> bool:
        """Whether the prediction is."""
        return self._predicted.is_isotropic

    def eval(self, wi: Array, wo: Array) -> Array:
        """BRDF f in 1/sr, shape (..., B); arguments and errors as in the prediction."""
        f = self._predicted.eval(wi, wo)
        wi, wo = np.broadcast_arrays(require_directions(wi, "wi"), require_directions(wo, "wo"))
        factors = self._factors.at(places(wi.reshape(-1, 3), wo.reshape(-1, 3)))
        return np.asarray(f * factors.T.reshape(f.shape) ** 3)

    def eval_cos(self, wi: Array, wo: Array) -> Array:
        """f * cos(theta_o) in 1/sr, shape (..., B)."""
        return self.eval(wi, wo) * np.maximum(np.asarray(wo)[..., 2], 0.0)[..., None]

    def albedo(self, wi: Array, resolution: int = 48) -> Array:
        """Directional albedo, shape (..., B), by quadrature over half vectors."""
        return quadrature_albedo(self, wi, resolution)

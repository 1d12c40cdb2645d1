"""A mixture of samples, times the interpolated residual of readings near a direction."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from manifold.brdf.wrapped import WrappedBRDF
from manifold.directions import require_directions
from manifold.model.prediction import PredictedBRDF
from manifold.models.nearby import NearbyFactors, places
from manifold.records import Array


class CorrectedBRDF(WrappedBRDF):
    """A predicted BRDF whose cube roots are multiplied by factors, direction by direction.

    Sampled as the prediction is: factors are between 1/2 and 2.
    """

    _albedo_nodes: ClassVar[int] = 48  # as of predictions

    def __init__(self, predicted: PredictedBRDF, factors: NearbyFactors):
        """Factors are in the bands of the prediction."""
        super().__init__(predicted)
        self._factors = factors

    def eval(self, wi: Array, wo: Array) -> Array:
        """BRDF f in 1/sr, shape (..., B); arguments and errors as in the prediction."""
        f = self._brdf.eval(wi, wo)
        wi, wo = np.broadcast_arrays(require_directions(wi, "wi"), require_directions(wo, "wo"))
        factors = self._factors.at(places(wi.reshape(-1, 3), wo.reshape(-1, 3)))
        return np.asarray(f * factors.T.reshape(f.shape) ** 3)

"""Readings of a gloss meter, beside those of a material: means over apertures around mirror directions."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from manifold.models.mixtures import MISSED, NOISE
from manifold.records import Array


@dataclass(frozen=True, eq=False)
class GlossReadings:
    """G readings of gloss.

    Attributes:
        samples: cube roots of the means over the apertures of n samples and, last, of the Lambertian, (n + 1, G).
        target: cube roots of the material's luminance there, shape (G,).
        luminance: what the bands of the readings contribute to it, shape (B,).
        where: coordinates of the mirror directions, see `nearby.places`, shape (G, 3).
    """

    samples: Array
    target: Array
    luminance: Array
    where: Array

    @property
    def weights(self) -> Array:
        """Weights of these readings, shape (G,)."""
        return np.ones(len(self.target))

    def misfit(self, weights: Array, level: float) -> float:
        """Squared error of weights (B, n + 1) over its variance; `level`: root mean square of the other readings."""
        variance = (NOISE**2 + MISSED**2) * (self.target**2 + level**2)
        return float(np.sum((self._luminous(weights @ self.samples) - self.target) ** 2 / variance))

    def scaled(self, roots: Array) -> Array:
        """Cube roots in bands, shape (B, G), scaled to have the luminance of the target."""
        return np.asarray(roots * self.target / np.maximum(self._luminous(roots), np.finfo(float).tiny))

    def _luminous(self, roots: Array) -> Array:
        return np.cbrt(np.maximum(self.luminance @ roots**3, 0.0))

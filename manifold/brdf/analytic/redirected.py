"""BRDFs with modified directions: seen through a refracting layer, or retro-reflective."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from manifold.brdf.analytic.base import AnalyticBRDF, set_per_band
from manifold.brdf.measured import BRDF
from manifold.errors import UsageError
from manifold.records import Array


@dataclass(frozen=True, eq=False)
class Immersed(AnalyticBRDF):
    """A BRDF under a transparent, absorbing layer: t^(1 / cos_i' + 1 / cos_o') f(wi', wo') / eta^2, primes refracted.

    What the boundary of the layer reflects is not part of it (see `Layered`); what it reflects back inside is lost.

    Attributes:
        brdf: what lies below.
        eta: index of refraction of the layer, at least 1.
        transmittance: of the layer along its normal, one way, in [0, 1], shape (B,) or a single number.
    Raises:
        UsageError: eta or transmittance is out of range.
    Source: Weidlich & Wilkie 2007, "Arbitrarily Layered Micro-Facet Surfaces", with the radiance's factor 1 / eta^2.
    """

    brdf: BRDF
    eta: float
    transmittance: Array = field(default_factory=lambda: np.ones(1))

    def __post_init__(self) -> None:
        if not (np.isfinite(self.eta) and self.eta >= 1.0):
            raise UsageError(f"eta is {self.eta}, expected an index of refraction of at least 1")
        object.__setattr__(self, "bands", self.brdf.bands)
        set_per_band(self, "transmittance", 0.0, 1.0)

    @property
    def is_isotropic(self) -> bool:
        return self.brdf.is_isotropic

    def _inside(self, w: Array) -> Array:
        """Directions (n, 3) after refraction."""
        plane = w[:, :2] / self.eta
        return np.column_stack([plane, np.sqrt(1.0 - np.sum(plane**2, axis=-1))])

    def _outside(self, inner: Array) -> Array:
        """Directions (n, 3) refracted to `inner`; below the horizon where that is, or where the light stays inside."""
        plane = inner[:, :2] * self.eta
        squared = np.sum(plane**2, axis=-1)
        outer = np.column_stack([plane, np.sqrt(np.maximum(1.0 - squared, 0.0))])
        outer[(squared >= 1.0) | (inner[:, 2] <= 0.0)] = (0.0, 0.0, -1.0)
        return outer

    def _eval(self, wi: Array, wo: Array) -> Array:
        inner_i, inner_o = self._inside(wi), self._inside(wo)
        f = self.brdf.eval(inner_i, inner_o) / self.eta**2
        if np.any(self.transmittance != 1.0):
            f *= self.transmittance ** (1.0 / inner_i[:, 2:] + 1.0 / inner_o[:, 2:])
        return f

    def _sample(self, wi: Array, u: Array) -> Array:
        return self._outside(self.brdf.sample(self._inside(wi), u)[0])

    def _pdf(self, wi: Array, wo: Array) -> Array:
        inner = self._inside(wo)
        return self.brdf.pdf(self._inside(wi), inner) * wo[:, 2] / (self.eta**2 * inner[:, 2])


@dataclass(frozen=True, eq=False)
class Retroreflection(AnalyticBRDF):
    """An isotropic BRDF turned back to the light: its value for wi after half a turn about the normal, and wo.

    A lobe around the mirror direction becomes one around wi.

    Attributes:
        brdf: any isotropic BRDF.
    Raises:
        UsageError: the BRDF is anisotropic, and the result would not be reciprocal.
    Source: the back vector of Belcour et al. 2014, "Bidirectional reflectance distribution function measurements and
    analysis of retroreflective materials".
    """

    brdf: BRDF

    def __post_init__(self) -> None:
        if not self.brdf.is_isotropic:
            raise UsageError("found an anisotropic BRDF as retro-reflective, expected an isotropic one")
        object.__setattr__(self, "bands", self.brdf.bands)

    def _eval(self, wi: Array, wo: Array) -> Array:
        return self.brdf.eval(_half_turn(wi), wo)

    def _sample(self, wi: Array, u: Array) -> Array:
        return self.brdf.sample(_half_turn(wi), u)[0]

    def _pdf(self, wi: Array, wo: Array) -> Array:
        return self.brdf.pdf(_half_turn(wi), wo)

    def _albedo(self, wi: Array) -> Array:
        return self.brdf.albedo(wi)


def _half_turn(w: Array) -> Array:
    return w * (-1.0, -1.0, 1.0)

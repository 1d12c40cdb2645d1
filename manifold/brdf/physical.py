"""The nearest physical BRDF, in the simplest sense: not negative, reciprocal, no more light out than in."""

from __future__ import annotations

import numpy as np

from manifold.brdf.measured import BRDF
from manifold.brdf.plausibility import AZIMUTHS_DEG, quadrature_albedo
from manifold.directions import from_spherical
from manifold.records import Array, Bands

_ELEVATIONS_DEG = np.linspace(0.0, 85.0, 18)  # where the albedo is looked at


class PhysicalBRDF:
    """A BRDF projected: negative values cut to zero, both orders of directions averaged, bands scaled.

    Every band is scaled by one number, so that its directional albedo is at most 1 at incidences from 0 to 85
    degrees; bands that keep to that are left as they are.

    Attributes:
        scale: what the bands were multiplied by, in (0, 1], shape (B,).
    """

    def __init__(self, brdf: BRDF):
        """Wrap a BRDF; evaluates it at some 20,000 direction pairs, more if it is anisotropic."""
        self._brdf = brdf
        self.sample, self.pdf = brdf.sample, brdf.pdf
        self.scale = np.ones(brdf.bands.count)
        azimuths = (0,) if brdf.is_isotropic else AZIMUTHS_DEG
        wi = from_spherical(np.deg2rad(_ELEVATIONS_DEG)[:, None], np.deg2rad(azimuths)[None, :])
        self.scale = 1.0 / np.maximum(self.albedo(wi).max(axis=(0, 1)), 1.0)

    @property
    def bands(self) -> Bands:
        """The spectral axis."""
        return self._brdf.bands

    @property
    def is_isotropic(self) -> bool:
        """Whether the BRDF is."""
        return self._brdf.is_isotropic

    def eval(self, wi: Array, wo: Array) -> Array:
        """f in 1/sr, at least 0 and the same for exchanged directions, shape (..., B)."""
        there = np.maximum(self._brdf.eval(wi, wo), 0.0)
        back = np.maximum(self._brdf.eval(wo, wi), 0.0)
        return 0.5 * (there + back) * self.scale

    def eval_cos(self, wi: Array, wo: Array) -> Array:
        """f * cos(theta_o) in 1/sr, shape (..., B)."""
        return self.eval(wi, wo) * np.maximum(np.asarray(wo)[..., 2], 0.0)[..., None]

    def albedo(self, wi: Array, resolution: int = 32) -> Array:
        """Directional albedo, shape (..., B), by quadrature over half vectors.

        Args:
            wi: incident unit vectors (..., 3).
            resolution: nodes in elevation and in azimuth.
        """
        return quadrature_albedo(self, wi, resolution)

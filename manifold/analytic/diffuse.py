"""Diffuse reflection by rough matte surfaces."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from manifold.analytic.base import AnalyticBRDF, set_per_band
from manifold.core.errors import UsageError
from manifold.core.records import Array, Bands

_SINGLE = 0.5 - 2.0 / (3.0 * np.pi)
_SINGLE_AVERAGE = 2.0 / 3.0 - 28.0 / (15.0 * np.pi)


@dataclass(frozen=True, eq=False)
class RoughDiffuse(AnalyticBRDF):
    """Matte facets in all directions: brighter towards the light and at grazing angles, colours deeper in between.

    Attributes:
        reflectance: of a facet, in [0, 1], shape (B,) or a single number; a white surface returns all light.
        roughness: r in [0, 1]; 0 is Lambert.

    Source: Portsmouth, Kutz & Hill 2024, "EON: A Practical Energy-Preserving Rough Diffuse BRDF", after Fujii's form of
    Oren & Nayar 1994.
    """

    reflectance: Array
    roughness: float
    bands: Bands

    def __post_init__(self) -> None:
        if not 0.0 <= self.roughness <= 1.0:
            raise UsageError(f"roughness is {self.roughness}, expected a number from 0 to 1")
        set_per_band(self, "reflectance", 0.0, 1.0)

    @property
    def _scale(self) -> float:
        return 1.0 / (1.0 + _SINGLE * self.roughness)

    def _single(self, w: Array) -> Array:
        """Return the albedo of one reflection by white facets, shape (n,)."""
        cosine = np.clip(w[:, 2], 1e-9, 1.0)
        sine = np.sqrt(1.0 - cosine**2)
        g = sine * (np.arccos(cosine) - sine * cosine) + 2.0 / 3.0 * (sine / cosine * (1.0 - sine**3) - sine)
        return self._scale * (1.0 + self.roughness / np.pi * g)

    @cached_property
    def _average(self) -> float:
        """Mean of `_single` over the hemisphere."""
        return self._scale * (1.0 + _SINGLE_AVERAGE * self.roughness)

    @cached_property
    def _multiple(self) -> Array:
        """Albedo per band of multiple reflection, relative to the light that one reflection does not return."""
        left = 1.0 - self._average
        return self.reflectance**2 * self._average / (1.0 - self.reflectance * left) / max(left, 1e-9)

    def _eval(self, wi: Array, wo: Array) -> Array:
        ci, co = wi[:, 2], wo[:, 2]
        s = np.sum(wi * wo, axis=-1) - ci * co
        s = np.where(s > 0.0, s / np.maximum(ci, co), s)
        f = (self._scale / np.pi * (1.0 + self.roughness * s))[:, None] * self.reflectance
        if self.roughness > 0.0:
            lost = (1.0 - self._single(wi)) * (1.0 - self._single(wo)) / np.pi
            f += lost[:, None] * self._multiple
        return np.asarray(f)

    def _albedo(self, wi: Array) -> Array:
        single = self._single(wi)[:, None]
        return single * self.reflectance + (1.0 - single) * self._multiple * (1.0 - self._average)

"""Base class of BRDFs that modify the values of another one."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import ClassVar

import numpy as np

from manifold.brdf.interface import BRDF
from manifold.brdf.notebook import NotebookPicture
from manifold.brdf.plausibility import quadrature_albedo
from manifold.core.records import Array, Bands


class WrappedBRDF(NotebookPicture, ABC):
    """Base class of BRDFs that change the values of another BRDF and keep its sampling."""

    _albedo_nodes: ClassVar[int] = 32  # nodes of the quadrature, in polar angle and in azimuth

    def __init__(self, brdf: BRDF):
        """Wrap a BRDF, which may lack `sample` and `pdf` if the result is never sampled."""
        self._brdf = brdf
        self.bands: Bands = brdf.bands
        self.is_isotropic: bool = brdf.is_isotropic

    def __repr__(self) -> str:
        return f"<{type(self).__name__}: {self.bands}, of {self._brdf!r}>"

    @abstractmethod
    def eval(self, wi: Array, wo: Array) -> Array:
        """Return f in 1/sr, shape (..., B)."""

    def eval_cos(self, wi: Array, wo: Array) -> Array:
        """Return f * cos(theta_o) in 1/sr, shape (..., B)."""
        return self.eval(wi, wo) * np.maximum(np.asarray(wo)[..., 2], 0.0)[..., None]

    def sample(self, wi: Array, u: Array) -> tuple[Array, Array]:
        """Return outgoing directions (..., 3) and their pdf (...) in 1/sr, as the wrapped BRDF draws them."""
        return self._brdf.sample(wi, u)

    def pdf(self, wi: Array, wo: Array) -> Array:
        """Return the density of `sample` in 1/sr, shape (...)."""
        return self._brdf.pdf(wi, wo)

    def albedo(self, wi: Array) -> Array:
        """Return the directional albedo (..., B) at wi (..., 3), by quadrature over half vectors."""
        return quadrature_albedo(self, wi, self._albedo_nodes)

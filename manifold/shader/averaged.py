"""Averages anisotropic materials over the azimuth of the sample."""

from __future__ import annotations

import numpy as np

from manifold.brdf import goniometer
from manifold.brdf.interface import BRDF
from manifold.brdf.measured import MeasuredBRDF
from manifold.brdf.wrapper import WrappedBRDF
from manifold.core.directions import rotate_z
from manifold.core.records import Array, BsdfFile

_AZIMUTHS = 24  # at which the sample is turned, over a whole turn


class AveragedBRDF(WrappedBRDF):
    """The mean of a BRDF over all azimuths of the sample."""

    def __init__(self, brdf: BRDF) -> None:
        """Wrap an anisotropic BRDF."""
        super().__init__(brdf)
        self.is_isotropic = True

    def eval(self, wi: Array, wo: Array) -> Array:
        """Return f in 1/sr, shape (..., B)."""
        wi, wo = np.asarray(wi, float), np.asarray(wo, float)
        angles = 2.0 * np.pi * np.arange(_AZIMUTHS) / _AZIMUTHS
        return np.asarray(
            sum(self._brdf.eval(rotate_z(wi, angle), rotate_z(wo, angle)) for angle in angles) / _AZIMUTHS
        )


def averaged(file: BsdfFile) -> BsdfFile:
    """Return an isotropic file with an anisotropic file's mean over azimuths, at the same incidences and resolution."""
    return goniometer.measure(
        AveragedBRDF(MeasuredBRDF(file)), file.name, description=file.description,
        resolution=file.spectra.shape[-1], theta_i_rad=file.theta_i_rad,
    )  # fmt: skip

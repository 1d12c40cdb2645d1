"""Neural fits of measured BRDFs as BRDFs: small networks from half and difference vectors to linear sRGB."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from manifold.analytic.base import AnalyticBRDF
from manifold.analytic.corpus import rgl_bands, write_files
from manifold.brdf import goniometer
from manifold.brdf.plausibility import quadrature_albedo
from manifold.colour.reflectances import srgb_spectra
from manifold.directions import from_spherical, to_rusinkiewicz
from manifold.formats.neural_weights import NeuralWeights, read_neural_weights
from manifold.io_rgl import write_bsdf
from manifold.records import Array, Bands, BsdfFile

RGB = Bands(None)
_STEEPEST_DEG = 89.0  # beyond it the albedo at this incidence is taken
_ALBEDO_RESOLUTION = 32
_INCIDENCES = 12
_STEEPEST_LOBE = 2.0  # highlights fall faster than what goniometer.measure allows predictions, and smoothly


@dataclass(frozen=True, eq=False)
class NeuralBRDF(AnalyticBRDF):
    """A network's BRDF: dense layers with ReLU, then max(exp(z) - 1, 0), in linear sRGB.

    Inputs are the half vector (hx, 0, hz) and the difference vector (dx, dy, dz) of the Rusinkiewicz frame, phi_d
    folded into [0, pi), so that the BRDF is reciprocal; fits of RGL files saw pi - phi_d. Nothing makes a network give
    the same on both sides of the plane of incidence: where measurements are not reciprocal, it does not.

    Attributes:
        weights: of the network.
        bands: RGB, or wavelengths: then every colour is up-sampled to a smooth spectrum of this colour.
        albedo_limits: None gives what was published; see `plausible`.
    Source: Sztrajman et al. 2021, "Neural BRDF Representation and Importance Sampling"; `srgb_spectra`.
    """

    weights: NeuralWeights
    bands: Bands = RGB
    albedo_limits: tuple[Array, Array] | None = None

    def plausible(self) -> NeuralBRDF:
        """The same material, both sides of the plane of incidence averaged, reflecting at most the light that arrives.

        Values are divided by max(1, A(wi), A(wo)), A being the largest albedo over bands: where A is at most 1 nothing
        changes, hues never do, and the result is reciprocal. Networks exceed 1 at grazing incidence above all.
        """
        theta = np.deg2rad(np.linspace(0.0, _STEEPEST_DEG, 31))
        # of the colours: no band of an up-sampled spectrum exceeds the largest of them
        symmetric = replace(self, bands=RGB, albedo_limits=(theta, np.ones_like(theta)))
        albedo = symmetric.albedo(from_spherical(theta, 0.0)).max(axis=-1)
        return replace(self, albedo_limits=(theta, np.maximum(albedo, 1.0)))

    def _eval(self, wi: Array, wo: Array) -> Array:
        theta_h, theta_d, phi_d, _ = to_rusinkiewicz(wi, wo)
        phi_d = np.mod(phi_d, np.pi)
        if self.weights.is_rgl:
            phi_d = np.pi - phi_d
        f = self._network(theta_h, theta_d, phi_d)
        if self.albedo_limits is not None:
            f += self._network(theta_h, theta_d, np.pi - phi_d)
            limits = [np.interp(np.arccos(np.minimum(w[:, 2], 1.0)), *self.albedo_limits) for w in (wi, wo)]
            f /= 2.0 * np.maximum(*limits)[:, None]
        return f if self.bands.is_rgb else f @ srgb_spectra(self.bands)

    def _network(self, theta_h: Array, theta_d: Array, phi_d: Array) -> Array:
        """f in linear sRGB, shape (n, 3), at Rusinkiewicz angles (n,)."""
        x = np.concatenate([from_spherical(theta_h, 0.0), from_spherical(theta_d, phi_d)], axis=-1)
        for kernel, bias in self.weights.layers:
            x = np.maximum(x @ kernel + bias, 0.0)  # at the end too: max(exp(z) - 1, 0) is exp(max(z, 0)) - 1
        return np.asarray(np.expm1(x))

    def _albedo(self, wi: Array) -> Array:
        return quadrature_albedo(self, wi, _ALBEDO_RESOLUTION)


def read_neural_fits(path: Path | str, bands: Bands = RGB) -> dict[str, NeuralBRDF]:
    """The published neural fits in a file, zip file or folder, by the material's name.

    Raises: as `read_neural_weights`.
    """
    return {weights.name: NeuralBRDF(weights, bands) for weights in read_neural_weights(path)}


def write_neural(
    source: Path | str,
    folder: Path | str,
    *,
    spectral: bool = False,
) -> list[Path]:
    """Write neural fits as RGL files, `NAME_rgb.bsdf` or `NAME_spec.bsdf`, made `plausible`.

    Args:
        source: an `.h5` file, a zip file, or a folder of them.
        folder: made if missing.
        spectral: up-sample colours to the 195 bands of the RGL database.
    Returns:
        The paths, sorted by name.
    Raises:
        UsageError: there is no such source, or the folder cannot be made.
        FileFormatError: the source holds no neural fits, or damaged ones.
    """
    fits = read_neural_fits(source, rgl_bands() if spectral else RGB)
    writers = {name: lambda path, b=brdf: write_bsdf(path, _measure(b)) for name, brdf in fits.items()}
    return write_files(folder, "_spec.bsdf" if spectral else "_rgb.bsdf", writers)


def _measure(brdf: NeuralBRDF) -> BsdfFile:
    name, rgb = brdf.weights.name, brdf.bands.is_rgb
    return goniometer.measure(
        brdf.plausible(),
        name,
        description=f"Neural fit of {name} (Sztrajman et al. 2021){'' if rgb else ', up-sampled from RGB'}",
        n_theta_i=_INCIDENCES,
        steepest=_STEEPEST_LOBE,
        bend=goniometer.SOFT_BEND,
        version=(1, 0) if rgb else (3, 1),
    )

"""Converts between the three channels of a camera and the bands of a material."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np

from manifold.brdf.measured import MeasuredBRDF
from manifold.colour.conversion import interpolation_matrix, xyz_to_srgb, xyz_weights
from manifold.colour.illuminants import Illuminant
from manifold.colour.reflectances import diffuse_reflectance, diffuse_reflectance_names
from manifold.core.directions import from_spherical
from manifold.core.errors import BandMismatchError, FileFormatError
from manifold.core.records import Array, Bands
from manifold.formats.readings import DAYLIGHT, Readings
from manifold.formats.spectra import read_spectrum
from manifold.library.store import Library

_NOISE = 0.02  # standard deviation of channels, relative to their mean
_UNLIKE = 0.1  # standard deviation of how a material's matrix from channels to bands differs from the prior's
_STEP_NM = 5.0
_VIEWS_DEG = (
    (45.0, 0.0),
    (30.0, -50.0),
    (60.0, 10.0),
)  # incidence and viewing polar angle, off the highlight


class Channels(NamedTuple):
    """The matrices that convert between the channels of a camera and the bands of a material.

    Attributes:
        responses: channels of reflectances in the bands of a library under D65, shape (3, B_l).
        to_bands: bands of the material estimated from the channels, shape (B, 3).
    """

    responses: Array
    to_bands: Array

    @classmethod
    def of_library(cls, library: Library, names: tuple[str, ...], file: Path | None = None) -> Channels:
        """Return the channels of a camera, from a file of its sensitivities, or by default those of linear sRGB.

        The conversion from the channels to the library's bands is learned from its named materials (`band_matrix`).
        """
        responses = srgb_responses(library.bands) if file is None else read_responses(file, library.bands)
        return cls(responses, band_matrix(library, names, responses))

    @classmethod
    def srgb(cls, bands: Bands) -> Channels:
        """Return the channels of linear sRGB, with a conversion to bands learned from measured reflectances."""
        responses = srgb_responses(bands)
        return cls(responses, np.eye(3) if bands.is_rgb else wiener_matrix(_measured(bands), responses))

    def beside(self, readings: Readings, of_library: Bands) -> tuple[Readings, Channels]:
        """Return readings converted to these channels, and the channels with a matrix to the bands of the completion.

        The bands are those of `evidence.bands_of`. The matrix reproduces the spectra of the readings from their
        channels as closely as its prior allows; the prior is the Wiener estimate of these bands.
        """
        read_nm, (responses, prior) = readings.wavelengths_nm, self
        if read_nm is None:
            return readings, self
        nm = read_nm if of_library.is_rgb else np.array(of_library.wavelengths_nm)
        to_read, to_result = interpolation_matrix(nm, read_nm), interpolation_matrix(read_nm, nm)
        if of_library.is_rgb:
            responses, prior = Channels.srgb(readings.bands)
        channels = in_channels(readings, responses @ to_result)
        spectra = without_gaps(readings.values, read_nm)
        known = np.isfinite(spectra).all(axis=1)
        level = np.maximum(np.abs(spectra[known]).mean(axis=1, keepdims=True), np.finfo(float).tiny)
        x, y = channels.values[known] / level, spectra[known] / level
        precision = x.T @ x + (_NOISE / _UNLIKE) ** 2 * np.eye(3)
        change = np.linalg.solve(precision, x.T @ (y - x @ (to_read @ prior).T)).T
        return channels, Channels(responses, to_result @ (to_read @ prior + change))


def srgb_responses(bands: Bands) -> Array:
    """Return the responses (3, B) of linear sRGB to reflectances in B bands under D65; the identity for RGB bands."""
    return np.eye(3) if bands.is_rgb else xyz_to_srgb(xyz_weights(bands)).T


def read_responses(path: Path, bands: Bands) -> Array:
    """Read the responses (3, B) of a camera to reflectances under D65, 1 for a perfect diffuser.

    The file is text of wavelengths and three sensitivities, see `formats.spectra.read_spectrum`.
    """
    if bands.is_rgb:
        raise BandMismatchError(
            f"{path}: sensitivities of a camera need a spectral library, found {bands}; leave them out"
        )
    nm, sensitivities = read_spectrum(path, "sensitivity")
    nodes = np.arange(nm[0], nm[-1], 1.0)
    seen = interpolation_matrix(nm, nodes) @ np.maximum(sensitivities, 0.0)
    seen *= Illuminant.named("D65").at(nodes)[:, None]
    responses = interpolation_matrix(np.asarray(bands.wavelengths_nm), nodes).T @ seen
    if not np.all(responses.sum(axis=0) > 0.0):
        raise FileFormatError(
            f"{path}: a channel has no sensitivity in {bands}, expected sensitivities above 0"
        )
    return np.asarray((responses / responses.sum(axis=0)).T)


def band_matrix(library: Library, names: tuple[str, ...], responses: Array) -> Array:
    """Return the matrix (B, 3) from channels of a camera to the bands of a library, by Wiener estimation.

    The matrix is learned from the library's named materials, away from their highlights, and from measured
    reflectances. It estimates the deviation from a flat spectrum, so that a neutral colour stays neutral. For
    `responses` see `srgb_responses`.

    Source: Haneishi et al. 2000, "System design for accurately estimating the spectral reflectance of art paintings".
    """
    if library.bands.is_rgb:
        return np.eye(3)
    spectra = np.vstack([_of_materials(library, names), _measured(library.bands)])
    return wiener_matrix(spectra, responses)


def wiener_matrix(spectra: Array, responses: Array) -> Array:
    """Return the Wiener matrix (B, 3) from spectra (n, B) and responses (3, B)."""
    seen = spectra @ responses.T
    level = np.maximum(seen.mean(axis=1, keepdims=True), 1e-4)
    x, y = seen / level - 1.0, spectra / level - 1.0
    covariance = x.T @ x / len(x) + _NOISE**2 * np.eye(3)
    deviations = np.linalg.solve(covariance, x.T @ y / len(x)).T  # [B, 3]
    return np.asarray(deviations @ (np.eye(3) - 1.0 / 3.0) + 1.0 / 3.0)


def _of_materials(library: Library, names: tuple[str, ...]) -> Array:
    wi, wo = (
        from_spherical(np.deg2rad([view[k] for view in _VIEWS_DEG]), azimuth)
        for k, azimuth in ((0, 0.0), (1, np.pi))
    )
    return np.pi * np.vstack(
        [np.maximum(MeasuredBRDF(library.read(name)).eval(wi, wo), 0.0) for name in names]
    )


def in_channels(readings: Readings, responses: Array) -> Readings:
    """Return spectral readings converted to a camera's channels by its responses (3, B).

    RGB readings stay as they are.
    """
    nm = readings.wavelengths_nm
    if nm is None:
        return readings
    values = without_gaps(readings.values, nm) @ responses.T
    return replace(readings, wavelengths_nm=None, values=values, viewing=DAYLIGHT)


def without_gaps(values: Array, nm: Array) -> Array:
    """Interpolate gaps between measured bands of spectra (P, B); unmeasured ends stay NaN."""
    filled = values.copy()
    for row in filled:
        known = np.isfinite(row)
        if known.any():
            row[~known] = np.interp(nm[~known], nm[known], row[known], left=np.nan, right=np.nan)
    return filled


@cache
def _measured(bands: Bands) -> Array:
    at = np.asarray(bands.wavelengths_nm)
    nm = np.arange(400.0, 701.0, _STEP_NM)
    to_bands = interpolation_matrix(nm, at)
    return np.array([to_bands @ diffuse_reflectance(name, nm) for name in diffuse_reflectance_names()])

"""Spectra of what a camera of three channels saw, estimated from a library's materials and measured reflectances."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np

from manifold.brdf.measured import MeasuredBRDF
from manifold.colour.conversion import interpolation_matrix, xyz_to_srgb, xyz_weights
from manifold.colour.illuminants import Illuminant
from manifold.colour.reflectances import diffuse_reflectance, diffuse_reflectance_names
from manifold.directions import from_spherical
from manifold.errors import BandMismatchError, FileFormatError, MissingFileError
from manifold.library.store import Library
from manifold.records import Array, Bands

_NOISE = 0.02  # standard deviation of channels, relative to their mean
_STEP_NM = 5.0
_VIEWS_DEG = ((45.0, 0.0), (30.0, -50.0), (60.0, 10.0))  # incidence and viewing elevation, off the highlight


def srgb_responses(bands: Bands) -> Array:
    """Responses (3, B) of linear sRGB to reflectances in B bands under D65; the identity for RGB bands."""
    return np.eye(3) if bands.is_rgb else xyz_to_srgb(xyz_weights(bands)).T


def read_responses(path: Path, bands: Bands) -> Array:
    """Responses (3, B) of a camera to reflectances under D65, 1 for a perfect diffuser.

    Args:
        path: text file of wavelengths in nm and three sensitivities, separated by commas or blanks.
        bands: of the reflectances.
    Raises:
        MissingFileError: there is no such file.
        FileFormatError: it has not four columns of finite numbers, or a channel sees nothing of these bands.
        BandMismatchError: the bands are RGB.
    """
    if bands.is_rgb:
        raise BandMismatchError(
            f"{path}: sensitivities of a camera need a spectral library, found {bands}; leave them out"
        )
    if not path.is_file():
        raise MissingFileError(
            f"{path}: no such file; name a text file of wavelengths and three sensitivities"
        )
    try:
        lines = path.read_text(encoding="utf-8-sig").replace(",", " ").replace(";", " ").splitlines()
        rows = [line.split() for line in lines if line[:1] in "+-.0123456789" and line.strip()]
        table = np.array(rows, dtype=float)
    except (ValueError, UnicodeDecodeError):
        table = np.empty((0, 0))
    is_table = table.ndim == 2 and table.shape[1:] == (4,) and len(table) > 1 and np.isfinite(table).all()
    if not is_table or np.any(np.diff(table[:, 0]) <= 0.0):
        raise FileFormatError(
            f"{path}: expected rows of an increasing wavelength in nm and three sensitivities"
        )
    nodes = np.arange(table[0, 0], table[-1, 0], 1.0)
    seen = interpolation_matrix(table[:, 0], nodes) @ np.maximum(table[:, 1:], 0.0)
    seen *= Illuminant.named("D65").at(nodes)[:, None]
    responses = interpolation_matrix(np.asarray(bands.wavelengths_nm), nodes).T @ seen
    if not np.all(responses.sum(axis=0) > 0.0):
        raise FileFormatError(f"{path}: a channel sees nothing of {bands}, expected sensitivities above 0")
    return np.asarray((responses / responses.sum(axis=0)).T)


def band_matrix(library: Library, names: tuple[str, ...], responses: Array) -> Array:
    """The matrix (B, 3) from channels of a camera to the bands of a library, by Wiener estimation.

    Deviations from a flat spectrum are linear in those of the channels, both relative to the mean of these: a neutral
    colour stays neutral. Learned from the library's materials, off their highlights, and from measured reflectances.

    Args:
        library: of B bands.
        names: of the materials to learn from.
        responses: of the camera, see `srgb_responses`.
    Source: Haneishi et al. 2000, "System design for accurately estimating the spectral reflectance of art paintings".
    """
    if library.bands.is_rgb:
        return np.eye(3)
    spectra = np.vstack([_of_materials(library, names), _measured(library.bands)])
    return wiener_matrix(spectra, responses)


def wiener_matrix(spectra: Array, responses: Array) -> Array:
    """The same from spectra (n, B) and responses (3, B)."""
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


@cache
def _measured(bands: Bands) -> Array:
    at = np.asarray(bands.wavelengths_nm)
    nm = np.arange(400.0, 701.0, _STEP_NM)
    to_bands = interpolation_matrix(nm, at)
    return np.array([to_bands @ diffuse_reflectance(name, nm) for name in diffuse_reflectance_names()])

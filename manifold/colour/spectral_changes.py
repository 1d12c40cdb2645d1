"""Spectra that are changed as linear sRGB says: of points of a surface, or of a colour that a picture shows."""

from __future__ import annotations

import numpy as np

from manifold.colour.conversion import to_srgb
from manifold.records import Array, Bands

NODES_NM = (460.0, 540.0, 605.0)
"""Where blue, green and red weigh alone; between them two share, so that the weights of a wavelength sum to 1."""

_LEAST = 1e-3  # of a weight's change, so that spectra stay positive


def weights_at(wavelengths_nm: Array) -> Array:
    """Shares of red, green and blue at wavelengths, piecewise linear, sums 1, shape (W, 3)."""
    blue, green, red = (np.interp(wavelengths_nm, NODES_NM, row) for row in np.eye(3))
    return np.stack([red, green, blue], axis=-1)


def spectral_changes(ratios: Array, mean: Array, bands: Bands) -> Array:
    """Changes of red, green and blue weights that give points their colours.

    The spectrum of a point is that of the mean times `weights_at(wavelengths) @ changes`: smooth, never negative, and
    that of the mean where all ratios are 1. Its linear sRGB has the given ratios to the mean's, except for points so
    saturated that a weight would be negative.

    Args:
        ratios: linear sRGB over the mean's, shape (..., 3), above 0.
        mean: spectrum of the mean, shape (B,).
        bands: of it; for RGB bands the ratios are the changes.
    Returns:
        Changes, shape (..., 3), above 0.
    """
    if bands.is_rgb:
        return ratios
    weights = weights_at(np.asarray(bands.wavelengths_nm))
    mixing = np.stack([to_srgb(mean * weight, bands) for weight in weights.T], axis=-1)
    mixing /= to_srgb(mean, bands)[:, None]  # rows sum to 1
    return np.asarray(np.maximum(ratios @ np.linalg.inv(mixing).T, _LEAST))

"""Conversion of readings to the bands of a library, and of weights to all of its bands."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from manifold.colour.conversion import to_srgb
from manifold.colour.narrow_bands import with_spectra
from manifold.errors import BandMismatchError
from manifold.formats.readings import Readings
from manifold.records import Array, Bands

_FEW = 3  # bands, other than blue, green and red, that are no colour


def for_library(readings: Readings, bands: Bands) -> Readings:
    """Readings that a library of some bands can complete: linear sRGB for an RGB library, spectra for any.

    Three narrow bands become spectra, see `colour.narrow_bands`.

    Raises:
        BandMismatchError: linear sRGB cannot become a spectrum; or bands are no colour, for an RGB library.
    """
    readings = with_spectra(readings)
    nm = readings.wavelengths_nm
    if not bands.is_rgb and nm is None:
        raise BandMismatchError(
            f"{readings.name}: readings in linear sRGB, expected wavelengths for a library of {bands}; complete "
            "them with an RGB library"
        )
    if bands.is_rgb and nm is not None and len(nm) <= _FEW:
        raise BandMismatchError(
            f"{readings.name}: {readings.bands}, expected blue, green and red, or a spectrum, for an RGB library; "
            "complete them with a spectral one"
        )
    return readings


def bands_of(readings: Readings, bands: Bands) -> Bands:
    """Those of what is completed from readings: of a library, or of spectra that its colours are less than."""
    return readings.bands if bands.is_rgb else bands


def in_srgb(readings: Readings) -> Readings:
    """Readings whose spectra, if they are such, are converted to linear sRGB under D65."""
    nm = readings.wavelengths_nm
    if nm is None:
        return readings
    rgb = np.full((len(readings), 3), np.nan)
    values = _without_gaps(readings.values, nm)
    whole = np.isfinite(values).all(axis=1)
    rgb[whole] = to_srgb(values[whole], readings.bands)
    converted = replace(readings, wavelengths_nm=None, values=rgb)
    return converted.with_note(
        "spectra are converted to linear sRGB under D65, as photographs have three channels"
    )


def _without_gaps(values: Array, nm: Array) -> Array:
    """Spectra (P, B) with gaps between measured bands interpolated; unmeasured ends stay NaN."""
    filled = values.copy()
    for row in filled:
        known = np.isfinite(row)
        if known.any():
            row[~known] = np.interp(nm[~known], nm[known], row[known], left=np.nan, right=np.nan)
    return filled


def in_all_bands(weights: Array, readings: Readings, bands: Bands) -> Array:
    """Weights (B_r, n) at the bands of readings, interpolated to all B bands of a library; constant outside."""
    if bands.wavelengths_nm is None or readings.wavelengths_nm is None:
        return weights
    used = np.flatnonzero(weights.any(axis=0))
    spread = np.zeros((bands.count, weights.shape[1]))
    at = np.array(bands.wavelengths_nm)
    for k in used:
        spread[:, k] = np.interp(at, readings.wavelengths_nm, weights[:, k])
    return spread


def beyond(readings: Readings, bands: Bands) -> tuple[float, float] | None:
    """First and last wavelength of the readings in nm, where the library's range is larger; else None."""
    nm, of_library = readings.wavelengths_nm, bands.wavelengths_nm
    if nm is None or of_library is None:
        return None
    low, high = float(nm[0]), float(nm[-1])
    return (low, high) if of_library[0] < low - 1.0 or of_library[-1] > high + 1.0 else None

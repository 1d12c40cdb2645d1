"""Estimates spectra from three narrow bands (blue, green, red, as in camera-like instruments) or widely spaced bands.

Three narrow bands are neither linear sRGB nor a spectrum that could be interpolated, and spectra interpolated between
widely spaced bands have wrong colours. A linear map, learned from measured reflectances, predicts the rest of the
spectrum. It maps the deviations of the bands from a flat spectrum to the deviations of the spectrum, in cube roots and
relative to the mean of the bands. The estimate is proportional to the measured values, and a neutral colour stays
neutral.

Source: Wiener estimation; Haneishi et al. 2000, "System design for accurately estimating the spectral reflectance of
art paintings".
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np

from manifold.colour.colour_science import colour_science
from manifold.colour.conversion import interpolation_matrix, to_xyz, xyz_to_srgb, xyz_weights
from manifold.colour.difference import VISIBLE, delta_e_2000, delta_e_2000_lab, lab_under_d65, lab_values
from manifold.colour.reflectances import diffuse_reflectance, diffuse_reflectance_names
from manifold.core.errors import UsageError
from manifold.core.names import counted
from manifold.core.records import Array, Bands, Mask
from manifold.formats.readings import DAYLIGHT, Readings, Viewing

SPECTRUM = Bands(tuple(np.arange(400.0, 701.0, 10.0).tolist()))
"""The bands of estimated spectra."""
_RANGES_NM = ((400.0, 500.0), (480.0, 580.0), (580.0, 700.0))
_RANGE_NM = (380.0, 730.0)  # of bands that tell of spectra from 400 to 700 nm
# Gap, first and last band in nm up to which interpolation stays below that: 0.9 for one colour in ten.
_DENSE_NM, _FIRST_NM, _LAST_NM = 25.0, 420.0, 680.0
_NOISE = 0.02  # standard deviation of the noise of cube roots, relative to their mean


def is_narrow(bands: Bands) -> bool:
    """Return whether there are three bands: one in the blue, one in the green and one in the red."""
    nm = bands.wavelengths_nm
    return (
        nm is not None
        and len(nm) == len(_RANGES_NM)
        and all(low <= at <= high for at, (low, high) in zip(nm, _RANGES_NM, strict=True))
    )


def is_coarse(bands: Bands) -> bool:
    """Return whether there are four or more visible bands whose interpolation changes one colour in ten visibly."""
    nm = np.array(bands.wavelengths_nm or ())[_visible(bands)]
    if len(nm) <= len(_RANGES_NM):
        return False
    is_dense = np.diff(nm).max() <= _DENSE_NM and nm[0] <= _FIRST_NM and nm[-1] >= _LAST_NM
    return not is_dense and interpolation_errors(bands)[1] > VISIBLE


def _visible(bands: Bands) -> Mask:
    """Return a mask of the bands (B,) from which spectra are estimated."""
    nm = np.array(bands.wavelengths_nm or ())
    return np.asarray((nm >= _RANGE_NM[0]) & (nm <= _RANGE_NM[1]))


def estimate_spectra(values: Array, bands: Bands) -> Array:
    """Estimate values in `SPECTRUM`, shape (..., 31), never negative, from narrow or coarse bands, shape (..., B)."""
    return _estimated(np.asarray(values, dtype=np.float64)[..., _visible(bands)], _matrix(bands))


def with_spectra(readings: Readings) -> Readings:
    """Return readings in three narrow bands as spectra, see `as_spectra`; others are converted by `in_daylight`."""
    return as_spectra(readings) if is_narrow(readings.bands) else in_daylight(readings)


def as_spectra(readings: Readings) -> Readings:
    """Return readings in narrow or coarse bands as spectra, with a note about the expected error of their colours.

    Raises UsageError if no reading has all bands.
    """
    values = np.full((len(readings), SPECTRUM.count), np.nan)
    visible = _visible(readings.bands)
    whole = readings.measured[:, visible].all(axis=1)
    if not np.any(whole):
        raise UsageError(
            f"{readings.name}: no direction was measured in all of {readings.bands}, from which spectra are estimated; "
            "read each direction in all bands"
        )
    values[whole] = estimate_spectra(readings.values[whole], readings.bands)
    errors = colour_errors(readings.bands)
    nm = ", ".join(f"{at:g}" for at in np.array(readings.bands.wavelengths_nm)[visible])
    note = f"spectra are estimated from {visible.sum()} bands at {nm} nm: {_error_in_words(errors)}"
    if is_narrow(readings.bands):
        note += "; a correction of this instrument (`manifold calibrate`) has a smaller error"
    if not np.all(whole):
        note += f"; {counted(int(np.sum(~whole)), 'reading')} without all bands left out"
    estimated = replace(
        readings,
        wavelengths_nm=np.array(SPECTRUM.wavelengths_nm),
        values=values,
        colour_error=errors[0],
        estimated_from=int(visible.sum()),
    )
    return estimated.with_note(note)


def interpolation_note(bands: Bands) -> str:
    """Return a note on the error of colours that are interpolated between coarse bands."""
    return f"colours are interpolated between {bands}: {_error_in_words(interpolation_errors(bands))}"


def _error_in_words(errors: tuple[float, float]) -> str:
    return f"expected colour error {errors[0]:.1f} CIEDE2000 (D65/2), above {errors[1]:.1f} for one colour in ten"


def in_daylight(readings: Readings) -> Readings:
    """Convert readings in linear sRGB to D65/2, with a note about the error, if they had another light or observer.

    Spectral readings are returned unchanged.
    """
    if readings.wavelengths_nm is not None or readings.viewing == DAYLIGHT:
        return readings
    lab = lab_values(readings.values, readings.bands)
    white = xyz_weights(readings.bands).sum(axis=0)
    seen = np.isfinite(lab).all(axis=1)
    values = np.full_like(readings.values, np.nan)
    xyz = colour_science().Lab_to_XYZ(lab_under_d65(lab[seen], readings.viewing), white[:2] / white.sum())
    values[seen] = xyz_to_srgb(xyz) / np.pi
    median, most = conversion_errors(readings.viewing)
    note = (
        f"colours under {readings.viewing} are converted to D65/2 assuming smooth spectra: "
        f"{_error_in_words((median, most))}"
    )
    converted = replace(
        readings,
        values=values,
        viewing=DAYLIGHT,
        is_viewing_assumed=False,
        colour_error=max(median, readings.colour_error),
    )
    return converted.with_note(note)


@lru_cache(maxsize=8)
def conversion_errors(viewing: Viewing) -> tuple[float, float]:
    """Return median and 90th percentile of CIEDE2000 for measured reflectances converted from a viewing to D65/2."""
    f = _reflectances()[1] / np.pi
    found = lab_under_d65(lab_values(f, SPECTRUM, viewing), viewing)
    errors = delta_e_2000_lab(found, lab_values(f, SPECTRUM))
    return float(np.median(errors)), float(np.percentile(errors, 90))


@lru_cache(maxsize=8)
def colour_errors(bands: Bands) -> tuple[float, float]:
    """Return median and 90th percentile of CIEDE2000 (D65) of measured reflectances that are estimated from the others.

    Reflectances of the same name, such as one patch of several ColorCheckers, are left out together.
    """
    names, spectra = _reflectances()
    read = _read(spectra, bands)
    estimates = np.empty_like(spectra)
    for name in set(names):
        own = np.array([other == name for other in names])
        estimates[own] = _estimated(read[own], _learned(spectra[~own], read[~own]))
    return _errors(to_xyz(estimates, SPECTRUM), spectra)


@lru_cache(maxsize=8)
def interpolation_errors(bands: Bands) -> tuple[float, float]:
    """Return median and 90th percentile of CIEDE2000 (D65) of measured reflectances interpolated between bands."""
    spectra = _reflectances()[1]
    return _errors(to_xyz(_at(spectra, np.array(bands.wavelengths_nm)), bands), spectra)


def _errors(xyz: Array, spectra: Array) -> tuple[float, float]:
    """Return median and 90th percentile of CIEDE2000 between XYZ colours (n, 3) and the colours of spectra (n, 31)."""
    white = to_xyz(np.ones(SPECTRUM.count), SPECTRUM)
    errors = delta_e_2000(xyz, to_xyz(spectra, SPECTRUM), white)
    return float(np.median(errors)), float(np.percentile(errors, 90))


def _estimated(values: Array, matrix: Array) -> Array:
    roots = np.cbrt(np.maximum(values, 0.0))
    level = roots.mean(axis=-1, keepdims=True)
    return np.asarray(np.maximum(level + (roots - level) @ matrix, 0.0) ** 3)


@lru_cache(maxsize=8)
def _matrix(bands: Bands) -> Array:
    spectra = _reflectances()[1]
    return _learned(spectra, _read(spectra, bands))


def _read(spectra: Array, bands: Bands) -> Array:
    """Return spectra (n, 31) at the visible bands."""
    return _at(spectra, np.array(bands.wavelengths_nm)[_visible(bands)])


def _learned(spectra: Array, read: Array) -> Array:
    """Return the matrix (B, 31) that maps deviations of bands to deviations of spectra.

    The n examples have spectra (n, 31) and readings (n, B).
    """
    roots = np.cbrt(read)
    level = roots.mean(axis=1, keepdims=True)
    of_bands, of_spectra = roots / level - 1.0, np.cbrt(spectra) / level - 1.0
    covariance = of_bands.T @ of_bands / len(read) + _NOISE**2 * np.eye(read.shape[1])
    return np.asarray(np.linalg.solve(covariance, of_bands.T @ of_spectra / len(read)))


def _at(spectra: Array, nm: Array) -> Array:
    return spectra @ interpolation_matrix(np.array(SPECTRUM.wavelengths_nm), nm).T


@lru_cache(maxsize=1)
def _reflectances() -> tuple[list[str], Array]:
    """Return names, without their sets, and spectra (n, 31) of all measured reflectances."""
    names = diffuse_reflectance_names()
    spectra = [diffuse_reflectance(name, np.array(SPECTRUM.wavelengths_nm)) for name in names]
    return [name.partition("/")[2].lower() for name in names], np.array(spectra)

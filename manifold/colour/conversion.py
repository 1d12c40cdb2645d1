"""Converts values in bands to CIE XYZ and sRGB, and between these."""

from __future__ import annotations

import warnings
from dataclasses import replace
from functools import lru_cache

import numpy as np

from manifold.colour.colour_science import frozen, standard_tables, wide_observer
from manifold.colour.illuminants import Illuminant
from manifold.core.errors import ShapeError, UsageError
from manifold.core.records import Array, Bands, BsdfFile

SRGB_TO_XYZ = frozen(
    np.array(
        [
            [0.41239079926595934, 0.35758433938387796, 0.1804807884018343],
            [0.2126390058715103, 0.7151686787677559, 0.07219231536073371],
            [0.019330818715591825, 0.11919477979462595, 0.9505321522496606],
        ]
    )
)
"""The matrix from linear sRGB to XYZ, computed from the primaries and white of IEC 61966-2-1."""
_RGB_WEIGHTS = frozen(SRGB_TO_XYZ.T.copy())

VISIBLE_NM = (380.0, 780.0)
"""The range of visible wavelengths, in nm."""


class InvisibleBandsWarning(UserWarning):
    """Warns that a colour is requested although all bands are in the infrared or ultraviolet."""


def to_xyz(values: Array, bands: Bands, illuminant: str = "D65") -> Array:
    """Return CIE XYZ (..., 3) of reflectance-like spectra (..., B).

    A perfect diffuser has Y = 1 under every illuminant.

    The spectrum is interpolated linearly between the bands, constant beyond them, and integrated in steps of 1 nm
    with the illuminant times the 2 degree observer of 1931. Linear sRGB values (RGB bands) have no spectrum: the sRGB
    matrix converts them, and the illuminant has no effect, but must exist.

    >>> bands = Bands(tuple(range(400, 701, 10)))
    >>> to_xyz(np.ones(bands.count), bands, "A").round(3)
    array([1.098, 1.   , 0.356])
    """
    return _require_bands(values, bands) @ xyz_weights(bands, illuminant)


def to_srgb(values: Array, bands: Bands, illuminant: str = "D65", *, adapt: bool = True) -> Array:
    """Convert reflectance-like spectra to linear sRGB (Rec. 709 primaries, not clipped), shape (..., 3).

    With `adapt` the white of the illuminant is adapted to D65 (Bradford), so that a perfect diffuser is (1, 1, 1)
    under every illuminant, as for an adapted observer. Without it, colours under illuminant A are orange. Values of
    RGB bands are returned unchanged.

    Args:
        values: spectra, shape (..., B).
        bands: the B bands of the spectra.
        illuminant: one of `illuminant_names()`.
        adapt: whether the illuminant's white is adapted to D65.

    Raises:
        UsageError: there is no such illuminant, or it has no power at visible wavelengths.
        ShapeError: the last axis of `values` is not B.

    >>> bands = Bands(tuple(range(400, 701, 10)))
    >>> to_srgb(0.5 * np.ones(bands.count), bands, "A").round(3)
    array([0.5, 0.5, 0.5])
    """
    values = _require_bands(values, bands)
    weights = xyz_weights(bands, illuminant)
    if bands.is_rgb:
        return values.copy()
    warn_if_invisible(bands)
    return values @ xyz_to_srgb(weights, weights.sum(axis=0) if adapt else None)


@lru_cache(maxsize=64)
def warn_if_invisible(bands: Bands) -> None:
    """Warn once if no band is visible, because colours are then meaningless greys."""
    low, high = VISIBLE_NM
    if not any(low <= nm <= high for nm in bands.wavelengths_nm or VISIBLE_NM):
        warnings.warn(
            f"{bands} are not visible and have no colour, expected bands between {low:g} and {high:g} nm; the colours "
            "shown are those of the nearest bands, extrapolated",
            InvisibleBandsWarning,
            stacklevel=4,
        )


def file_to_srgb(file: BsdfFile) -> BsdfFile:
    """Return a file with its values in linear sRGB under D65."""
    rgb = to_srgb(np.moveaxis(file.spectra, 2, -1), file.bands).astype(np.float32)
    return replace(file, wavelengths_nm=None, spectra=np.moveaxis(rgb, -1, 2))


def luminance(values: Array, bands: Bands) -> Array:
    """Return Y of reflectance-like spectra (..., B), shape (...), 1 for a perfect diffuser.

    The light is D65, so that the result agrees with Y of linear sRGB, and spectral and RGB materials can be
    compared.
    """
    weights = _RGB_WEIGHTS if bands.is_rgb else xyz_weights(bands)
    return _require_bands(values, bands) @ weights[:, 1]


@lru_cache(maxsize=64)
def xyz_weights(bands: Bands, illuminant: str = "D65", observer_deg: int = 2) -> Array:
    """Return the read-only matrix (B, 3) from band values to XYZ; see `to_xyz`.

    Linear sRGB is defined only for the 2 degree observer.
    """
    light = Illuminant.named(illuminant)
    if bands.is_rgb:
        return _RGB_WEIGHTS
    nodes, weights = sensor_responses(light, observer_deg)
    return frozen(interpolation_matrix(np.asarray(bands.wavelengths_nm), nodes).T @ weights)


def sensor_responses(illuminant: Illuminant, observer_deg: int = 2) -> tuple[Array, Array]:
    """Return wavelengths (K,) every 1 nm and the illuminant times colour-matching functions, (K, 3).

    The observer is the CIE standard observer of 2 degrees (1931) or 10 degrees (1964). The sums over wavelengths
    are the XYZ of the perfect diffuser, with Y = 1.
    """
    if observer_deg not in (2, 10):
        raise UsageError(f"an observer of {observer_deg} degrees, expected 2 (CIE 1931) or 10 (CIE 1964)")
    nodes, matching = standard_tables().observer if observer_deg == 2 else wide_observer()
    stimulus = illuminant.at(nodes)[:, None] * matching
    total = stimulus[:, 1].sum()
    if total <= 0.0:
        raise UsageError(
            f"illuminant {illuminant.name!r} gives no visible light; choose another, such as D65"
        )
    return nodes, stimulus / total


def interpolation_matrix(nodes: Array, at: Array) -> Array:
    """Return the matrix (K, n) of linear interpolation from n nodes to K points, constant beyond the ends."""
    return np.stack([np.interp(at, nodes, row) for row in np.eye(len(nodes))], axis=1)


def xyz_to_srgb(xyz: Array, white: Array | None = None) -> Array:
    """Convert XYZ (..., 3) to linear sRGB, not clipped.

    `white` (3,), by default D65, is the XYZ that becomes (1, 1, 1).
    """
    to_rgb = np.linalg.inv(SRGB_TO_XYZ)
    if white is not None:
        to_rgb = to_rgb @ _adaptation(np.asarray(white, float), SRGB_TO_XYZ.sum(axis=1))
    return np.asarray(xyz) @ to_rgb.T


def srgb_to_xyz(linear: Array) -> Array:
    """Convert linear sRGB (..., 3) to CIE XYZ; the white is D65 with Y = 1."""
    return np.asarray(linear) @ SRGB_TO_XYZ.T


def encode_srgb(linear: Array) -> Array:
    """Encode linear sRGB in [0, 1], shape (..., 3), as display values in [0, 1] (IEC 61966-2-1)."""
    linear = np.clip(linear, 0.0, 1.0)
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1.0 / 2.4) - 0.055)


def decode_srgb(display: Array) -> Array:
    """Decode display values in [0, 1], any shape, to linear sRGB (IEC 61966-2-1)."""
    display = np.asarray(display, dtype=np.float64)
    curve = ((np.maximum(display, 0.0) + 0.055) / 1.055) ** 2.4
    return np.where(display <= 12.92 * 0.0031308, display / 12.92, curve)


def _adaptation(white: Array, target: Array) -> Array:
    """Return Bradford's matrix (3, 3) that takes XYZ seen under one white to XYZ seen under another."""
    bradford = standard_tables().bradford
    return np.linalg.inv(bradford) @ np.diag(bradford @ target / (bradford @ white)) @ bradford


def _require_bands(values: Array, bands: Bands) -> Array:
    values = np.asarray(values, dtype=np.float64)
    if values.ndim == 0 or values.shape[-1] != bands.count:
        raise ShapeError(f"values have shape {values.shape}, expected (..., {bands.count}) for {bands}")
    return values

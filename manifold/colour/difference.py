"""Computes colour differences, CIEDE2000 and spectral angle, at the geometries of multi-angle instruments.

Light comes in at 45 degrees; the detectors lie in the plane of incidence at aspecular angles of -15, 15, 25,
45, 75 and 110 degrees, counted from the mirror direction towards the light, as in ASTM E2194 and E2539 for
metallic and interference coatings. The compared quantity is the radiance factor, pi f, which is 1 for a perfect
diffuser in all directions, and may be far above 1 near the mirror direction.
"""

from __future__ import annotations

import numpy as np

from manifold.colour.colour_science import colour_science
from manifold.colour.conversion import sensor_responses, srgb_to_xyz, to_xyz, xyz_to_srgb, xyz_weights
from manifold.colour.illuminants import Illuminant, illuminant_power
from manifold.colour.reflectances import BEYOND_COLOURS, beyond_reflectances, srgb_spectra
from manifold.core.directions import from_spherical
from manifold.core.errors import ShapeError
from manifold.core.metrics import spectral_angle
from manifold.core.records import Array, Bands
from manifold.formats.readings import DAYLIGHT, Viewing

INCIDENCE_DEG = 45.0
ASPECULAR_DEG = (-15.0, 15.0, 25.0, 45.0, 75.0, 110.0)
VISIBLE = (
    1.0  # CIEDE2000 of a visible difference: half of observers see 0.8 side by side (Paravina et al. 2015)
)
ITP_WHITE_CD_M2 = 100.0  # luminance of white on the display that Delta E_ITP is about
ILLUMINANTS = ("D65", "A", "F11")


def multi_angle_pairs() -> tuple[Array, Array]:
    """Return the direction pairs of the six geometries: wi and wo, each of shape (6, 3)."""
    wi = from_spherical(np.deg2rad(INCIDENCE_DEG), 0.0)
    towards_light = np.deg2rad(np.array(ASPECULAR_DEG) - INCIDENCE_DEG)  # elevation, negative on the far side
    wo = from_spherical(np.abs(towards_light), np.where(towards_light < 0, np.pi, 0.0))
    return np.broadcast_to(wi, wo.shape).copy(), wo


def illuminants_for(bands: Bands) -> tuple[str, ...]:
    """Return the illuminants under which colours are compared; only D65 for linear sRGB, which has no spectrum."""
    return ("D65",) if bands.is_rgb else ILLUMINANTS


def colour_differences(f: Array, f_star: Array, bands: Bands, illuminant: str) -> tuple[Array, Array]:
    """Return CIEDE2000 (...) and spectral angle (...) in degrees between BRDF values f and f_star (..., B) in 1/sr.

    Colours are relative to the illuminant's white. The spectral angle is the angle between the spectra of the
    reflected light, or between linear sRGB vectors for RGB bands.
    """
    f, f_star = np.asarray(f), np.asarray(f_star)
    if f.shape != f_star.shape:
        raise ShapeError(f"f has shape {f.shape}, f_star {f_star.shape}, expected the same (..., bands)")
    white = xyz_weights(bands, illuminant).sum(axis=0)
    xyz, xyz_star = (to_xyz(np.pi * values, bands, illuminant) for values in (f, f_star))
    light = illuminant_power(bands, illuminant)
    return delta_e_2000(xyz, xyz_star, white), np.rad2deg(spectral_angle(f * light, f_star * light))


def to_lab(xyz: Array, white: Array) -> Array:
    """Convert CIE XYZ (..., 3) seen under a white (3,) with Y = 1 to CIELAB (..., 3)."""
    white = np.asarray(white)
    return np.asarray(colour_science().XYZ_to_Lab(np.asarray(xyz), white[:2] / np.sum(white)))


def lab_values(f: Array, bands: Bands, viewing: Viewing = DAYLIGHT) -> Array:
    """Return CIELAB (..., 3) of f (..., B) in 1/sr, as radiance factors; for linear sRGB under D65/2."""
    weights = xyz_weights(bands, *viewing)
    return to_lab(np.pi * np.asarray(f) @ weights, weights.sum(axis=0))


def is_beyond_reflectances(lab: Array, share: float = BEYOND_COLOURS) -> bool:
    """Return whether a CIELAB colour (3,) is clearly outside the colours of reflectances from 0 to 1 under D65.

    With the default margin, fluorescent paints lie inside.
    """
    white = srgb_to_xyz(np.ones(3))
    xyz = np.asarray(colour_science().Lab_to_XYZ(lab, white[:2] / white.sum()))
    return bool(beyond_reflectances(xyz_to_srgb(xyz)) > share)


def lab_under_d65(lab: Array, viewing: Viewing) -> Array:
    """Convert CIELAB (..., 3) under another light or for another observer to D65 and the 2 degree observer.

    Input and output are relative to the white of their light and observer. The colour does not determine the
    spectrum; a combination of smooth spectra of the primaries is assumed.
    Source: Mallett & Yuksel 2019, for the spectra.
    """
    if viewing == DAYLIGHT:
        return np.asarray(lab, dtype=np.float64)
    nm, weights = sensor_responses(Illuminant.named(viewing.illuminant), viewing.observer_deg)
    white = weights.sum(axis=0)
    xyz = np.asarray(colour_science().Lab_to_XYZ(lab, white[:2] / white.sum()))
    of_primaries = srgb_spectra(Bands(tuple(nm.tolist()))) @ weights
    linear = xyz @ np.linalg.inv(of_primaries)
    return to_lab(srgb_to_xyz(linear), srgb_to_xyz(np.ones(3)))


def delta_e_2000(xyz: Array, xyz_star: Array, white: Array) -> Array:
    """Return CIEDE2000 between colours seen under one white, shape (...).

    Args:
        xyz, xyz_star: CIE XYZ, shape (..., 3), in the units of the white.
        white: XYZ of the perfect diffuser, shape (3,), with Y = 1.
    Source: CIE 142-2001; Sharma, Wu & Dalal 2005.

    >>> white = np.array([0.9505, 1.0, 1.0891])
    >>> float(delta_e_2000(0.20 * white, 0.21 * white, white).round(2))
    1.09
    """
    return delta_e_2000_lab(to_lab(xyz, white), to_lab(xyz_star, white))


def delta_e_2000_lab(lab: Array, lab_star: Array) -> Array:
    """Return CIEDE2000 between CIELAB colours (..., 3), shape (...)."""
    return np.asarray(colour_science().delta_E(lab, lab_star, method="CIE 2000"))


def delta_e_itp(xyz: Array, xyz_star: Array) -> Array:
    """Return Delta E_ITP (...) between XYZ (..., 3) of a display with white D65, Y = 1, at 100 cd/m^2.

    A difference of 1 is just visible.

    Source: ITU-R BT.2124.
    """
    colour = colour_science()
    ictcp = [colour.XYZ_to_ICtCp(ITP_WHITE_CD_M2 * np.maximum(c, 0.0)) for c in (xyz, xyz_star)]
    return np.asarray(colour.difference.delta_E_ITP(*ictcp))

"""Colour differences of predictions: CIEDE2000 and spectral angle at the geometries of multi-angle instruments.

Light comes in at 45 degrees; the detectors stand in the plane of incidence at aspecular angles of -15, 15, 25,
45, 75 and 110 degrees, counted from the mirror direction towards the light, as in ASTM E2194 and E2539 for
metallic and interference coatings. The compared quantity is the radiance factor, pi f, which is 1 for a perfect
diffuser in all directions, and may be far above 1 near the mirror direction.
"""

from __future__ import annotations

import numpy as np

from manifold.colour.colour_science import colour_science
from manifold.colour.conversion import sensor_responses, srgb_to_xyz, to_xyz, xyz_weights
from manifold.colour.illuminants import Illuminant, illuminant_power
from manifold.colour.reflectances import srgb_spectra
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
_BT_2020 = np.array(
    [
        [1.7166511879712678, -0.35567078377639244, -0.2533662813736598],
        [-0.6666843518324888, 1.6164812366349386, 0.015768545813911117],
        [0.01763985744531079, -0.04277061325780853, 0.9421031212354739],
    ]
)
_TO_CONES = (
    np.array([[1688, 2146, 262], [683, 2951, 462], [99, 309, 3688]]) / 4096.0 @ _BT_2020
)  # BT.2100, from XYZ
_TO_ITP = (
    np.array([[2048, 2048, 0], [3305, -6806.5, 3501.5], [17933, -17390, -543]]) / 4096.0
)  # T is half of Ct


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
    """Return CIEDE2000 (...) and spectral angle (...) in degrees between two f (..., B) in 1/sr.

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
    """Convert CIE XYZ (..., 3) seen under a white (3,) with Y = 1 to CIELAB (..., 3).

    Source: CIE 15:2004, section 8.2.1.
    """
    relative = np.asarray(xyz) / (np.asarray(white) / white[1])
    x, y, z = np.moveaxis(
        np.where(relative > 216.0 / 24389.0, np.cbrt(relative), (24389.0 / 27.0 * relative + 16.0) / 116.0),
        -1,
        0,
    )
    return np.stack([116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)], axis=-1)


def lab_values(f: Array, bands: Bands, viewing: Viewing = DAYLIGHT) -> Array:
    """Return CIELAB (..., 3) of f (..., B) in 1/sr, as radiance factors; for linear sRGB under D65/2."""
    weights = xyz_weights(bands, *viewing)
    return to_lab(np.pi * np.asarray(f) @ weights, weights.sum(axis=0))


def lab_under_d65(lab: Array, viewing: Viewing) -> Array:
    """Convert CIELAB (..., 3) under another light or for another observer to D65 and the 2 degree observer.

    Both are relative to their whites. The colour does not determine the spectrum; a combination of smooth spectra
    of the primaries is assumed.
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
    """Return CIEDE2000 between CIELAB colours (..., 3), shape (...).

    Source: Sharma, Wu & Dalal 2005, eqs. 2 to 22.
    """
    (L1, a1, b1), (L2, a2, b2) = (np.moveaxis(np.asarray(c, np.float64), -1, 0) for c in (lab, lab_star))
    chroma = (np.hypot(a1, b1) + np.hypot(a2, b2)) / 2.0
    stretched = 1.5 - 0.5 * np.sqrt(chroma**7 / (chroma**7 + 25.0**7))
    a1, a2 = stretched * a1, stretched * a2
    C1, C2 = np.hypot(a1, b1), np.hypot(a2, b2)
    h1, h2 = (np.degrees(np.arctan2(b, a)) % 360.0 for a, b in ((a1, b1), (a2, b2)))
    is_grey = C1 * C2 == 0.0
    apart = np.where(is_grey, 0.0, (h2 - h1 + 180.0) % 360.0 - 180.0)
    dH = 2.0 * np.sqrt(C1 * C2) * np.sin(np.radians(apart) / 2.0)
    h = np.where(is_grey, h1 + h2, h1 + apart / 2.0)
    L, C = (L1 + L2) / 2.0, (C1 + C2) / 2.0
    terms = ((-0.17, 1.0, -30.0), (0.24, 2.0, 0.0), (0.32, 3.0, 6.0), (-0.20, 4.0, -63.0))
    T = 1.0 + sum(share * np.cos(np.radians(times * h + shift)) for share, times, shift in terms)
    S_L = 1.0 + 0.015 * (L - 50.0) ** 2 / np.sqrt(20.0 + (L - 50.0) ** 2)
    S_C, S_H = 1.0 + 0.045 * C, 1.0 + 0.015 * C * T
    turn = 60.0 * np.exp(-((((h % 360.0) - 275.0) / 25.0) ** 2))
    R_T = -2.0 * np.sqrt(C**7 / (C**7 + 25.0**7)) * np.sin(np.radians(turn))
    dL, dC, dH = (L2 - L1) / S_L, (C2 - C1) / S_C, dH / S_H
    return np.asarray(np.sqrt(np.maximum(dL**2 + dC**2 + dH**2 + R_T * dC * dH, 0.0)))


def delta_e_itp(xyz: Array, xyz_star: Array) -> Array:
    """Return Delta E_ITP (...) between XYZ (..., 3) of a display with white D65, Y = 1, at 100 cd/m^2.

    A difference of 1 is just visible.

    Source: ITU-R BT.2124, annex 1; BT.2100, table 4, for the perceptual quantiser.
    """
    itp = []
    for c in (xyz, xyz_star):
        cones = ITP_WHITE_CD_M2 / 1e4 * np.maximum(c, 0.0) @ _TO_CONES.T
        power = np.maximum(cones, 0.0) ** (1305.0 / 8192.0)
        quantised = ((107.0 + 2413.0 * power) / (128.0 + 2392.0 * power)) ** (2523.0 / 32.0)
        itp.append(quantised @ _TO_ITP.T)
    return np.asarray(720.0 * np.linalg.norm(itp[0] - itp[1], axis=-1))

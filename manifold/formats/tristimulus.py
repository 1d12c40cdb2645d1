"""Values that are no spectra: CIE XYZ, in which some instruments write, and one band without a wavelength."""

from __future__ import annotations

import numpy as np

from manifold.records import Array

_PRIMARIES_XY = ((0.64, 0.33), (0.30, 0.60), (0.15, 0.06))
_D65_XY = (0.3127, 0.3290)
_UNNAMED_NM = 550.0


def xyz_to_linear_srgb(xyz: Array) -> Array:
    """Linear sRGB (..., 3), not clipped, of XYZ under D65, Y = 1 being white. Source: IEC 61966-2-1."""
    primaries = np.array([[x / y, 1.0, (1.0 - x - y) / y] for x, y in _PRIMARIES_XY]).T
    x, y = _D65_XY
    white = np.array([x / y, 1.0, (1.0 - x - y) / y])
    matrix = primaries * np.linalg.solve(primaries, white)
    return np.asarray(xyz) @ np.linalg.inv(matrix).T


def linear_srgb_to_xyz(rgb: Array) -> Array:
    """XYZ (..., 3) of linear sRGB; the inverse of `xyz_to_linear_srgb`."""
    return np.asarray(rgb) @ np.linalg.inv(xyz_to_linear_srgb(np.eye(3)))


def converted(xyz: Array, notes: list[str]) -> Array:
    """`xyz_to_linear_srgb`, and a note of it."""
    notes.append("CIE XYZ, converted to linear sRGB")
    return xyz_to_linear_srgb(xyz)


def unnamed_band(notes: list[str]) -> Array:
    """The wavelength in nm, shape (1,), that a band without one is taken to have, and a note of it."""
    notes.append(f"one band without a wavelength: taken as {_UNNAMED_NM:g} nm")
    return np.array([_UNNAMED_NM])

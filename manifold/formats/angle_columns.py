"""Columns of directions in tables: what heads call the angles, and their unit."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Literal

import numpy as np

from manifold.directions import from_spherical
from manifold.formats.text import Place
from manifold.records import Array

ANGLES = ("theta_i", "phi_i", "theta_o", "phi_o")
RELATIVE = "phi_o - phi_i"
"""What `angle_name` calls a difference of azimuths."""

_POLAR = r"(theta|zenith|zen|polar|th|angle)+"
_AZIMUTH = r"(phi|azimuth(al)?|azi|az|azimuth(al)?angle)"
_LIGHT = r"(i|in|inc|incident|incidence|incoming|light|lighting|illumination|source|sun|solar)"
_SEEN = (
    r"(o|out|outgoing|s|sc|scat|scatter|scattered|scattering|r|refl|reflected|reflection|v|view|viewing|observer|"
    r"observation|det|detector|detection|receiver|e|exit|emission|emergence|emergent)"
)
_SPELLINGS = {
    "theta_i": rf"{_LIGHT}{_POLAR}|{_POLAR}{_LIGHT}|ti|sza|aoi|incidence|angleofincidence",
    "phi_i": rf"{_LIGHT}{_AZIMUTH}|{_AZIMUTH}{_LIGHT}|saa|poi",
    "theta_o": rf"{_SEEN}{_POLAR}|{_POLAR}{_SEEN}|ts|vza|theta",
    "phi_o": rf"{_SEEN}{_AZIMUTH}|{_AZIMUTH}{_SEEN}|vaa|phi",
    RELATIVE: rf"(d|delta|diff|rel|relative){_AZIMUTH}(angle)?|raa",
}
_GREEK = str.maketrans(
    {"\u03b8": "theta", "\u03d1": "theta", "\u03c6": "phi", "\u03d5": "phi", "\u0394": "delta"}
)
_DEGREES, _RADIANS = r"deg|°|º", r"rad(ian)?s?(?![a-z])"
_UNITS = re.compile(r"\(.*?\)|\[.*?\]|(degrees?|deg|radians?|rad)$|°|º")
_ROUNDING = 0.01  # radians


def angle_name(head: str) -> str | None:
    """Which of `ANGLES`, or `RELATIVE`, a column's head names in any usual spelling, or None."""
    text = _UNITS.sub("", head.lower().translate(_GREEK).strip())
    letters = re.sub(r"[^a-z]", "", _UNITS.sub("", text.strip(" _-")))
    return next((name for name, spelling in _SPELLINGS.items() if re.fullmatch(spelling, letters)), None)


def stated_unit(text: str) -> Literal["degrees", "radians"] | None:
    """The unit of angles that heads, or what stands above them, name."""
    if re.search(_DEGREES, text, re.IGNORECASE):
        return "degrees"
    return "radians" if re.search(_RADIANS, text, re.IGNORECASE) else None


def exceed_radians(angles: Mapping[str, Array]) -> bool:
    """Whether angles are too large for radians: elevations beyond pi, azimuths beyond a full turn."""
    return any(
        float(np.max(np.abs(values), initial=0.0))
        > (np.pi if name.startswith("theta") else 2.0 * np.pi) + _ROUNDING
        for name, values in angles.items()
    )


def directions(angles: Mapping[str, Array], place: Place, notes: list[str]) -> tuple[Array, Array, Array]:
    """Which rows are reflected light, bool (P,), and their wi and wo, (Q, 3).

    Args:
        angles: by `angle_name`, in radians, each (P,); theta_i and theta_o at least.
        place: of errors.
        notes: what was assumed is added.
    Raises:
        FileFormatError: an elevation is beyond 180 degrees, or no row is of reflected light.
    """
    for key in ("theta_i", "theta_o"):
        worst = float(np.max(np.abs(angles[key])))
        if worst > np.pi + 1e-6:
            raise place.error(f"{key} reaches {np.rad2deg(worst):.4g} degrees, expected at most 90")
    keep = np.ones(len(angles["theta_i"]), dtype=bool)
    for key in ("theta_i", "theta_o"):
        keep &= np.abs(angles[key]) <= 0.5 * np.pi + 1e-4
    if not np.all(keep):
        notes.append(f"{int((~keep).sum())} rows of transmitted light (beyond 90 degrees) are left out")
    if not np.any(keep):
        raise place.error("no rows of reflected light, expected theta below 90 degrees")
    phi_i, phi_o = angles.get("phi_i"), angles.get("phi_o", np.zeros(len(keep)))
    if RELATIVE in angles and phi_i is None:
        phi_i, phi_o = np.zeros(len(keep)), angles[RELATIVE]
        notes.append("differences of azimuths: the mirror direction is taken at 180 degrees")
    elif phi_i is None:
        phi_i = np.full(len(keep), np.pi)
        notes.append("no phi_i: the mirror direction is taken at phi_s = 0")
    return (
        keep,
        _upper(from_spherical(angles["theta_i"][keep], phi_i[keep])),
        _upper(from_spherical(angles["theta_o"][keep], phi_o[keep])),
    )


def _upper(w: Array) -> Array:
    """Directions with rounding below the horizon taken away."""
    w[:, 2] = np.maximum(w[:, 2], 0.0)
    return w

"""Converts angles, or names of geometries, to the directions of readings.

Names are `45as-15`, `r15as_45`, `45as25az90`, `45asMinus15`, `45/0`; `as15`, `-15°`, `15d`, `-15DP`.
DP (double path) marks the mean of readings from both sides; for isotropic specimens it equals the reading from one
side, which SP (single path) marks.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from manifold.core.defaults import ROUNDING
from manifold.core.directions import from_spherical
from manifold.core.names import counted
from manifold.core.records import Array, Indices, Mask
from manifold.formats.column_heads import PHASE, RELATIVE
from manifold.formats.readings import Assumption, aspecular_pair
from manifold.formats.text import ErrorContext

_ROUNDING = 0.01  # radians
_PHASE_ROUNDING = np.deg2rad(1.0)  # of angles in whole degrees


def exceed_radians(angles: Mapping[str, Array]) -> bool:
    """Return whether angles are too large for radians: polar angles beyond pi, azimuths beyond a full turn."""
    return any(
        float(np.max(np.abs(values), initial=0.0))
        > (np.pi if name.startswith("theta") else 2.0 * np.pi) + _ROUNDING
        for name, values in angles.items()
    )


def directions(
    angles: Mapping[str, Array],
    context: ErrorContext,
    notes: list[str],
    heads: Mapping[str, str] = MappingProxyType({}),
    where: Callable[[int], str] | None = None,
) -> tuple[Mask, Array, Array]:
    """Return a mask (P,) of the rows of reflected light, and the wi and wo (Q, 3) of these rows.

    `angles` holds arrays (P,) in radians by `angle_name`, at least theta_i and theta_o. Assumptions are added to
    `notes`. For notes and errors, `heads` are the file's headings of the angles, and `where` describes a row.
    """
    keep = np.ones(len(angles["theta_i"]), dtype=bool)
    for key in ("theta_i", "theta_o"):
        worst = float(np.max(np.abs(angles[key])))
        if worst > np.pi + 1e-6:
            raise context.error(f"{key} reaches {np.rad2deg(worst):.4g} degrees, expected at most 90")
        keep &= np.abs(angles[key]) <= 0.5 * np.pi + 1e-4
    is_alone = ~keep & (np.abs(angles["theta_o"]) <= 0.5 * np.pi + 1e-4)
    if np.any(is_alone):
        row = int(np.argmax(is_alone))
        raise context.error(
            f"incidence of {np.rad2deg(abs(angles['theta_i'][row])):.4g} degrees, expected at most 90",
            f"row {row + 1} of the values" if where is None else where(row),
            remedy="correct the angle",
        )
    if (left := int((~keep).sum())) > 0:
        rows = f"{counted(left, 'row')} of transmitted light (beyond 90 degrees)"
        notes.append(f"{rows} {'is' if left == 1 else 'are'} left out")
    if not np.any(keep):
        raise context.error("no rows of reflected light, expected theta below 90 degrees")
    phi_i, phi_o = angles.get("phi_i"), angles.get("phi_o")
    if PHASE in angles:
        angles = _with_relative_azimuth(angles, keep, context, notes)
    if RELATIVE in angles:
        if phi_i is not None or phi_o is not None:
            raise context.error("dphi beside phi_i or phi_o, expected either the difference or both azimuths")
        phi_i, phi_o = np.zeros(len(keep)), angles[RELATIVE]
        head = heads.get(RELATIVE)
        between = (
            f"azimuth '{head}', between the planes of light and eye" if head else "differences of azimuths"
        )
        notes.append(Assumption(f"{between}: the mirror direction is taken at 180 degrees"))
    elif phi_i is None:
        phi_i = np.full(len(keep), np.pi)
        if phi_o is None:
            notes.append(
                Assumption("no azimuths: all directions are assumed on the side of the mirror direction")
            )
        else:
            seen = heads.get("phi_o", "phi_o")
            notes.append(
                Assumption(f"no azimuth of the light: the mirror direction is taken at {seen} = 0 degrees")
            )
    elif phi_o is None:
        raise context.error("phi_i without phi_o, expected both azimuths")
    if phi_o is None:
        phi_o = np.zeros(len(keep))
    wi, wo = (
        from_spherical(angles["theta_i"][keep], phi_i[keep]),
        from_spherical(angles["theta_o"][keep], phi_o[keep]),
    )
    wi[:, 2], wo[:, 2] = np.maximum(wi[:, 2], 0.0), np.maximum(wo[:, 2], 0.0)  # rounding at the horizon
    return keep, wi, wo


def _with_relative_azimuth(
    angles: Mapping[str, Array], keep: Mask, context: ErrorContext, notes: list[str]
) -> Mapping[str, Array]:
    """Return the angles with the difference of azimuths that phase angles imply; check azimuths that are given."""
    theta_i, theta_o, phase = (np.where(keep, angles[key], 0.0) for key in ("theta_i", "theta_o", PHASE))
    across = np.sin(theta_i) * np.sin(theta_o)
    least, most = np.abs(theta_i - theta_o), theta_i + theta_o
    if RELATIVE in angles or "phi_o" in angles:
        azimuth = angles[RELATIVE] if RELATIVE in angles else angles["phi_o"] - angles.get("phi_i", np.pi)
        cosine = np.cos(theta_i) * np.cos(theta_o) + across * np.cos(azimuth)
        off = np.abs(np.arccos(np.clip(cosine, -1.0, 1.0)) - phase)
        expected = "those of the other angles"
    else:
        off = np.maximum(least - phase, phase - most)
        expected = "between the difference and the sum of incidence and emission"
        cosine = np.cos(phase) - np.cos(theta_i) * np.cos(theta_o)
        cosine = np.divide(cosine, across, out=np.ones_like(across), where=across > ROUNDING)
        angles = {**angles, RELATIVE: np.arccos(np.clip(cosine, -1.0, 1.0))}
        notes.append(
            Assumption(
                "azimuths follow from phase angles, of a sample that is symmetric about the plane of incidence"
            )
        )
    if np.any(off[keep] > _PHASE_ROUNDING):
        worst = int(np.argmax(np.where(keep, off, 0.0)))
        raise context.error(
            f"phase angle {np.rad2deg(phase[worst]):.4g} degrees at incidence {np.rad2deg(theta_i[worst]):.4g} and "
            f"emission {np.rad2deg(theta_o[worst]):.4g}, expected {expected}"
        )
    return angles


class SingleValues(NamedTuple):
    """Rows of one value at one pair of directions and one wavelength, arranged as a table (P, B).

    Attributes:
        first: index of the first row of every direction pair, shape (P,).
        wavelengths_nm: wavelengths in nm, shape (B,).
        cell: index of every row in the flattened table, shape (n,).
    """

    first: Indices
    wavelengths_nm: Array
    cell: Indices

    def table(self, rows: Array) -> Array:
        """Arrange values of the rows (n,) as a table (P, B), with means of repeated values and NaN for missing ones."""
        count = np.bincount(self.cell, minlength=self.first.size * self.wavelengths_nm.size)
        with np.errstate(invalid="ignore"):
            mean = np.bincount(self.cell, rows, len(count)) / count
        return mean.reshape(self.first.size, -1)

    @property
    def repeated(self) -> int:
        """Return the number of rows with the same directions and wavelength as an earlier row."""
        return len(self.cell) - len(np.unique(self.cell))


def by_band(where: Array, nm: Array, context: ErrorContext) -> SingleValues:
    """Arrange rows at angles or directions (n, d) and wavelengths (n,) in nm by pair and band."""
    bands, band = np.unique(np.round(nm, 6), return_inverse=True)
    _, first, inverse = np.unique(np.round(where, 9), axis=0, return_index=True, return_inverse=True)
    order = np.argsort(first)
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order))
    if len(first) * bands.size > 10 * len(nm) + 1000:
        raise context.error(
            f"{bands.size} bands at {len(first)} pairs of directions in {len(nm)} rows: few have a value"
        )
    return SingleValues(first[order], bands, rank[inverse.reshape(-1)] * bands.size + band.reshape(-1))


_LONGEST = 40  # letters; names of geometries are shorter
_DEGREES = r"(°|º|deg|degrees?|d)?"
_SIGN = r"([-_+]|m|minus)?"
_NAME = re.compile(
    rf"""[^\d+-]*                                      # r, R, Geometry:
    (?P<anchor>\d+(\.\d+)?){_DEGREES}[:/_]?
    (as|asp|aspecular)(?P<sign>{_SIGN})(?P<aspecular>\d+(\.\d+)?){_DEGREES}
    ([_,/]?(az|azimuth)[:=]?(?P<side>{_SIGN})(?P<azimuth>\d+(\.\d+)?){_DEGREES})?""",
    re.IGNORECASE | re.VERBOSE,
)
_TWO = re.compile(
    rf"[^\d+-]*(?P<first>\d+){_DEGREES}[a-z]?(?P<between>[/:_])(?P<second>\d+){_DEGREES}\D*", re.I
)
_ASPECULAR = re.compile(
    rf"((as|asp|aspecular)(?P<word>m|minus)?)?(?P<sign>[-_+])?(?P<angle>\d+){_DEGREES}", re.IGNORECASE
)
_MARKED = re.compile(r"as|°|º|deg|DP|SP|path", re.IGNORECASE)
_PATH = re.compile(r"[_-]?[(\[]?(?P<kind>DP|SP|doublepath|singlepath)[)\]]?$", re.IGNORECASE)
# with light at 45 degrees: ASTM E2194, DIN 6175-2
_USUAL_ASPECULAR = (-15.0, 15.0, 20.0, 25.0, 45.0, 75.0, 110.0)
_THREE = {25.0, 45.0, 75.0}  # also the incidences of instruments that look along the normal
_LEAST_INCIDENCE = 5.0  # below, `1/0` is no geometry but a fraction or a count

Angles = tuple[float, float, float]
"""Anchor, aspecular and azimuth angle in degrees."""


def parse_geometry(text: str) -> Angles | None:
    """Return the anchor, aspecular and azimuth angles in degrees of a geometry's name, or None.

    An underscore before an angle is a minus sign: programs write it where names allow no sign.

    >>> parse_geometry("r45as_15"), parse_geometry("45/0"), parse_geometry("d/8")
    ((45.0, -15.0, 0.0), (45.0, 45.0, 0.0), None)
    """
    text = _plain(text)
    if (incidence := _along_normal(text)) is not None:
        return incidence, incidence, 0.0
    found = _NAME.fullmatch(text)
    if found is None:
        return None
    anchor, aspecular = float(found["anchor"]), _sign(found["sign"]) * float(found["aspecular"])
    if anchor >= 90.0 or abs(aspecular) > 180.0:
        return None
    return anchor, aspecular, _sign(found["side"]) * float(found["azimuth"] or 0.0)


def parse_aspecular(text: str) -> float | None:
    """Return the aspecular angle in degrees of a text such as `-15`, `as15`, `110°`, `15DP`; else None."""
    found = _ASPECULAR.fullmatch(_plain(text))
    angle = _sign(found["word"] or found["sign"]) * float(found["angle"]) if found is not None else None
    return angle if angle in _USUAL_ASPECULAR else None


def is_geometry(text: str) -> bool:
    """Return whether a text can only be the name of a geometry; `-15` and `15d` could be other things."""
    if parse_geometry(text) is not None:
        return True
    return parse_aspecular(text) is not None and _MARKED.search(text) is not None


def resolve(names: Iterable[str], context: ErrorContext, notes: list[str]) -> dict[str, Angles]:
    """Return the angles of the geometries that a table names, by name; other texts are omitted."""
    names = list(dict.fromkeys(names))
    angles = {name: of_name for name in names if (of_name := parse_geometry(name)) is not None}
    alone = {name: a for name in names if name not in angles and (a := parse_aspecular(name)) is not None}
    if set(alone.values()) == _THREE:
        raise context.error(
            "geometries 25, 45 and 75 are ambiguous: write 45as25 ... if they are aspecular angles, or 25/0 ... if "
            "they are angles of incidence"
        )
    if alone and angles:
        raise context.error(
            f"geometries '{next(iter(alone))}' and '{next(iter(angles))}' in one column, expected only "
            "aspecular angles, or only names such as 45as15"
        )
    if alone:
        angles |= {name: (45.0, angle, 0.0) for name, angle in alone.items()}
        notes.append(Assumption("the file gives only aspecular angles; the light is assumed at 45 degrees"))
    if any(found["kind"][0] in "dD" for name in angles if (found := _PATH.search("".join(name.split())))):
        notes.append("DP, means of two paths from either side: taken as one path, as for isotropic samples")
    return angles


def geometry_directions(text: str) -> tuple[Array, Array] | None:
    """Return wi (3,) and wo (3,) of a geometry's name, or None for other texts and for wo below the horizon."""
    angles = parse_geometry(text)
    return None if angles is None else directions_of(angles)


def directions_of(angles: Angles) -> tuple[Array, Array] | None:
    """Return wi (3,) and wo (3,), or None if wo lies below the horizon."""
    wi, wo = aspecular_pair(*angles)
    return (wi, wo) if wo[2] > 0.0 else None


def _along_normal(text: str) -> float | None:
    """Return the incidence in degrees of a name such as 45/0 or 0/45, one direction of which is the normal, or None."""
    found = _TWO.fullmatch(text)
    if found is None or re.match(r"0\d", found["second"]):
        return None
    low, high = sorted((float(found["first"]), float(found["second"])))
    # Others are times or names.
    is_usual = high == 45.0 or (found["between"] == "/" and _LEAST_INCIDENCE <= high < 90.0)
    return high if low == 0.0 and is_usual else None


def _plain(text: str) -> str:
    """Return a text without blanks and a path, with plain minus signs; empty if it is too long for a name."""
    text = "".join(text.split())
    return _PATH.sub("", text).replace("\u2212", "-").replace("\u2013", "-") if len(text) <= _LONGEST else ""


def _sign(text: str | None) -> float:
    return -1.0 if (text or "+")[0] in "-_mM" else 1.0

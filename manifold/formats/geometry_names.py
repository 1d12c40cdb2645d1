"""Names of geometries: `45as-15`, `r45as15`, `r15as_45`, `45as25az90`, `45asMinus15`, `45° as 15°`, `45/0`; `as15`."""

from __future__ import annotations

import re

from manifold.formats.readings import aspecular_pair
from manifold.records import Array

_NAME = re.compile(
    r"""^[^\d+-]*?                                    # r, R, geometry:
    (?P<anchor>\d+(\.\d+)?)\s*(°|deg)?\s*[:/_]?\s*
    (as|asp|aspecular)\s*
    (?P<sign>[-_+]|m(inus)?\s*)?\s*(?P<aspecular>\d+(\.\d+)?)\s*(°|deg)?
    (\s*[_,/]?\s*(az|azimuth)\s*[:=]?\s*
    (?P<side>[-_+]|m(inus)?\s*)?\s*(?P<azimuth>\d+(\.\d+)?)\s*(°|deg)?)?\s*$""",
    re.IGNORECASE | re.VERBOSE,
)
_45_0 = re.compile(r"[^\d]*(45\s*°?\s*[a-z]?\s*[/:_]\s*0|0\s*°?\s*[/:_]\s*45)\b\D*", re.IGNORECASE)
_ASPECULAR = re.compile(r"(as(pecular)?)?\s*(?P<sign>[-_+])?\s*(?P<angle>\d+)\s*(°|deg)?", re.IGNORECASE)
_UNIT = re.compile(r"\s*[(\[]?\s*%\s*[Rr]?\s*[)\]]?$")
# with light at 45 degrees: ASTM E2194, DIN 6175-2
_USUAL_ASPECULAR = (-15.0, 15.0, 20.0, 25.0, 45.0, 75.0, 110.0)


def parse_geometry(text: str) -> tuple[float, float, float] | None:
    """Anchor, aspecular and azimuth angle in degrees of a geometry's name, or None.

    An underscore before an angle is a minus sign: programs write it where names allow no sign.
    """
    text = _plain(text)
    if _45_0.fullmatch(text):
        return 45.0, 45.0, 0.0
    found = _NAME.match(text)
    if found is None:
        return None
    anchor, aspecular = float(found["anchor"]), _sign(found["sign"]) * float(found["aspecular"])
    if anchor >= 90.0 or abs(aspecular) > 180.0:
        return None
    return anchor, aspecular, _sign(found["side"]) * float(found["azimuth"] or 0.0)


def parse_aspecular(text: str) -> float | None:
    """One of the usual aspecular angles in degrees where a text is nothing else: `-15`, `as15`, `110°`."""
    found = _ASPECULAR.fullmatch(_plain(text))
    angle = _sign(found["sign"]) * float(found["angle"]) if found is not None else None
    return angle if angle in _USUAL_ASPECULAR else None


def _plain(text: str) -> str:
    """Without what stands behind it, a unit, and with plain minus signs."""
    return _UNIT.sub("", text.strip()).replace("\u2212", "-").replace("\u2013", "-")


def _sign(text: str | None) -> float:
    return -1.0 if (text or "+")[0] in "-_mM" else 1.0


def geometry_directions(text: str) -> tuple[Array, Array] | None:
    """wi (3,) and wo (3,) of a geometry's name, or None where it is none, or wo lies below the horizon."""
    angles = parse_geometry(text)
    if angles is None:
        return None
    wi, wo = aspecular_pair(*angles)
    return (wi, wo) if wo[2] > 0.0 else None

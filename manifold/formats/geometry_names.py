"""Names of multi-angle geometries: `45as-15`, `r45as15`, `r15as_45`, `45as25az90`, `45° as 15°`."""

from __future__ import annotations

import re

from manifold.formats.readings import aspecular_pair
from manifold.records import Array

_NAME = re.compile(
    r"""^[^\d+-]*?                                    # r, R, geometry:
    (?P<anchor>\d+(\.\d+)?)\s*(°|deg)?\s*[:/_]?\s*
    (as|asp|aspecular)\s*
    (?P<sign>[-_+]|m(inus)?\s*)?\s*(?P<aspecular>\d+(\.\d+)?)\s*(°|deg)?
    (\s*[_,/]?\s*(az|azimuth)\s*[:=]?\s*(?P<azimuth>[-+]?\d+(\.\d+)?)\s*(°|deg)?)?\s*$""",
    re.IGNORECASE | re.VERBOSE,
)


def parse_geometry(text: str) -> tuple[float, float, float] | None:
    """Anchor, aspecular and azimuth angle in degrees of a geometry's name, or None.

    An underscore before the aspecular angle is a minus sign: programs write it where names allow no sign.
    """
    found = _NAME.match(text.strip().replace("\u2212", "-").replace("\u2013", "-"))
    if found is None:
        return None
    sign = -1.0 if (found["sign"] or "+")[0] in "-_mM" else 1.0
    anchor, aspecular = float(found["anchor"]), sign * float(found["aspecular"])
    if anchor >= 90.0 or abs(aspecular) > 180.0:
        return None
    return anchor, aspecular, float(found["azimuth"] or 0.0)


def geometry_directions(text: str) -> tuple[Array, Array] | None:
    """wi (3,) and wo (3,) of a geometry's name, or None where it is none, or wo lies below the horizon."""
    angles = parse_geometry(text)
    if angles is None:
        return None
    wi, wo = aspecular_pair(*angles)
    return (wi, wo) if wo[2] > 0.0 else None

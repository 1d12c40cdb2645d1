"""Names of geometries: `45as-15`, `r15as_45`, `45as25az90`, `45asMinus15`, `45/0`; `as15`, `-15°`, `15d`, `-15DP`.

A path of two is named DP (double path): a sample is read from both sides and the mean taken, so that isotropic
samples have the value of one side, SP.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass

from manifold.formats.readings import aspecular_pair
from manifold.records import Array

_DEGREES = r"(°|º|deg(rees?)?|d)"
_NAME = re.compile(
    rf"""^[^\d+-]*?                                    # r, R, geometry:
    (?P<anchor>\d+(\.\d+)?)\s*{_DEGREES}?\s*[:/_]?\s*
    (as|asp|aspecular)\s*
    (?P<sign>[-_+]|m(inus)?\s*)?\s*(?P<aspecular>\d+(\.\d+)?)\s*{_DEGREES}?
    (\s*[_,/]?\s*(az|azimuth)\s*[:=]?\s*
    (?P<side>[-_+]|m(inus)?\s*)?\s*(?P<azimuth>\d+(\.\d+)?)\s*{_DEGREES}?)?\s*$""",
    re.IGNORECASE | re.VERBOSE,
)
_TWO = re.compile(
    rf"""[^\d+-]*?(?P<first>\d+)\s*{_DEGREES}?\s*[a-z]?\s*
    (?P<between>[/:_])\s*(?P<second>-?\d+)\b\s*{_DEGREES}?\D*""",
    re.IGNORECASE | re.VERBOSE,
)
_ASPECULAR = re.compile(
    rf"(as(p(ecular)?)?\s*(?P<word>m(inus)?)?)?\s*(?P<sign>[-_+])?\s*(?P<angle>\d+)\s*{_DEGREES}?",
    re.IGNORECASE,
)
_MARKED = re.compile(r"as|°|º|deg|DP|SP|path", re.IGNORECASE)
_UNIT = re.compile(r"\s*[(\[]?\s*%\s*[Rr]?\s*[)\]]?$")
_DOUBLE, _SINGLE = r"DP|double[ _-]?path", r"SP|single[ _-]?path"
_PATH = re.compile(
    rf"[\s_-]*[(\[]?(?P<behind>{_DOUBLE}|{_SINGLE})[)\]]?$|^(?P<before>{_DOUBLE}|{_SINGLE})\b[\s_]*",
    re.IGNORECASE,
)
# with light at 45 degrees: ASTM E2194, DIN 6175-2
_USUAL_ASPECULAR = (-15.0, 15.0, 20.0, 25.0, 45.0, 75.0, 110.0)
_THREE = {25.0, 45.0, 75.0}  # also the incidences of a CM-512m3, which looks along the normal
_MOST_ASPECULAR = 110.0
_LEAST_INCIDENCE = 5.0  # below, `1/0` is no geometry but a fraction or a count

Angles = tuple[float, float, float]
"""Anchor, aspecular and azimuth angle in degrees."""


class AmbiguousGeometryError(ValueError):
    """Names that may mean different directions; says which, and what to write instead."""


@dataclass(frozen=True)
class GeometryNames:
    """What the names of a table's geometries mean, taken together.

    Attributes:
        angles: of every name that is one.
        notes: what was assumed.
    """

    angles: dict[str, Angles]
    notes: tuple[str, ...]


def parse_geometry(text: str) -> Angles | None:
    """Anchor, aspecular and azimuth angle in degrees of a geometry's name, or None.

    An underscore before an angle is a minus sign: programs write it where names allow no sign.
    """
    text = _plain(text)
    two = _two_angles(text)
    if two is not None and 0.0 in two:  # one direction is the normal
        return max(two), max(two), 0.0
    found = _NAME.match(text)
    if found is None:
        return None
    anchor, aspecular = float(found["anchor"]), _sign(found["sign"]) * float(found["aspecular"])
    if anchor >= 90.0 or abs(aspecular) > 180.0:
        return None
    return anchor, aspecular, _sign(found["side"]) * float(found["azimuth"] or 0.0)


def parse_aspecular(text: str) -> float | None:
    """One of the usual aspecular angles in degrees where a text is nothing else: `-15`, `as15`, `110°`, `15DP`."""
    found = _ASPECULAR.fullmatch(_plain(text))
    angle = _sign(found["word"] or found["sign"]) * float(found["angle"]) if found is not None else None
    return angle if angle in _USUAL_ASPECULAR else None


def is_geometry(text: str) -> bool:
    """Whether a text can be nothing but a geometry: `-15`, `15d` and `45/75` can be others."""
    if parse_geometry(text) is not None:
        return True
    return parse_aspecular(text) is not None and _MARKED.search(text) is not None


def can_be_geometry(text: str) -> bool:
    """Whether a text where a geometry is expected is one."""
    return is_geometry(text) or parse_aspecular(text) is not None or _two_angles(_plain(text)) is not None


def resolve(names: Iterable[str], titles: str) -> GeometryNames:
    """The angles of all geometries of one table.

    Args:
        names: as the table has them.
        titles: what the file says of the instrument.
    Raises:
        AmbiguousGeometryError: they may mean different directions.
    """
    names = list(dict.fromkeys(names))
    angles = {name: found for name in names if (found := parse_geometry(name)) is not None}
    notes = []
    others = [name for name in names if name not in angles]
    two = {name: pair for name in others if (pair := _two_angles(_plain(name))) is not None}
    alone = {name: angle for name in others if (angle := parse_aspecular(name)) is not None}
    if two:
        _require_aspecular_seconds(two)
        angles |= {name: (first, second, 0.0) for name, (first, second) in two.items()}
        notes.append("second angles such as 110 cannot be from the normal: all are taken as aspecular")
    if set(alone.values()) == _THREE:
        if "512m3" not in titles.lower():
            raise AmbiguousGeometryError(
                "geometries 25, 45 and 75 alone: aspecular angles with light at 45 degrees, or incidences of a "
                "CM-512m3; write 45as25 ... or 25/0 ..."
            )
        angles |= {name: (angle, angle, 0.0) for name, angle in alone.items()}
        notes.append("incidences of a CM-512m3, which looks along the normal")
    elif alone:
        angles |= {name: (45.0, angle, 0.0) for name, angle in alone.items()}
        notes.append("aspecular angles alone: the light is taken at 45 degrees")
    if any(_is_double_path(name) for name in angles):
        notes.append("DP, means of two paths from either side: taken as one path, as for isotropic samples")
    return GeometryNames(angles, tuple(notes))


def _require_aspecular_seconds(two: dict[str, tuple[float, float]]) -> None:
    """Names such as 45/75 tell no aspecular angle from one of the normal, unless one cannot be of the normal."""
    seconds = [second for _, second in two.values()]
    if max(seconds) > 90.0 and all(second in _USUAL_ASPECULAR for second in seconds):
        return
    name = next(iter(two))
    first, second = two[name]
    raise AmbiguousGeometryError(
        f"geometry '{name[:24]}': the second angle may be aspecular or from the normal; write "
        f"{first:g}as{second:g} or {first:g}as{first - second:g}"
    )


def geometry_directions(text: str) -> tuple[Array, Array] | None:
    """wi (3,) and wo (3,) of a geometry's name, or None where it is none, or wo lies below the horizon."""
    angles = parse_geometry(text)
    return None if angles is None else directions_of(angles)


def directions_of(angles: Angles) -> tuple[Array, Array] | None:
    """wi (3,) and wo (3,), or None where wo lies below the horizon."""
    wi, wo = aspecular_pair(*angles)
    return (wi, wo) if wo[2] > 0.0 else None


def _two_angles(text: str) -> tuple[float, float] | None:
    """Both angles of a name such as 45/0."""
    found = _TWO.fullmatch(text)
    if found is None or re.match(r"0\d", found["second"]):
        return None
    first, second = float(found["first"]), float(found["second"])
    if {first, second} == {0.0, 45.0}:
        return first, second
    if found["between"] != "/" or first >= 90.0 or abs(second) > _MOST_ASPECULAR:
        return None  # a time, a name
    return (first, second) if max(first, second) >= _LEAST_INCIDENCE else None


def _is_double_path(text: str) -> bool:
    found = _PATH.search(_without_unit(text))
    return found is not None and (found["behind"] or found["before"])[0] in "dD"


def _plain(text: str) -> str:
    """Without what stands beside it, a unit or a path, and with plain minus signs."""
    return _PATH.sub("", _without_unit(text)).replace("\u2212", "-").replace("\u2013", "-").strip()


def _without_unit(text: str) -> str:
    return _UNIT.sub("", text.strip())


def _sign(text: str | None) -> float:
    return -1.0 if (text or "+")[0] in "-_mM" else 1.0

"""Values of files: their bands or CIE XYZ, and whether they are a BRDF, times the cosine, factors or percent."""

from __future__ import annotations

import re
from collections.abc import Iterable

import numpy as np

from manifold.formats.column_heads import Quantity, channel, wavelength
from manifold.formats.text import ErrorContext, number
from manifold.records import Array

_NO_UNIT = "no unit given (--unit brdf, factor or percent): "
TAKEN_AS_BRDF = _NO_UNIT + "taken as BRDF in 1/sr"
TAKEN_AS_FACTORS = _NO_UNIT + "taken as reflectance factors, 1 being the perfect diffuser"
TAKEN_AS_PERCENT = _NO_UNIT + "values above 2 away from the mirror direction, or above 30, taken as percent"
TOO_BRIGHT = _NO_UNIT + "as BRDF in 1/sr it would reflect more light than it receives: "
_MOST_BRDF = 1.15  # median radiance factor away from the mirror direction: of 20 real materials at most 0.86
_FEWEST = 5  # values that say so
_PERCENT_FROM = 2.0  # reflectance factors away from the mirror direction are below this, percentages above
_PERCENT_ANYWHERE = 30.0  # 15 degrees from it, where these instruments see most, even chrome stays below this

_LENGTH = r"(?:nm|nano\w+|[u\u00b5\u03bc]m|micro\w+)"
_WAVELENGTH_IS = re.compile(
    rf"(?:wavelength|lambda|\u03bb)\s*[(\[]?(?:in )?{_LENGTH}?[)\]]?\s*[:=]?\s*(\d+(?:\.\d+)?)\b"
)
_NUMBER_OF_NM = re.compile(
    r"(?<![-\d.])(\d{3,4}(?:\.\d+)?) ?nm\b"  # not the end of a range
    r"|(?:^[#!\s]*|(?:laser|light|led)\b.*?(?<![-\d.]))(\d+\.\d+) ?[u\u00b5\u03bc]m\b"
)

_PRIMARIES_XY = ((0.64, 0.33), (0.30, 0.60), (0.15, 0.06))
_D65_XY = (0.3127, 0.3290)
_UNNAMED_NM = 550.0


def nanometres(text: str) -> float | None:
    """The wavelength in nm that a text begins with, micrometres where it is below 100; None where there is none.

    >>> nanometres("633 nm"), nanometres("0,5"), nanometres("red")
    (633.0, 500.0, None)
    """
    found = re.match(r"[\d.,]+", text)
    value = number(found[0]) if found else None
    if value is None or value <= 0.0:
        return None
    return value if value >= 100.0 else 1000.0 * value


def named_wavelength(comments: Iterable[str]) -> float | None:
    """The only wavelength that comments name in nm; None where they name none, or several.

    >>> named_wavelength(["# Wavelength (nm) = 850.0"]), named_wavelength(["# 0.85 um"])
    (850.0, 850.0)
    """
    lines = [line.lower() for line in comments]
    for pattern in (_WAVELENGTH_IS, _NUMBER_OF_NM):
        named = {nanometres(m[m.lastindex or 0]) for line in lines for m in pattern.finditer(line)} - {None}
        if len(named) == 1:
            return named.pop()
    return None


def as_brdf(values: Array, kind: Quantity, wo: Array, notes: list[str], white: float = 1.0) -> Array:
    """f in 1/sr of values (P, B) of a quantity at wo (P, 3); NaN where the cosine is 0.

    What was done is added to the notes. White is the reflectance factor of the perfect diffuser: 1, or 100 in percent.
    """
    if kind == "factor":
        notes.append("reflectance factors, divided by pi")
        return values / (white * np.pi)
    if kind == "f_cos":
        notes.append("values include the cosine of theta_o, and are divided by it")
        cosine = wo[:, 2:]
        return np.divide(values, cosine, out=np.full_like(values, np.nan), where=cosine > 1e-3)
    return values


def bands_of(
    heads: list[str], values: Array, notes: list[str], context: ErrorContext, comments: Iterable[str] = ()
) -> tuple[Array | None, Array]:
    """Wavelengths in nm, increasing, or None for linear sRGB, and the values (P, B) in their order."""
    letters = [channel(head) or "" for head in heads]
    for space in ("rgb", "xyz"):
        if sorted(letters) == sorted(space):
            values = values[:, [letters.index(letter) for letter in space]]
            return None, converted(values, notes) if space == "xyz" else values
    nm = [wavelength(head) for head in heads]
    if nm == [None]:
        return unnamed_band(notes, comments), values
    if None in nm:
        raise context.error(
            f"band '{heads[nm.index(None)][:24]}', expected a wavelength such as 465nm, R, G, B or X, Y, Z"
        )
    found = np.array(nm, dtype=float)
    if len(set(nm)) < len(nm):
        raise context.error(
            f"two columns of '{max(heads, key=heads.count)[:24]}', expected different wavelengths"
        )
    order = np.argsort(found)
    return found[order], values[:, order]


def looks_like_percent(wi: Array, wo: Array, values: Array, most_factor: float = _PERCENT_FROM) -> bool:
    """Whether values are too large for reflectance factors, away from the mirror direction or anywhere."""
    mirror = np.einsum("pi,pi->p", wi * [-1.0, -1.0, 1.0], wo)
    off = np.nan_to_num(values[mirror < np.cos(np.deg2rad(40.0))])
    return bool(np.max(off, initial=0.0) > most_factor or np.max(np.nan_to_num(values)) > _PERCENT_ANYWHERE)


def is_too_bright(wi: Array, wo: Array, values: Array) -> bool:
    """Whether values (P, B) in 1/sr are too large in the median, away from the mirror direction and the horizon."""
    mirror = np.einsum("pi,pi->p", wi * [-1.0, -1.0, 1.0], wo)
    is_diffuse = (mirror < np.cos(np.deg2rad(40.0))) & (
        np.minimum(wi[:, 2], wo[:, 2]) > np.cos(np.deg2rad(70.0))
    )
    seen = values[is_diffuse].mean(axis=1)
    seen = seen[np.isfinite(seen)]
    return bool(len(seen) >= _FEWEST and np.pi * np.median(seen) > _MOST_BRDF)


def xyz_to_linear_srgb(xyz: Array) -> Array:
    """Linear sRGB (..., 3), not clipped, of XYZ under D65, Y = 1 being white. Source: IEC 61966-2-1."""
    primaries = np.array([[x / y, 1.0, (1.0 - x - y) / y] for x, y in _PRIMARIES_XY]).T
    x, y = _D65_XY
    white = np.array([x / y, 1.0, (1.0 - x - y) / y])
    matrix = primaries * np.linalg.solve(primaries, white)
    return np.asarray(xyz) @ np.linalg.inv(matrix).T


def lab_to_linear_srgb(lab: Array) -> Array:
    """Linear sRGB (..., 3), relative to its white, of CIELAB (..., 3). Source: CIE 15."""
    scaled = (lab[..., :1] + 16.0) / 116.0 + lab * [0.0, 1.0 / 500.0, -1.0 / 200.0]
    f = np.stack([scaled[..., 1], scaled[..., 0], scaled[..., 2]], axis=-1)
    relative = np.where(f > 6.0 / 29.0, f**3, 3.0 * (6.0 / 29.0) ** 2 * (f - 4.0 / 29.0))
    return xyz_to_linear_srgb(relative * linear_srgb_to_xyz(np.ones(3)))


def linear_srgb_to_xyz(rgb: Array) -> Array:
    """XYZ (..., 3) of linear sRGB; the inverse of `xyz_to_linear_srgb`."""
    return np.asarray(rgb) @ np.linalg.inv(xyz_to_linear_srgb(np.eye(3)))


def converted(xyz: Array, notes: list[str]) -> Array:
    """`xyz_to_linear_srgb`, and a note of it."""
    notes.append("CIE XYZ, converted to linear sRGB")
    return xyz_to_linear_srgb(xyz)


def unnamed_band(notes: list[str], comments: Iterable[str] = ()) -> Array:
    """The wavelength in nm, shape (1,), of a band without one: a comment's or a green one; and a note of it."""
    named = named_wavelength(comments)
    if named is not None:
        notes.append(f"one band, its wavelength is taken from a comment: {named:g} nm")
        return np.array([named])
    notes.append(f"one band without a wavelength: taken as {_UNNAMED_NM:g} nm")
    return np.array([_UNNAMED_NM])

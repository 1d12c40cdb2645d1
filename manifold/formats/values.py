"""Interprets the values of files: their bands or CIE XYZ, and their quantity and unit."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from manifold.core.directions import cos_from_mirror
from manifold.core.errors import FileFormatError
from manifold.core.records import Array, Indices, Mask
from manifold.formats.column_heads import channel, is_percent, uncertainty_head, wavelength
from manifold.formats.quantities import BRDF, FACTORS, Quantity
from manifold.formats.readings import NO_UNIT, Assumption
from manifold.formats.text import LENGTH_UNIT, ErrorContext, is_length_unit, wavelength_nm

L_PER_Y = (29.0 / 3.0) ** 3
"""L* over Y, where Y is 1 for the perfect diffuser, of colours with L* below 8. Source: CIE 15."""

SHORTEST_NM, LONGEST_NM = 100.0, 1e5
"""The range of wavelengths in nm; numbers outside it must have another unit."""

_NO_UNIT = f"{NO_UNIT} (--unit brdf, factor or percent): "
_AS_BRDF = _NO_UNIT + "taken as BRDF in 1/sr"
TAKEN_AS_BRDF = Assumption(_AS_BRDF)
LOOKS_LIKE_FACTORS = Assumption(
    _AS_BRDF
    + "; the only value away from the mirror direction looks like a reflectance factor, since as BRDF it "
    "would reflect more light than it receives: give --unit factor if it is"
)
TAKEN_AS_FACTORS = Assumption(_NO_UNIT + "taken as reflectance factors, 1 being the perfect diffuser")
TAKEN_AS_PERCENT = Assumption(
    _NO_UNIT + "values above 2 away from the mirror direction, or above 30, taken as percent"
)
TOO_BRIGHT = _NO_UNIT + "as BRDF in 1/sr it would reflect more light than it receives: "
_MOST_BRDF = (
    1.15  # radiance factor of a band away from the mirror direction: of 20 real materials at most 1.02
)
_BANDS = 1.0 / 8.0  # share of the bands that tells BRDF from factors: colours may have few bright bands
# Share of the bands that tells percent; fewer may be saturated. Of 51 materials of the corpus and 20 measured ones in
# percent, at geometries of an MA-T12, all reach it; one does not reach one half.
_MANY_BANDS = 0.25
_OVERLAP = 0.5  # share of the smaller range of two parts of a file above which they are two spectra
_FEW = 5  # values; of fewer all must be too bright, and at least two
_PERCENT_FROM = 2.0  # reflectance factors away from the mirror direction are below this, percentages above
_PERCENT_ANYWHERE = 30.0  # 15 degrees from it, where these instruments see most, even chrome stays below this

_STATEMENT = re.compile(
    r"(?<![a-z])(?:wavelengths?|wellenl(?:\u00e4|ae)ngen?|lambda|\u03bb)[\s_/]*(?:in\s)?"
    rf"[(\[]?(?P<unit>{LENGTH_UNIT}(?![a-z]))?[)\]]?\s*(?:is\s|[:=,;])?\s*"
    r"(?P<number>(?:\d+(?:[.,]\d+)?|[.,]\d+)(?:e[-+]?\d+)?)(?P<rest>.*)"
)
_UNIT_BEHIND = re.compile(r"\s*[(\[]?(?P<unit>[^\W\d_]+(?:\s?\^?-1)?)[)\]]?")
_FOREIGN_UNITS = {"ev", "thz", "ghz", "hz", "mm", "pm", "k"}
_SEVERAL = re.compile(r"\s*(?:[-,;/\u2013]|to|and)\s*\d")
_NUMBER_OF_NM = re.compile(
    r"(?<![-\d.,])(?P<nm>\d{3,4}(?:[.,]\d+)?) ?nm\b"  # not the end of a range
    r"|(?:^[#!\s]*|(?:laser|light|led)\b.*?(?<![-\d.,]))(?P<um>\d+[.,]\d+) ?[u\u00b5\u03bc]m\b"
)

_TYPICAL = 0.06  # relative standard uncertainty of a value whose reading counts half of an exact one
_PRIMARIES_XY = ((0.64, 0.33), (0.30, 0.60), (0.15, 0.06))
_D65_XY = (0.3127, 0.3290)
UNNAMED_NM = 550.0
"""Wavelength of a single band without one: green, where eyes see most."""


def named_wavelength(comments: Iterable[str], context: ErrorContext) -> float | None:
    """Return the only wavelength that comments name in nm; None if they name none, or several.

    Raises:
        FileFormatError: a comment states a wavelength that is not understood.
    """
    lines = list(comments)
    stated = [
        _stated(found, line, context)
        for line in lines
        if (found := _STATEMENT.search(line.lower())) is not None
    ]
    if stated:
        named = set(stated)
    else:
        matches = (found for line in lines for found in _NUMBER_OF_NM.finditer(line.lower()))
        named = {wavelength_nm(m["nm"], "nm") if m["nm"] else wavelength_nm(m["um"], "um") for m in matches}
    return named.pop() if len(named) == 1 else None


def require_one_spectrum(nm: Array, context: ErrorContext, where: str | None = None) -> None:
    """Raise FileFormatError if wavelengths in nm (B,), in the order of a file, repeat or run twice through a range.

    Two spectra, one below the other, would become one that goes up and down. The ranges of neighbouring detectors
    overlap by less than half.
    """
    steps = np.diff(nm)
    if np.all(steps > 0.0) or np.all(steps < 0.0):
        return
    turns = np.flatnonzero(steps * np.sign(np.median(steps)) <= 0.0) + 1
    ends = [(part.min(), part.max()) for part in np.split(nm, turns)]
    common = [min(a[1], b[1]) - max(a[0], b[0]) for a, b in pairwise(ends)]
    least = [min(a[1] - a[0], b[1] - b[0]) for a, b in pairwise(ends)]
    k = next((k for k, (c, n) in enumerate(zip(common, least, strict=True)) if c > _OVERLAP * n), None)
    found = None if k is None else f"wavelengths go back from {nm[turns[k] - 1]:g} to {nm[turns[k]]:g} nm"
    ordered = np.sort(nm)
    if (twice := np.flatnonzero(np.diff(ordered) == 0.0)).size and (
        k is None or nm[turns[k] - 1] == nm[turns[k]]
    ):
        found = f"wavelength {ordered[twice[0]]:g} nm twice"
    if found is not None:
        raise context.error(
            f"{found}, expected one spectrum", where, remedy="keep one spectrum, and one value per wavelength"
        )


def _stated(found: re.Match[str], line: str, context: ErrorContext) -> float | None:
    """Return the wavelength in nm of a statement; None if it is one of several, or a number of something else."""
    behind = _UNIT_BEHIND.match(found["rest"])
    word = "" if behind is None else behind["unit"]
    is_attached = word != "" and found["rest"].startswith(word)
    is_unit = is_length_unit(word) or is_attached or word in _FOREIGN_UNITS
    rest = found["rest"][behind.end() :] if behind is not None and is_unit else found["rest"]
    if _SEVERAL.match(rest):
        return None
    unit = word if is_unit else found["unit"] or ""
    if not unit and re.fullmatch(r"\d{1,2}", found["number"]):  # wavelength 1 of 3
        return None
    nm = wavelength_nm(found["number"], unit)
    if nm is None or not SHORTEST_NM <= nm <= LONGEST_NM:
        raise context.error(
            f"found '{line.strip()[:60]}', expected a wavelength such as 633 nm or 1.55 um",
            remedy="correct the comment",
        )
    return nm


def as_brdf(
    values: Array, quantity: Quantity, wi: Array, wo: Array, notes: list[str], white: float = 1.0
) -> Array:
    """Apply `Quantity.brdf`, and add a note about the conversion."""
    if (note := quantity.note) is not None:
        notes.append(note)
    return quantity.brdf(values, wi, wo, white)


class Assumed(NamedTuple):
    """The unit assumed for values without one: a key of `readings.UNITS`, its quantity, and the value of white."""

    unit: str
    quantity: Quantity
    white: float
    note: str


def assumed_unit(raw: Sequence[tuple[Array, Array, Array]], context: ErrorContext) -> Assumed:
    """Choose the unit of values without one: BRDF in 1/sr, reflectance factors, or these in percent.

    Values are reflectance factors if, as a BRDF, they would reflect more light than arrives in at least an eighth of
    the bands. If only a single value indicates this, they stay a BRDF, with a note. Factors are in percent if their
    median over bands is too bright as well, or if an eighth of the bands are brighter than fluorescence can explain.
    Saturated bands do not count. Raises FileFormatError if values are too bright even in percent.

    `raw` holds wi (P, 3), wo (P, 3) and values (P, B) of each sample of one file.
    """
    raw = [(wi, wo, values[:, ~saturated_bands(wi, wo, values)]) for wi, wo, values in raw]
    if not any(is_too_bright(*of_sample) for of_sample in raw):
        few_say_so = any(is_too_bright(*of_sample, fewest=1) for of_sample in raw)
        return Assumed("brdf", BRDF, 1.0, LOOKS_LIKE_FACTORS if few_say_so else TAKEN_AS_BRDF)
    if not _are_too_bright_factors(raw, 1.0):
        return Assumed("factor", FACTORS, 1.0, Assumption(TOO_BRIGHT + "taken as reflectance factors"))
    if _are_too_bright_factors(raw, 100.0):
        raise _no_unit(raw, context)
    return Assumed("percent", FACTORS, 100.0, Assumption(TOO_BRIGHT + "taken as per cent"))


def assumed_factors(raw: Sequence[tuple[Array, Array, Array]], context: ErrorContext) -> Assumed:
    """Return reflectance factors as the assumed unit, or percent if the values are too large.

    Raises FileFormatError if they are too large for percent too.
    """
    if not any(looks_like_percent(*of_sample) for of_sample in raw):
        return Assumed("factor", FACTORS, 1.0, TAKEN_AS_FACTORS)
    if any(looks_like_percent(wi, wo, values / 100.0) for wi, wo, values in raw):
        raise _no_unit(raw, context)
    return Assumed("percent", FACTORS, 100.0, TAKEN_AS_PERCENT)


def _are_too_bright_factors(raw: Sequence[tuple[Array, Array, Array]], white: float) -> bool:
    """Return whether values are too bright for reflectance factors, `white` being that of the perfect diffuser."""
    as_factors = [(wi, wo, values / (white * np.pi)) for wi, wo, values in raw]
    return any(
        is_too_bright(wi, wo, f, most=_PERCENT_FROM)
        or is_too_bright(wi, wo, np.median(f, axis=1, keepdims=True))
        for wi, wo, f in as_factors
    )


def _no_unit(raw: Sequence[tuple[Array, Array, Array]], context: ErrorContext) -> FileFormatError:
    most = max(float(np.max(np.nan_to_num(values))) for _, _, values in raw)
    return context.error(
        f"values of up to {most:.5g}, which even as per cent would reflect more light than they receive, expected a "
        "BRDF in 1/sr, or reflectance factors",
        remedy="name their quantity, or divide by the value of a perfect diffuser; make codes of pictures linear first",
    )


def relative_uncertainties(
    columns: Mapping[str, Array], band_heads: Sequence[str], raw: Array, kind: Quantity, white: float,
    notes: list[str], context: ErrorContext,
) -> Array:  # fmt: skip
    """Return the relative standard uncertainties (P, B) of a file's raw values (P, B); NaN if none is given.

    `columns` holds columns of uncertainties (P,) by heading, see `column_heads.uncertainty_head`; unused columns are
    noted.
    """
    relative = np.full(raw.shape, np.nan)
    nm = [wavelength(head) for head in band_heads]
    left_out = []
    for text, column in columns.items():
        head = uncertainty_head(text)
        own = [k for k in range(len(nm)) if head is not None and head.nm in (None, nm[k])]
        if head is None or not own or head.coverage == 0.0 or np.any(np.isfinite(relative[:, own])):
            left_out.append(text)
            continue
        given = column[:, None] / head.coverage
        if np.any(given < 0.0):
            raise context.error(f"a negative uncertainty in column '{text[:24]}', expected 0 or more")
        in_percent = is_percent([text])
        if head.is_relative or (in_percent and white == 1.0):
            relative[:, own] = given / (100.0 if in_percent else 1.0)
        elif kind.base:
            relative[:, own] = given * np.log(kind.base)
        else:
            size = np.abs(raw[:, own])
            relative[:, own] = np.divide(given, size, out=np.full(size.shape, np.nan), where=size > 0.0)
    if left_out:
        notes.append(
            f"{', '.join(left_out)[:80]}: left out, expected standard uncertainties, one column for each of the values"
        )
    return relative


class Weights(NamedTuple):
    """The weights and scatter of readings from the uncertainties of their values, see `Readings`.

    Attributes:
        scatter: relative standard deviation of the cube roots, shape (P,).
        weights: weights of the readings, shape (P,).
        repeatability: median relative standard uncertainty of the values.
        note: sentence about the conversion.
    """

    scatter: Array
    weights: Array
    repeatability: float
    note: str

    @property
    def readings(self) -> dict[str, Any]:
        """Return the weights, scatter and repeatability as arguments of `Readings`."""
        return {"scatter": self.scatter, "weights": self.weights, "repeatability": self.repeatability}


def weights_of(relative: Array) -> Weights | None:
    """Return the weights of readings with relative standard uncertainties (P, B); None if all are 0 or unknown."""
    known = np.isfinite(relative)
    count = np.maximum(known.sum(axis=1), 1)
    scatter = np.sqrt(np.where(known, relative, 0.0) ** 2 @ np.ones(relative.shape[1]) / count) / 3.0
    if not np.any(scatter > 0.0):
        return None
    median = 3.0 * float(np.median(scatter))
    note = f"uncertainties of {100.0 * median:.2g} % in the median weigh the values"
    return Weights(scatter, 1.0 / (1.0 + (3.0 * scatter / _TYPICAL) ** 2), median, note)


def bands_of(
    heads: list[str], values: Array, notes: list[str], context: ErrorContext, comments: Iterable[str] = ()
) -> tuple[Array | None, Array]:
    """Return increasing wavelengths in nm, or None for linear sRGB, and the values (P, B) in this order."""
    letters = [channel(head) or "" for head in heads]
    for space in ("rgb", "xyz"):
        if sorted(letters) == sorted(space):
            values = values[:, [letters.index(letter) for letter in space]]
            return None, converted(values, notes) if space == "xyz" else values
    nm = [wavelength(head) for head in heads]
    if nm == [None]:
        return unnamed_band(notes, context, comments), values
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


def looks_like_percent(
    wi: Array, wo: Array, values: Array, most_factor: float = _PERCENT_FROM, share: float = _MANY_BANDS
) -> bool:
    """Return whether values are too large for reflectance factors, away from the mirror direction or anywhere.

    They must be too large in at least the `share` of the bands, so that a saturated band does not count.
    """
    f = np.nan_to_num(values)
    off = f[cos_from_mirror(wi, wo) < np.cos(np.deg2rad(40.0))]
    is_large = (off.max(axis=0, initial=0.0) > most_factor) | (f.max(axis=0) > _PERCENT_ANYWHERE)
    return bool(is_large.sum() >= max(share * values.shape[1], 1.0))


def is_too_bright(wi: Array, wo: Array, values: Array, fewest: int = 2, most: float = _MOST_BRDF) -> bool:
    """Return whether at least an eighth of the bands are too bright, see `bright_bands`."""
    return int(bright_bands(wi, wo, values, fewest, most).sum()) >= max(_BANDS * values.shape[1], 1.0)


def bright_bands(wi: Array, wo: Array, values: Array, fewest: int = 2, most: float = _MOST_BRDF) -> Mask:
    """Return a mask (B,) of bands whose values (P, B) in 1/sr are too large, away from mirror direction and horizon.

    A band is judged by its median, or by its smallest value if there are fewer than five; with fewer than `fewest`
    values it is False.
    """
    is_bright = np.zeros(values.shape[1], dtype=bool)
    for k, band in enumerate(values[is_diffuse(wi, wo)].T):
        seen = band[np.isfinite(band)]
        if len(seen) >= fewest:
            is_bright[k] = np.pi * (np.median(seen) if len(seen) >= _FEW else seen.min()) > most
    return is_bright


def saturated_bands(wi: Array, wo: Array, values: Array) -> Mask:
    """Return a mask (B,) of bands too bright even for factors; it is all False if they are a quarter or more."""
    is_saturated = bright_bands(wi, wo, values / np.pi, most=_PERCENT_FROM)
    if is_saturated.sum() >= max(_MANY_BANDS * len(is_saturated), 1.0):
        is_saturated[:] = False
    return is_saturated


def too_bright_rows(wi: Array, wo: Array, values: Array) -> Indices:
    """Return the indices of rows of values (P, B) in 1/sr whose mean is too large; none if half or more have one."""
    with np.errstate(invalid="ignore"):
        rows = np.flatnonzero(is_diffuse(wi, wo) & (np.pi * np.mean(values, axis=1) > _MOST_BRDF))
    return rows if 2 * len(rows) < len(values) else rows[:0]


def is_diffuse(wi: Array, wo: Array) -> Mask:
    """Return a mask of direction pairs (P, 3) away from mirror direction and horizon."""
    mirror = cos_from_mirror(wi, wo)
    is_seen = np.minimum(wi[:, 2], wo[:, 2]) > np.cos(np.deg2rad(70.0))
    return np.asarray((mirror < np.cos(np.deg2rad(40.0))) & is_seen)


def lightness_doubts(lightness: float) -> list[str]:
    """Return a note if the largest L* of a file is so small that its values are probably from 0 to 1."""
    if not 0.0 < lightness <= 1.0:
        return []
    return [Assumption(f"L* is at most {lightness:.2g}, so black: multiply by 100 if it is a fraction")]


def xyz_to_linear_srgb(xyz: Array) -> Array:
    """Convert XYZ under D65, where white has Y = 1, to linear sRGB (..., 3), not clipped. Source: IEC 61966-2-1."""
    primaries = np.array([[x / y, 1.0, (1.0 - x - y) / y] for x, y in _PRIMARIES_XY]).T
    x, y = _D65_XY
    white = np.array([x / y, 1.0, (1.0 - x - y) / y])
    matrix = primaries * np.linalg.solve(primaries, white)
    return np.asarray(xyz) @ np.linalg.inv(matrix).T


def lab_to_linear_srgb(lab: Array) -> Array:
    """Convert CIELAB (..., 3) to linear sRGB (..., 3), relative to its white. Source: CIE 15."""
    scaled = (lab[..., :1] + 16.0) / 116.0 + lab * [0.0, 1.0 / 500.0, -1.0 / 200.0]
    f = np.stack([scaled[..., 1], scaled[..., 0], scaled[..., 2]], axis=-1)
    relative = np.where(f > 6.0 / 29.0, f**3, 3.0 * (6.0 / 29.0) ** 2 * (f - 4.0 / 29.0))
    return xyz_to_linear_srgb(relative * linear_srgb_to_xyz(np.ones(3)))


def linear_srgb_to_xyz(rgb: Array) -> Array:
    """Convert linear sRGB to XYZ (..., 3); the inverse of `xyz_to_linear_srgb`."""
    return np.asarray(rgb) @ np.linalg.inv(xyz_to_linear_srgb(np.eye(3)))


def converted(xyz: Array, notes: list[str]) -> Array:
    """Apply `xyz_to_linear_srgb`, and add a note about it."""
    notes.append("CIE XYZ, converted to linear sRGB")
    return xyz_to_linear_srgb(xyz)


def unnamed_band(notes: list[str], context: ErrorContext, comments: Iterable[str] = ()) -> Array:
    """Return the wavelength (1,) in nm that a comment names for a single band, or a green one with a note."""
    named = named_wavelength(comments, context)
    if named is not None:
        notes.append(f"one band, its wavelength is taken from a comment: {named:g} nm")
        return np.array([named])
    notes.append(Assumption(f"one band without a wavelength: taken as {UNNAMED_NM:g} nm"))
    return np.array([UNNAMED_NM])

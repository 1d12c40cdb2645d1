"""Heads of columns in tables, matched as a whole: angles, bands, quantities, gloss, names of samples."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Literal, NamedTuple

from manifold.formats.readings import GLOSS_ANGLES_DEG, Viewing
from manifold.formats.text import ErrorContext

Quantity = Literal["f", "f_cos", "factor"]
"""BRDF in 1/sr; BRDF times cos theta_o; reflectance factor, pi times the BRDF."""

RELATIVE = "phi_o - phi_i"
"""What `angle_name` calls a difference of azimuths."""

_LONGEST = 80  # letters; longer cells are no heads
_LIGHT = r"(i|in|inc|incident|incidence|incoming|light|lighting|illumination|source|sun|solar)"
_SEEN = (
    r"(o|out|outgoing|s|sc|scat|scatter|scattered|scattering|r|refl|reflected|reflection|v|view|viewing|observer|"
    r"observation|measure|measured|measuring|measurement|det|detector|detection|receiver|e|exit|emission|emergence|"
    r"emergent)"
)
_POLAR = r"((theta|zenith|zen|polar|th)(angle)?|angle)"
_POLAR_FIRST = r"((theta|zenith|zen|polar|th)(angle)?|angleof)"
_AZIMUTH = r"(phi|azimuth|azimuthal|azi|az)(angle)?"
_ANGLES = {
    "theta_i": rf"{_LIGHT}{_POLAR}|{_POLAR_FIRST}{_LIGHT}|ti|sza|aoi|incidence|srcz",
    "phi_i": rf"{_LIGHT}{_AZIMUTH}|{_AZIMUTH}{_LIGHT}|saa|poi|srca",
    "theta_o": rf"{_SEEN}{_POLAR}|{_POLAR_FIRST}{_SEEN}|ts|vza|theta|viewz",
    "phi_o": rf"{_SEEN}{_AZIMUTH}|{_AZIMUTH}{_SEEN}|vaa|phi|viewa",
    RELATIVE: rf"(d|delta|diff|rel|relative){_AZIMUTH}|raa",
}
_GREEK = str.maketrans({"θ": "theta", "ϑ": "theta", "φ": "phi", "ϕ": "phi", "Δ": "delta"})
_DEGREES = re.compile(r"(?<![a-z])deg(rees?)?(?![a-z])|°|º")
_RADIANS = re.compile(r"(?<![a-z])rad(ians?)?(?![a-z])")
_BRACKETS = re.compile(r"\([^()]*\)|\[[^\[\]]*\]")
_PER_STERADIAN = re.compile(r"1\s*/\s*sr|sr\s*\^?\s*-?\s*1")
_BAND_UNIT = re.compile(r"[(\[]\s*(nm|um|µm|μm|microns?)\s*[)\]]")
_NUMBER_LAST = re.compile(r"(?P<words>.*?)(?P<number>\d+([.,]\d+)?)\s*(?P<unit>nm|um|µm|μm|microns?)?")
_LEAST_NM, _MOST_NM = 150.0, 20_000.0
_LARGEST_BARE_NM = 5000.0  # larger numbers without a unit are counts or values
_BAND_WORDS = ("nm", "spectral", "spec", "spectral nm", "lambda", "wavelength", "wl")  # a number follows them
_QUANTITIES: dict[str, Quantity | None] = {
    **dict.fromkeys(("", *_BAND_WORDS, "value", "values")),
    **dict.fromkeys(("brdf", "bsdf", "f", "fr", "f r"), "f"),
    **dict.fromkeys(
        ("r", "refl", "reflectance", "spectral reflectance", "reflectance factor", "radiance factor", "brf", "brrf"),
        "factor",
    ),
    **dict.fromkeys(
        ("ars", "dsf", "ccbrdf", "ccbsdf", "cc brdf", "cc bsdf", "brdf*cos", "bsdf*cos", "f cos", "cos corrected brdf"),
        "f_cos",
    ),
}  # fmt: skip
_WAVELENGTHS = {
    "nm",
    *(f"{word}{unit}" for word in ("wavelength", "lambda", "wl") for unit in ("", " nm", " um")),
}
_CHANNELS = {"red": "r", "green": "g", "blue": "b"} | {letter: letter for letter in "rgbxyz"}
_NAMES = (
    "sample name", "sample", "name", "data name", "measurement name", "sample id", "sample no", "trial name", "trial",
    "batch name", "batch", "standard name", "standard", "material name", "material", "color name", "colour name", "id",
)  # fmt: skip  # the best first
_GLOSS_WORDS = {"gloss", "glanz", "gu", "deg", "degree", "degrees", "unit", "units", "value"}
_USUAL_GLOSS_DEG = 60.0


_OF_VIEWING = r"(?P<light>[A-Za-z]+[0-9]*)\s*/\s*(?P<deg>2|10)\s*°?"
_VIEWING = re.compile(_OF_VIEWING)
_LAB = re.compile(rf"(?P<axis>[Lab])\s*\*?\s*([(\[]\s*{_OF_VIEWING}\s*[)\]])?")


class ValueHead(NamedTuple):
    """What the head of a column of values says: words in lower case, without units, and the wavelength or None."""

    words: str
    nm: float | None


def angle_name(head: str) -> str | None:
    """`theta_i`, `phi_i`, `theta_o`, `phi_o` or `RELATIVE`, which a column's head names, or None."""
    if len(head) > _LONGEST:
        return None
    text = _RADIANS.sub("", _DEGREES.sub("", _BRACKETS.sub("", head.lower().translate(_GREEK))))
    letters = re.sub(r"[^a-z]", "", text)
    return next((name for name, spelling in _ANGLES.items() if re.fullmatch(spelling, letters)), None)


def angle_unit(
    heads: Sequence[str], context: ErrorContext, where: str
) -> Literal["degrees", "radians"] | None:
    """The unit that heads of angles name, or None. Raises FileFormatError where they name both."""
    is_degrees, is_radians = (any(unit.search(h.lower()) for h in heads) for unit in (_DEGREES, _RADIANS))
    if is_degrees and is_radians:
        raise context.error("angles in degrees and in radians, expected one unit", where)
    return "degrees" if is_degrees else "radians" if is_radians else None


def value_head(head: str) -> ValueHead | None:
    """What the head of a column of values says, such as `465nm`, `BRDF_465`, `R400 [%]`, `BRF`; None for others."""
    if len(head) > _LONGEST:
        return None
    text = _BRACKETS.sub(" ", _BAND_UNIT.sub(r" \1", head.lower()))
    text = _PER_STERADIAN.sub(" ", text).replace("%", " ").replace("percent", " ").strip()
    found = _NUMBER_LAST.fullmatch(text)
    words = " ".join(re.split(r"[\s_.:-]+", (found["words"] if found else text).strip(" _.:-")))
    if words not in _QUANTITIES and words.removeprefix("brdf ").removeprefix("bsdf ") not in _CHANNELS:
        return None
    if found is None:
        return None if words in _BAND_WORDS else ValueHead(words, None)
    value = float(found["number"].replace(",", "."))
    nm = value if (found["unit"] or "nm") == "nm" else 1000.0 * value
    is_nm = _LEAST_NM <= nm <= (_MOST_NM if found["unit"] else _LARGEST_BARE_NM)
    return ValueHead(words, nm) if is_nm else None


def wavelength(head: str) -> float | None:
    """The wavelength in nm that a column's head names, or None."""
    found = value_head(head)
    return found.nm if found is not None else None


def is_wavelength(head: str) -> bool:
    """Whether a column's head says that its cells are wavelengths."""
    return plain_head(head).removesuffix("s") in _WAVELENGTHS and not any(map(str.isdigit, head))


def channel(head: str) -> str | None:
    """`r`, `g`, `b`, `x`, `y` or `z`, which a column's head names, or None."""
    found = value_head(head)
    if found is None or found.nm is not None:
        return None
    return _CHANNELS.get(found.words.removeprefix("brdf ").removeprefix("bsdf "))


def quantity(heads: Sequence[str]) -> Quantity | None:
    """What the values are by their columns' heads; None where these say nothing."""
    if len(heads) == 3 and all(map(channel, heads)):
        return None
    found = (value_head(head) for head in heads)
    return next((kind for h in found if h is not None and (kind := _QUANTITIES.get(h.words))), None)


def is_percent(heads: Sequence[str]) -> bool:
    """Whether heads of values name percent."""
    return any("%" in head or re.search(r"\bpercent\b", head.lower()) for head in heads)


def gloss_angle(head: str) -> float | None:
    """The angle in degrees of the gloss that a column's head names, the usual one where it names none, or None."""
    words = re.findall(r"[^\W\d_]+|\d+", head.lower()) if len(head) <= _LONGEST else []
    numbers = [float(word) for word in words if word.isdecimal()]
    others = {word for word in words if not word.isdecimal()}
    if not others & {"gloss", "glanz", "gu"} or others - _GLOSS_WORDS or len(numbers) > 1:
        return None
    angle = numbers[0] if numbers else _USUAL_GLOSS_DEG
    return angle if angle in GLOSS_ANGLES_DEG else None


class LabHead(NamedTuple):
    """A head such as `L* (D65/10)`: its axis is `l`, `a` or `b`; the viewing is None where it names none."""

    axis: str
    viewing: Viewing | None


def lab_head(head: str) -> LabHead | None:
    """What the head of a column of CIELAB values says; None for others."""
    found = _LAB.fullmatch(head.strip()) if len(head) <= _LONGEST else None
    if found is None:
        return None
    return LabHead(found["axis"].lower(), None if found["light"] is None else _viewing(found))


def viewing(text: str) -> Viewing | None:
    """The light and the observer that a text such as `D65/10` is; None for others."""
    found = _VIEWING.fullmatch(text.strip()) if len(text) <= _LONGEST else None
    return None if found is None else _viewing(found)


def _viewing(found: re.Match[str]) -> Viewing:
    return Viewing(found["light"].upper(), int(found["deg"]))


def plain_head(head: str) -> str:
    """The words of a head in lower case, without what stands in brackets."""
    return (
        " ".join(re.findall(r"[^\W\d_]+", _BRACKETS.sub("", head.lower()))) if len(head) <= _LONGEST else ""
    )


def name_column(heads: Sequence[str]) -> int | None:
    """Which column holds names of samples."""
    words = [plain_head(head) for head in heads]
    return next((words.index(name) for name in _NAMES if name in words), None)

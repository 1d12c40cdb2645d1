"""The meaning of column headings: angles, bands, quantities, gloss, names of specimens."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from typing import Literal, NamedTuple

from manifold.formats import quantities
from manifold.formats.quantities import BRDF, FACTORS, Quantity
from manifold.formats.readings import GLOSS_ANGLES_DEG, Viewing
from manifold.formats.text import LENGTH_UNIT, ErrorContext, wavelength_nm

RELATIVE = "phi_o - phi_i"
"""Name of `angle_name` for a difference of azimuths."""
PHASE = "phase"
"""Name of the angle between the directions to the light and to the viewer."""
NUMBER = "number"
"""Key of `name_columns` for a column of numbers of samples, which may also count rows."""
STANDARD, TYPE = "standard", "type"
"""Keys of `name_columns` for columns of standards, and of types, which may also describe geometries."""
OF_STANDARDS = ("batch", "trial")
"""Keys of `name_columns` for columns that are empty for the standard itself."""

_LONGEST = 80  # letters; longer cells are no heads
_LIGHT = r"(i|in|inc|incident|incidence|incoming|light|lighting|illumination|source|sun|solar)"
_SEEN = (
    r"(o|out|outgoing|s|sc|scat|scatter|scattered|scattering|r|refl|reflected|reflection|v|view|viewing|observer|"
    r"observation|measure|measured|measuring|measurement|det|detector|detection|receiver|e|exit|emission|emergence|"
    r"emergent)"
)
_POLAR = r"((theta|zenith|zen|polar|th)(angle)?|angle)"
_POLAR_FIRST = r"((theta|zenith|zen|polar|th)(angle)?(of(the)?)?|angleof(the)?)"
_AZIMUTH = r"(phi|azimuth|azimuthal|azi|az)(angle)?"
_ANGLES = {
    "theta_i": rf"{_LIGHT}{_POLAR}|{_POLAR_FIRST}{_LIGHT}|ti|sza|aoi|incidence|inc|srcz",
    "phi_i": rf"{_LIGHT}{_AZIMUTH}|{_AZIMUTH}(of(the)?)?{_LIGHT}|saa|poi|srca",
    "theta_o": rf"{_SEEN}{_POLAR}|{_POLAR_FIRST}{_SEEN}|ts|vza|theta|viewz|emission|emi|emergence",
    "phi_o": rf"{_SEEN}{_AZIMUTH}|{_AZIMUTH}(of(the)?)?{_SEEN}|vaa|phi|viewa",
    RELATIVE: rf"(d|delta|diff|rel|relative){_AZIMUTH}|raa",
    PHASE: r"phase(angle)?|pha|angleofphase",
}
_PLANETARY = {"i": "theta_i", "e": "theta_o", "g": PHASE, "psi": RELATIVE}  # letters of planetary photometry
_AZIMUTH_ALONE = re.compile(_AZIMUTH)
_GREEK = str.maketrans({"θ": "theta", "ϑ": "theta", "φ": "phi", "ϕ": "phi", "Δ": "delta"})
_DEGREES = re.compile(r"(?<![a-z])deg(rees?)?(?![a-z])|°|º")
_RADIANS = re.compile(r"(?<![a-z])rad(ians?)?(?![a-z])")
_BRACKETS = re.compile(r"\([^()]*\)|\[[^\[\]]*\]")
_BAND = re.compile(
    rf"(?<![\d.,])(?P<number>\d+(?:[.,]\d+)?)[\s_]*(?P<unit>{LENGTH_UNIT}(?![a-z0-9]))?(?![\d.,]*\d)"
)
_MULTIPLE = re.compile(  # `1000*BRDF`, `10^3 BRDF`, `BRDF / 1000`
    rf"\d\s*[*\u00d7\u00b7^]|[*\u00d7\u00b7]\s*\d|/\s*\d[\d.,]*(?![\d.,]|\s*{LENGTH_UNIT})"
)
_LEAST_NM, _MOST_NM = 150.0, 20_000.0
_LARGEST_BARE_NM = 5000.0  # larger numbers without a unit are counts or values
_BAND_WORDS = {
    "nm",
    "spectral",
    "spec",
    "lambda",
    "wavelength",
    "wavelengths",
    "wl",
    "at",
    "\u03bb",
    "value",
    "values",
}
_WAVELENGTH_WORDS = {
    "wavelength",
    "wavelengths",
    "lambda",
    "wl",
    "wvl",
    "\u03bb",
    "wellenl\u00e4nge",
    "wave",
    "nm",
}
_WAVENUMBER_WORDS = {"wavenumber", "wavenumbers", "wellenzahl"}
_CHANNELS = {"red": "r", "green": "g", "blue": "b"} | {letter: letter for letter in "rgbxyz"}
# Heads by what they name, from the general to the special; the usual spelling first.
_NAMES = {
    "material": ("material name", "material"),
    "colour": ("color name", "colour name"),
    STANDARD: ("standard name", "standard"),
    "sample": ("sample name", "sample", "name", "data name", "measurement name"),
    "batch": ("batch name", "batch"),
    "trial": ("trial name", "trial"),
    NUMBER: ("sample id", "sample no", "id"),
    TYPE: ("type",),
}
_CALLED_BY = ("sample", "trial", "batch", NUMBER, STANDARD, "material", "colour", TYPE)
_GLOSS_WORDS = {"gloss", "glanz", "gu", "deg", "degree", "degrees", "unit", "units", "value"}
_USUAL_GLOSS_DEG = 60.0


_OF_VIEWING = (
    r"(?:(?P<light>[A-Za-z]+[0-9]*)\s*/\s*(?P<deg>2|10)\s*[\u00b0\u00ba]?|"
    r"(?P<deg_first>2|10)\s*[\u00b0\u00ba]?\s*/\s*(?P<light_last>[A-Za-z]+[0-9]*))"
)
_VIEWING = re.compile(_OF_VIEWING)
_CIE_LIGHT = "(?:[ACE]|D[0-9]{2}|FL?[0-9]{1,2})"
_LIGHT_SAID = re.compile(rf"\billuminant\W+({_CIE_LIGHT})(?![\w/])", re.IGNORECASE)
_OBSERVER_SAID = re.compile(r"\bobserver\W+(2|10)(?![\d.,])", re.IGNORECASE)
_VIEWING_OF_CIE = re.compile(rf"(?<![\w/]){_OF_VIEWING.replace('[A-Za-z]+[0-9]*', _CIE_LIGHT)}(?![\w/])")
_LAB_AXES = "lab"
_LAB = re.compile(rf"(?:CIE\s*)?(?P<axis>[LAaBbl])\s*\*?\s*([(\[]?\s*{_OF_VIEWING}\s*[)\]]?)?")


class ValueHead(NamedTuple):
    """The meaning of the heading of a column of values.

    Attributes:
        nm: wavelength in nm, or None.
        quantity: quantity of the values, or None.
        channel: `r`, `g`, `b`, `x`, `y` or `z`, or None.
    """

    nm: float | None
    quantity: Quantity | None
    channel: str | None


def angle_name(head: str) -> str | None:
    """Return the angle that a heading names, or None if it names no angle.

    The angle is `theta_i`, `phi_i`, `theta_o`, `phi_o`, `RELATIVE` (a difference of azimuths) or `PHASE`.
    `angle_names` also understands headings whose meaning depends on the others, such as `phi` and `azimuth`.
    """
    letters = _letters(head)
    return next((name for name, spelling in _ANGLES.items() if re.fullmatch(spelling, letters)), None)


def _letters(head: str) -> str:
    if len(head) > _LONGEST or head.strip().lower() == "the":  # a word of prose, not `th_e`
        return ""
    text = _RADIANS.sub("", _DEGREES.sub("", _BRACKETS.sub("", head.lower().translate(_GREEK))))
    return re.sub(r"[^a-z]", "", text)


def angle_names(heads: Sequence[str]) -> list[str | None]:
    """Return the angle of every heading of a table, or None; a heading may depend on the others.

    `phi` beside `phi_r` is the azimuth of the light, as is `theta` beside `theta_r`. `azimuth` beside `incidence` and
    `emission` is the angle between their planes, as in planetary photometry, whose letters i, e, g and psi are
    understood.
    """
    letters = [_letters(head) for head in heads]
    is_planetary = {"i", "e"} <= set(letters)
    names = [
        (_PLANETARY.get(word) if is_planetary else None) or angle_name(head)
        for word, head in zip(letters, heads, strict=True)
    ]
    for seen, light in (("theta_o", "theta_i"), ("phi_o", "phi_i")):
        of_any = [k for k, word in enumerate(letters) if word == seen.partition("_")[0]]
        if names.count(seen) == 2 and len(of_any) == 1 and light not in names:
            names[of_any[0]] = light
    if not {"phi_i", "phi_o", RELATIVE} & set(names) and (
        is_planetary or any(re.match("emi|emer", word) for word in letters)
    ):
        alone = [k for k, word in enumerate(letters) if _AZIMUTH_ALONE.fullmatch(word)]
        if len(alone) == 1:
            names[alone[0]] = RELATIVE
    return names


def angle_unit(
    heads: Sequence[str], context: ErrorContext, where: str
) -> Literal["degrees", "radians"] | None:
    """Return the unit that headings of angles name, or None. Raises FileFormatError if they name both."""
    is_degrees, is_radians = (any(unit.search(h.lower()) for h in heads) for unit in (_DEGREES, _RADIANS))
    if is_degrees and is_radians:
        raise context.error("angles in degrees and in radians, expected one unit", where)
    return "degrees" if is_degrees else "radians" if is_radians else None


def value_head(head: str) -> ValueHead | None:
    """Parse the heading of a column of values, such as `BRDF (633 nm)`, `R400 [%]`; return None for others."""
    if not head.strip() or len(head) > _LONGEST:
        return None
    text = quantities.plain(head)
    bands = list(_BAND.finditer(text))
    if len(bands) > 1 or _MULTIPLE.search(text):
        return None
    nm = None
    if bands:
        unit = bands[0]["unit"] or "nm"
        nm = wavelength_nm(bands[0]["number"], unit)
        if nm is None or not _LEAST_NM <= nm <= (_MOST_NM if bands[0]["unit"] else _LARGEST_BARE_NM):
            return None
        text = f"{text[: bands[0].start()]} {text[bands[0].end() :]}"
    words = quantities.phrase(text).split()
    others = " ".join(word for word in words if word not in _BAND_WORDS)
    of_channel = others.removeprefix("brdf ").removeprefix("bsdf ")
    letter = None if bands else _CHANNELS.get(of_channel)
    quantity = BRDF if letter is not None and of_channel != others else quantities.quantity_of(others)
    if quantities.is_per_steradian(head):
        if quantity is not None and quantity.scale != 1.0:
            return None
        quantity = BRDF if quantity is None and not others else quantity
    is_wavelength = bool(words) and not others and not bands
    if (others and quantity is None and letter is None) or is_wavelength:
        return None
    return ValueHead(nm, quantity, letter)


def wavelength(head: str) -> float | None:
    """Return the wavelength in nm that the heading of a column names, or None."""
    said = value_head(head)
    return said.nm if said is not None else None


def wavelength_unit(head: str) -> str | None:
    """Return the unit of a column of wavelengths or wavenumbers, by its heading; None for other columns.

    The unit is empty if the heading names none.

    >>> wavelength_unit("Wavelength (nm)"), wavelength_unit("lambda"), wavelength_unit("465nm")
    ('nm', '', None)
    """
    if len(head) > _LONGEST:
        return None
    text = head.strip().lower()
    unit = re.search(rf"(?<![^\W_])({LENGTH_UNIT})(?![^\W_])[\s)\].]*$", text)
    words = re.findall(r"[^\W\d_]+", text[: unit.start()] if unit else text)
    words = [word for word in words if word != "in"]
    is_named = len(words) == 1 and words[0] in _WAVELENGTH_WORDS | _WAVENUMBER_WORDS
    is_unit = not words and unit is not None and len(unit[1]) > 1  # `m` and `A` are other things
    if not (is_named or is_unit) or any(map(str.isdigit, text[: unit.start()] if unit else text)):
        return None
    if unit is not None:
        return unit[1]
    return "cm-1" if words[0] in _WAVENUMBER_WORDS else "nm" if words[0] == "nm" else ""


def is_wavelength(head: str) -> bool:
    """Return whether the cells below a heading are wavelengths or wavenumbers."""
    return wavelength_unit(head) is not None


def is_wavenumber(head: str) -> bool:
    """Return whether the heading of a column says that its cells are wavenumbers."""
    unit = wavelength_unit(head)
    return unit is not None and "cm" in unit


def channel(head: str) -> str | None:
    """Return `r`, `g`, `b`, `x`, `y` or `z`, which the heading of a column names, or None."""
    said = value_head(head)
    return None if said is None else said.channel


def quantity(heads: Sequence[str], context: ErrorContext, where: str) -> Quantity | None:
    """Return the quantity that the headings of columns name, or None.

    Raises:
        FileFormatError: headings name different quantities.
    """
    is_rgb = len(heads) == 3 and all(map(channel, heads))  # `R` is red
    said = {head.quantity for head in map(value_head, heads) if head is not None}
    named = [q for q in said if q is not None and not (is_rgb and q == FACTORS)]
    if len(named) > 1:
        raise context.error(
            f"columns of {' and of '.join(sorted(q.title for q in named))}, expected one quantity", where
        )
    return named[0] if named else None


def is_percent(heads: Sequence[str]) -> bool:
    """Return whether headings of values name percent."""
    return any(map(quantities.is_percent, heads))


class UncertaintyHead(NamedTuple):
    """The meaning of the heading of a column of uncertainties.

    Attributes:
        nm: the wavelength of the values to which it belongs, or None.
        is_relative: whether the uncertainties are relative to the values.
        coverage: coverage factor; 0 for expanded uncertainties without a stated factor.
    """

    nm: float | None
    is_relative: bool
    coverage: float


_UNCERTAIN = {
    "std", "stdev", "stddev", "sd", "sigma", "uncertainty", "unc", "error", "err", "u", "ubrdf", "deviation",
}  # fmt: skip
_BESIDE_UNCERTAIN = {
    "dev", "standard", "expanded", "combined", "relative", "rel", "c", "1", "one", "brdf", "bsdf", "f", "r", "brf",
    "reff", "radf", "rf", "refl", "reflectance", "factor", "i", "k",
}  # fmt: skip
_COVERAGE = re.compile(r"\bk\s*=\s*(\d(?:[.,]\d+)?)")


def uncertainty_head(head: str) -> UncertaintyHead | None:
    """Parse the heading of a column of uncertainties, such as `Std. Dev.`, `u(BRDF)`; return None for others."""
    if len(head) > _LONGEST:
        return None
    text = quantities.plain(re.sub(r"\u00b1|\+\s*/?\s*-", " std ", head)).replace("\u03c3", "sigma")
    said = _COVERAGE.search(text)
    text = _COVERAGE.sub(" ", text)
    bands = [
        m for m in _BAND.finditer(text) if m["unit"] or float(m["number"].replace(",", ".")) >= _LEAST_NM
    ]
    if len(bands) > 1:
        return None
    if bands:
        text = f"{text[: bands[0].start()]} {text[bands[0].end() :]}"
    words = quantities.phrase(text).split()
    own = {word for word in words if word in _UNCERTAIN}
    if not own or set(words) - own - _BESIDE_UNCERTAIN - _BAND_WORDS:
        return None
    coverage = float(said[1].replace(",", ".")) if said else 0.0 if "expanded" in words else 1.0
    nm = wavelength_nm(bands[0]["number"], bands[0]["unit"] or "nm") if bands else None
    return UncertaintyHead(nm, bool({"relative", "rel"} & set(words)), coverage)


def gloss_angle(head: str) -> float | None:
    """Return the angle in degrees of a column of gloss, by default 60, or None for other headings."""
    words = re.findall(r"[^\W\d_]+|\d+", head.lower()) if len(head) <= _LONGEST else []
    numbers = [float(word) for word in words if word.isdecimal()]
    others = {word for word in words if not word.isdecimal()}
    if not others & {"gloss", "glanz", "gu"} or others - _GLOSS_WORDS or len(numbers) > 1:
        return None
    angle = numbers[0] if numbers else _USUAL_GLOSS_DEG
    return angle if angle in GLOSS_ANGLES_DEG else None


class LabHead(NamedTuple):
    """The meaning of a heading such as `L* (D65/10)`: the axis `l`, `a` or `b`, and the viewing or None."""

    axis: str
    viewing: Viewing | None


def lab_head(head: str) -> LabHead | None:
    """Parse the heading of a column of CIELAB values; return None for others."""
    found = _LAB.fullmatch(head.strip()) if len(head) <= _LONGEST else None
    if found is None:
        return None
    return LabHead(found["axis"].lower(), _viewing(found))


def viewing(text: str) -> Viewing | None:
    """Return the light and the observer of a text such as `D65/10`, or None."""
    found = _VIEWING.fullmatch(text.strip()) if len(text) <= _LONGEST else None
    return None if found is None else _viewing(found)


def viewing_in(text: str) -> Viewing | None:
    """Return the CIE light and observer that a text such as `Illuminant: D65/10` names; None for others."""
    found = _VIEWING_OF_CIE.search(text) if len(text) <= _LONGEST else None
    return None if found is None else _viewing(found)


def viewing_of_lines(lines: Iterable[str]) -> Viewing | None:
    """Return the CIE light and observer that lines name, such as `Illuminant: A` and `Observer: 10`; or None."""
    lines = [line for line in lines if len(line) <= _LONGEST]
    if (named := next((seen for line in lines if (seen := viewing_in(line)) is not None), None)) is not None:
        return named
    light, degrees = (
        {found[1].upper() for line in lines for found in said.finditer(line)}
        for said in (_LIGHT_SAID, _OBSERVER_SAID)
    )
    return Viewing(light.pop(), int(degrees.pop())) if len(light) == len(degrees) == 1 else None


def _viewing(found: re.Match[str]) -> Viewing | None:
    light, degrees = found["light"] or found["light_last"], found["deg"] or found["deg_first"]
    return None if light is None else Viewing(light.upper(), int(degrees))


def lab_columns(
    heads: Sequence[str], wanted: Viewing | None = None
) -> tuple[list[int], Viewing | None] | None:
    """Return the columns of L*, a* and b* of a header, and their light and observer; or None.

    If a header has several such triples, return the one of the wanted light and observer, otherwise the first.
    """
    said = {k: lab for k, head in enumerate(heads) if (lab := lab_head(head)) is not None}
    by_viewing: dict[Viewing | None, list[int]] = {}
    for seen in dict.fromkeys(lab.viewing for lab in said.values()):
        axes = {lab.axis: k for k, lab in said.items() if lab.viewing == seen}
        if len(axes) == len(_LAB_AXES):
            by_viewing[seen] = [axes[axis] for axis in _LAB_AXES]
    if not by_viewing:
        return None
    seen = wanted if wanted in by_viewing else next(iter(by_viewing))
    return by_viewing[seen], seen


def plain_head(head: str) -> str:
    """Return the words of a heading in lower case, without anything in brackets."""
    return (
        " ".join(re.findall(r"[^\W\d_]+", _BRACKETS.sub("", head.lower()))) if len(head) <= _LONGEST else ""
    )


def name_columns(heads: Sequence[str]) -> dict[str, int]:
    """Return the columns that together name a sample, by what they name (standard, trial), the most general first.

    >>> name_columns(["Trial Name", "Standard Name", "400"])
    {'standard': 1, 'trial': 0}
    """
    words = [plain_head(head) for head in heads]
    found = {
        what: next((words.index(name) for name in names if name in words), -1)
        for what, names in _NAMES.items()
    }
    return {what: k for what, k in found.items() if k >= 0}


def sample_names(cells: Iterable[Mapping[str, str]], default: str = "") -> list[str]:
    """Return the name of each sample, from its cells by the keys of `name_columns`.

    The name is the cell of one column or, if several samples share that cell, includes the cells that distinguish them.
    `default` is the name of samples without any.

    >>> sample_names([{"standard": "red", "trial": ""}, {"standard": "red", "trial": "red 1"}])
    ['red', 'red 1']
    >>> sample_names([{"sample": "red", "type": "Standard"}, {"sample": "red", "type": "Batch"}])
    ['red: Standard', 'red: Batch']
    """
    cells = list(cells)
    short = [next((own[key] for key in _CALLED_BY if own.get(key)), default) for own in cells]
    alike: dict[str, list[Mapping[str, str]]] = {}
    for name, own in zip(short, cells, strict=True):
        alike.setdefault(name, []).append(own)
    telling = {
        name: {key for key in of[0] if len({own[key] for own in of}) > 1} for name, of in alike.items()
    }
    told = [
        dict.fromkeys(cell for key, cell in own.items() if cell and (cell == name or key in telling[name]))
        for name, own in zip(short, cells, strict=True)
    ]
    return [": ".join(own) or name for name, own in zip(short, told, strict=True)]

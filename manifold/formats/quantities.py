"""Finds the quantity that the headings of BRDF tables and of spectra name.

Words that this module does not understand raise an error; they never mean the default.

Sources: ASTM E1392 and E2387 (BRDF, cosine-corrected BSDF), CIE S 017 (reflectance factor, radiance factor, radiance
coefficient), Hapke 1993, chapter 10 (I/F and REFF).
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from manifold.core.records import Array
from manifold.formats.text import ErrorContext

LEAST_COSINE = 1e-3
"""Smallest cosine with the normal by which a value may be divided."""


@dataclass(frozen=True)
class Quantity:
    """A quantity and its conversion into a BRDF: f = scale * value / cosines, after undoing a logarithm.

    Attributes:
        title: name of the quantity, in the plural.
        scale: f in 1/sr for a value of 1 at cosines of 1.
        cosines: angles whose cosines the values include: `i`, `o` or both.
        base: base of the logarithm of the values; 0 if they are not logarithms.
    """

    title: str
    scale: float = 1.0
    cosines: str = ""
    base: float = 0.0

    def brdf(self, values: Array, wi: Array, wo: Array, white: float = 1.0) -> Array:
        """Convert values (P, B) at wi and wo (P, 3) to f in 1/sr, shape (P, B); NaN where a cosine is 0.

        `white` is the value that stands for 1 in the unit of the values, such as 100 for percent.
        """
        f = self.scale * (np.power(self.base, values) if self.base else values / white)
        for letter, w in (("i", wi), ("o", wo)):
            if letter in self.cosines:
                cosine = w[:, 2:]
                f = np.divide(f, cosine, out=np.full_like(f, np.nan), where=cosine > LEAST_COSINE)
        return f

    @property
    def note(self) -> str | None:
        """Return a note on the conversion of the values; None if they are the BRDF itself."""
        done = ["divided by pi"] if self.scale != 1.0 else []
        done += [f"divided by the cosine of theta_{letter}" for letter in self.cosines]
        log = f"logarithms to base {'e' if self.base == math.e else '10'} of " if self.base else ""
        return f"{log}{self.title}{', ' if done else ''}{' and '.join(done)}" if done or log else None


BRDF = Quantity("BRDF")
COSINE_BRDF = Quantity("BRDF times the cosine of theta_o", cosines="o")
FACTORS = Quantity("reflectance factors", 1.0 / np.pi)
I_OVER_F = Quantity("I/F (radiance factors of planetary photometry)", 1.0 / np.pi, "i")

KNOWN = "BRDF, cosine-corrected BRDF, reflectance factor, I/F or log10(BRDF)"
"""Text for error messages that lists the supported quantities."""

# Of whole phrases as `phrase` returns them.
_F = r"(brdf|bsdf|f|f r|fr|bidirectional (reflectance|scatter|scattering) distribution function)"
_REFLECTANCE = (
    r"(reflectance|reflection|reflexion|reflectivity|reflexionsgrad|remission|remissionsgrad|refl|reflect)"
)
_PATTERNS = tuple(
    (quantity, re.compile(pattern))
    for quantity, pattern in (
        (BRDF, rf"{_F}( r)?|(radiance|luminance) coefficient"),
        (
            COSINE_BRDF,
            rf"(cc|cos corrected|cos) ({_F}|scatter)|({_F}|scatter) ((x |times )?cos( theta)?( [sorv])?|cos corrected)|"
            r"ccbrdf|ccbsdf|ars|dsf|(angle|angular) resolved (scatter|scattering)",
        ),
        (
            FACTORS,
            rf"r|beta|rf|brf|brrf|reff|((bidirectional )?{_REFLECTANCE}|radiance|luminance) factor|"
            rf"{_REFLECTANCE}",
        ),
        (I_OVER_F, "i f|i over f|radf"),
    )
)
_LOGS = {"lg": 10.0, "ln": math.e}
_FILLERS = {
    "spectral", "value", "values", "measured", "mean", "average", "averaged", "avg", "data", "the", "of",
}  # fmt: skip
_SYNONYMS = {"cosine": "cos", "weighted": "corrected", "costheta": "cos"}
_PER_STERADIAN = re.compile(
    r"\b1\s*/\s*(sr|steradians?)\b|/\s*(sr|steradians?)\b|\b(sr|steradian)\s*(\^|\*\*)?\s*[-\u2212\u2013]\s*1|"
    r"sr\s*\u207b\u00b9|\bper\s+(sr|steradian)\b|\binverse\s+steradians?\b"
)  # fmt: skip
_PERCENT = re.compile(r"%|\bper\s?cent(age)?s?\b|\bpct\b")
_NOT_WEIGHTED = re.compile(r"\b(not|un|non)[-\s]?cos(ine)?[-\s]?(weighted|corrected)\b")
# Words that make a text a statement on the quantity; other words of prose say nothing.
_TELLING = re.compile(
    r"(cc)?b[rs]df|btdf|bssrdf|reflectanc\w*|reflectiv\w*|reflexion\w*|remission\w*|radian\w*|irradian\w*|"
    r"luminan\w*|intensit\w*|cos|ln|lg|log|absor\w*|extin\w*|transmi\w*|factors?|coefficients?|normali[sz]ed|relative|"
    r"arbitrary|counts?|signal|voltage|power|flux|albedo|b?rr?f|reff|radf|ars|dsf"
)  # fmt: skip
# Reflectances of other geometries, or of which nothing says whether they are relative to a diffuser.
_UNCLEAR = re.compile(
    rf"\b(bidirectional|bi directional|directional|hemispherical|diffuse|total|specular) {_REFLECTANCE}\b"
    r"(?! (factor|distribution))"
)
_TRANSMITTED = re.compile(r"btdf|transmi\w*")


def plain(text: str) -> str:
    """Return a text in lower case without the unit of its values, and with `lg` for the common logarithm."""
    text = _PER_STERADIAN.sub(" ", text.lower().replace("_", " "))
    return re.sub(r"\blog\s?10(?!\d)|\blg\b", " lg ", _PERCENT.sub(" ", text))


def phrase(text: str) -> str:
    """Return the words of a `plain` text in order, without words that do not affect the quantity."""
    words = re.findall(r"[^\W\d_]+|\d+", text)
    return " ".join(_SYNONYMS.get(word, word) for word in words if word not in _FILLERS)


def is_percent(text: str) -> bool:
    """Return whether a text names percent."""
    return _PERCENT.search(text.lower()) is not None


def is_per_steradian(text: str) -> bool:
    """Return whether a text names the unit of a BRDF."""
    return _PER_STERADIAN.search(text.lower().replace("_", " ")) is not None


def quantity_of(words: str) -> Quantity | None:
    """Return the quantity that a whole `phrase` names, or None."""
    first, _, rest = words.partition(" ")
    if first in _LOGS:
        logged = quantity_of(rest)
        return None if logged is None or logged.base else replace(logged, base=_LOGS[first])
    return next((quantity for quantity, pattern in _PATTERNS if pattern.fullmatch(words)), None)


def quantity_in_prose(
    text: str, what: str, context: ErrorContext, where: str | None = None
) -> Quantity | None:
    """Return the quantity that a text such as `Reflectance factor of a plate` names; None if it names none.

    Raises:
        FileFormatError: the words name an unsupported quantity, or several; `what` names the text in the message.
    """
    words = phrase(_NOT_WEIGHTED.sub(" ", plain(text))).split()
    telling = [k for k, word in enumerate(words) if _TELLING.fullmatch(word)]
    if not telling:
        return BRDF if is_per_steradian(text) else None
    spans = ((i, j) for i in range(telling[0] + 1) for j in range(len(words), telling[-1], -1))
    found = next((q for i, j in spans if (q := quantity_of(" ".join(words[i:j])))), None)
    is_contradiction = found is not None and found.scale != 1.0 and is_per_steradian(text)
    if found is None or is_contradiction or _UNCLEAR.search(" ".join(words)):
        light = "transmitted light, " if _TRANSMITTED.search(" ".join(words)) else ""
        raise context.error(
            f"{what} is '{text.strip()[:60]}': {light}expected {KNOWN}",
            where,
            remedy="convert the values to one of these",
        )
    return found


SpectrumKind = Literal["reflectance", "log", "absorbance", "transmittance", "power", "sensitivity", "other"]
"""The content of a column of a spectrum; `log` is log10(1/R), the apparent absorbance of a reflectance."""

# Patterns of whole words.
_SPECTRUM_WORDS: dict[SpectrumKind, str] = {
    "reflectance": rf"{_REFLECTANCE}s?|brf|tgt|r",
    "absorbance": r"absor\w+|extin[ck]\w+|abs|od|a",
    "transmittance": r"transmi\w+|t|trans",
    "power": r"(ir)?radian\w*|(ir)?rad|exitance|power|spd|flux|emission|intensity|illuminant|luminance|watts?|energy|w",
    "sensitivity": r"sensitivit\w*|responsiv\w*|response|qe",
    "other": r"emissivit\w*|emittance|counts?|dn|digital|raw|voltage|photons?|quanta|log|lg|ln|deriv\w*|kubelka|munk",
}
_OF_LETTERS = re.compile(r"\bk\W*/\W*s\b|\bf\W*\(\W*r|\b1\s*-\s*r")  # Kubelka-Munk's, absorptance
_LOG_OF_RECIPROCAL = re.compile(r"\b(lg|log)\W*1\s*/\s*r(efl\w*)?\b|-\s*(lg|log)\W*r(efl\w*)?\b")


def spectrum_kinds(head: str) -> set[SpectrumKind]:
    """Return the kinds of spectra that the words of a column's heading name; empty if they name none."""
    text = plain(head)
    if _LOG_OF_RECIPROCAL.search(text):
        return {"log"}
    if _OF_LETTERS.search(text):
        return {"other"}
    words = re.findall(r"[^\W\d_]+", text)
    words = [word for word in words if len(word) > 1 or len(words) == 1]  # `R`, but not `paint R`
    return {
        kind
        for kind, pattern in _SPECTRUM_WORDS.items()
        if any(re.fullmatch(pattern, word) for word in words)
    }

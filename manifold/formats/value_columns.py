"""Columns of values beside directions: their bands, and whether they are a BRDF, times the cosine, or factors."""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import Literal

import numpy as np

from manifold.formats.text import Place
from manifold.formats.tristimulus import converted, unnamed_band
from manifold.records import Array

Quantity = Literal["f", "f_cos", "factor"]
"""BRDF in 1/sr; BRDF times cos theta_o; reflectance factor, pi times the BRDF."""

_LEAST_NM = 150.0
_BAND = re.compile(r"(?P<number>\d+(\.\d+)?)\s*(?P<unit>nm|um|µm|μm|micron)?", re.IGNORECASE)
_COSINE = re.compile(
    r"\b(ARS|DSF|CC_?BS?[RST]?DF)(?![a-z])|BS?[RST]?DF\W*\(?cos|\bf_cos|cos(ine)?[ -]?(corrected|weighted)",
    re.IGNORECASE,
)
_FACTOR = re.compile(r"\bB?BRR?F(?![a-z])|(reflectance|radiance|reflection)[ _-]*factor", re.IGNORECASE)


def quantity(texts: Iterable[str]) -> Quantity:
    """What heads of values, and what stands above them, say that the values are; f where they say nothing."""
    for text in texts:
        if _COSINE.search(text):
            return "f_cos"
        if _FACTOR.search(text):
            return "factor"
    return "f"


def as_brdf(values: Array, kind: Quantity, wo: Array, notes: list[str]) -> Array:
    """f in 1/sr of values (P, B) of a quantity at directions wo (P, 3); NaN where the cosine is 0, and a note."""
    if kind == "factor":
        notes.append("reflectance factors, divided by pi")
        return values / np.pi
    if kind == "f_cos":
        notes.append("values include the cosine of theta_o, and are divided by it")
        cosine = wo[:, 2:]
        return np.divide(values, cosine, out=np.full_like(values, np.nan), where=cosine > 1e-3)
    return values


def bands_of(heads: list[str], values: Array, notes: list[str], place: Place) -> tuple[Array | None, Array]:
    """Wavelengths in nm, increasing, or None for linear sRGB, and the values (P, B) in their order.

    Raises:
        FileFormatError: a head names no band, or two name the same.
    """
    bare = [re.sub(r"\(.*?\)|\[.*?\]", "", head.lower()) for head in heads]
    letters = [re.sub(r"^b[rs]df|[^a-z]", "", head) for head in bare]
    for space in ("rgb", "xyz"):
        words = [{"red": "r", "green": "g", "blue": "b"}.get(letter, letter) for letter in letters]
        if sorted(words) == sorted(space):
            values = values[:, [words.index(letter) for letter in space]]
            if space == "xyz":
                values = converted(values, notes)
            return None, values
    nm = []
    for head in heads:
        wavelength = wavelength_of(head)
        if wavelength is None and len(heads) == 1:
            return unnamed_band(notes), values
        if wavelength is None:
            raise place.error(f"band '{head[:24]}', expected a wavelength such as 465nm, R, G, B or X, Y, Z")
        nm.append(wavelength)
    order = np.argsort(nm)
    ascending = np.array(nm)[order]
    if np.any(np.diff(ascending) <= 0) or ascending[0] <= 0:
        raise place.error(f"bands {', '.join(heads[:6])}, expected different wavelengths")
    return ascending, values[:, order]


def wavelength_of(head: str) -> float | None:
    """The wavelength in nm of a band's head; numbers without a unit are nm, or numbers of bands where too small."""
    found = _BAND.search(head)
    if found is None or (found["unit"] is None and float(found["number"]) < _LEAST_NM):
        return None
    return float(found["number"]) * (1.0 if (found["unit"] or "nm").lower() == "nm" else 1000.0)

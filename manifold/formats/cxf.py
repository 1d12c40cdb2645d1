"""CxF3 files (ISO 17972-1): reflectance spectra of objects at multi-angle geometries.

A geometry is the spectrum's own name, or a `BRDFAngle` (illumination angle, aspecular angle, optional azimuth) or a
`SingleAngle` of its colour specification. 1.0 is the perfect diffuser. Nothing but these elements is read: vendors add
elements and attributes that the schema has elsewhere, or not at all.
"""

from __future__ import annotations

import codecs
from collections import Counter
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import numpy as np

from manifold.formats.error_context import ErrorContext
from manifold.formats.geometry_names import geometry_directions
from manifold.formats.readings import Readings, aspecular_pair, mean_of_repeats
from manifold.formats.text import decode, read_bytes
from manifold.formats.values import TAKEN_AS_PERCENT, looks_like_percent
from manifold.records import Array

_REMEDY = "export CxF3 with multi-angle reflectance again"
_LARGEST = 12_000_000  # bytes
_MOST_VALUES = 20_000_000  # of a sample: spectra times all their wavelengths
_USUAL_STEP_NM = "10"


def sniff(head: bytes) -> bool:
    """Whether a file's beginning is a CxF document of any version."""
    text = _text(head).lstrip().lower()
    return text.startswith("<") and ("cxf" in text) and "html" not in text[:200]


def read(path: Path) -> list[Readings]:
    """Readings of every object that has reflectance spectra at directional geometries.

    Raises:
        FileFormatError: another version of CxF, not well formed, or no such spectra.
        UsageError: the file cannot be read.
    """
    context = ErrorContext(path, _REMEDY)
    root = _parse(read_bytes(path, _LARGEST), context)
    specifications = {
        str(item.get("Id")): measurement
        for item in root.iterfind("{*}Resources/{*}ColorSpecificationCollection/{*}ColorSpecification")
        if (measurement := item.find("{*}MeasurementSpec")) is not None
    }
    objects = root.iterfind("{*}Resources/{*}ObjectCollection/{*}Object")
    found = [_object(item, specifications, context, path.stem) for item in objects]
    samples = _by_name([one for one in found if one is not None], context)
    if not samples:
        raise context.error(
            "no reflectance at directional geometries, expected ReflectanceSpectrum with BRDFAngle or SingleAngle, or "
            "named by its geometry (45as15, 45/0)"
        )
    if any(looks_like_percent(one.wi, one.wo, one.values) for one in samples):
        samples = [replace(s, values=s.values / 100.0).with_note(TAKEN_AS_PERCENT) for s in samples]
    return [replace(one, values=one.values / np.pi) for one in samples]


def _text(data: bytes) -> str:
    """The document as text: XML may be UTF-16."""
    if data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return data.decode("utf-16", "replace")
    return decode(data)


def _parse(data: bytes, context: ErrorContext) -> Element:
    text = _text(data).strip()
    head = text[:4000].lower()
    if "<!doctype" in head or "<!ENTITY" in text:
        raise context.error("a document type with entities, expected plain CxF3")
    if "cxf" in head and "cxf3" not in head:
        raise context.error("CxF of an older version, expected CxF3 (colorexchangeformat.com/CxF3-core)")
    try:
        return ElementTree.fromstring(text)
    except (ElementTree.ParseError, ValueError, RecursionError) as error:
        raise context.error(f"not a readable CxF3 document ({' '.join(str(error).split())[:100]})") from None


def _by_name(objects: list[Readings], context: ErrorContext) -> list[Readings]:
    """One record per name: objects of one name hold a sample's geometries, or are measurements, which get numbers."""
    parts: dict[str, list[list[Readings]]] = {}
    seen: dict[str, set[tuple[float, ...]]] = {}
    for one in objects:
        keys = {tuple(row) for row in np.round(np.hstack([one.wi, one.wo]), 6)}
        if keys.isdisjoint(seen.get(one.name, keys)):
            parts[one.name][-1].append(one)
            seen[one.name] |= keys
        else:
            parts.setdefault(one.name, []).append([one])
            seen[one.name] = keys
    return [
        replace(_joined(own, context), name=f"{name} ({k})" if k > 1 else name)
        for name, measurements in parts.items()
        for k, own in enumerate(measurements, start=1)
    ]


def _joined(parts: list[Readings], context: ErrorContext) -> Readings:
    if len(parts) == 1:
        return parts[0]
    nm = [np.array(part.wavelengths_nm) for part in parts for _ in part.values]
    bands, table = _common_bands(nm, [row for part in parts for row in part.values], context)
    wi, wo = (np.concatenate([getattr(part, key) for part in parts]) for key in ("wi", "wo"))
    notes = tuple(dict.fromkeys(note for part in parts for note in part.notes))
    texture = {key: value for part in parts for key, value in part.texture.items()}
    return Readings(parts[0].name, parts[0].instrument, wi, wo, bands, table, notes=notes, texture=texture)


def _object(
    item: Element, specifications: Mapping[str, Element], context: ErrorContext, default: str
) -> Readings | None:
    """Reflectance factors of one object as the file has them, or None where it has none at a geometry."""
    name = item.get("Name") or default
    pairs, values, wavelengths = [], [], []
    instrument, turns = "spectrophotometer (CxF3)", Counter[str]()
    left_out = 0
    for index, spectrum in enumerate(item.iterfind("{*}ColorValues/{*}ReflectanceSpectrum"), start=1):
        where = f"object '{name[:40]}', spectrum {index}"
        key = spectrum.get("ColorSpecification", "")
        measurement = specifications.get(key, spectrum)  # a spectrum has no such children
        pair = _geometry(spectrum, measurement, turns[key], context, where)
        turns[key] += geometry_directions(spectrum.get("Name", "")) is None
        if pair is None:
            left_out += 1
            continue
        pairs.append(pair)
        values.append(
            np.array([context.number(c.rstrip(",;"), where) for c in (spectrum.text or "").split()])
        )
        wavelengths.append(_wavelengths(spectrum, values[-1].size, measurement, context, where))
        device = [measurement.findtext(f"{{*}}Device/{{*}}{key}") for key in ("Manufacturer", "Model")]
        instrument = " ".join(filter(None, device)) or instrument
    if not pairs:
        return None
    bands, table = _common_bands(wavelengths, values, context)
    wi, wo = (np.array(w) for w in zip(*pairs, strict=True))
    wi, wo, table, scatter, repeats = mean_of_repeats(wi, wo, table)
    notes = [f"{left_out} spectra without a directional geometry are left out"] if left_out else []
    notes += repeats
    texture: dict[str, Any] = {
        tags.get("Name") or f"tags {k}": {
            str(tag.get("Name")): tag.get("Value") for tag in tags.iterfind("{*}Tag")
        }
        for k, tags in enumerate(item.iterfind("{*}TagCollection"))
    }
    return Readings(
        name, instrument, wi, wo, bands, table, notes=tuple(notes), texture=texture, scatter=scatter
    )


def _geometry(
    spectrum: Element, measurement: Element, turn: int, context: ErrorContext, where: str
) -> tuple[Array, Array] | None:
    """Directions of a spectrum, by its own name first. A specification's angles are used one after the other."""
    name = spectrum.get("Name", "")
    if (by_name := geometry_directions(name)) is not None:
        return by_name

    def angle(parent: Element, key: str) -> float | None:
        text = parent.findtext(f"{{*}}{key}")
        return None if text is None else context.number(text, where)

    angles = measurement.findall("{*}GeometryChoice/{*}MultiAngle/{*}BRDFAngle")
    if angles:
        named = [a for a in angles if name and a.get("Notation") == name]
        chosen = named[0] if named else angles[turn % len(angles)]
        lit, aspecular = angle(chosen, "IlluminationAngle"), angle(chosen, "Aspecular")
        if lit is None or aspecular is None:
            return geometry_directions(chosen.get("Notation", ""))
        wi, wo = aspecular_pair(abs(lit), aspecular, angle(chosen, "Azimuth") or 0.0)
        return (wi, wo) if wi[2] > 0.0 and wo[2] > 0.0 else None
    single = measurement.find("{*}GeometryChoice/{*}SingleAngle")
    if single is None:
        return None
    lit, seen = angle(single, "IlluminationAngle"), angle(single, "MeasurementAngle")
    if lit is None or seen is None or max(abs(lit), abs(seen)) >= 90.0:
        return None
    # 45/0: the aspecular angle from the mirror direction to the other leg, on the normal's side.
    return aspecular_pair(abs(lit), abs(lit) - abs(seen))


def _wavelengths(
    spectrum: Element, count: int, measurement: Element, context: ErrorContext, where: str
) -> Array:
    """Wavelengths (B,): a spectrum's own Increment comes before that of its specification; 10 nm by default."""
    shared = measurement.find("{*}WavelengthRange")
    common = shared.attrib if shared is not None else {}
    own_step = spectrum.get("Increment") or spectrum.get("Interval")
    start = spectrum.get("StartWL") or common.get("StartWL", "0")
    step_nm = context.number(own_step or common.get("Increment", _USUAL_STEP_NM), where)
    first_nm = context.number(start, where)
    if step_nm <= 0 or first_nm <= 0 or not count:
        raise context.error("no wavelengths or no values, expected StartWL, Increment and reflectance", where)
    nm: Array = first_nm + step_nm * np.arange(count, dtype=float)
    end = spectrum.get("EndWL")
    if end is not None and abs(context.number(end, where) - nm[-1]) > step_nm / 2.0:
        raise context.error(
            f"{count} values from {first_nm:g} nm by {step_nm:g} nm, expected EndWL={end!r}", where
        )
    return nm


def _common_bands(
    wavelengths: list[Array], values: list[Array], context: ErrorContext
) -> tuple[Array, Array]:
    """All wavelengths (B,) of the spectra, and values (P, B), NaN where a spectrum has none."""
    bands = np.unique(np.concatenate(wavelengths))
    if bands.size * len(values) > _MOST_VALUES:
        raise context.error(
            f"{len(values)} spectra at {bands.size} wavelengths, expected the same wavelengths of all"
        )
    table = np.full((len(values), bands.size), np.nan)
    for row, nm, value in zip(table, wavelengths, values, strict=True):
        row[np.searchsorted(bands, nm)] = value
    return bands, table

"""CxF3 files (ISO 17972-1): reflectance spectra of objects at multi-angle geometries.

Spectra are `ReflectanceSpectrum` or `CustomSpectrum`. A geometry is the spectrum's own name, or a `BRDFAngle`
(illumination angle, aspecular angle, optional azimuth) or a `SingleAngle` of its colour specification. 1.0 is the
perfect diffuser. Other elements are ignored, because vendors add elements and attributes that the schema lacks or
has elsewhere.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import numpy as np

from manifold.core.records import Array
from manifold.formats.column_heads import sample_names
from manifold.formats.geometries import geometry_directions
from manifold.formats.readings import Assumption, Readings, aspecular_pair, mean_of_repeats
from manifold.formats.text import ErrorContext, decode, read_bytes
from manifold.formats.values import looks_like_percent

_REMEDY = "export CxF3 with multi-angle reflectance again"
_LARGEST = 12_000_000  # bytes
_MOST_VALUES = 20_000_000  # values of a sample: spectra times all their wavelengths
_USUAL_STEP_NM, _LAST_VISIBLE_NM = 10.0, 780.0  # of spectrophotometers for colours
_PROPERTIES = ("Tint", "Background")  # of CxF/X-4: how much of the ink, on what
_MOST_REFLECTANCE = 3.0  # the schema's; near the mirror direction metallic paints reflect more
_SPECTRA = ("ReflectanceSpectrum", "CustomSpectrum")
_Spectrum = tuple[Array, Array, Array, Array]  # wi, wo, wavelengths and values


def sniff(head: bytes) -> bool:
    """Return whether a file's beginning is a CxF document of any version."""
    text = decode(head).lstrip().lower()
    return text.startswith("<") and ("cxf" in text) and "html" not in text[:200]


def read(path: Path) -> list[Readings]:
    """Read every object that has reflectance spectra at directional geometries."""
    context = ErrorContext(path, _REMEDY)
    root = _parse(read_bytes(path, _LARGEST), context)
    specifications = {
        str(item.get("Id")): measurement
        for item in root.iterfind("{*}Resources/{*}ColorSpecificationCollection/{*}ColorSpecification")
        if (measurement := item.find("{*}MeasurementSpec")) is not None
    }
    objects = root.iterfind("{*}Resources/{*}ObjectCollection/{*}Object")
    samples = _by_name(
        [(_identity(item), o) for item in objects for o in _object(item, specifications, context, path.stem)],
        context,
    )
    if not samples:
        raise context.error(
            "no reflectance at directional geometries, expected ReflectanceSpectrum or CustomSpectrum with BRDFAngle "
            "or SingleAngle, or named by its geometry (45as15, 45/0)"
        )
    for one in samples:
        if looks_like_percent(one.wi, one.wo, one.values, _MOST_REFLECTANCE, share=0.0):
            raise context.error(
                f"object '{one.name[:40]}': reflectance of up to {np.nanmax(one.values):.4g}, expected 1.0 for the "
                "perfect diffuser",
                remedy="divide per cent by 100",
            )
    return [replace(one, values=one.values / np.pi) for one in samples]


def _parse(data: bytes, context: ErrorContext) -> Element:
    text = decode(data).strip()
    head = text[:4000].lower()
    if "<!doctype" in head or "<!ENTITY" in text:
        raise context.error("a document type with entities, expected plain CxF3")
    if "cxf" in head and "cxf3" not in head:
        raise context.error("CxF of an older version, expected CxF3 (colorexchangeformat.com/CxF3-core)")
    try:
        return ElementTree.fromstring(text)
    except (ElementTree.ParseError, ValueError, RecursionError) as error:
        raise context.error(f"not a readable CxF3 document ({' '.join(str(error).split())[:100]})") from None


def _identity(item: Element) -> dict[str, str]:
    """Return what tells objects of one name apart: their type, and the properties of CxF/X-4 (ISO 17972-4)."""
    said = {str(tag.get("Name")): str(tag.get("Value")) for tag in item.iterfind("{*}TagCollection/{*}Tag")}
    properties = ", ".join(f"{key} {said[key]}" for key in _PROPERTIES if key in said)
    return {"type": item.get("ObjectType", ""), "properties": properties}


def _by_name(objects: list[tuple[dict[str, str], Readings]], context: ErrorContext) -> list[Readings]:
    """Return one record per name and `_identity`.

    Objects in which both agree are either the geometries of one specimen, or repeated measurements, which are
    numbered.
    """
    parts: dict[tuple[str, ...], list[list[Readings]]] = {}
    seen: dict[tuple[str, ...], set[tuple[float, ...]]] = {}
    cells: dict[tuple[str, ...], dict[str, str]] = {}
    for identity, one in objects:
        own = {"sample": one.name, **identity}
        key = tuple(own.values())
        keys = {tuple(row) for row in np.round(np.hstack([one.wi, one.wo]), 6)}
        if keys.isdisjoint(seen.get(key, keys)):
            parts[key][-1].append(one)
            seen[key] |= keys
        else:
            parts.setdefault(key, []).append([one])
            seen[key], cells[key] = keys, own
    return [
        replace(_joined(own, context), name=f"{name} ({k})" if k > 1 else name)
        for name, measurements in zip(sample_names(cells.values()), parts.values(), strict=True)
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
) -> list[Readings]:
    """Return the reflectance factors of an object: one record per measuring condition, or none."""
    name = item.get("Name") or default
    notes: list[str] = []
    parts: dict[str, list[_Spectrum]] = {}  # by specification
    turns = Counter[str]()
    left_out = 0
    spectra = [s for s in item.iterfind("{*}ColorValues/*") if s.tag.rpartition("}")[2] in _SPECTRA]
    for index, element in enumerate(spectra, start=1):
        where = f"object '{name[:40]}', spectrum {index}"
        key = element.get("ColorSpecification", "")
        measurement = specifications.get(key, element)  # a spectrum has no such children
        pair = _geometry(element, measurement, turns[key], context, where)
        turns[key] += geometry_directions(element.get("Name", "")) is None
        if pair is None or re.search(
            "Transmittance|Emissive", measurement.findtext("{*}MeasurementType", "")
        ):
            left_out += 1
            continue
        parts.setdefault(key, []).append((*pair, *_values(element, measurement, notes, context, where)))
    if left_out:
        notes.append(f"{left_out} spectra without a directional geometry are left out")
    texture: dict[str, Any] = {
        tags.get("Name") or f"tags {k}": {str(tag.get("Name")): tag.get("Value") for tag in of_texture}
        for k, tags in enumerate(item.iterfind("{*}TagCollection"))
        if (of_texture := [tag for tag in tags.iterfind("{*}Tag") if tag.get("Name") not in _PROPERTIES])
    }
    if properties := _identity(item)["properties"]:
        notes.append(properties)
    conditions = _conditions(parts, specifications)
    if len(conditions) > 1:
        notes.append(f"measured under {', '.join(conditions)}: each is a sample of its own")
    return [
        _measurement(
            f"{name} ({condition})" if len(conditions) > 1 else name,
            [spectrum for key in keys for spectrum in parts[key]],
            next(filter(None, (_device(specifications[key]) for key in keys if key in specifications)), None),
            list(dict.fromkeys(notes)), texture, context,
        )
        for condition, keys in conditions.items()
    ]  # fmt: skip


def _conditions(
    parts: Mapping[str, list[_Spectrum]], specifications: Mapping[str, Element]
) -> dict[str, list[str]]:
    """Return specifications by their measuring condition, so that M1 and M2 are not averaged.

    Specifications of different geometries are one condition. Where several have one geometry, their lamp and filter
    tell conditions apart, or, where these are not given or the same, the specifications themselves.
    """
    at = {
        key: {tuple(np.round(np.hstack([wi, wo]), 6)) for wi, wo, *_ in spectra}
        for key, spectra in parts.items()
    }
    if sum(map(len, at.values())) == len(set().union(*at.values())):
        return {"": list(parts)} if parts else {}
    by_lamp: dict[str, list[str]] = {}
    for key in parts:
        measurement = specifications.get(key)
        words = [
            None if measurement is None else measurement.findtext(f"{{*}}Device/{{*}}{tag}")
            for tag in ("DeviceIllumination", "DeviceFilter")
        ]
        by_lamp.setdefault(", ".join(filter(None, words)), []).append(key)
    is_apart = all(
        sum(len(at[key]) for key in keys) == len(set().union(*(at[key] for key in keys)))
        for keys in by_lamp.values()
    )
    return by_lamp if is_apart and "" not in by_lamp else {key: [key] for key in parts}


def _device(measurement: Element) -> str:
    words = (measurement.findtext(f"{{*}}Device/{{*}}{key}") for key in ("Manufacturer", "Model"))
    return " ".join(filter(None, words))


def _measurement(
    name: str,
    spectra: list[_Spectrum],
    instrument: str | None,
    notes: list[str],
    texture: dict[str, Any],
    context: ErrorContext,
) -> Readings:
    wi, wo = (np.array([spectrum[k] for spectrum in spectra]) for k in (0, 1))
    bands, table = _common_bands([s[2] for s in spectra], [s[3] for s in spectra], context)
    wi, wo, table, scatter, repeats = mean_of_repeats(wi, wo, table)
    return Readings(
        name, instrument or "spectrophotometer (CxF3)", wi, wo, bands, table, notes=(*notes, *repeats),
        texture=texture, scatter=scatter,
    )  # fmt: skip


def _geometry(
    spectrum: Element, measurement: Element, turn: int, context: ErrorContext, where: str
) -> tuple[Array, Array] | None:
    """Return the directions of a spectrum, by its own name first; a specification's angles are used in turn."""
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


def _values(
    spectrum: Element, measurement: Element, notes: list[str], context: ErrorContext, where: str
) -> tuple[Array, Array]:
    """Return wavelengths (B,), increasing, and values (B,); assumptions are added to the notes."""
    points = spectrum.findall("{*}SpectralPoint")
    if points:
        cells = [
            [context.number(p.get("WL", ""), where), context.number(p.text or "", where)] for p in points
        ]
        nm, values = np.array(sorted(cells)).T
        if nm[0] <= 0.0 or np.any(np.diff(nm) <= 0.0):
            raise context.error("a wavelength of 0, or twice the same, expected different ones in nm", where)
        return nm, values
    values = np.array([context.number(c.rstrip(",;"), where) for c in (spectrum.text or "").split()])
    return _wavelengths(spectrum, values.size, measurement, notes, context, where), values


def _wavelengths(
    spectrum: Element, count: int, measurement: Element, notes: list[str], context: ErrorContext, where: str
) -> Array:
    """Return the wavelengths (B,) of a spectrum in nm.

    What a spectrum states takes precedence over its specification. Without an Increment, the last wavelength gives it;
    without that it is taken as 10 nm, with a note.
    """
    shared = measurement.find("{*}WavelengthRange")
    said = {**(shared.attrib if shared is not None else {}), **spectrum.attrib}
    first_nm = context.number(said.get("StartWL", "0"), where)
    step = spectrum.get("Increment") or spectrum.get("Interval") or said.get("Increment")
    last_nm = context.number(said["EndWL"], where) if said.get("EndWL") else None
    step_nm = _USUAL_STEP_NM if step is None else context.number(step, where)
    if step is None and last_nm is not None and count > 1:
        step_nm = (last_nm - first_nm) / (count - 1)
    if step_nm <= 0 or first_nm <= 0 or not count:
        raise context.error(
            "has no wavelengths or no values, expected StartWL, Increment and reflectance", where
        )
    nm: Array = first_nm + step_nm * np.arange(count, dtype=float)
    if last_nm is not None and abs(last_nm - nm[-1]) > step_nm / 2.0:
        raise context.error(
            f"{count} values from {first_nm:g} nm by {step_nm:g} nm, expected EndWL={said['EndWL']!r}", where
        )
    if step is None and last_nm is None:
        if nm[-1] > _LAST_VISIBLE_NM:
            raise context.error(
                f"{count} values from {first_nm:g} nm without an Increment, expected one: by {step_nm:g} nm they would "
                f"end at {nm[-1]:g} nm",
                where,
                remedy="state the Increment",
            )
        notes.append(
            Assumption(f"no Increment of wavelengths is stated: taken as {step_nm:g} nm, up to {nm[-1]:g} nm")
        )
    return nm


def _common_bands(
    wavelengths: list[Array], values: list[Array], context: ErrorContext
) -> tuple[Array, Array]:
    """Return all wavelengths (B,) of the spectra, and values (P, B), NaN where a spectrum has none."""
    bands = np.unique(np.concatenate(wavelengths))
    if bands.size * len(values) > _MOST_VALUES:
        raise context.error(
            f"{len(values)} spectra at {bands.size} wavelengths, expected the same wavelengths of all"
        )
    table = np.full((len(values), bands.size), np.nan)
    for row, nm, value in zip(table, wavelengths, values, strict=True):
        row[np.searchsorted(bands, nm)] = value
    return bands, table

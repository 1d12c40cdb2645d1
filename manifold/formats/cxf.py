"""CxF3 files (ISO 17972-1): reflectance spectra of objects at multi-angle geometries, through colour-cxf.

A geometry is the spectrum's own name, or a `BRDFAngle` (illumination angle, aspecular angle, optional azimuth) or a
`SingleAngle` of its colour specification. 1.0 is the perfect diffuser.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from manifold.formats.geometry_names import geometry_directions
from manifold.formats.readings import Readings, aspecular_pair, mean_of_repeats
from manifold.formats.spectro_table import TAKEN_AS_PERCENT, looks_like_percent
from manifold.formats.text import Place, decode, read_bytes
from manifold.records import Array

_REMEDY = "export CxF3 with multi-angle reflectance again"
_LARGEST = 12_000_000  # bytes
_MOST_SPECTRA = 100_000
_SPECTRA = "{*}Resources/{*}ObjectCollection/{*}Object/{*}ColorValues/{*}ReflectanceSpectrum"


def sniff(head: bytes) -> bool:
    """Whether a file's beginning is a CxF document of any version."""
    text = decode(head).lstrip().lower()
    return text.startswith("<") and ("cxf" in text) and "html" not in text[:200]


def read(path: Path) -> list[Readings]:
    """Readings of every object that has reflectance spectra at directional geometries.

    Raises:
        FileFormatError: another version of CxF, not well formed, or no such spectra.
        UsageError: the file cannot be read.
    """
    place = Place(path, _REMEDY)
    document, attributes = _parse(read_bytes(path, _LARGEST), place)
    resources = document.resources
    if resources is None or resources.object_collection is None:
        raise place.error("no objects found, expected CxF3 resources with an ObjectCollection")
    collection = resources.color_specification_collection
    specifications = {s.id: s for s in collection.color_specification} if collection is not None else {}
    items = resources.object_collection.object_value
    if sum(len(_spectra(item)) for item in items) != len(attributes):
        raise place.error("spectra outside the ColorValues of one ObjectCollection, expected none")
    own = iter(attributes)
    found = [_object(item, own, specifications, place, path.stem) for item in items]
    samples = _by_name([one for one in found if one is not None])
    if not samples:
        raise place.error(
            "no reflectance at directional geometries, expected ReflectanceSpectrum with BRDFAngle or SingleAngle, or "
            "named by its geometry (45as15, 45/0)"
        )
    if any(looks_like_percent(one.wi, one.wo, one.values) for one in samples):
        samples = [replace(s, values=s.values / 100.0).with_note(TAKEN_AS_PERCENT) for s in samples]
    return [replace(one, values=one.values / np.pi) for one in samples]


def _by_name(objects: list[Readings]) -> list[Readings]:
    """One record per name: objects of one name hold a sample's geometries, or are measurements, which get numbers."""
    samples: dict[str, list[Readings]] = {}
    for one in objects:
        own = samples.setdefault(one.name, [])
        if own and not _share_geometry(own[-1], one):
            own[-1] = _joined(own[-1], one)
        else:
            own.append(replace(one, name=f"{one.name} ({len(own) + 1})") if own else one)
    return [one for own in samples.values() for one in own]


def _share_geometry(first: Readings, second: Readings) -> bool:
    keys = [{tuple(row) for row in np.round(np.hstack([r.wi, r.wo]), 6)} for r in (first, second)]
    return not keys[0].isdisjoint(keys[1])


def _joined(first: Readings, second: Readings) -> Readings:
    rows = [(np.array(r.wavelengths_nm), row) for r in (first, second) for row in r.values]
    bands, table = _common_bands([nm for nm, _ in rows], [row for _, row in rows])
    wi, wo = np.concatenate([first.wi, second.wi]), np.concatenate([first.wo, second.wo])
    return Readings(
        first.name, first.instrument, wi, wo, bands, table,
        notes=tuple(dict.fromkeys([*first.notes, *second.notes])), texture={**first.texture, **second.texture},
    )  # fmt: skip


def _parse(data: bytes, place: Place) -> tuple[Any, list[dict[str, str]]]:
    """The document, and all attributes of its spectra: vendors write some that the schema has elsewhere."""
    from colour_cxf import cxf3
    from xsdata.formats.dataclass.parsers import XmlParser
    from xsdata.formats.dataclass.parsers.config import ParserConfig

    text = decode(data).strip()
    head = text[:4000].lower()
    if "<!doctype" in head or "<!ENTITY" in text:
        raise place.error("a document type with entities, expected plain CxF3")
    if "cxf" in head and "cxf3" not in head:
        raise place.error("CxF of an older version, expected CxF3 (colorexchangeformat.com/CxF3-core)")
    config = ParserConfig(fail_on_unknown_properties=False)
    try:
        with warnings.catch_warnings():  # what is not converted stays text, and is refused where it is used
            warnings.simplefilter("ignore")
            root = ElementTree.fromstring(text)
            for sphere in root.iterfind(".//{*}SphereGeometry"):
                sphere.clear()  # a word by the schema, but vendors write elements
            attributes = [dict(spectrum.attrib) for spectrum in root.iterfind(_SPECTRA)]
            document = XmlParser(config=config).parse(ElementTree.ElementTree(root), cxf3.CxF)
    except MemoryError:
        raise
    except Exception as error:  # xsdata raises whatever its parsers do
        reason = " ".join(str(error).split())[:100] or type(error).__name__
        raise place.error(f"not a readable CxF3 document ({reason})") from None
    return document, attributes


def _spectra(item: Any) -> list[Any]:
    choices = item.color_values.choice if item.color_values is not None else []
    return [c for c in choices if type(c).__name__ == "ReflectanceSpectrum"]


def _object(
    item: Any,
    attributes: Iterator[dict[str, str]],
    specifications: dict[Any, Any],
    place: Place,
    default: str,
) -> Readings | None:
    """Reflectance factors of one object as the file has them, or None where it has none at a geometry."""
    spectra = _spectra(item)
    if len(spectra) > _MOST_SPECTRA:
        raise place.error(f"{len(spectra)} spectra of one object, expected at most {_MOST_SPECTRA}")
    wi, wo, values, wavelengths = [], [], [], []
    instrument, seen = "spectrophotometer (CxF3)", dict.fromkeys(specifications, 0)
    left_out = 0
    for index, (spectrum, own) in enumerate(zip(spectra, attributes, strict=False)):
        where = f"object '{(item.name or default)[:40]}', spectrum {index + 1}"
        specification = specifications.get(spectrum.color_specification)
        measurement = specification.measurement_spec if specification is not None else None
        pair = _geometry(spectrum, measurement, seen, place, where)
        if pair is None:
            left_out += 1
            continue
        cells = spectrum.value.split() if isinstance(spectrum.value, str) else spectrum.value
        row = np.array([_number(cell, place, where) for cell in cells])
        nm = _wavelengths(spectrum, own, row.size, measurement, place, where)
        wi.append(pair[0])
        wo.append(pair[1])
        values.append(row)
        wavelengths.append(nm)
        device = measurement.device if measurement is not None else None
        if device is not None:
            instrument = " ".join(filter(None, (device.manufacturer, device.model))) or instrument
    if not values:
        return None
    bands, table = _common_bands(wavelengths, values)
    wi_rows, wo_rows, table, repeats = mean_of_repeats(np.array(wi), np.array(wo), table)
    notes = [f"{left_out} spectra without a directional geometry are left out"] if left_out else []
    if repeats:
        notes.append(f"{repeats} spectra repeat a geometry: their means are taken")
    texture: dict[str, Any] = {
        collection.name or f"tags {k}": {tag.name: tag.value for tag in collection.tag}
        for k, collection in enumerate(item.tag_collection)
    }
    return Readings(
        item.name or default, instrument, wi_rows, wo_rows, bands, table, notes=tuple(notes), texture=texture
    )


def _number(value: Any, place: Place, where: str) -> float:
    """A number of the document: as it was converted, or from its text; lists may be separated by commas, too."""
    return place.number(str(value).rstrip(",;"), where)


def _geometry(
    spectrum: Any, measurement: Any, seen: dict[Any, int], place: Place, where: str
) -> tuple[Array, Array] | None:
    """Directions of a spectrum, by its own name first. A specification's angles are used one after the other."""
    if (by_name := geometry_directions(spectrum.name or "")) is not None:
        return by_name
    geometry = measurement.geometry_choice if measurement is not None else None
    choice: Any = geometry.choice if geometry is not None else None
    kind = type(choice).__name__
    if kind == "MultiAngleType" and choice.brdfangle:
        turn = seen.get(spectrum.color_specification, 0)
        seen[spectrum.color_specification] = turn + 1
        named = [a for a in choice.brdfangle if a.notation and a.notation == spectrum.name]
        angle = named[0] if named else choice.brdfangle[turn % len(choice.brdfangle)]
        if angle.illumination_angle is not None and angle.aspecular is not None:
            lit, aspecular, azimuth = (
                _number(a, place, where)
                for a in (angle.illumination_angle, angle.aspecular, angle.azimuth or 0.0)
            )
            wi, wo = aspecular_pair(abs(lit), aspecular, azimuth)
            return (wi, wo) if wi[2] > 0.0 and wo[2] > 0.0 else None
        return geometry_directions(angle.notation or "")
    if (
        kind == "SingleAngleType"
        and choice.illumination_angle is not None
        and choice.measurement_angle is not None
    ):
        lit, seen_at = (
            abs(_number(a, place, where)) for a in (choice.illumination_angle, choice.measurement_angle)
        )
        # 45/0: the aspecular angle from the mirror direction to the other leg, on the normal's side.
        return aspecular_pair(lit, lit - seen_at) if max(lit, seen_at) < 90.0 else None
    return None


def _wavelengths(
    spectrum: Any, own: dict[str, str], count: int, measurement: Any, place: Place, where: str
) -> Array:
    """Wavelengths (B,): a spectrum's own Increment comes before that of its specification; 10 nm by default."""
    wavelength_range = measurement.wavelength_range if measurement is not None else None
    start = spectrum.start_wl
    if start is None and wavelength_range is not None:
        start = wavelength_range.start_wl
    step = wavelength_range.increment if wavelength_range is not None else 10
    step = own.get("Increment") or own.get("Interval") or step
    first, step = (_number(w or 0, place, where) for w in (start, step))
    if step <= 0 or first <= 0 or not count:
        raise place.error("no wavelengths or no values, expected StartWL, Increment and reflectance", where)
    nm: Array = first + step * np.arange(count, dtype=float)
    if "EndWL" in own and abs(_number(own["EndWL"], place, where) - nm[-1]) > step / 2.0:
        raise place.error(
            f"{count} values from {first:g} nm by {step:g} nm, expected EndWL={own['EndWL']!r}", where
        )
    return nm


def _common_bands(wavelengths: list[Array], values: list[Array]) -> tuple[Array, Array]:
    """All wavelengths (B,) of the spectra, and values (P, B), NaN where a spectrum has none."""
    bands = np.unique(np.concatenate(wavelengths))
    table = np.full((len(values), bands.size), np.nan)
    for row, nm, value in zip(table, wavelengths, values, strict=True):
        row[np.searchsorted(bands, nm)] = value
    return bands, table

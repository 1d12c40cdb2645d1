"""Tables of multi-angle spectrophotometers: rows of geometries, columns of wavelengths, or the other way round.

What workbooks and CSV files share: cells in, readings out. Values are reflectance factors R, f = R / pi.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from manifold.formats.geometry_names import (
    AmbiguousGeometryError,
    GeometryNames,
    can_be_geometry,
    directions_of,
    is_geometry,
    resolve,
)
from manifold.formats.readings import Readings, mean_of_repeats
from manifold.formats.stacked_tables import stacked
from manifold.formats.table_cells import (
    HEADER_ROWS,
    NO_VALUE,
    Cell,
    Table,
    all_cells,
    cell_at,
    gloss_angle,
    name_column,
    parse_wavelength,
    plain_head,
    text_of,
)
from manifold.formats.table_layouts import layouts, with_geometries
from manifold.formats.text import Place, number, plain_float
from manifold.records import Array

TITLE_IN_PERCENT = re.compile(
    r"\b(reflectance|unit)\w*( factors?)?\W{0,4}(in )?(%|per ?cent)|% ?reflect", re.IGNORECASE
)
_ONE_GEOMETRY = re.compile(r"(?<![\d.,/:])(45\s*°?[a-z]?\s*[/:]\s*0|0\s*°?\s*[/:]\s*45)\s*°?(?![\d.,/:])")
PERCENT_FROM = 2.0  # reflectance factors away from the mirror direction are below this, percentages above
PERCENT_ANYWHERE = 30.0  # 15 degrees from it, where these instruments see most, even chrome stays below this

NO_TABLE = (
    "no table of reflectance found, expected columns of wavelengths beside a column of geometries such as 45as15, "
    "columns of both such as '45as15 400', or theta_i, phi_i, theta_o, phi_o"
)
TAKEN_AS_FACTORS = "no unit given: taken as reflectance factors, 1 being the perfect diffuser"
TAKEN_AS_PERCENT = (
    "no unit given: values above 2 away from the mirror direction, or above 30, taken as percent"
)
"""Note of readings that `looks_like_percent`."""


@dataclass(frozen=True)
class Header:
    """A table's header: where it stands, and what its columns are."""

    row: int
    bands: dict[int, float]  # column: nm; RGB channels are 0, 1, 2 with is_rgb
    is_rgb: bool
    geometry: int
    name: int | None
    unit: str  # `f`, `percent`, `factor` or `unknown`
    gloss: dict[int, float]  # column: angle in degrees


def read_table(table: Table, place: Place, name: str, instrument: str) -> list[Readings]:
    """Readings of every sample of a table, in its order.

    Args:
        table: cells in any layout; texts that are numbers count as numbers.
        place: of errors.
        name: of the sample where the table has no column of names.
        instrument: for the record.
    Raises:
        FileFormatError: no header is found, or a cell is not what its column holds.
    """
    found = find_header(table, place)
    if found is None:
        raise place.error(NO_TABLE)
    return read_rows(*found, place, name, instrument)


def read_rows(table: Table, header: Header, place: Place, name: str, instrument: str) -> list[Readings]:
    """Readings of every sample below a header.

    Raises:
        FileFormatError: a cell is not what its column holds, or there are no readings.
    """
    rows = table.rows
    order = sorted(header.bands, key=header.bands.__getitem__)
    nm = [header.bands[column] for column in order]
    if any(b <= a for a, b in pairwise(nm)):
        raise place.error(
            "two columns of the same wavelength, expected different ones", table.where(header.row, None)
        )
    titles = [text_of(cell) for row in rows[: header.row] for cell in row]
    if header.unit == "unknown" and any(map(TITLE_IN_PERCENT.search, titles)):
        header = replace(header, unit="percent")
    geometries = _geometries(table, header, place, " ".join([instrument, *titles]))
    if header.name is None:
        header = replace(header, name=_dividing_column(rows[header.row + 1 :], header, geometries))
    samples: dict[str, list[tuple[Array, Array, list[float]]]] = {}
    gloss: dict[str, dict[float, list[float]]] = {}
    last = name
    for index in range(header.row + 1, len(rows)):
        row = rows[index]
        if not any(text_of(cell) for cell in row):
            continue
        where = table.where(index, None)
        directions = _directions(row, header, geometries, place, where)
        if directions is None:
            if any(number(text_of(row[c])) is not None for c in order if c < len(row)):
                raise place.error(f"values {_geometry_text(row, header)}, expected one such as 45as15", where)
            continue  # a footnote, a title
        if header.name is not None and header.name < len(row) and text_of(row[header.name]):
            last = text_of(row[header.name])
        values = [value_at(table, index, column, header.unit == "percent", place) for column in order]
        samples.setdefault(last, []).append((*directions, values))
        for column, angle in header.gloss.items():
            units = number(text_of(cell_at(row, column)))
            if units is None:
                continue  # empty, or a word such as `matt`
            if units < 0.0:
                raise place.error(
                    f"found gloss of {units:g} units, expected 0 or more", table.where(index, column)
                )
            gloss.setdefault(last, {}).setdefault(angle, []).append(units)
    if not samples:
        raise place.error(
            "a header but no rows of readings, expected one per geometry", table.where(header.row, None)
        )
    notes = list(geometries.notes)
    if header.unit == "unknown":
        header = replace(
            header, unit=_unit_by_values([row for found in samples.values() for row in found], notes)
        )
    return [
        replace(
            _sample(key, instrument, readings, header, nm, notes, place),
            gloss={angle: float(np.mean(units)) for angle, units in gloss.get(key, {}).items()},
        )
        for key, readings in samples.items()
    ]


def find_header(table: Table, place: Place) -> tuple[Table, Header] | None:
    """The table, rewritten if need be to one row per geometry, and its header; None where there is none.

    Raises:
        FileFormatError: a layout is recognised, but a row ends early, two columns are the same, or tables below each
            other do not fit together.
    """
    joined = stacked(table, place)
    for candidate in layouts(table if joined is None else joined, place):
        rows = candidate.rows
        for index, row in enumerate(rows[:HEADER_ROWS]):
            header = _parse_header(index, row, rows[index + 1 : index + 4])
            if header is not None:
                return candidate, header
    stated = _stated_geometry(table)
    joined = with_geometries([(table, stated)], place) if stated else None
    return find_header(joined, place) if joined is not None else None


def _stated_geometry(table: Table) -> str | None:
    """The geometry of all readings that cells at the top name, of an instrument with one: 45/0 or 0/45."""
    texts = (text_of(cell) for row in table.rows[:HEADER_ROWS] for cell in row)
    found = {match.group() for text in texts for match in _ONE_GEOMETRY.finditer(text)}
    return found.pop() if len(found) == 1 else None


def _geometries(table: Table, header: Header, place: Place, titles: str) -> GeometryNames:
    """What the names of all geometries mean, together."""
    cells = (cell_at(row, header.geometry) for row in table.rows[header.row + 1 :])
    try:
        return resolve(filter(None, map(text_of, cells)), titles)
    except AmbiguousGeometryError as error:
        raise place.error(str(error)) from None


def _sample(
    name: str,
    instrument: str,
    rows: list[tuple[Array, Array, list[float]]],
    header: Header,
    nm: list[float],
    table_notes: Sequence[str],
    place: Place,
) -> Readings:
    wi, wo = np.array([row[0] for row in rows]), np.array([row[1] for row in rows])
    values = np.array([row[2] for row in rows])
    if not np.any(np.isfinite(values)):
        raise place.error(f"sample '{name[:40]}' has no values, expected reflectance")
    notes = list(table_notes)
    wi, wo, values, repeats = mean_of_repeats(wi, wo, values)
    if repeats:
        notes.append(f"{repeats} rows repeat a geometry: their means are taken")
    if (
        header.is_rgb
        and header.unit != "f"
        and np.nanmax(values) > 1.0
        and np.all(np.nan_to_num(values) % 1.0 == 0.0)
    ):
        raise place.error(
            f"sample '{name[:40]}' has whole R, G, B up to {np.nanmax(values):g}: colours of a display, "
            "expected reflectance"
        )
    if header.unit != "f":
        values = values / (100.0 * np.pi if header.unit == "percent" else np.pi)
    if np.any(np.isnan(values)):
        notes.append(f"{int(np.isnan(values).sum())} empty cells are not measured")
    return Readings(
        name, instrument, wi, wo, None if header.is_rgb else np.array(nm), values, notes=tuple(notes)
    )


def _unit_by_values(rows: Sequence[tuple[Array, Array, list[float]]], notes: list[str]) -> str:
    """`percent` or `factor`, for all samples of a table together, and a note of it."""
    wi, wo, values = (np.array(part) for part in zip(*rows, strict=True))
    percent = looks_like_percent(wi, wo, values)
    notes.append(TAKEN_AS_PERCENT if percent else TAKEN_AS_FACTORS)
    return "percent" if percent else "factor"


def looks_like_percent(wi: Array, wo: Array, values: Array) -> bool:
    """Whether values are too large for reflectance factors, away from the mirror direction or anywhere."""
    mirror = np.einsum("pi,pi->p", wi * [-1.0, -1.0, 1.0], wo)
    off = np.nan_to_num(values[mirror < np.cos(np.deg2rad(40.0))])
    return bool(np.max(off, initial=0.0) > PERCENT_FROM or np.max(np.nan_to_num(values)) > PERCENT_ANYWHERE)


def _parse_header(index: int, row: Sequence[Cell], below: Sequence[Sequence[Cell]]) -> Header | None:
    texts = [text_of(cell) for cell in row]
    plain = list(map(plain_head, texts))
    geometry = _geometry_column(plain, below)
    if geometry is None:
        return None
    if is_geometry(texts[geometry]):
        return None  # a row of readings
    bands = {
        k: nm for k, text in enumerate(texts) if k != geometry and (nm := parse_wavelength(text)) is not None
    }
    if bands and len(bands) <= sum(number(t) is not None for k, t in enumerate(texts) if k not in bands):
        return None  # a row of values, few of which could be wavelengths
    is_rgb = False
    if not bands:
        bands = {plain.index(c): float(k) for k, c in enumerate("rgb") if c in plain}
        is_rgb = len(bands) == 3
        if not is_rgb:
            return None
    name = name_column(plain)
    if name is None:
        name = _untitled_names(texts[:geometry], below)
    joined = " ".join(texts).lower()
    if any(word in joined for word in ("1/sr", "sr^-1", "sr-1", "brdf", "bsdf")):
        unit = "f"
    elif (
        "%" in joined
        or "percent" in joined
        or any(text_of(c).endswith("%") for cells in below for c in cells)
        or any("%" in text_of(cells[geometry]) for cells in below if geometry < len(cells))
    ):
        unit = "percent"
    else:
        unit = "unknown"
    gloss = {
        k: angle for k, text in enumerate(texts) if k != geometry and (angle := gloss_angle(text)) is not None
    }
    return Header(index, bands, is_rgb, geometry, name, unit, gloss)


def _untitled_names(texts: Sequence[str], below: Sequence[Sequence[Cell]]) -> int | None:
    """A column of texts without a head, before the geometries: names of samples."""
    for k, head in enumerate(texts):
        if not head and all_cells(below, k, lambda text: number(text) is None):
            return k
    return None


def _dividing_column(rows: Sequence[Sequence[Cell]], header: Header, geometries: GeometryNames) -> int | None:
    """The first column before the geometries that divides rows which repeat these: names of samples in any language."""
    readings = [row for row in rows if text_of(cell_at(row, header.geometry)) in geometries.angles]
    names = [text_of(cell_at(row, header.geometry)) for row in readings]
    if len(set(names)) == len(names):
        return None
    for column in range(header.geometry):
        texts = [text_of(cell_at(row, column)) for row in readings]
        is_whole = len(set(zip(texts, names, strict=True))) == len(names)
        if all(texts) and is_whole and 1 < len(set(texts)) <= len(names) / 2:
            return column
    return None


def _geometry_column(heads: list[str], below: Sequence[Sequence[Cell]]) -> int | None:
    """The column that is called so, or holds nothing but geometries in the next rows."""
    for k, head in enumerate(heads):
        is_angle = head.startswith(("angle", "aspecular", "wavelength")) or head in ("nm", "winkel")
        if (
            head.startswith("geometr")
            or all_cells(below, k, is_geometry)
            or (is_angle and all_cells(below, k, can_be_geometry))
        ):
            return k
    return None


def _geometry_text(row: Sequence[Cell], header: Header) -> str:
    text = text_of(cell_at(row, header.geometry))
    return f"at geometry '{text[:24]}'" if text else "without a geometry"


def _directions(
    row: Sequence[Cell], header: Header, geometries: GeometryNames, place: Place, where: str
) -> tuple[Array, Array] | None:
    text = text_of(cell_at(row, header.geometry))
    if text not in geometries.angles:
        if any(c.isdigit() for c in text) and "as" in text.lower():
            raise place.error(f"found geometry '{text[:24]}', expected one such as 45as15", where)
        return None
    found = directions_of(geometries.angles[text])
    if found is None:
        raise place.error(
            f"geometry '{text[:24]}' lies below the horizon, expected one such as 45as15", where
        )
    return found


def value_at(table: Table, index: int, column: int, percent: bool, place: Place) -> float:
    row = table.rows[index]
    if column >= len(row) and not table.is_sheet:
        raise place.error(
            f"the row ends after {len(row)} cells, expected a value", table.where(index, column)
        )
    cell = cell_at(row, column)
    value = plain_float(cell) if isinstance(cell, str) else float("nan")
    if abs(value) < 1e300:
        return value
    text = text_of(cell)
    if percent:
        text = text.removesuffix("%").rstrip()
    if text.lower() in NO_VALUE:
        return float("nan")
    return place.number(text, table.where(index, column))

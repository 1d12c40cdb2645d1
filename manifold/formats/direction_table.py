"""Tables with columns of directions, theta_i, phi_i, theta_o, phi_o, beside bands, or one row per wavelength."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from manifold.formats.angle_columns import angle_name, directions, exceed_radians, stated_unit
from manifold.formats.geometry_names import is_geometry
from manifold.formats.readings import Readings, mean_of_repeats
from manifold.formats.spectro_table import TAKEN_AS_PERCENT, TITLE_IN_PERCENT, value_at
from manifold.formats.table_cells import (
    HEADER_ROWS,
    Table,
    all_cells,
    cell_at,
    name_column,
    parse_wavelength,
    plain_head,
    text_of,
)
from manifold.formats.text import Place, number
from manifold.formats.value_columns import Quantity, as_brdf, bands_of, quantity
from manifold.records import Array

_COLOURS = ({"r", "g", "b"}, {"x", "y", "z"})
_WAVELENGTHS = ("wavelength", "wavelengthnm", "wl", "lambda", "nm")
_VALUE = re.compile(
    r"(b[rs]?[rs]df|ars|dsf|ccb[rs]df|brr?f|values?|fr?|r|refl\w*|radiancefactors?)(cos\w*|sr)?"
)
_STATED_F = re.compile(r"sr\s*\^?\s*[({]?\s*-\s*1|/\s*sr|B[RS]+DF", re.IGNORECASE)
_STATED_FACTOR = re.compile(r"\brefl(ectance)?(?! *distribution)\b", re.IGNORECASE)
_FACTORS_BELOW = 2.0  # f away from the mirror direction, in the median; percentages are above


@dataclass(frozen=True)
class _Header:
    """Where a header stands, and its columns: of angles and bands by their heads, of names and wavelengths."""

    row: int
    angles: dict[str, int]
    bands: dict[str, int]
    name: int | None
    wavelength: int | None
    is_degrees: bool | None
    kind: Quantity | None  # None where nothing is said
    is_percent: bool


def names_directions(cells: Sequence[str]) -> bool:
    """Whether cells are the head of such a table: both elevations are named."""
    return {"theta_i", "theta_o"} <= {angle_name(cell) for cell in cells}


def read_directions(
    table: Table, place: Place, name: str, instrument: str, comments: Sequence[str] = ()
) -> list[Readings]:
    """Readings of every sample of a table, in its order; empty where it is of another kind.

    Args:
        table: cells; texts that are numbers count as numbers.
        place: of errors.
        name: of the sample where the table has no column of names.
        instrument: for the record.
        comments: lines that say what the numbers are.
    Raises:
        FileFormatError: a column appears twice, none holds values, or a cell is not what its column holds.
    """
    header = _header(table, place, comments)
    if header is None:
        return []
    samples: dict[str, list[list[float]]] = {}
    last, heads = name, [text_of(cell) for cell in table.rows[header.row]]
    for index in range(header.row + 1, len(table.rows)):
        row = table.rows[index]
        texts = [text_of(cell_at(row, column)) for column in header.angles.values()]
        if not any(texts) or texts == [heads[column] for column in header.angles.values()]:
            if any(number(text_of(cell_at(row, column))) is not None for column in header.bands.values()):
                raise place.error("values without directions", table.where(index, None))
            continue  # a footnote, a repeated header
        where = table.where(index, None)
        cells = [
            place.number(text, f"{where}, {key}") for key, text in zip(header.angles, texts, strict=True)
        ]
        if header.wavelength is not None:
            text = text_of(cell_at(row, header.wavelength))
            cells.append(place.number(text.lower().removesuffix("nm"), f"{where}, wavelength"))
        cells += [value_at(table, index, c, header.is_percent, place) for c in header.bands.values()]
        if header.name is not None:
            last = text_of(cell_at(row, header.name)) or last
        samples.setdefault(last, []).append(cells)
    if not samples:
        raise place.error("a header but no rows of readings", table.where(header.row, None))
    shared: list[str] = []
    everything = np.array([row for rows in samples.values() for row in rows])
    header = replace(header, is_degrees=_are_degrees(header, everything, shared))
    return [_sample(key, instrument, np.array(rows), header, shared, place) for key, rows in samples.items()]


def _header(table: Table, place: Place, comments: Sequence[str]) -> _Header | None:
    for index, row in enumerate(table.rows[:HEADER_ROWS]):
        texts = [text_of(cell) for cell in row]
        if not names_directions(texts):
            continue
        below = table.rows[index + 1 : index + 4]
        if any(all_cells(below, column, is_geometry) for column in range(len(texts))):
            return None  # of a spectrophotometer, which names its geometries
        titles = [*comments, *(text_of(cell) for above in table.rows[:index] for cell in above)]
        return _columns(index, texts, titles, place, table.where(index, None))
    return None


def _columns(index: int, texts: list[str], titles: list[str], place: Place, where: str) -> _Header:
    angles: dict[str, int] = {}
    for column, text in enumerate(texts):
        key = angle_name(text)
        if key is not None and key in angles:
            raise place.error(f"{key} appears twice, expected each angle once", where)
        if key is not None:
            angles[key] = column
    plain = ["" if k in angles.values() else plain_head(text) for k, text in enumerate(texts)]
    bands = _band_columns(texts, plain, set(angles.values()), place, where)
    others = (k for k, word in enumerate(plain) if word in _WAVELENGTHS and k not in bands.values())
    wavelength = next(others, None) if len(bands) == 1 else None
    words = [*bands, *titles]
    joined = " ".join(words)
    kind: Quantity | None = quantity(words)
    if kind == "f" and not _STATED_F.search(joined):
        kind = "factor" if _STATED_FACTOR.search(joined) else None
    unit = stated_unit(" ".join(texts[column] for column in angles.values())) or stated_unit(" ".join(titles))
    is_percent = any("%" in text or "percent" in text.lower() for text in bands) or any(
        map(TITLE_IN_PERCENT.search, titles)
    )
    return _Header(
        index,
        angles,
        bands,
        name_column(plain),
        wavelength,
        None if unit is None else unit == "degrees",
        kind,
        is_percent,
    )


def _band_columns(
    texts: list[str], plain: list[str], taken: set[int], place: Place, where: str
) -> dict[str, int]:
    """Columns of values by their heads: of wavelengths, of R, G, B or X, Y, Z, or the only one of values."""
    free = [k for k in range(len(texts)) if k not in taken]
    found = [k for k in free if parse_wavelength(texts[k]) is not None]
    letters = {
        {"red": "r", "green": "g", "blue": "b"}.get(word, word): k
        for k in free
        if (word := re.sub(r"^b[rs]df", "", plain[k]))
    }
    for colours in _COLOURS:
        if not found and colours <= set(letters):
            found = [letters[colour] for colour in sorted(colours)]
    values = [k for k in free if _VALUE.fullmatch(plain[k])]
    if not found and len(values) == 1:
        found = values
    if not found:
        raise place.error(
            f"columns {', '.join(texts[:12])}: expected values beside the directions, with heads such as 465nm, "
            "R, G, B, or BRDF",
            where,
        )
    heads = [texts[k] for k in found]
    if len(set(heads)) < len(heads):
        raise place.error(f"two columns of '{max(heads, key=heads.count)[:24]}', expected one each", where)
    return dict(zip(heads, found, strict=True))


def _are_degrees(header: _Header, rows: Array, notes: list[str]) -> bool:
    """Whether angles are in degrees: as stated, else unless all could be radians and some are no whole numbers."""
    if header.is_degrees is not None:
        return header.is_degrees
    angles = rows[:, : len(header.angles)]
    if exceed_radians(dict(zip(header.angles, angles.T, strict=True))) or np.all(angles == np.round(angles)):
        return True
    notes.append("no unit of angles: all lie within pi, and are taken as radians")
    return False


def _sample(
    name: str, instrument: str, rows: Array, header: _Header, shared: list[str], place: Place
) -> Readings:
    """Readings of the rows (P, angles and values) of one sample."""
    notes = list(shared)
    heads = list(header.bands)
    if header.wavelength is not None:
        rows, heads = _one_row_per_direction(rows, len(header.angles))
    scale = np.pi / 180.0 if header.is_degrees else 1.0
    angles = {key: scale * rows[:, k] for k, key in enumerate(header.angles)}
    keep, wi, wo = directions(angles, place, notes)
    values = rows[keep][:, len(angles) :]
    if not np.any(np.isfinite(values)):
        raise place.error(f"sample '{name[:40]}' has no values, expected f in 1/sr")
    if header.is_percent or (header.kind is None and _is_percent(wi, wo, values)):
        notes += [] if header.is_percent else [TAKEN_AS_PERCENT]
        values = values / (100.0 * np.pi)
    else:
        if header.kind is None:
            notes.append("no unit given: taken as BRDF in 1/sr")
        values = as_brdf(values, header.kind or "f", wo, notes)
    nm, values = bands_of(heads, values, notes, place)
    wi, wo, values, repeats = mean_of_repeats(wi, wo, values)
    if repeats:
        notes.append(f"{repeats} rows repeat a geometry: their means are taken")
    if np.any(np.isnan(values)):
        notes.append(f"{int(np.isnan(values).sum())} empty cells are not measured")
    return Readings(name, instrument, wi, wo, nm, values, notes=tuple(notes))


def _one_row_per_direction(rows: Array, angles: int) -> tuple[Array, list[str]]:
    """Rows of angles, a wavelength and a value as rows of angles and all bands, and heads of these."""
    keys, inverse = np.unique(rows[:, :angles], axis=0, return_inverse=True)
    nm, band = np.unique(rows[:, angles], return_inverse=True)
    table, counts = np.zeros((len(keys), nm.size)), np.zeros((len(keys), nm.size))
    at = inverse.reshape(-1), band.reshape(-1)
    np.add.at(table, at, np.nan_to_num(rows[:, angles + 1]))
    np.add.at(counts, at, np.isfinite(rows[:, angles + 1]))
    means = np.divide(table, counts, out=np.full_like(table, np.nan), where=counts > 0)
    is_micrometres = nm[-1] < 100.0
    return np.hstack([keys, means]), [f"{w * 1000.0 if is_micrometres else w:.9g}nm" for w in nm]


def _is_percent(wi: Array, wo: Array, values: Array) -> bool:
    """Whether values are too large for f in the median away from the mirror direction."""
    off = values[np.einsum("pi,pi->p", wi * [-1.0, -1.0, 1.0], wo) < np.cos(np.deg2rad(40.0))]
    return bool(np.any(np.isfinite(off)) and np.nanmedian(off) > _FACTORS_BELOW)

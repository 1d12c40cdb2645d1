"""Layouts of a spectrophotometer's table, rewritten to one row per sample and geometry, wavelengths beside it.

Programs and people also write one row per sample, with columns of geometry and wavelength (`45as-15 400`, or in two
header rows); one row per value; any of these turned; and a sheet per geometry.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import zip_longest

from manifold.formats.geometry_names import can_be_geometry, is_geometry
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
    turned,
)
from manifold.formats.text import Place, number

_LEAST_COLUMNS = 3  # of geometry and wavelength, or of wavelengths, make a header
_BEHIND = r"[\s)\]]*(\(.*\)|\[.*\]|%)?"  # a unit
_WAVELENGTH_LAST = re.compile(
    r"(?P<geometry>.+?)(?P<between>[\s_,;:/|@(\[-]+)(?P<nm>\d{3,4}([.,]\d+)?\s*(nm)?)"
    rf"{_BEHIND}",
    re.IGNORECASE,
)
_WAVELENGTH_FIRST = re.compile(
    r"\D{0,12}?(?P<nm>\d{3,4}([.,]\d+)?\s*(nm)?)"
    rf"(?P<between>[\s_,;:/|@(\[]+)(?P<geometry>.+?){_BEHIND}",
    re.IGNORECASE,
)
_UNITS = (("1/sr", " [1/sr]"), ("sr^-1", " [1/sr]"), ("sr-1", " [1/sr]"), ("%", " [%]"), ("percent", " [%]"))
_VALUE_HEADS = (
    "r",
    "f",
    "brdf",
    "value",
    "values",
    "reflectance",
    "reflectancefactor",
    "spectralreflectance",
)


@dataclass
class _Spectrum:
    """One sample at one geometry: its cells by wavelength, and where they stand."""

    name: str
    geometry: str
    cells: dict[float, Cell] = field(default_factory=dict)
    places: dict[float, str] = field(default_factory=dict)
    gloss: dict[float, Cell] = field(default_factory=dict)


def layouts(table: Table, place: Place) -> Iterator[Table]:
    """The table as it stands, and as what it is if it has another layout.

    Raises:
        FileFormatError: a layout is recognised, but a row ends early, or two columns are the same.
    """
    yield table
    sideways = turned(table)
    yield from _wide(table, place)
    yield from _long(table)
    yield sideways
    yield from _wide(sideways, place)


def with_geometries(tables: Sequence[tuple[Table, str]], place: Place) -> Table | None:
    """One table of several that hold one geometry each, of samples by wavelengths; None where none does.

    Raises:
        FileFormatError: a row ends early, or two columns have the same wavelength.
    """
    spectra: list[_Spectrum] = []
    unit = ""
    for table, geometry in tables:
        for candidate in (table, turned(table)):
            found = _spectra_at(candidate, geometry, place)
            if found is not None:
                spectra += found
                unit = unit or _unit(candidate.rows[:HEADER_ROWS])
                break
    return _rewritten(spectra, [], unit) if spectra else None


def _spectra_at(table: Table, geometry: str, place: Place) -> list[_Spectrum] | None:
    """Rows of a table whose columns are wavelengths, or None where there is no such header."""
    for index, row in enumerate(table.rows[:HEADER_ROWS]):
        nm = {c: w for c, cell in enumerate(row) if (w := parse_wavelength(text_of(cell))) is not None}
        if len(nm) >= _LEAST_COLUMNS:
            columns = {c: (geometry, w) for c, w in nm.items()}
            return _spectra(table, index, index, columns, place)
    return None


def _wide(table: Table, place: Place) -> Iterator[Table]:
    """The table of one row per sample, with columns of geometry and wavelength in one or two header rows.

    Between the two may stand a row that says the same of all columns, such as a unit; above them, one of samples.
    """
    filled = [k for k, row in enumerate(table.rows[:HEADER_ROWS]) if any(map(text_of, row))]
    for first, second, third in zip_longest(filled, filled[1:], filled[2:]):
        columns, last = _split_heads(table.rows[first]), first
        if len(columns) < _LEAST_COLUMNS and second is not None:
            columns, last = _paired_heads(table.rows[first], table.rows[second]), second
        if len(columns) < _LEAST_COLUMNS and third is not None and _says_one_thing(table.rows[second]):
            columns, last = _paired_heads(table.rows[first], table.rows[third]), third
        if len(columns) >= _LEAST_COLUMNS:
            unit = _unit(table.rows[first : last + 1])
            above = max((k for k in filled if k < first), default=None)
            samples = {} if above is None else _samples_above(table.rows[above], columns)
            spectra = [
                replace(spectrum, name=f"{sample} {spectrum.name}".rstrip())
                for sample, own in (samples or {"": columns}).items()
                for spectrum in _spectra(table, first, last, own, place)
            ]
            yield _rewritten(spectra, table.rows[: (above or 0) if samples else first], unit)
            return


def _samples_above(
    row: Sequence[Cell], columns: dict[int, tuple[str, float]]
) -> dict[str, dict[int, tuple[str, float]]]:
    """The columns of every sample that a row names above columns of the same heads; empty where it names none."""
    if len(set(columns.values())) == len(columns):
        return {}
    above, found = "", dict[str, dict[int, tuple[str, float]]]()
    for c in range(max(columns) + 1):
        above = text_of(cell_at(row, c)) or above
        if c in columns:
            found.setdefault(above, {})[c] = columns[c]
    is_told_apart = all(len(set(own.values())) == len(own) for own in found.values())
    return found if is_told_apart and "" not in found else {}


def _says_one_thing(row: Sequence[Cell]) -> bool:
    texts = {text for cell in row if (text := text_of(cell))}
    return len(texts) == 1 and number(texts.pop()) is None


def names_both(text: str) -> bool:
    """Whether a head names a geometry and a wavelength, as `45as-15 400` does."""
    return _split_head(text) is not None


def _split_head(text: str) -> tuple[str, float] | None:
    for pattern in (_WAVELENGTH_LAST, _WAVELENGTH_FIRST):
        found = pattern.fullmatch(text)
        nm = parse_wavelength(found["nm"]) if found is not None else None
        if found is not None and nm is not None and can_be_geometry(found["geometry"]):
            return found["geometry"].strip(), nm
    return None


def _split_heads(row: Sequence[Cell]) -> dict[int, tuple[str, float]]:
    """Geometry and wavelength of every column whose head names both."""
    found = {c: _split_head(text_of(cell)) for c, cell in enumerate(row)}
    return {c: both for c, both in found.items() if both is not None}


def _paired_heads(first: Sequence[Cell], second: Sequence[Cell]) -> dict[int, tuple[str, float]]:
    """Geometry and wavelength of columns with one above the other; merged cells of the upper row are repeated."""
    above, columns = "", {}
    for c, cell in enumerate(second):
        above = (text_of(first[c]) if c < len(first) else "") or above
        below = text_of(cell)
        nm = parse_wavelength(below)
        if nm is not None and can_be_geometry(above):
            columns[c] = above, nm
        elif is_geometry(below) and (nm := parse_wavelength(above)) is not None:
            columns[c] = below, nm
    return columns


def _spectra(
    table: Table, first: int, last: int, columns: dict[int, tuple[str, float]], place: Place
) -> list[_Spectrum]:
    """The spectra of all rows below a header, which takes the rows `first` to `last`."""
    if len(set(columns.values())) < len(columns):
        geometry, nm = next(pair for pair in columns.values() if list(columns.values()).count(pair) > 1)
        raise place.error(
            f"two columns of {nm:g} nm at {geometry[:24]}, expected one each", table.where(last, None)
        )
    rows = [
        (k, row)
        for k, row in enumerate(table.rows[last + 1 :], start=last + 1)
        if any(number(text_of(row[c])) is not None for c in columns if c < len(row))
    ]
    names = _names(table.rows[first : last + 1], [row for _, row in rows], set(columns))
    gloss = {
        c: angle
        for row in table.rows[first : last + 1]
        for c, cell in enumerate(row)
        if (angle := gloss_angle(text_of(cell))) is not None
    }
    spectra: list[_Spectrum] = []
    for name, (k, row) in zip(names, rows, strict=True):
        made: dict[str, _Spectrum] = {}
        for c, (geometry, nm) in columns.items():
            if c >= len(row) and not table.is_sheet:
                raise place.error(f"the row ends after {len(row)} cells, expected a value", table.where(k, c))
            spectrum = made.setdefault(geometry, _Spectrum(name, geometry))
            spectrum.cells[nm], spectrum.places[nm] = cell_at(row, c), table.where(k, c)
        found = list(filter(_has_values, made.values()))
        for spectrum in found[:1]:
            spectrum.gloss = {angle: cell_at(row, c) for c, angle in gloss.items()}
        spectra += found
    return spectra


def _has_values(spectrum: _Spectrum) -> bool:
    return any(text_of(cell).lower() not in NO_VALUE for cell in spectrum.cells.values())


def _names(header: Sequence[Sequence[Cell]], rows: Sequence[Sequence[Cell]], taken: set[int]) -> list[str]:
    """Names of the samples in rows: a column that is called so, else the first of texts, else numbers if several."""
    for heads in header:
        column = name_column(["" if c in taken else plain_head(text_of(v)) for c, v in enumerate(heads)])
        if column is not None:
            return [text_of(cell_at(row, column)) for row in rows]
    for c in range(min(taken)):
        texts = [text_of(cell_at(row, c)) for row in rows]
        if all(texts) and all(number(text) is None for text in texts):
            is_value = len(rows) == 1 and plain_head(texts[0]) in _VALUE_HEADS
            return [""] if is_value else texts
    return [""] if len(rows) == 1 else [str(k) for k in range(1, len(rows) + 1)]


def _long(table: Table) -> Iterator[Table]:
    """The table of one row per value."""
    for index, row in enumerate(table.rows[:HEADER_ROWS]):
        heads = [plain_head(text_of(cell)) for cell in row]
        below = table.rows[index + 1 : index + 4]
        geometry = _first(heads, ("geometr", "angle", "aspecular"))
        nm = _first(heads, ("wavelength", "lambda", "nm"))
        value = next((heads.index(head) for head in _VALUE_HEADS if head in heads), None)
        if geometry is None or nm is None or value is None or len({geometry, nm, value}) < 3:
            continue
        if not all_cells(below, geometry, can_be_geometry) or not all_cells(below, nm, parse_wavelength):
            continue
        spectra = _pivoted(table, index, name_column(heads), geometry, nm, value)
        yield _rewritten(spectra, table.rows[:index], _unit([row]))
        return


def _pivoted(
    table: Table, header: int, name: int | None, geometry: int, nm: int, value: int
) -> list[_Spectrum]:
    """Spectra of rows of one value each; a second value at one wavelength begins another measurement."""
    found: dict[tuple[str, str, int], _Spectrum] = {}
    turns: dict[tuple[str, str, float], int] = {}
    for k, row in enumerate(table.rows[header + 1 :], start=header + 1):
        if max(geometry, nm, value) >= len(row):
            continue
        wavelength = parse_wavelength(text_of(row[nm]))
        if wavelength is None:
            continue
        sample = text_of(row[name]) if name is not None and name < len(row) else ""
        at = text_of(row[geometry])
        turn = turns[sample, at, wavelength] = turns.get((sample, at, wavelength), 0) + 1
        spectrum = found.setdefault((sample, at, turn), _Spectrum(sample, at))
        spectrum.cells[wavelength] = row[value]
        spectrum.places[wavelength] = table.where(k, value)
    return list(found.values())


def _rewritten(spectra: list[_Spectrum], titles: Sequence[Sequence[Cell]], unit: str) -> Table:
    """A table of one row per sample and geometry, below the titles."""
    nm = sorted({wavelength for spectrum in spectra for wavelength in spectrum.cells})
    gloss = sorted({angle for spectrum in spectra for angle in spectrum.gloss})
    head = [
        "Name", "Geometry", *(f"{wavelength:g}nm{unit}" for wavelength in nm), *(f"gloss {a:g}" for a in gloss)
    ]  # fmt: skip
    rows = [[s.name, s.geometry, *map(s.cells.get, nm), *map(s.gloss.get, gloss)] for s in spectra]
    first = len(titles) + 1

    def where(row: int, column: int | None) -> str:
        if row < first:
            return f"row {row + 1}"
        places = spectra[row - first].places
        key = nm[column - 2] if column is not None and 2 <= column < 2 + len(nm) else next(iter(places))
        text = places.get(key, next(iter(places.values())))
        return text if column is not None else text.rpartition(", column")[0]

    return Table([*titles, head, *rows], where)


def _unit(rows: Iterable[Sequence[Cell]]) -> str:
    """The unit that heads name, as it stands behind one."""
    text = " ".join(text_of(cell) for row in rows for cell in row).lower()
    return next((behind for word, behind in _UNITS if word in text), "")


def _first(heads: Sequence[str], beginnings: tuple[str, ...]) -> int | None:
    return next((k for k, head in enumerate(heads) if head.startswith(beginnings)), None)

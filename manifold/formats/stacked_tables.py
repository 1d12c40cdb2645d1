"""Tables that stand below each other, one per geometry or one per sample, rewritten to one table."""

from __future__ import annotations

import math
from collections.abc import Sequence

from manifold.formats.geometry_names import can_be_geometry, is_geometry
from manifold.formats.table_cells import (
    Cell,
    Table,
    name_column,
    parse_wavelength,
    plain_head,
    text_of,
)
from manifold.formats.table_layouts import with_geometries
from manifold.formats.text import Place, plain_float

_LEAST_BANDS = 3  # make a header


def stacked(table: Table, place: Place) -> Table | None:
    """One table of several that stand below each other; None where it is one already.

    Tables of one geometry each have its name above them or in the corner of their header; those of one sample each
    have the same header with a column of geometries.

    Raises:
        FileFormatError: the headers of samples' tables differ, or a sample has no name above its table.
    """
    made = _of_geometries(table, place)
    return _of_samples(table, place) if made is None else made


def _of_geometries(table: Table, place: Place) -> Table | None:
    """One table of tables of one geometry each, every one of which holds spectra."""
    marks = [(k, name) for k, row in enumerate(table.rows) if (name := _geometry_of(row)) is not None]
    if len({name for _, name in marks}) < 2:
        return None
    header: list[int] = []
    blocks: list[tuple[Table, str]] = []
    ends = [k for k, _ in marks[1:]] + [len(table.rows)]
    for (begin, name), end in zip(marks, ends, strict=True):
        own = range(begin, end)
        heads = [k for k in own if _is_header(table.rows[k])]
        above = [] if heads or _is_upright(table.rows[begin + 1 : end]) else header
        blocks.append((_some_rows(table, [*above, *own]), name))
        header = heads[:1] or header
    if any(with_geometries([block], place) is None for block in blocks):
        return None
    return with_geometries(blocks, place)


def _geometry_of(row: Sequence[Cell]) -> str | None:
    """The geometry that a row names alone, behind the word, or before the wavelengths of a header."""
    first = next((text for cell in row if (text := text_of(cell))), "")
    if not first or math.isfinite(plain_float(first)):  # as most rows begin
        return None
    is_word = plain_head(first).startswith("geometr")
    if not is_word and not is_geometry(first):
        return None
    others = [text for cell in row if (text := text_of(cell))][1:]
    if is_word and len(others) == 1 and can_be_geometry(others[0]):
        return others[0]
    is_mark = not others or (len(others) >= _LEAST_BANDS and all(map(parse_wavelength, others)))
    return first if is_mark and is_geometry(first) else None


def _is_header(row: Sequence[Cell]) -> bool:
    return sum(parse_wavelength(text_of(cell)) is not None for cell in row) >= _LEAST_BANDS


def _is_upright(rows: Sequence[Sequence[Cell]]) -> bool:
    """Whether wavelengths stand below each other."""
    return sum(bool(row) and parse_wavelength(text_of(row[0])) is not None for row in rows) >= _LEAST_BANDS


def _of_samples(table: Table, place: Place) -> Table | None:
    """One table of tables of one sample each, whose name stands above its header."""
    headers = [k for k, row in enumerate(table.rows) if _names_geometries(row) and _is_header(row)]
    if len(headers) < 2:
        return None
    first = headers[0]
    head = [text_of(cell) for cell in table.rows[first]]
    for k in headers:
        if [text_of(cell) for cell in table.rows[k]] != head:
            raise place.error(
                f"a second table with other columns than in {table.where(first, None)}, expected the same; put each "
                "into a file of its own",
                table.where(k, None),
            )
    if name_column([plain_head(text) for text in head]) is not None:
        return _some_rows(table, [k for k in range(len(table.rows)) if k not in headers[1:]])
    titles: set[int] = set()
    named: dict[int, str] = {}  # sample by header
    for k in headers:
        found = _title_above(table.rows, k)
        if found is None:
            raise place.error(
                f"{len(headers)} tables below each other, expected the name of a sample above each",
                table.where(k, None),
            )
        titles.add(found[0])
        named[k] = found[1]
    places = [k for k in range(len(table.rows)) if k not in titles and k not in headers[1:]]
    sample, rows = "", []
    for k, row in enumerate(table.rows):
        sample = named.get(k, sample)
        if k in places:
            rows.append(["Name" if k == first else sample, *row])

    def where(row: int, column: int | None) -> str:
        return table.where(places[row], None if column is None else max(column - 1, 0))

    return Table(rows, where, table.is_sheet)


def _names_geometries(row: Sequence[Cell]) -> bool:
    words = (cell for cell in row if isinstance(cell, str) and "geometr" in cell.lower())
    return any(plain_head(word).startswith("geometr") for word in words)


def _title_above(rows: Sequence[Sequence[Cell]], header: int) -> tuple[int, str] | None:
    """The row above a header that names a sample, alone or behind the word, and the name."""
    row = next((k for k in range(header - 1, -1, -1) if any(map(text_of, rows[k]))), None)
    found = [text for cell in rows[row] if (text := text_of(cell))] if row is not None else []
    is_named = len(found) == 2 and name_column([plain_head(found[0])]) is not None
    return (row, found[-1]) if row is not None and (len(found) == 1 or is_named) else None


def _some_rows(table: Table, places: Sequence[int]) -> Table:
    """Rows of a table, which errors name as they stand there."""
    return Table(
        [table.rows[k] for k in places], lambda row, column: table.where(places[row], column), table.is_sheet
    )

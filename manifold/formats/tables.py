"""Reads tables of readings from the cells of workbooks and CSV files.

Two layouts are read: one row per direction pair (columns theta_i, phi_i, theta_o, phi_o), as in files of goniometers,
and one row per geometry (a column of names such as 45as15), as in files of multi-angle spectrophotometers; bands are
columns. Tables with one row per value and wavelength, or with one row per wavelength and geometries as columns, are
rearranged.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import compress
from typing import Any

import numpy as np

from manifold.core.names import first_few
from manifold.core.records import Array, Mask
from manifold.formats import column_heads
from manifold.formats.column_heads import (
    angle_names,
    channel,
    gloss_angle,
    uncertainty_head,
    wavelength,
)
from manifold.formats.geometries import (
    directions,
    directions_of,
    exceed_radians,
    is_geometry,
    parse_aspecular,
    parse_geometry,
    resolve,
)
from manifold.formats.quantities import FACTORS, I_OVER_F, KNOWN, Quantity
from manifold.formats.readings import (
    DAYLIGHT,
    Assumption,
    Readings,
    Viewing,
    gloss_fault,
    mean_of_repeats,
)
from manifold.formats.text import (
    CORRECT_CELL,
    ErrorContext,
    Measure,
    angle_unit,
    number,
    number_with_unit,
    plain_float,
    wavelength_nm,
)
from manifold.formats.values import (
    L_PER_Y,
    TAKEN_AS_FACTORS,
    TAKEN_AS_PERCENT,
    Assumed,
    as_brdf,
    assumed_factors,
    assumed_unit,
    bands_of,
    bright_bands,
    lab_to_linear_srgb,
    lightness_doubts,
    linear_srgb_to_xyz,
    relative_uncertainties,
    require_one_spectrum,
    too_bright_rows,
    weights_of,
)

Cell = str | float | int | None
HEADERS = "'Name, Geometry, 400, 410' or 'theta_i (deg), phi_i (deg), theta_o (deg), phi_o (deg), 465nm'"
"""Text for error messages that shows the supported headers."""
NEW_HEADER = f"give the table a header such as {HEADERS}"
"""Text for error messages that tells how to replace a header that is not understood."""
WEIGHT_HEAD, SCATTER_HEAD = "weight", "scatter of cube roots"
"""Heads of the columns of `Readings.weights` and `Readings.scatter`."""

_NAMED_ROWS = 3  # in a note
_HEADER_ROWS = 60  # a header stands at the top, below titles
_CONDITION = re.compile(r"M[0-3]\b")
_USUAL_VIEWING = Viewing("D65", 10)  # viewing of instruments for coatings, where heads name none
_BLACK_LAB = {"src_z", "src_a", "view_z", "view_a"}  # a program's heads; its values are reflectance factors


@dataclass(frozen=True)
class Table:
    """The rows of cells of a table.

    Attributes:
        sheet: title of the workbook's sheet; its rows end at their last cell that is not empty. None for CSV files.
        place: function that returns where a row and column were before the table was rearranged; None if it was not.
    """

    rows: Sequence[Sequence[Cell]]
    sheet: str | None = None
    place: Callable[[int, int | None], tuple[int, int | None]] | None = None

    def where(self, row: int, column: int | None = None) -> str:
        """Describe a row and column, counted from 0, for error messages."""
        if self.place is not None:
            row, column = self.place(row, column)
        sheet = f"sheet '{self.sheet}', " if self.sheet is not None else ""
        return f"{sheet}row {row + 1}" + ("" if column is None else f", column {column + 1}")

    def text(self, row: int, column: int) -> str:
        """Return the text of a cell; rows may end before it."""
        cells = self.rows[row]
        return text_of(cells[column]) if column < len(cells) else ""


@dataclass(frozen=True)
class Columns:
    """The columns that a header names.

    Attributes:
        heads: all cells of the header.
        angles: columns of angles, by the names of `angle_name`, in a table of directions.
        geometry: the column of geometries' names, or None in a table of directions.
        bands: columns of values.
        names: columns that together name the sample, see `column_heads.name_columns`.
        gloss: columns of gloss, with its angle in degrees.
        comments: lines of the file that may name a wavelength.
        viewing: light and observer of CIELAB values, which are converted to linear sRGB; None for other values.
        kind: quantity that the file states outside the header; None if it states none.
        uncertainties: columns of uncertainties.
        own: columns of weights and scatter, as this package writes them, by heading.
    """

    row: int
    heads: list[str]
    angles: dict[str, int]
    geometry: int | None
    bands: list[int]
    names: dict[str, int]
    gloss: dict[int, float]
    comments: tuple[str, ...] = ()
    viewing: Viewing | None = None
    is_viewing_assumed: bool = False
    kind: Quantity | None = None
    uncertainties: list[int] = field(default_factory=list)
    own: dict[str, int] = field(default_factory=dict)

    def seen_under(self, texts: Iterable[str]) -> Columns:
        """Return the columns with the light and observer that one of the texts names, if no heading does."""
        named = column_heads.viewing_of_lines(texts)
        if not self.is_viewing_assumed or named is None:
            return self
        return replace(self, viewing=named, is_viewing_assumed=False)

    @property
    def band_heads(self) -> list[str]:
        """Heads of the columns of values."""
        return [self.heads[column] for column in self.bands]

    @property
    def key(self) -> list[int]:
        """The columns that determine the geometry of a row."""
        return [self.geometry] if self.geometry is not None else list(self.angles.values())


@dataclass
class _Sample:
    """Rows of one sample: where they stand, their geometries or angles, values, uncertainties, and gloss by angle."""

    rows: list[int] = field(default_factory=list)
    keys: list[list[str]] = field(default_factory=list)
    values: list[list[float]] = field(default_factory=list)
    uncertainties: list[list[float]] = field(default_factory=list)
    own: list[list[float]] = field(default_factory=list)
    gloss: dict[float, list[float]] = field(default_factory=dict)


def text_of(cell: Cell) -> str:
    """Return the text of a cell, without blanks around it."""
    if cell is None:
        return ""
    if isinstance(cell, float):
        return str(int(cell)) if cell.is_integer() and abs(cell) < 1e6 else repr(cell)
    return str(cell).strip()


def names_directions(heads: Sequence[str]) -> bool:
    """Return whether cells are the header of a table of directions, which names both polar angles."""
    return {"theta_i", "theta_o"} <= set(angle_names(heads))


def resembles_header(heads: Sequence[str]) -> bool:
    """Return whether cells look like the header of a table of readings, complete or not."""
    return (
        any(column_heads.plain_head(head).startswith("geometr") for head in heads)
        or (any(map(column_heads.is_wavelength, heads)) and any(map(is_geometry, heads)))
        or sum(name is not None for name in angle_names(heads)) >= 2
        or sum(wavelength(head) is not None for head in heads) >= 3
        or not_understood(heads) is not None
    )


def not_understood(heads: Sequence[str]) -> str | None:
    """Return the unknown heading in a header with values and only one polar angle; None for other cells.

    The result is empty if all headings are understood.

    >>> not_understood(["AOI", "AOR", "BRDF"]), not_understood(["the", "incidence", "of", "BRDF"])
    ('AOR', None)
    """
    names = angle_names(heads)
    is_value = [
        (said := column_heads.value_head(head)) is not None and said.quantity is not None for head in heads
    ]
    known = zip(heads, names, is_value, strict=True)
    unknown = [head for head, name, is_of_value in known if name is None and not is_of_value]
    elevations = {"theta_i", "theta_o"} & set(names)
    return "".join(unknown) if len(elevations) == 1 and any(is_value) and len(unknown) <= 1 else None


def name_cells(table: Table, row: int, names: Mapping[str, int], above: tuple[str, ...]) -> tuple[str, ...]:
    """Return the cells that name the sample of a row.

    `names` are columns as `column_heads.name_columns` returns them. An empty cell takes the text of the row above if
    all cells before it equal the cells of that row. If a cell before it has a text, an empty cell after the name of a
    standard, or in a column of trials or batches, stays empty.
    """
    cells: list[str] = []
    is_said = is_standard = False
    for k, (what, column) in enumerate(names.items()):
        cell = table.text(row, column)
        is_none = is_said and (is_standard or what in column_heads.OF_STANDARDS)
        cells.append(cell or ("" if is_none or tuple(cells) != above[:k] else above[k]))
        is_said = is_said or bool(cell)
        is_standard = is_standard or (bool(cell) and what == column_heads.STANDARD)
    return tuple(cells)


def find_columns(table: Table, context: ErrorContext) -> tuple[Table, Columns] | None:
    """Find the first row that is a header; return the table with a column per band and its columns, or None."""
    for index, row in enumerate(table.rows[:_HEADER_ROWS]):
        heads = [text_of(cell) for cell in row]
        geometry = _geometry_column(table, index, heads)
        wide = _wide(table, index, heads, geometry, context)
        if wide is not table:
            table, heads = wide, [text_of(cell) for cell in wide.rows[index]]
            geometry = _geometry_column(table, index, heads)
        is_named = names_directions(heads) or geometry is not None
        lab = None if any(wavelength(head) is not None for head in heads) else column_heads.lab_columns(heads)
        if is_named and lab is not None:
            axes, seen = lab
            table = _from_lab(table, index, axes)
            heads = [text_of(cell) for cell in table.rows[index]]
            columns = (
                _direction_columns(table, index, heads, context)
                if geometry is None
                else _geometry_columns(table, index, heads, geometry, context, axes)
            )
            return table, replace(columns, viewing=seen or _USUAL_VIEWING, is_viewing_assumed=seen is None)
        if names_directions(heads):
            return table, _direction_columns(table, index, heads, context)
        if geometry is not None and any(wavelength(head) for k, head in enumerate(heads) if k != geometry):
            return table, _geometry_columns(table, index, heads, geometry, context)
    return None


def _wide(table: Table, index: int, heads: list[str], geometry: int | None, context: ErrorContext) -> Table:
    """Return the table with a column per wavelength if its header has a column of wavelengths; else unchanged."""
    of_nm = [k for k, head in enumerate(heads) if column_heads.is_wavelength(head)]
    others = [k for k, head in enumerate(heads) if head and k not in of_nm and uncertainty_head(head) is None]
    if len(of_nm) != 1 or not others:
        return table
    if all(is_geometry(heads[k]) for k in others):
        return _from_spectra_down(table, index, of_nm[0], others, context)
    values = [
        k
        for k in others
        if (said := column_heads.value_head(heads[k]))
        and said.nm is None
        and not (said.channel and not said.quantity)
    ]
    directions = [k for k, angle in enumerate(angle_names(heads)) if angle or k == geometry]
    named = [heads[k] if k in others else "" for k in range(len(heads))]
    names = _name_columns(table, index, named, [*directions, of_nm[0]])
    keys = sorted({*directions, *names.values()})
    known = {*directions, *column_heads.name_columns(named).values()}
    is_known = geometry is not None or (names_directions(heads) and len(known) + 1 == len(others))
    if len(values) != 1 or values[0] in keys or not is_known:
        return table
    uncertain = [k for k, head in enumerate(heads) if head and uncertainty_head(head) is not None]
    return _from_rows_of_bands(table, index, of_nm[0], [*values, *uncertain[:1]], keys, names, context)


def _from_spectra_down(
    table: Table, index: int, of_nm: int, geometries: list[int], context: ErrorContext
) -> Table:
    """Turn a table with a column per geometry and a row per wavelength into one with a row per geometry."""
    below = [row for row in range(index + 1, len(table.rows)) if any(table.text(row, k) for k in geometries)]
    unit = column_heads.wavelength_unit(text_of(table.rows[index][of_nm])) or ""
    heads = [_band(table, row, of_nm, unit, context) for row in below]
    require_one_spectrum(
        np.array([wavelength(head) for head in heads], dtype=float), context, table.where(index)
    )
    spectra = [
        [table.rows[index][k], *(table.rows[row][k] if k < len(table.rows[row]) else None for row in below)]
        for k in geometries
    ]

    def place(row: int, column: int | None) -> tuple[int, int | None]:
        if row <= index:
            return (index if not column else below[column - 1]), of_nm
        return (below[column - 1] if column else index), geometries[row - index - 1]

    return Table([*table.rows[:index], ["Geometry", *heads], *spectra], table.sheet, place)


def _from_rows_of_bands(
    table: Table,
    index: int,
    of_nm: int,
    columns: list[int],
    keys: list[int],
    names: Mapping[str, int],
    context: ErrorContext,
) -> Table:
    """Return a row per spectrum of a table with a row per value, and maybe its uncertainty, beside its wavelength."""
    heads = [text_of(cell) for cell in table.rows[index]]
    unit = column_heads.wavelength_unit(heads[of_nm]) or ""
    # Rows of the bands of spectra, by directions and sample.
    found: dict[tuple[str, ...], list[dict[str, int]]] = {}
    sample = ("",) * len(names)
    for row in range(index + 1, len(table.rows)):
        texts = {k: table.text(row, k) for k in keys}
        if not table.text(row, columns[0]) or texts == {k: heads[k] for k in keys}:
            continue  # a footnote, or the header again
        sample = name_cells(table, row, names, sample)
        texts |= dict(zip(names.values(), sample, strict=True))
        band = _band(table, row, of_nm, unit, context)
        spectra = found.setdefault(tuple(texts.values()), [{}])
        if band in spectra[-1]:
            spectra.append({})
        spectra[-1][band] = row
    spectra_of = [(key, rows) for key, spectra in found.items() for rows in spectra]
    bands = sorted(
        {band for _, rows in spectra_of for band in rows}, key=lambda band: wavelength(band) or 0.0
    )
    if len(bands) * len(spectra_of) > 10 * len(table.rows) + 1000:
        raise context.error(
            f"{len(bands)} wavelengths at {len(spectra_of)} pairs of directions in {len(table.rows)} rows: few have a "
            "value, expected the same wavelengths at all",
            table.where(index),
        )
    wide: list[Sequence[Cell]] = [
        [*key, *(_cell(table, rows.get(band), column) for column in columns for band in bands)]
        for key, rows in spectra_of
    ]

    def place(row: int, column: int | None) -> tuple[int, int | None]:
        own = spectra_of[row - index - 1][1] if row > index else {}
        first = next(iter(own.values()), row)
        if column is None or column < len(keys):
            return first, None if column is None else keys[column]
        k, band = divmod(column - len(keys), len(bands))
        return own.get(bands[band], first), columns[k]

    head = [*(heads[k] for k in keys), *(f"{heads[column]} {band}" for column in columns for band in bands)]
    return Table([*table.rows[:index], head, *wide], table.sheet, place)


def _cell(table: Table, row: int | None, column: int) -> Cell:
    """Return the cell of a row, which may end before it; None without a row."""
    return None if row is None or column >= len(table.rows[row]) else table.rows[row][column]


def _from_lab(table: Table, index: int, axes: list[int]) -> Table:
    """Return the table with linear sRGB in place of CIELAB values; cells without a colour stay as they are."""
    rows: list[Sequence[Cell]] = list(table.rows[: index + 1])
    made = list(rows[index])
    for k, channel_name in zip(axes, "RGB", strict=True):
        made[k] = channel_name
    rows[index] = made
    for row in range(index + 1, len(table.rows)):
        cells = list(table.rows[row])
        lab = [number(table.text(row, k)) for k in axes]
        if None not in lab:
            for k, value in zip(axes, lab_to_linear_srgb(np.array(lab, dtype=float)).tolist(), strict=True):
                cells[k] = value
        rows.append(cells)
    return Table(rows, table.sheet, table.place)


def _band(table: Table, row: int, column: int, unit: str, context: ErrorContext) -> str:
    """Return a cell's wavelength as the heading of a band; a bare number is in its column's unit."""
    text = table.text(row, column)
    nm = wavelength_nm(text, unit)
    head = "" if nm is None else f"{nm:.9g}nm"
    if wavelength(head) is None:
        raise context.error(
            f"found '{text[:24]}', expected a wavelength in {unit or 'nm'}",
            table.where(row, column),
            remedy=CORRECT_CELL,
        )
    return head


def _direction_columns(table: Table, index: int, heads: list[str], context: ErrorContext) -> Columns:
    where = table.where(index)
    named = angle_names(heads)
    angles = {key: k for k, key in enumerate(named) if key is not None}
    twice = next((key for key in angles if named.count(key) > 1), None)
    if twice is not None:
        raise context.error(f"{twice} appears twice, expected each angle once", where, remedy=NEW_HEADER)
    free = [k for k, head in enumerate(heads) if k not in angles.values() and head]
    others = [heads[k] if k in free else "" for k in range(len(heads))]
    names = _name_columns(table, index, others, [*angles.values()])
    gloss = {k: a for k in free if (a := gloss_angle(heads[k])) is not None}
    uncertainties = [k for k in free if uncertainty_head(heads[k]) is not None]
    own = {head: heads.index(head) for head in (WEIGHT_HEAD, SCATTER_HEAD) if head in heads}
    unused = column_heads.name_columns(others).values()
    bands = [k for k in free if k not in (*unused, *gloss, *uncertainties, *own.values())]
    said = [column_heads.value_head(heads[k]) for k in bands]
    unknown = [heads[k] for k, head in zip(bands, said, strict=True) if head is None]
    is_one_kind = len(bands) == 1 or all(channel(heads[k]) for k in bands) or all(h and h.nm for h in said)
    if not bands or unknown or not is_one_kind:
        raise context.error(
            f"columns {', '.join(unknown or [head for head in heads if head])[:80]}: expected values beside the "
            f"directions, one row per pair of directions, in columns such as 465nm, R, G, B, or one of {KNOWN}",
            where,
            remedy=NEW_HEADER,
        )
    return Columns(
        index,
        heads,
        angles,
        None,
        bands,
        names,
        gloss,
        _above(table, index),
        uncertainties=uncertainties,
        own=own,
    )


def _above(table: Table, index: int) -> tuple[str, ...]:
    """Return the lines above a header, which may name a wavelength."""
    return tuple(" ".join(filter(None, map(text_of, row))) for row in table.rows[:index])


def _geometry_columns(
    table: Table, index: int, heads: list[str], geometry: int, context: ErrorContext, lab: Sequence[int] = ()
) -> Columns:
    bands = [*lab] or [k for k, head in enumerate(heads) if k != geometry and wavelength(head) is not None]
    gloss = {
        k: angle for k, head in enumerate(heads) if k != geometry and (angle := gloss_angle(head)) is not None
    }
    for k in range(min(bands), len(heads)):
        is_lost = k < max(bands) and k != geometry and k not in gloss
        if k not in bands and heads[k] and (is_lost or number(heads[k]) is not None):
            raise context.error(
                f"found '{heads[k][:24]}' among wavelengths, expected a number in nm",
                table.where(index, k),
                remedy=NEW_HEADER,
            )
    nm = [wavelength(heads[k]) for k in bands]
    if not lab and len(set(nm)) < len(nm):
        raise context.error("two columns of the same wavelength, expected different ones", table.where(index))
    others = ["" if k in (geometry, *bands) else head for k, head in enumerate(heads)]
    names = _name_columns(table, index, others, [geometry])
    return Columns(index, heads, {}, geometry, bands, names, gloss, _above(table, index))


def _name_columns(table: Table, index: int, heads: Sequence[str], key: Sequence[int]) -> dict[str, int]:
    """Return the columns that name samples.

    Numbers and types name them only where other names and `key`, the columns of directions and wavelengths, repeat.
    Otherwise they count rows or describe geometries. A column of numbers alone names samples, unlike one of types.
    """
    names = column_heads.name_columns(heads)
    rows = [k for k in range(index + 1, len(table.rows)) if sum(map(bool, map(text_of, table.rows[k]))) > 1]
    for what in (column_heads.NUMBER, column_heads.TYPE):
        if what not in names:
            continue
        others = {other: k for other, k in names.items() if other != what}
        is_number = what == column_heads.NUMBER
        counts = is_number and len({table.text(row, names[what]) for row in rows} - {""}) == len(rows)
        if (others or not is_number) and (counts or not _repeats(table, rows, others, key)):
            names = others
    return names


def _repeats(table: Table, rows: Sequence[int], names: Mapping[str, int], key: Sequence[int]) -> bool:
    """Return whether rows of the same names have the same texts in the columns `key`."""
    named_by = ("",) * len(names)
    seen = set()
    for row in rows:
        named_by = name_cells(table, row, names, named_by)
        seen.add((named_by, *(table.text(row, k) for k in key)))
    return len(seen) < len(rows)


def _geometry_column(table: Table, index: int, heads: list[str]) -> int | None:
    """Return the column called geometry, or whose next rows hold nothing but names of geometries; or None."""
    for k, head in enumerate(heads):
        if is_geometry(head):
            continue  # a row of readings
        word = column_heads.plain_head(head)
        below = [
            text for row in range(index + 1, min(index + 4, len(table.rows))) if (text := table.text(row, k))
        ]
        is_angle = word in ("angle", "angles", "aspecular", "aspecular angle")
        if word.startswith("geometr") or (below and all(map(is_geometry, below))):
            return k
        if is_angle and below and all(is_geometry(t) or parse_aspecular(t) is not None for t in below):
            return k
    return None


def _lights_in_columns(table: Table, columns: Columns, context: ErrorContext) -> list[str]:
    """Return lines such as `illuminant: A` of columns that hold the light or the observer of CIELAB values."""
    if not columns.is_viewing_assumed:
        return []
    lines = []
    for k, head in enumerate(columns.heads):
        if (word := column_heads.plain_head(head)) in ("illuminant", "observer"):
            values = {table.text(row, k) for row in range(columns.row + 1, len(table.rows))} - {"", head}
            if len(values) > 1:
                raise context.error(
                    f"column {head} holds {', '.join(sorted(values))[:60]}, expected one value"
                )
            lines += [f"{word}: {value}" for value in values]
    return lines


def read_table(
    table: Table, columns: Columns, context: ErrorContext, name: str, instrument: str
) -> list[Readings]:
    """Read every sample below a header, in the table's order; texts that are numbers are read as numbers.

    `name` is the name of a sample without a name in the table.
    """
    _require_nothing_above(table, columns, context)
    columns = columns.seen_under(_lights_in_columns(table, columns, context))
    notes: list[str] = []
    is_percent = column_heads.is_percent(columns.band_heads)
    samples: dict[tuple[str, ...], _Sample] = {}
    angles = {} if columns.geometry is None else resolve(_geometries(table, columns), context, notes)
    named_by = ("",) * len(columns.names)
    for index in range(columns.row + 1, len(table.rows)):
        keys = [table.text(index, column) for column in columns.key]
        if keys == [columns.heads[column] for column in columns.key]:
            continue  # the header again
        if not any(keys) or (columns.geometry is not None and keys[0] not in angles):
            _require_footnote(table, index, keys, columns, context)
            continue
        named_by = name_cells(table, index, columns.names, named_by)
        sample = samples.setdefault(named_by, _Sample())
        sample.rows.append(index)
        sample.keys.append(keys)
        sample.values.append([_value(table, index, k, context) for k in columns.bands])
        sample.uncertainties.append([_value(table, index, k, context) for k in columns.uncertainties])
        sample.own.append([_value(table, index, k, context) for k in columns.own.values()])
        is_percent |= any(table.text(index, k).endswith("%") for k in columns.bands)
        for column, angle in columns.gloss.items():
            if (units := _gloss(table, index, column, angle, context)) is not None:
                sample.gloss.setdefault(angle, []).append(units)
    if not samples:
        raise context.error(
            "a header but no rows of readings, expected one per geometry", table.where(columns.row)
        )
    if columns.geometry is None:
        unit = _is_degrees(table, columns, samples, context)
        pairs = {key: _angle_pairs(table, s, columns, unit, context) for key, s in samples.items()}
    else:
        for one in samples.values():
            _require_one_condition(table, one, columns, context)
        pairs = {key: _geometry_pairs(table, s, angles, columns, context) for key, s in samples.items()}
    kind = columns.kind or column_heads.quantity(columns.band_heads, context, table.where(columns.row))
    if kind is None and (is_percent or (columns.geometry is None and set(columns.heads) >= _BLACK_LAB)):
        kind = FACTORS
    if is_percent and kind is not None and kind not in (FACTORS, I_OVER_F):
        raise context.error(
            f"percent of {kind.title}, expected reflectance factors", table.where(columns.row)
        )
    if columns.viewing is not None:
        kind = FACTORS
        of_whom = ", which no heading says (--illuminant, --observer)" if columns.is_viewing_assumed else ""
        notes.append(
            f"colours are read as CIELAB under {columns.viewing}{of_whom}; they do not determine spectra"
        )
        rgb = np.concatenate([np.array(sample.values) for sample in samples.values()])
        notes += lightness_doubts(L_PER_Y * float(np.nanmax(linear_srgb_to_xyz(rgb)[:, 1], initial=0.0)))
    named = column_heads.sample_names(
        (dict(zip(columns.names, cells, strict=True)) for cells in samples), name
    )
    white = 100.0 if is_percent else 1.0
    assumed: Assumed | None = None
    if kind is None:
        raw = [(wi, wo, np.array(samples[key].values)[keep]) for key, (keep, wi, wo, _) in pairs.items()]
        assumed = (assumed_unit if columns.geometry is None else assumed_factors)(raw, context)
        kind, white = assumed.quantity, assumed.white
        notes.append(assumed.note)
        is_rgb = all(map(channel, columns.band_heads))
        if is_rgb and assumed.unit == "percent" and all(np.all(values % 1.0 == 0.0) for _, _, values in raw):
            notes.append(Assumption("whole numbers: if they are codes of a picture, make them linear first"))
    return [
        replace(
            _readings(of_sample, instrument, table, sample, pairs[key], columns, kind, white, notes, context),
            assumed_unit=None if assumed is None else assumed.unit,
            viewing=columns.viewing or DAYLIGHT,
            is_viewing_assumed=columns.is_viewing_assumed,
        )
        for of_sample, (key, sample) in zip(named, samples.items(), strict=True)
    ]


def _gloss(table: Table, index: int, column: int, angle: float, context: ErrorContext) -> float | None:
    """Return the gloss units in a cell; None if it is empty, or a word such as `matt`."""
    measure = number_with_unit(table.text(index, column))
    if measure is None:
        return None
    fault = gloss_fault(angle, measure.value)
    if measure.unit not in ("", "gu"):
        fault = f"found '{table.text(index, column)[:24]}', expected gloss units"
    if fault is not None:
        raise context.error(fault, table.where(index, column), remedy=CORRECT_CELL)
    return measure.value


def _geometries(table: Table, columns: Columns) -> Iterator[str]:
    column = columns.key[0]
    return (text for row in range(columns.row + 1, len(table.rows)) if (text := table.text(row, column)))


def _require_nothing_above(table: Table, columns: Columns, context: ErrorContext) -> None:
    """Raise FileFormatError if there are readings above the header."""
    for index in range(columns.row):
        count = sum(number(table.text(index, k)) is not None for k in range(len(table.rows[index])))
        if count >= len(columns.bands) + len(columns.angles) and (
            columns.geometry is None or any(parse_geometry(text_of(cell)) for cell in table.rows[index])
        ):
            raise context.error("readings above the header, expected all below it", table.where(index))


def _require_footnote(
    table: Table, index: int, keys: list[str], columns: Columns, context: ErrorContext
) -> None:
    """Raise FileFormatError if a row without a direction holds values, or a text meant as a geometry."""
    text = next(filter(None, keys), "")
    has_values = any(number(table.text(index, k)) is not None for k in columns.bands)
    if not has_values and not ("as" in text.lower() and any(c.isdigit() for c in text)):
        return
    if columns.geometry is None:
        raise context.error("values without directions", table.where(index))
    found = f"found geometry '{text[:24]}'" if text else "values without a geometry"
    raise context.error(f"{found}, expected one such as 45as15", table.where(index))


def _value(table: Table, index: int, column: int, context: ErrorContext) -> float:
    """Return the value of a cell, NaN if nothing was measured."""
    row = table.rows[index]
    if column >= len(row) and table.sheet is None:
        raise context.error(
            f"the row ends after {len(row)} cells, expected a value", table.where(index, column)
        )
    cell = row[column] if column < len(row) else None
    value = plain_float(cell) if isinstance(cell, str) else float("nan")
    if abs(value) < 1e300:
        return value
    text = text_of(cell).removesuffix("%").rstrip()
    return float("nan") if not text else context.number(text, table.where(index, column))


def _is_degrees(
    table: Table, columns: Columns, samples: Mapping[tuple[str, ...], _Sample], context: ErrorContext
) -> bool:
    """Return whether angles are in degrees: as headings or cells say, or because they are too large for radians."""
    where = table.where(columns.row)
    unit = column_heads.angle_unit([columns.heads[k] for k in columns.angles.values()], context, where)
    cells = [[_measure(text) for text in row] for s in samples.values() for row in s.keys]
    units = {unit, *(angle_unit(m.unit) for row in cells for m in row if m is not None and m.unit)} - {None}
    if len(units) > 1:
        raise context.error("angles in degrees and in radians, expected one unit", where)
    if units:
        return "degrees" in units
    keys = np.array([[0.0 if measure is None else measure.value for measure in row] for row in cells])
    if np.any(keys) and not exceed_radians(dict(zip(columns.angles, keys.T, strict=True))):
        raise context.error(
            "angles that may be degrees or radians, expected headings such as theta_i (deg)",
            where,
            remedy=NEW_HEADER,
        )
    return True


# Which rows are kept, their wi and wo, and notes.
_Pairs = tuple[Mask, Array, Array, list[str]]


def _angle_pairs(
    table: Table, sample: _Sample, columns: Columns, is_degrees: bool, context: ErrorContext
) -> _Pairs:
    scale = np.pi / 180.0 if is_degrees else 1.0
    cells = [
        [
            _angle(text, f"{table.where(row)}, {key}", context)
            for key, text in zip(columns.angles, keys, strict=True)
        ]
        for row, keys in zip(sample.rows, sample.keys, strict=True)
    ]
    notes: list[str] = []
    angles = dict(zip(columns.angles, scale * np.array(cells).T, strict=True))
    heads = {angle: columns.heads[k] for angle, k in columns.angles.items()}
    keep, wi, wo = directions(angles, context, notes, heads, lambda k: table.where(sample.rows[k]))
    return keep, wi, wo, notes


def _measure(text: str) -> Measure | None:
    """Return `number_with_unit`, quickly for what Python takes for a number."""
    value = plain_float(text)
    return Measure(value, "") if abs(value) < 1e300 else number_with_unit(text)


def _angle(text: str, where: str, context: ErrorContext) -> float:
    """Return the angle in a cell, in its own unit."""
    measure = _measure(text)
    is_angle = measure is not None and (not measure.unit or angle_unit(measure.unit) is not None)
    return measure.value if measure is not None and is_angle else context.number(text, where)


def _require_one_condition(table: Table, sample: _Sample, columns: Columns, context: ErrorContext) -> None:
    """Raise FileFormatError where a geometry is read under M1 and M2 (ISO 13655), which are no repeats."""
    others = [
        k
        for k in range(len(columns.heads))
        if k not in (*columns.names.values(), *columns.key, *columns.bands)
    ]
    first: dict[tuple[int, str], str] = {}
    for row, (geometry,) in zip(sample.rows, sample.keys, strict=True):
        for k in others:
            found = _CONDITION.match(table.text(row, k))
            if found and first.setdefault((k, geometry), found[0]) != found[0]:
                raise context.error(
                    f"{found[0]} beside {first[k, geometry]} at '{geometry[:24]}', expected one measuring condition; "
                    "keep the rows of one",
                    table.where(row, k),
                )


def _geometry_pairs(
    table: Table,
    sample: _Sample,
    angles: dict[str, tuple[float, float, float]],
    columns: Columns,
    context: ErrorContext,
) -> _Pairs:
    pairs = []
    for row, (text,) in zip(sample.rows, sample.keys, strict=True):
        pair = directions_of(angles[text])
        if pair is None:
            raise context.error(
                f"geometry '{text[:24]}' lies below the horizon, expected one such as 45as15",
                table.where(row),
            )
        pairs.append(pair)
        first = sample.rows[sample.keys.index([text])]
        if not columns.names and first != row:
            raise context.error(
                f"geometry '{text[:24]}' is also in {table.where(first)}; expected a column Name that "
                "distinguishes the samples",
                table.where(row),
            )
    wi, wo = (np.array(w) for w in zip(*pairs, strict=True))
    return np.ones(len(pairs), dtype=np.bool_), wi, wo, []


def _readings(
    name: str,
    instrument: str,
    table: Table,
    sample: _Sample,
    pairs: _Pairs,
    columns: Columns,
    kind: Quantity,
    white: float,
    table_notes: list[str],
    context: ErrorContext,
) -> Readings:
    keep, wi, wo, own_notes = pairs
    notes = [*table_notes, *own_notes]
    raw = np.array(sample.values)[keep]
    if not np.any(np.isfinite(raw)):
        raise context.error(f"sample '{name[:40]}' has no values, expected reflectance or f in 1/sr")
    values = as_brdf(raw, kind, wi, wo, notes if columns.geometry is None else [], white)
    rows = [table.where(row) for row in compress(sample.rows, keep)]
    notes += _doubtful(rows, columns.band_heads, wi, wo, values)
    uncertain = dict(
        zip(
            (columns.heads[k] for k in columns.uncertainties),
            np.array(sample.uncertainties)[keep].T,
            strict=True,
        )
    )
    relative = relative_uncertainties(uncertain, columns.band_heads, raw, kind, white, notes, context)
    _, _, relative, *_ = mean_of_repeats(wi, wo, relative)
    nm, values = bands_of(columns.band_heads, values, notes, context, columns.comments)
    wi, wo, values, scatter, repeats = mean_of_repeats(wi, wo, values)
    notes += repeats
    said = weights_of(relative)
    weighed: dict[str, Any] = {"scatter": scatter}
    if said is not None:
        notes.append(said.note)
        weighed = said.readings | {"scatter": np.maximum(scatter, said.scatter)}
    if columns.own and len(wi) == len(raw):
        own = dict(zip(columns.own, np.array(sample.own)[keep].T, strict=True))
        weighed |= {
            name: own[head]
            for name, head in (("weights", WEIGHT_HEAD), ("scatter", SCATTER_HEAD))
            if head in own
        }
    if np.any(np.isnan(values)):
        count = int(np.isnan(values).sum())
        notes.append(
            "1 empty cell is not measured" if count == 1 else f"{count} empty cells are not measured"
        )
    gloss = {angle: float(np.mean(units)) for angle, units in sample.gloss.items()}
    return Readings(name, instrument, wi, wo, nm, values, notes=tuple(notes), gloss=gloss, **weighed)


def _doubtful(rows: list[str], heads: list[str], wi: Array, wo: Array, values: Array) -> list[str]:
    """Return notes on rows of values (P, B) in 1/sr that are negative, or too bright away from mirror directions.

    Some bands may be too bright alone. Single channels of colours outside sRGB are negative.
    """
    notes = list[str]()
    is_spectral = channel(heads[0]) is None
    with np.errstate(invalid="ignore"):
        is_negative = np.any(values < 0.0, axis=1) if is_spectral else np.mean(values, axis=1) < 0.0
    if len(negative := np.flatnonzero(is_negative)):
        named = first_few([rows[k] for k in negative], _NAMED_ROWS)
        notes.append(Assumption(f"{named}: negative values, which count as 0"))
    alone = np.flatnonzero(bright_bands(wi, wo, values))
    if is_spectral and 0 < 2 * len(alone) < len(heads):
        named = first_few([heads[k] for k in alone], _NAMED_ROWS)
        notes.append(
            Assumption(
                f"band {named}: brighter than a perfect diffuser, away from the mirror direction; saturated?"
            )
        )
    bright = too_bright_rows(wi, wo, values)
    if len(bright):
        named = first_few([rows[k] for k in bright], _NAMED_ROWS)
        most = np.pi * float(values[bright].mean(axis=1).max())
        up_to = "up to " if len(bright) > 1 else ""
        notes.append(
            Assumption(
                f"{named}: {up_to}{most:.3g} times as bright as a perfect diffuser, away from the mirror direction; "
                "check the values"
            )
        )
    return notes


def in_one_unit(found: Sequence[Readings]) -> list[Readings]:
    """Give the readings of all tables of a file the same assumed unit: percent if any of them must be percent."""
    if not any(TAKEN_AS_PERCENT in one.notes for one in found):
        return list(found)
    return [
        replace(
            one,
            values=one.values / 100.0,
            assumed_unit="percent",
            notes=tuple(TAKEN_AS_PERCENT if note == TAKEN_AS_FACTORS else note for note in one.notes),
        )
        if TAKEN_AS_FACTORS in one.notes
        else one
        for one in found
    ]

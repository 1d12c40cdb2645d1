"""Tables of readings: cells of workbooks and CSV files, the columns that a header names, and the readings below it.

Two layouts are read: a row per pair of directions (columns theta_i, phi_i, theta_o, phi_o), as goniometers have it; and
a row per geometry (a column of names such as 45as15), as multi-angle spectrophotometers have it. Bands are columns.
Tables with a row per value beside its wavelength, or a row per wavelength below names of geometries, are rearranged.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from manifold.formats import column_heads
from manifold.formats.column_heads import Quantity, angle_name, channel, gloss_angle, wavelength
from manifold.formats.geometries import (
    directions,
    directions_of,
    exceed_radians,
    is_geometry,
    parse_aspecular,
    parse_geometry,
    resolve,
)
from manifold.formats.readings import DAYLIGHT, Readings, Viewing, gloss_fault, mean_of_repeats
from manifold.formats.text import ErrorContext, number, plain_float
from manifold.formats.values import (
    TAKEN_AS_BRDF,
    TAKEN_AS_FACTORS,
    TAKEN_AS_PERCENT,
    TOO_BRIGHT,
    as_brdf,
    bands_of,
    is_too_bright,
    lab_to_linear_srgb,
    looks_like_percent,
    nanometres,
)
from manifold.records import Array

Cell = str | float | int | None
HEADERS = "'Name, Geometry, 400, 410' or 'theta_i (deg), phi_i (deg), theta_o (deg), phi_o (deg), 465nm'"
"""The headers of tables that are read, for errors."""

_HEADER_ROWS = 60  # a header stands at the top, below titles
_CONDITION = re.compile(r"M[0-3]\b")
_LAB_AXES = "lab"
_USUAL_VIEWING = Viewing("D65", 10)  # viewing of instruments for coatings, where heads name none
_BLACK_LAB = {"src_z", "src_a", "view_z", "view_a"}  # a program's heads; its values are reflectance factors


@dataclass(frozen=True)
class Table:
    """Rows of cells.

    Attributes:
        sheet: title of the workbook's sheet; its rows end at their last cell that is not empty. None for CSV files.
        place: where a row and column stood before they were rearranged; None where they were not.
    """

    rows: Sequence[Sequence[Cell]]
    sheet: str | None = None
    place: Callable[[int, int | None], tuple[int, int | None]] | None = None

    def where(self, row: int, column: int | None = None) -> str:
        """A row and column, counted from 0, in words for errors."""
        if self.place is not None:
            row, column = self.place(row, column)
        sheet = f"sheet '{self.sheet}', " if self.sheet is not None else ""
        return f"{sheet}row {row + 1}" + ("" if column is None else f", column {column + 1}")

    def text(self, row: int, column: int) -> str:
        """What a cell says; rows may end before it."""
        cells = self.rows[row]
        return text_of(cells[column]) if column < len(cells) else ""


@dataclass(frozen=True)
class Columns:
    """A header's columns.

    Attributes:
        heads: all its cells.
        angles: columns by what `angle_name` calls them, in a table of directions.
        geometry: the column of geometries' names, or None in a table of directions.
        bands: columns of values.
        name: the column of samples' names, if there is one.
        gloss: columns of gloss, with its angle in degrees.
        comments: lines of the file that may name a wavelength.
        viewing: of CIELAB values, which are linear sRGB relative to it in these columns; None of other values.
        kind: what the file says of its values elsewhere than in heads; None where it says nothing.
    """

    row: int
    heads: list[str]
    angles: dict[str, int]
    geometry: int | None
    bands: list[int]
    name: int | None
    gloss: dict[int, float]
    comments: tuple[str, ...] = ()
    viewing: Viewing | None = None
    kind: Quantity | None = None

    @property
    def band_heads(self) -> list[str]:
        """Heads of the columns of values."""
        return [self.heads[column] for column in self.bands]

    @property
    def key(self) -> list[int]:
        """The columns that say where a row was measured."""
        return [self.geometry] if self.geometry is not None else list(self.angles.values())


@dataclass
class _Sample:
    """Rows of one sample: where they stand, their geometries or angles, values, and gloss by angle."""

    rows: list[int] = field(default_factory=list)
    keys: list[list[str]] = field(default_factory=list)
    values: list[list[float]] = field(default_factory=list)
    gloss: dict[float, list[float]] = field(default_factory=dict)


def text_of(cell: Cell) -> str:
    """What a cell says, without blanks around it."""
    if cell is None:
        return ""
    if isinstance(cell, float):
        return str(int(cell)) if cell.is_integer() and abs(cell) < 1e6 else repr(cell)
    return str(cell).strip()


def names_directions(heads: Sequence[str]) -> bool:
    """Whether cells are the header of a table of directions: both elevations are named."""
    return {"theta_i", "theta_o"} <= {angle_name(head) for head in heads}


def resembles_header(heads: Sequence[str]) -> bool:
    """Whether cells look like the header of a table of readings, complete or not."""
    return (
        any(column_heads.plain_head(head).startswith("geometr") for head in heads)
        or (any(map(column_heads.is_wavelength, heads)) and any(map(is_geometry, heads)))
        or sum(angle_name(head) is not None for head in heads) >= 2
        or sum(wavelength(head) is not None for head in heads) >= 3
    )


def find_columns(table: Table, context: ErrorContext) -> tuple[Table, Columns] | None:
    """The columns of the first row that is a header, and the table whose bands are columns; None without a header."""
    for index, row in enumerate(table.rows[:_HEADER_ROWS]):
        heads = [text_of(cell) for cell in row]
        geometry = _geometry_column(table, index, heads)
        wide = _wide(table, index, heads, geometry, context)
        if wide is not table:
            table, heads = wide, [text_of(cell) for cell in wide.rows[index]]
            geometry = _geometry_column(table, index, heads)
        is_named = names_directions(heads) or geometry is not None
        if is_named and (lab := _lab_columns(heads)) is not None:
            axes, seen = lab
            table = _from_lab(table, index, axes)
            heads = [text_of(cell) for cell in table.rows[index]]
            columns = (
                _direction_columns(table, index, heads, context)
                if geometry is None
                else _geometry_columns(table, index, heads, geometry, context, axes)
            )
            return table, replace(columns, viewing=seen)
        if names_directions(heads):
            return table, _direction_columns(table, index, heads, context)
        if geometry is not None and any(wavelength(head) for k, head in enumerate(heads) if k != geometry):
            return table, _geometry_columns(table, index, heads, geometry, context)
    return None


def _wide(table: Table, index: int, heads: list[str], geometry: int | None, context: ErrorContext) -> Table:
    """The table with a column per wavelength, where a header at `index` has a column of wavelengths; else as it is."""
    of_nm = [k for k, head in enumerate(heads) if column_heads.is_wavelength(head)]
    others = [k for k, head in enumerate(heads) if head and k not in of_nm]
    if len(of_nm) != 1 or not others:
        return table
    if all(is_geometry(heads[k]) for k in others):
        return _from_spectra_down(table, index, of_nm[0], others, context)
    values = [
        k
        for k in others
        if (said := column_heads.value_head(heads[k])) and said.nm is None and not channel(heads[k])
    ]
    name = column_heads.name_column([heads[k] if k in others else "" for k in range(len(heads))])
    keys = [k for k in others if angle_name(heads[k]) or k in (geometry, name)]
    is_known = geometry is not None or (names_directions(heads) and len(keys) + 1 == len(others))
    if len(values) != 1 or values[0] in keys or not is_known:
        return table
    return _from_rows_of_bands(table, index, of_nm[0], values[0], keys, name, context)


def _from_spectra_down(
    table: Table, index: int, of_nm: int, geometries: list[int], context: ErrorContext
) -> Table:
    """A row per geometry of a table that has a column per geometry and a row per wavelength."""
    below = [row for row in range(index + 1, len(table.rows)) if any(table.text(row, k) for k in geometries)]
    heads = [_band(table, row, of_nm, context) for row in below]
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
    of_value: int,
    keys: list[int],
    name: int | None,
    context: ErrorContext,
) -> Table:
    """A row per spectrum of a table that has a row per value, beside its wavelength."""
    heads = [text_of(cell) for cell in table.rows[index]]
    # Rows of the bands of spectra, by directions and sample.
    found: dict[tuple[str, ...], list[dict[str, int]]] = {}
    sample = ""
    for row in range(index + 1, len(table.rows)):
        texts = {k: table.text(row, k) for k in keys}
        if not table.text(row, of_value) or texts == {k: heads[k] for k in keys}:
            continue  # a footnote, or the header again
        if name is not None:
            sample = texts[name] = texts[name] or sample
        band = _band(table, row, of_nm, context)
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
        [*key, *(table.rows[rows[band]][of_value] if band in rows else None for band in bands)]
        for key, rows in spectra_of
    ]

    def place(row: int, column: int | None) -> tuple[int, int | None]:
        own = spectra_of[row - index - 1][1] if row > index else {}
        first = next(iter(own.values()), row)
        if column is None or column < len(keys):
            return first, None if column is None else keys[column]
        return own.get(bands[column - len(keys)], first), of_value

    head = [*(heads[k] for k in keys), *(f"{heads[of_value]} {band}" for band in bands)]
    return Table([*table.rows[:index], head, *wide], table.sheet, place)


def _lab_columns(heads: list[str]) -> tuple[list[int], Viewing] | None:
    """The columns of CIELAB values in a header without bands, and their light and observer."""
    said = {k: lab for k, head in enumerate(heads) if (lab := column_heads.lab_head(head)) is not None}
    if any(wavelength(head) is not None for head in heads):
        return None
    for seen in dict.fromkeys(lab.viewing for lab in said.values()):
        axes = {lab.axis: k for k, lab in said.items() if lab.viewing == seen}
        if len(axes) == len(_LAB_AXES):
            return [axes[axis] for axis in _LAB_AXES], seen or _USUAL_VIEWING
    return None


def _from_lab(table: Table, index: int, axes: list[int]) -> Table:
    """The table with linear sRGB in place of CIELAB values; what is no colour stays as it is."""
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


def _band(table: Table, row: int, column: int, context: ErrorContext) -> str:
    """The wavelength in a cell as the head of a band."""
    text = table.text(row, column)
    nm = nanometres(text) if number(text) is not None else None
    head = "" if nm is None else f"{nm:.9g}nm"
    if wavelength(head) is None:
        raise context.error(f"found '{text[:24]}', expected a wavelength in nm", table.where(row, column))
    return head


def _direction_columns(table: Table, index: int, heads: list[str], context: ErrorContext) -> Columns:
    where = table.where(index)
    named = [angle_name(head) for head in heads]
    angles = {key: k for k, key in enumerate(named) if key is not None}
    twice = next((key for key in angles if named.count(key) > 1), None)
    if twice is not None:
        raise context.error(f"{twice} appears twice, expected each angle once", where)
    free = [k for k, head in enumerate(heads) if k not in angles.values() and head]
    name = column_heads.name_column([heads[k] if k in free else "" for k in range(len(heads))])
    gloss = {k: a for k in free if (a := gloss_angle(heads[k])) is not None}
    bands = [k for k in free if k != name and k not in gloss]
    said = [column_heads.value_head(heads[k]) for k in bands]
    unknown = [heads[k] for k, head in zip(bands, said, strict=True) if head is None]
    is_one_kind = len(bands) == 1 or all(channel(heads[k]) for k in bands) or all(h and h.nm for h in said)
    if not bands or unknown or not is_one_kind:
        raise context.error(
            f"columns {', '.join(unknown or [head for head in heads if head])[:80]}: expected values beside the "
            "directions, with heads such as 465nm, R, G, B, or BRDF, a row per pair of directions",
            where,
        )
    return Columns(index, heads, angles, None, bands, name, gloss)


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
                f"found '{heads[k][:24]}' among wavelengths, expected nm", table.where(index, k)
            )
    nm = [wavelength(heads[k]) for k in bands]
    if not lab and len(set(nm)) < len(nm):
        raise context.error("two columns of the same wavelength, expected different ones", table.where(index))
    name = column_heads.name_column(["" if k in (geometry, *bands) else head for k, head in enumerate(heads)])
    return Columns(index, heads, {}, geometry, bands, name, gloss)


def _geometry_column(table: Table, index: int, heads: list[str]) -> int | None:
    """The column that is called so, or holds nothing but names of geometries in the next rows."""
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


def read_table(
    table: Table, columns: Columns, context: ErrorContext, name: str, instrument: str
) -> list[Readings]:
    """Readings of every sample below a header, in the table's order; texts that are numbers count as numbers.

    The name is that of the sample where the table has no column of names.
    """
    _require_nothing_above(table, columns, context)
    notes: list[str] = []
    is_percent = column_heads.is_percent(columns.band_heads)
    samples: dict[str, _Sample] = {}
    angles = {} if columns.geometry is None else resolve(_geometries(table, columns), context, notes)
    last = name
    for index in range(columns.row + 1, len(table.rows)):
        keys = [table.text(index, column) for column in columns.key]
        if keys == [columns.heads[column] for column in columns.key]:
            continue  # the header again
        if not any(keys) or (columns.geometry is not None and keys[0] not in angles):
            _require_footnote(table, index, keys, columns, context)
            continue
        last = (table.text(index, columns.name) if columns.name is not None else "") or last
        sample = samples.setdefault(last, _Sample())
        sample.rows.append(index)
        sample.keys.append(keys)
        sample.values.append([_value(table, index, k, context) for k in columns.bands])
        is_percent |= any(isinstance(cell, str) and cell.endswith("%") for cell in table.rows[index])
        for column, angle in columns.gloss.items():
            units = number(table.text(index, column))  # None where empty, or a word such as `matt`
            if units is not None and (fault := gloss_fault(angle, units)) is not None:
                raise context.error(fault, table.where(index, column))
            if units is not None:
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
    kind = columns.kind or column_heads.quantity(columns.band_heads)
    if is_percent or (columns.geometry is None and set(columns.heads) >= _BLACK_LAB):
        kind = "factor"
    if columns.viewing is not None:
        kind = "factor"
        notes.append(f"colours are read as CIELAB under {columns.viewing}, which says nothing of spectra")
    white, assumed = 100.0 if is_percent else 1.0, None
    if kind is None and columns.geometry is not None:
        kind = "factor"
        raw = [(wi, wo, np.array(samples[key].values)) for key, (_, wi, wo, _) in pairs.items()]
        white = 100.0 if any(looks_like_percent(*one) for one in raw) else 1.0
        notes.append(TAKEN_AS_FACTORS if white == 1.0 else TAKEN_AS_PERCENT)
        assumed = "factor" if white == 1.0 else "percent"
    elif kind is None:
        raw = [(wi, wo, np.array(samples[key].values)[keep]) for key, (keep, wi, wo, _) in pairs.items()]
        assumed = "brdf"
        if any(is_too_bright(*one) for one in raw):
            kind, assumed = "factor", "factor"
            if any(is_too_bright(wi, wo, values / np.pi) for wi, wo, values in raw):
                white, assumed = 100.0, "percent"
        notes.append(
            TAKEN_AS_BRDF
            if assumed == "brdf"
            else TOO_BRIGHT + ("taken as reflectance factors" if assumed == "factor" else "taken as per cent")
        )
    return [
        replace(
            _readings(key, instrument, sample, pairs[key], columns, kind or "f", white, notes, context),
            assumed_unit=assumed,
            viewing=columns.viewing or DAYLIGHT,
        )
        for key, sample in samples.items()
    ]


def _geometries(table: Table, columns: Columns) -> Iterator[str]:
    column = columns.key[0]
    return (text for row in range(columns.row + 1, len(table.rows)) if (text := table.text(row, column)))


def _require_nothing_above(table: Table, columns: Columns, context: ErrorContext) -> None:
    """Raise FileFormatError where readings stand above the header."""
    for index in range(columns.row):
        count = sum(number(table.text(index, k)) is not None for k in range(len(table.rows[index])))
        if count >= len(columns.bands) + len(columns.angles) and (
            columns.geometry is None or any(parse_geometry(text_of(cell)) for cell in table.rows[index])
        ):
            raise context.error("readings above the header, expected all below it", table.where(index))


def _require_footnote(
    table: Table, index: int, keys: list[str], columns: Columns, context: ErrorContext
) -> None:
    """Raise FileFormatError where a row without a direction holds values, or what was meant as a geometry."""
    text = next(filter(None, keys), "")
    has_values = any(number(table.text(index, k)) is not None for k in columns.bands)
    if not has_values and not ("as" in text.lower() and any(c.isdigit() for c in text)):
        return
    if columns.geometry is None:
        raise context.error("values without directions", table.where(index))
    found = f"found geometry '{text[:24]}'" if text else "values without a geometry"
    raise context.error(f"{found}, expected one such as 45as15", table.where(index))


def _value(table: Table, index: int, column: int, context: ErrorContext) -> float:
    """The value of a cell, NaN where nothing was measured."""
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


def _is_degrees(table: Table, columns: Columns, samples: dict[str, _Sample], context: ErrorContext) -> bool:
    """Whether angles are in degrees: as heads say, or because they are too large for radians."""
    where = table.where(columns.row)
    unit = column_heads.angle_unit([columns.heads[k] for k in columns.angles.values()], context, where)
    if unit is not None:
        return unit == "degrees"
    keys = np.array([[number(text) or 0.0 for text in row] for s in samples.values() for row in s.keys])
    if np.any(keys) and not exceed_radians(dict(zip(columns.angles, keys.T, strict=True))):
        raise context.error(
            "angles that may be degrees or radians, expected heads such as theta_i (deg)", where
        )
    return True


# Which rows are kept, their wi and wo, and notes.
_Pairs = tuple[Array, Array, Array, list[str]]


def _angle_pairs(
    table: Table, sample: _Sample, columns: Columns, is_degrees: bool, context: ErrorContext
) -> _Pairs:
    scale = np.pi / 180.0 if is_degrees else 1.0
    cells = [
        [
            context.number(text, f"{table.where(row)}, {key}")
            for key, text in zip(columns.angles, keys, strict=True)
        ]
        for row, keys in zip(sample.rows, sample.keys, strict=True)
    ]
    notes: list[str] = []
    angles = dict(zip(columns.angles, scale * np.array(cells).T, strict=True))
    return (*directions(angles, context, notes), notes)


def _require_one_condition(table: Table, sample: _Sample, columns: Columns, context: ErrorContext) -> None:
    """Raise FileFormatError where a geometry is read under M1 and M2 (ISO 13655), which are no repeats."""
    others = [k for k in range(len(columns.heads)) if k not in (columns.name, *columns.key, *columns.bands)]
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
        if columns.name is None and first != row:
            raise context.error(
                f"geometry '{text[:24]}' stands in {table.where(first)}, too; expected a column Name that "
                "tells samples apart",
                table.where(row),
            )
    wi, wo = (np.array(w) for w in zip(*pairs, strict=True))
    return np.ones(len(pairs), dtype=bool), wi, wo, []


def _readings(
    name: str,
    instrument: str,
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
    values = np.array(sample.values)[keep]
    if not np.any(np.isfinite(values)):
        raise context.error(f"sample '{name[:40]}' has no values, expected reflectance or f in 1/sr")
    values = as_brdf(values, kind, wo, notes if columns.geometry is None else [], white)
    nm, values = bands_of(columns.band_heads, values, notes, context, columns.comments)
    wi, wo, values, scatter, repeats = mean_of_repeats(wi, wo, values)
    notes += repeats
    if np.any(np.isnan(values)):
        notes.append(f"{int(np.isnan(values).sum())} empty cells are not measured")
    gloss = {angle: float(np.mean(units)) for angle, units in sample.gloss.items()}
    return Readings(name, instrument, wi, wo, nm, values, notes=tuple(notes), gloss=gloss, scatter=scatter)


def in_one_unit(found: Sequence[Readings]) -> list[Readings]:
    """The readings of one file's tables, which have one unit: percent where any of them must be."""
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

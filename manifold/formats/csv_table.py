"""CSV files of readings: one row per geometry of a spectrophotometer, or per direction pair in degrees with f in 1/sr.

Separators are `;`, tab or comma, or blanks below a header of directions. Decimal commas are accepted unless the
separator is a comma. Lines that begin with # are comments; `# format:`, `# name:`, `# instrument:` and `# gloss 60:`
are the package's own.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from manifold.core import disk
from manifold.core.defaults import REPEATABILITY
from manifold.core.directions import to_spherical
from manifold.core.errors import FileFormatError
from manifold.core.names import in_one_line
from manifold.core.records import Array
from manifold.formats.column_heads import gloss_angle, plain_head, viewing
from manifold.formats.foreign import resembles_json
from manifold.formats.quantities import BRDF
from manifold.formats.readings import DAYLIGHT, Readings
from manifold.formats.tables import (
    NEW_HEADER,
    SCATTER_HEAD,
    WEIGHT_HEAD,
    Columns,
    Table,
    find_columns,
    names_directions,
    not_understood,
    read_table,
    resembles_header,
)
from manifold.formats.text import CORRECT_CELL, ErrorContext, decode, number, read_bytes, split_cells

_REMEDY = "correct the table"
_SEPARATORS = (";", "\t", ",", None)  # None: blanks
_FORMAT = "manifold readings 1"  # a version that is read, whatever has none
_OWN_NUMBERS = {"repeatability": "repeatability", "colour error": "colour_error"}
_MOST_COMMENTS = 40  # lines at the top
_HEAD = 70  # lines at the top, one of which is the header


def sniff(head: bytes) -> bool:
    """Return whether a file's beginning has the header of a table of readings, or a line that resembles one."""
    text = decode(head)
    if "\0" in text or resembles_json(text) or text.lstrip().startswith("<"):
        return False
    lines = [_uncommented(line) for line in text.splitlines() if line.strip()][:_HEAD]
    try:
        if _header(lines, ErrorContext(Path(), "")) is not None:
            return True
    except FileFormatError:
        return True
    return any(resembles_header(split_cells(line.lstrip("#% "), s)) for line in lines for s in _SEPARATORS)


def read(path: Path) -> list[Readings]:
    """Read the readings of every sample of a CSV file."""
    context = ErrorContext(path, _REMEDY)
    lines = [_uncommented(line) for line in decode(read_bytes(path)).split("\n")]
    own = dict(_own_comments(lines))
    if own.get("format", _FORMAT) != _FORMAT and own["format"].startswith("manifold readings"):
        version = f"'{own['format']}', expected '{_FORMAT}'"
        raise context.error(version, remedy="read it with a newer version of manifold")
    table, columns = _table(["" if line.startswith("#") else line for line in lines], context)
    comments = tuple(line for line in lines if line.startswith("#"))
    columns = replace(
        columns, comments=(*comments, *columns.comments), kind=BRDF if own.get("format") == _FORMAT else None
    )
    columns = columns.seen_under(columns.comments)
    is_spectro = columns.geometry is not None
    instrument = own.get("instrument") or f"{'spectrophotometer' if is_spectro else 'goniometer'} (CSV)"
    found = read_table(table, columns, context, own.get("name") or path.stem, instrument)
    if len(found) > 1:
        return found
    return [_with_own(found[0], own, context)]


def _with_own(readings: Readings, own: Mapping[str, str], context: ErrorContext) -> Readings:
    """Return the readings with the properties that the package's own comments state."""
    units = {angle: number(text) for key, text in own.items() if (angle := gloss_angle(key)) is not None}
    gloss = {angle: value for angle, value in units.items() if value is not None}  # not `gloss: matt`
    readings = replace(readings, gloss={**gloss, **readings.gloss})
    if own.get("format") != _FORMAT:
        return readings
    numbers: dict[str, Any] = {
        name: context.number(own[key], key) for key, name in _OWN_NUMBERS.items() if key in own
    }
    readings = replace(readings, **numbers)
    return replace(readings, viewing=viewing(own.get("viewing", "")) or readings.viewing)


def _own_comments(lines: list[str]) -> Iterator[tuple[str, str]]:
    """Yield keys in lower case and values of comments such as `# name: satin`."""
    for line in lines[:_MOST_COMMENTS]:
        key, _, value = line.lstrip("# ").partition(":")
        if line.startswith("#") and value.strip():
            yield key.strip().lower(), value.strip()


def _uncommented(line: str) -> str:
    """Return the line, without its comment mark if it is the header of a table of directions."""
    bare = line.lstrip("#% ")
    is_header = line.startswith(("#", "%")) and any(
        names_directions(split_cells(bare, s)) for s in _SEPARATORS
    )
    return bare if is_header else line


def _table(lines: list[str], context: ErrorContext) -> tuple[Table, Columns]:
    """Return the cells, by the first separator with which a line is a header, and its columns."""
    separator, columns = _header(lines[:_HEAD], context) or (None, None)
    if columns is None:
        raise _no_header(lines, context)
    table = Table([_row(line, separator, k, context) for k, line in enumerate(lines, start=1)])
    _require_width(table, columns.row, separator, context)
    found = find_columns(table, context)
    if found is None:
        raise _no_header(lines, context)
    return found


def _header(lines: list[str], context: ErrorContext) -> tuple[str | None, Columns] | None:
    """Return the separator with which one of the first lines is a header, and its columns; None without a header."""
    for separator in _SEPARATORS:
        found = find_columns(Table([split_cells(line, separator) for line in lines]), context)
        if found is not None and (separator is not None or found[1].geometry is None):
            return separator, found[1]
    return None


def _no_header(lines: list[str], context: ErrorContext) -> FileFormatError:
    for separator in _SEPARATORS:
        for row in (split_cells(line.lstrip("#% "), separator) for line in lines[:_HEAD]):
            said = ", ".join(row)[:80]
            if (
                separator is not None
                and len(row) > 1
                and any(plain_head(c).startswith("geometr") for c in row)
            ):
                return context.error(
                    f"a header without values ({said}), expected wavelengths or L*, a*, b* beside the geometry",
                    remedy=NEW_HEADER,
                )
            if (unknown := not_understood(row)) is not None:
                fault = f"the heading {unknown} is not understood" if unknown else "one elevation"
                return context.error(
                    f"a header {said}: {fault}, expected both elevations, such as theta_i, theta_o",
                    remedy=NEW_HEADER,
                )
    return context.error("no header of a table of readings found", remedy=NEW_HEADER)


def _row(line: str, separator: str | None, number_of_line: int, context: ErrorContext) -> list[str]:
    """Split a line into cells; a quote ends on its own line.

    Trailing empty cells, which some programs write, are dropped.
    """
    if line.count('"') % 2:
        raise context.error(
            "a quote that does not end, expected cells of a table",
            f"row {number_of_line}",
            remedy=CORRECT_CELL,
        )
    row = split_cells(line, separator)
    while separator != "," and row and not row[-1]:
        row.pop()
    return row


def _require_width(table: Table, header: int, separator: str | None, context: ErrorContext) -> None:
    """Raise FileFormatError if a row has more numbers than the header, as with decimal commas."""
    width = len(table.rows[header])
    for k, row in enumerate(table.rows[header + 1 :], start=header + 1):
        if any(number(str(cell)) is not None for cell in row[width:]):
            remedy = ": decimal commas need quotes, or another separator" if separator == "," else ""
            raise context.error(f"{len(row)} cells below a header of {width}{remedy}", table.where(k))


def write(path: Path, readings: Readings) -> None:
    """Write directions in degrees and f in 1/sr, one row per pair; unmeasured values are empty cells.

    Weights and scatter are columns if they differ between readings; other properties are comments.
    """
    out = io.StringIO()
    out.write(f"# format: {_FORMAT}\n")
    out.write(f"# name: {in_one_line(readings.name)}\n# instrument: {in_one_line(readings.instrument)}\n")
    out.writelines(f"# gloss {angle:g}: {units:.9g}\n" for angle, units in readings.gloss.items())
    if readings.repeatability != REPEATABILITY:
        out.write(f"# repeatability: {readings.repeatability:.9g}\n")
    if readings.colour_error:
        out.write(f"# colour error: {readings.colour_error:.9g}\n")
    if readings.viewing != DAYLIGHT:
        out.write(f"# viewing: {readings.viewing}\n")
    out.write("# BRDF in 1/sr; angles in degrees about the normal\n")
    extra = {
        head: column
        for head, column, usual in (
            (WEIGHT_HEAD, readings.weights, 1.0),
            (SCATTER_HEAD, readings.scatter, 0.0),
        )
        if np.any(column != usual)
    }
    writer = csv.writer(out, lineterminator="\n")
    angles = ["theta_i (deg)", "phi_i (deg)", "theta_o (deg)", "phi_o (deg)"]
    writer.writerow([*angles, *band_heads(readings), *extra])
    table = np.hstack([readings.values, *(column[:, None] for column in extra.values())])
    for angle, row in zip(angles_deg(readings), table, strict=True):
        writer.writerow([*(f"{a:.9g}" for a in angle), *("" if np.isnan(v) else f"{v:.9g}" for v in row)])
    disk.write_text(path, out.getvalue())


def angles_deg(readings: Readings) -> Array:
    """Return theta_i, phi_i, theta_o, phi_o in degrees of every pair, azimuths from 0 to 360, shape (P, 4)."""
    columns = []
    for w in (readings.wi, readings.wo):
        theta, phi = to_spherical(w)
        columns += [np.rad2deg(theta), np.rad2deg(phi) % 360.0]
    return np.stack(columns, axis=1)


def band_heads(readings: Readings) -> list[str]:
    """Return the headings of the bands: `465nm`, or `R`, `G`, `B`."""
    nm = readings.bands.wavelengths_nm
    return ["R", "G", "B"] if nm is None else [f"{w:.9g}nm" for w in nm]

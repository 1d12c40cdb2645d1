"""CSV files of readings: a row per geometry of a spectrophotometer, or directions in degrees beside f in 1/sr.

Separators are `;`, tab or comma, or blanks below a header of directions. Unless commas separate, decimal commas are
numbers. Lines that begin with # are comments; `# format:`, `# name:`, `# instrument:` and `# gloss 60:` are the
package's own.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from manifold import disk
from manifold.directions import to_spherical
from manifold.formats.column_heads import gloss_angle, plain_head
from manifold.formats.readings import Readings
from manifold.formats.tables import (
    HEADERS,
    Columns,
    Table,
    find_columns,
    names_directions,
    read_table,
    resembles_header,
    text_of,
)
from manifold.formats.text import ErrorContext, decode, number, read_bytes
from manifold.names import in_one_line
from manifold.records import Array

_REMEDY = f"give the table a header such as {HEADERS}"
_SEPARATORS = (";", "\t", ",", None)  # None: blanks
_FORMAT = "manifold readings 1"  # a version that is read, whatever has none
_MOST_COMMENTS = 40  # lines at the top


def sniff(head: bytes) -> bool:
    """Whether a file's beginning has a line that resembles the header of a table of readings."""
    text = decode(head)
    if "\0" in text:
        return False
    for line in [line.lstrip("#% ") for line in text.splitlines() if line.strip()][:60]:
        if any(resembles_header(_cells(line, s)) for s in _SEPARATORS if s) or names_directions(line.split()):
            return True
    return False


def read(path: Path) -> list[Readings]:
    """Readings of every sample of a CSV file."""
    context = ErrorContext(path, _REMEDY)
    lines = [_uncommented(line) for line in decode(read_bytes(path)).split("\n")]
    own = dict(_own_comments(lines))
    if own.get("format", _FORMAT) != _FORMAT and own["format"].startswith("manifold readings"):
        version = f"'{own['format']}', expected '{_FORMAT}'"
        raise context.error(version, remedy="read it with a newer version of manifold")
    table, columns = _table(["" if line.startswith("#") else line for line in lines], context)
    comments = tuple(line for line in lines if line.startswith("#"))
    columns = replace(columns, comments=comments, kind="f" if own.get("format") == _FORMAT else None)
    is_spectro = columns.geometry is not None
    instrument = own.get("instrument") or f"{'spectrophotometer' if is_spectro else 'goniometer'} (CSV)"
    found = read_table(table, columns, context, own.get("name") or path.stem, instrument)
    if len(found) > 1:
        return found
    units = {angle: number(text) for key, text in own.items() if (angle := gloss_angle(key)) is not None}
    gloss = {angle: value for angle, value in units.items() if value is not None}  # not `gloss: matt`
    return [replace(found[0], gloss={**gloss, **found[0].gloss})]


def _own_comments(lines: list[str]) -> Iterator[tuple[str, str]]:
    """Keys in lower case and values of comments such as `# name: satin`."""
    for line in lines[:_MOST_COMMENTS]:
        key, _, value = line.lstrip("# ").partition(":")
        if line.startswith("#") and value.strip():
            yield key.strip().lower(), value.strip()


def _uncommented(line: str) -> str:
    """The line; without its mark if it is a comment that is the header of a table of directions."""
    bare = line.lstrip("#% ")
    is_header = line.startswith(("#", "%")) and any(names_directions(_cells(bare, s)) for s in _SEPARATORS)
    return bare if is_header else line


def _table(lines: list[str], context: ErrorContext) -> tuple[Table, Columns]:
    """The cells, by the first separator with which a line is a header, and its columns."""
    refusal = context.error("no header of a table of readings found")
    for separator in _SEPARATORS:
        head = Table([_cells(line, separator) for line in lines[:70]])
        bare = next(
            (row for row in head.rows if any(plain_head(text_of(c)).startswith("geometr") for c in row)), None
        )
        if bare is not None and len(bare) > 1:
            shown = ", ".join(str(cell) for cell in bare)[:80]
            refusal = context.error(
                f"a header without values ({shown}), expected wavelengths or L*, a*, b* beside the geometry"
            )
        found = find_columns(head, context)
        if found is not None and (separator is not None or found[1].geometry is None):
            table = Table([_row(line, separator, k, context) for k, line in enumerate(lines, start=1)])
            _require_width(table, found[1].row, separator, context)
            return find_columns(table, context) or found
    raise refusal


def _cells(line: str, separator: str | None) -> list[str]:
    """Cells of a line, quotes taken off where they are whole."""
    if separator is None:
        return line.split()
    return [cell.strip() for cell in next(csv.reader([line], delimiter=separator), [])]


def _row(line: str, separator: str | None, number_of_line: int, context: ErrorContext) -> list[str]:
    """Cells of a line; a quote ends on its own line. Trailing empty cells, which programs leave, are left out."""
    if separator is None:
        return line.split()
    try:
        row = next(csv.reader([line], delimiter=separator, strict=True), [])
    except csv.Error as error:
        raise context.error(f"not cells of a table ({error})", f"row {number_of_line}") from None
    while separator != "," and row and not row[-1].strip():
        row.pop()
    return [cell.strip() for cell in row]


def _require_width(table: Table, header: int, separator: str | None, context: ErrorContext) -> None:
    """Raise FileFormatError where a row has numbers beyond the header: decimal commas that are taken as separators."""
    width = len(table.rows[header])
    for k, row in enumerate(table.rows[header + 1 :], start=header + 1):
        if any(number(str(cell)) is not None for cell in row[width:]):
            remedy = ": decimal commas need quotes, or another separator" if separator == "," else ""
            raise context.error(f"{len(row)} cells below a header of {width}{remedy}", table.where(k))


def write(path: Path, readings: Readings) -> None:
    """Directions in degrees and f in 1/sr, one row per pair; empty cells are not measured."""
    out = io.StringIO()
    out.write(f"# format: {_FORMAT}\n")
    out.write(f"# name: {in_one_line(readings.name)}\n# instrument: {in_one_line(readings.instrument)}\n")
    out.writelines(f"# gloss {angle:g}: {units:.9g}\n" for angle, units in readings.gloss.items())
    out.write("# BRDF in 1/sr; angles in degrees about the normal\n")
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(["theta_i (deg)", "phi_i (deg)", "theta_o (deg)", "phi_o (deg)", *band_heads(readings)])
    for angles, row in zip(angles_deg(readings), readings.values, strict=True):
        writer.writerow([*(f"{a:.9g}" for a in angles), *("" if np.isnan(v) else f"{v:.9g}" for v in row)])
    disk.write_text(path, out.getvalue())


def angles_deg(readings: Readings) -> Array:
    """theta_i, phi_i, theta_o, phi_o in degrees of every pair, azimuths from 0 to 360, shape (P, 4)."""
    columns = []
    for w in (readings.wi, readings.wo):
        theta, phi = to_spherical(w)
        columns += [np.rad2deg(theta), np.rad2deg(phi) % 360.0]
    return np.stack(columns, axis=1)


def band_heads(readings: Readings) -> list[str]:
    """`465nm` or `R`, `G`, `B`."""
    nm = readings.bands.wavelengths_nm
    return ["R", "G", "B"] if nm is None else [f"{w:.9g}nm" for w in nm]

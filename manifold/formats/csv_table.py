"""CSV files of readings: the table of a spectrophotometer's workbook, or directions in degrees beside f in 1/sr.

Separators are `;`, tab, `|` or comma, or blanks below a head that names directions. Unless commas separate, decimal
commas are numbers.
"""

from __future__ import annotations

import csv
import io
import re
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from manifold.directions import to_spherical
from manifold.formats.direction_table import names_directions, read_directions
from manifold.formats.geometry_names import can_be_geometry, is_geometry
from manifold.formats.readings import Readings
from manifold.formats.spectro_table import read_table
from manifold.formats.table_cells import HEADER_ROWS, gloss_angle, parse_wavelength, plain_table
from manifold.formats.table_layouts import names_both
from manifold.formats.text import LARGEST_TEXT, Place, decode, number, read_bytes
from manifold.records import Array
from manifold.system import atomic
from manifold.system.names import in_one_line

_REMEDY = "export the table again with columns Geometry, 400, 410, ..."
_HEADS = 3  # of wavelengths, or of geometries beside them, make a line the head of a table
_TEXTURE = ("graininess", "sparkle", "coarseness", "diffuse")


def sniff(head: bytes) -> bool:
    """Whether a file's beginning is a table of readings."""
    text = decode(head)
    if "\0" in text:
        return False
    rows_of_both, titles = 0, 0
    for line in [line for line in text.splitlines() if line.strip()][:60]:
        words = line.lower()
        separator = _separator(line)
        titles += is_geometry(line.strip(' ";,|\t'))
        if names_directions(_cells(_uncommented(line))) or _names_wavelength(line):
            return True
        if separator is None:
            continue
        if "geometr" in words:
            return True
        cells = [cell.strip(' "') for cell in words.split(separator)]
        if _is_header(cells) or (sum(c.isdigit() for c in line) > 20 and "as" in line):
            return True
        rows_of_both += names_both(cells[0]) or any(
            can_be_geometry(first) and parse_wavelength(second) is not None
            for first, second in pairwise(cells[:3])
        )
    return rows_of_both >= _HEADS or titles >= 2


def _is_header(cells: list[str]) -> bool:
    """Whether cells are wavelengths, both geometries and wavelengths, geometries beside the word, or both words."""
    has_angle, has_nm = (
        any(cell.startswith(words) for cell in cells)
        for words in (("angle", "aspecular"), ("wavelength", "lambda", "nm"))
    )
    return (has_angle and has_nm) or (
        sum(parse_wavelength(cell) is not None for cell in cells) >= _HEADS
        or sum(map(names_both, cells)) >= _HEADS
        or (cells[0].startswith(("nm", "wavelength")) and sum(map(can_be_geometry, cells)) >= _HEADS)
    )


def read(path: Path) -> list[Readings]:
    """Readings of every sample of a CSV file.

    Raises:
        FileFormatError: there is no header, or a cell is not what its column holds; the error names it.
        UsageError: the file cannot be read.
    """
    place = Place(path, _REMEDY)
    text = decode(read_bytes(path, LARGEST_TEXT))
    lines = [_uncommented(line) for line in text.splitlines()]
    rows = _rows(lines, place)
    _require_width(rows, place)
    texture = {
        line[1:].partition(":")[0].strip(): line.partition(":")[2].strip()
        for line in lines
        if line.startswith("#") and any(word in line.lower() for word in _TEXTURE)
    }
    name, instrument = path.stem, ""
    for line in lines[:40]:
        key, _, value = line.lstrip("# ").partition(":")
        if line.startswith("#") and value.strip():
            name = value.strip() if key.strip().lower() == "name" else name
            instrument = value.strip() if key.strip().lower() == "instrument" else instrument
    gloss = {
        angle: units
        for line in lines[:40]
        for key, _, value in [line.lstrip("# ").partition(":")]
        if line.startswith("#")
        and (angle := gloss_angle(key)) is not None
        and (units := number(value.strip())) is not None  # not `gloss: matt`
    }
    comments = [line.lstrip("# ") for line in lines if line.startswith("#") and not _names_sample(line)]
    table = plain_table(rows)
    found_readings = read_directions(table, place, name, instrument or "goniometer (CSV)", comments)
    found_readings = found_readings or read_table(table, place, name, instrument or "spectrophotometer (CSV)")
    if len(found_readings) == 1:
        (only,) = found_readings
        return [replace(only, texture=texture or only.texture, gloss={**gloss, **only.gloss})]
    return found_readings


def _uncommented(line: str) -> str:
    """The line; without its mark if it is a comment that is the head of a table of directions."""
    bare = line.lstrip("#% ")
    return bare if line.startswith(("#", "%")) and names_directions(_cells(bare)) else line


def _names_sample(line: str) -> bool:
    return line.lstrip("# ").lower().startswith(("name:", "instrument:"))


def _cells(line: str) -> list[str]:
    """Cells of a line by its own separator, blanks where there is no other."""
    separator = _separator(line)
    return line.split() if separator is None else line.split(separator)


def _rows(lines: list[str], place: Place) -> list[list[str]]:
    """Cells of all lines, none in comments."""
    plain = ["" if line.startswith("#") else line for line in lines]
    head = [line for line in plain[:HEADER_ROWS] if line.strip()]
    found = [s for line in head if (s := _separator(line)) is not None]
    found = found or [s for line in head for s in ";\t|," if s in line and _names_wavelength(line)]
    if not found and any(names_directions(line.split()) for line in head):
        return [line.split() for line in plain]
    if not found:
        raise place.error("no separated cells found, expected a table")
    separator = max(set(found), key=found.count)
    try:
        table = [
            [cell.strip() for cell in row]
            for row in csv.reader(io.StringIO("\n".join(plain)), delimiter=separator)
        ]
    except csv.Error as error:
        raise place.error(f"not a table ({error})") from None
    return [_repaired(row, separator) for row in table]


def _names_wavelength(line: str) -> bool:
    """Whether a line is the head of columns of which the first holds wavelengths."""
    return re.match(r'[ "]*(wave ?length|lambda|nm)[^;,|\t]{0,12}[;,|\t]', line, re.IGNORECASE) is not None


def write(path: Path, readings: Readings) -> None:
    """Directions in degrees and f in 1/sr, one row per pair; empty cells are not measured."""
    out = io.StringIO()
    out.write(f"# name: {in_one_line(readings.name)}\n# instrument: {in_one_line(readings.instrument)}\n")
    out.writelines(f"# gloss {angle:g}: {units:.9g}\n" for angle, units in readings.gloss.items())
    out.write("# BRDF in 1/sr; angles in degrees about the normal\n")
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(["theta_i (deg)", "phi_i (deg)", "theta_o (deg)", "phi_o (deg)", *band_heads(readings)])
    for angles, row in zip(angles_deg(readings), readings.values, strict=True):
        writer.writerow([*(f"{a:.9g}" for a in angles), *("" if np.isnan(v) else f"{v:.9g}" for v in row)])
    atomic.write_text(path, out.getvalue())


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


def _separator(line: str) -> str | None:
    counts = {s: line.count(s) for s in (";", "\t", "|", ",")}
    for separator in (";", "\t", "|"):
        if counts[separator] >= 2:
            return separator
    return "," if counts[","] >= 2 else None


def _repaired(row: list[str], separator: str) -> list[str]:
    """Cells without trailing empty ones, which programs leave behind."""
    while len(row) > 1 and not row[-1] and separator != ",":
        row = row[:-1]
    return row


def _require_width(rows: list[list[str]], place: Place) -> None:
    """Raise FileFormatError where a row has numbers beyond the end of the header.

    Decimal commas that are not told from separators make such rows.
    """
    header = next(
        (k for k, row in enumerate(rows[:HEADER_ROWS]) if row and _is_header([c.lower() for c in row])), None
    )
    if header is None:
        return
    width = len(rows[header])
    for k, row in enumerate(rows[header + 1 :], start=header + 2):
        if any(number(cell) is not None for cell in row[width:]):
            raise place.error(
                f"{len(row)} cells below a header of {width}: decimal commas need quotes, or another separator",
                f"row {k}",
            )

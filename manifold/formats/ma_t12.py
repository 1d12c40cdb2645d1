"""Workbooks of multi-angle spectrophotometers such as the X-Rite MA-T12: `.xlsx`, read and written by openpyxl.

Sheets `Color Data`, `Texture Data`, `Spectral Data`, `Texture Images`. `Spectral Data` has titles above a header
`Name`, `Date/Time`, `Geometry`, `400` ... `700`, then a row per geometry. Values are reflectance factors.
"""

from __future__ import annotations

import io
import warnings
import zipfile
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from manifold.errors import FileFormatError
from manifold.formats.direction_table import read_directions
from manifold.formats.geometry_names import can_be_geometry
from manifold.formats.readings import MA_T12_NAMES, Readings
from manifold.formats.sheet_images import sheet_images
from manifold.formats.spectro_table import TAKEN_AS_FACTORS, TAKEN_AS_PERCENT, Header, find_header, read_rows
from manifold.formats.table_cells import Cell, Table, plain_table
from manifold.formats.table_layouts import with_geometries
from manifold.formats.text import Place, read_bytes
from manifold.system import atomic

_REMEDY = "export the workbook again from the spectrophotometer's program"
_LARGEST_FILE = 200_000_000  # bytes; flake images make a real workbook a few megabytes
_LARGEST_SHEETS = 12_000_000  # bytes unpacked: 500 samples in one workbook
_MOST_PARTS = 5000
_MOST_ROWS, _MOST_CELLS = 50_000, 2_000_000  # openpyxl makes all cells up to the last of a row


def sniff(head: bytes) -> bool:
    """Whether a file may be a workbook: a ZIP archive; its parts are looked at when it is read."""
    return head.startswith(b"PK\x03\x04")


def read(path: Path) -> list[Readings]:
    """Readings and texture of every sample of a workbook.

    Raises:
        FileFormatError: it is another archive, damaged, unpacks to more than any workbook does, or a cell is wrong.
        UsageError: the file cannot be read.
    """
    place = Place(path, _REMEDY)
    data = read_bytes(path, _LARGEST_FILE)
    _check_archive(data, place)
    sheets = _sheets(data, place)
    instrument = _instrument(sheets)
    measured = [
        one
        for title in sheets
        for one in read_directions(plain_table(sheets[title], title), place, path.stem, instrument)
    ]
    if measured:
        return measured
    found = _tables(sheets, place)
    several = len(found) > 1

    readings = {
        title: read_rows(*table, place, title if several else path.stem, instrument)
        for title, table in found.items()
    }
    if any(TAKEN_AS_PERCENT in one.notes for of in readings.values() for one in of):
        readings = {title: [_as_percent(one) for one in of] for title, of in readings.items()}
    texture = _texture(sheets, data)
    return [
        replace(one, texture=texture.get(one.name, texture.get("", {}))) for one in _named_apart(readings)
    ]


def _as_percent(readings: Readings) -> Readings:
    """The readings in the unit of another sheet, which is percent, where their own sheet gave none."""
    if TAKEN_AS_FACTORS not in readings.notes:
        return readings
    notes = tuple(TAKEN_AS_PERCENT if note == TAKEN_AS_FACTORS else note for note in readings.notes)
    return replace(readings, values=readings.values / 100.0, notes=notes)


def _tables(sheets: Mapping[str, list[list[Cell]]], place: Place) -> dict[str, tuple[Table, Header]]:
    """The sheets that hold reflectance, by title: those called spectral, else all; or one of geometries' sheets.

    Raises:
        FileFormatError: there is none.
    """
    titles = [title for title in sheets if "spectral" in title.lower()] or list(sheets)
    found = {}
    for title in titles:
        table = find_header(plain_table(sheets[title], title), place)
        if table is not None:
            found[title] = table
    spectra = {title: table for title, table in found.items() if not table[1].is_rgb}
    if found:
        return spectra or found
    geometries = [(plain_table(sheets[t], t), t) for t in sheets if can_be_geometry(t)]
    joined = with_geometries(geometries, place)
    table = find_header(joined, place) if joined is not None else None
    if table is not None:
        return {geometries[0][1]: table}
    listed = ", ".join(list(sheets)[:6])
    raise place.error(
        f"found a workbook with sheets {listed}, expected one called 'Spectral Data', or "
        "columns of wavelengths beside one of geometries such as 45as15, or a sheet per geometry"
    )


def _named_apart(readings: Mapping[str, list[Readings]]) -> list[Readings]:
    """The samples of all sheets; where two have the same name, the title of the sheet stands before it."""
    names = [one.name for found in readings.values() for one in found]
    return [
        one if names.count(one.name) == 1 else replace(one, name=f"{title}: {one.name}")
        for title, found in readings.items()
        for one in found
    ]


def _check_archive(data: bytes, place: Place) -> None:
    """Refuse what is no workbook, and what unpacks to more than one."""
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            parts = archive.infolist()
    except (zipfile.BadZipFile, ValueError, OSError, NotImplementedError) as error:
        raise place.error(f"not a readable workbook ({error})") from None
    names = {part.filename for part in parts}
    if not any(name.startswith("xl/") for name in names):
        kinds = (
            ("word/", "a Word document"),
            ("ppt/", "a presentation"),
            ("mimetype", "an OpenDocument file"),
        )
        kind = next((k for prefix, k in kinds if any(n.startswith(prefix) for n in names)), "a ZIP archive")
        raise place.error(f"found {kind}, expected an .xlsx workbook of a spectrophotometer")
    unpacked = sum(part.file_size for part in parts if not part.filename.startswith("xl/media/"))
    if len(parts) > _MOST_PARTS or unpacked > _LARGEST_SHEETS:
        raise place.error(
            f"its {len(parts)} parts unpack to {unpacked / 1e6:.0f} MB, expected a spectrophotometer's workbook of "
            f"at most {_LARGEST_SHEETS / 1e6:.0f} MB"
        )


def _sheets(data: bytes, place: Place) -> dict[str, list[list[Cell]]]:
    """Cells of every sheet by its title."""
    import openpyxl

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            book = openpyxl.load_workbook(io.BytesIO(data), read_only=True, data_only=True)
            sheets = {}
            for sheet in book.worksheets:
                sheet.reset_dimensions()  # the size declared in the file is not trusted
                rows: list[list[Cell]] = []
                cells = 0
                for row in sheet.iter_rows(values_only=True, max_row=_MOST_ROWS):
                    cells += len(row)
                    if cells > _MOST_CELLS:
                        raise place.error(f"sheet '{sheet.title}' has more than {_MOST_CELLS} cells")
                    rows.append([cell if isinstance(cell, int | float | None) else str(cell) for cell in row])
                sheets[str(sheet.title)] = rows
            book.close()
    except (MemoryError, FileFormatError):
        raise
    except Exception as error:  # openpyxl raises whatever its parsers do
        reason = " ".join(str(error).split())[:80] or type(error).__name__
        raise place.error(f"not a readable workbook ({reason})") from None
    if not sheets:
        raise place.error("a workbook without sheets, expected 'Spectral Data'")
    return sheets


def _pick(sheets: Mapping[str, object], word: str) -> str | None:
    """The title of the first sheet whose title holds a word, case aside."""
    return next((title for title in sheets if word in title.lower()), None)


def _instrument(sheets: Mapping[str, list[list[Cell]]]) -> str:
    """What the titles say of the instrument."""
    for rows in sheets.values():
        for row in rows[:8]:
            for cell in row:
                text = str(cell or "")
                if any(word in text.lower() for word in ("ma-t12", "mat12", "ma-t6", "ma9", "byk", "x-rite")):
                    return text.strip()[:60]
    return "multi-angle spectrophotometer (workbook)"


def _texture(sheets: Mapping[str, list[list[Cell]]], data: bytes) -> dict[str, dict[str, Any]]:
    """Texture rows and flake images by sample; what names no sample is under the empty name."""
    texture: dict[str, dict[str, Any]] = {}
    title = _pick(sheets, "texture data")
    for name, entry in _texture_rows(sheets[title]) if title else []:
        texture.setdefault(name, {}).setdefault("values", []).append(entry)
    title = _pick(sheets, "texture image")
    if title:
        images = sheet_images(data, title, sheets[title])
        for entry in texture.values() if texture and images else ():
            entry["images"] = images
        if images and not texture:
            texture[""] = {"images": images}
    if len(texture) == 1:
        texture[""] = next(iter(texture.values()))
    return texture


def _texture_rows(rows: list[list[Cell]]) -> list[tuple[str, dict[str, Any]]]:
    """Sample and columns of every row below the header, which is the first row of at least three texts."""
    for index, row in enumerate(rows[:20]):
        heads = ["" if cell is None else str(cell).strip() for cell in row]
        if sum(bool(head) for head in heads) >= 3:
            found = []
            for below in rows[index + 1 :]:
                entry = {h: c for h, c in zip(heads, below, strict=False) if h and c is not None}
                if entry:
                    found.append((str(entry.get("Name", entry.get("name", ""))), entry))
            return found
    return []


def write(path: Path, readings: Readings) -> None:
    """A workbook with the layout of an MA-T12's; values are reflectance factors.

    Args:
        path: where to.
        readings: at the 12 geometries of `geometry_ma_t12`, in their order; texture as `read` gives it.
    """
    import openpyxl
    from openpyxl.drawing.image import Image

    book = openpyxl.Workbook()
    colour = book.active
    assert colour is not None
    colour.title = "Color Data"
    colour.append([readings.instrument])
    spectral, texture = book.create_sheet("Spectral Data"), book.create_sheet("Texture Data")
    images = book.create_sheet("Texture Images")
    spectral.append([readings.instrument])
    spectral.append([])
    nm = readings.bands.wavelengths_nm or ()
    spectral.append(["Name", "Date/Time", "Geometry", *(f"{w:g}" for w in nm)])
    for geometry, row in zip(MA_T12_NAMES, np.pi * readings.values, strict=True):
        cells = [None if np.isnan(v) else float(v) for v in row]
        spectral.append([readings.name, "2026-01-01 12:00:00", geometry, *cells])
    texture.append([readings.instrument])
    texture.append([])
    entries = readings.texture.get("values", [])
    if entries:
        texture.append(list(entries[0]))
        for entry in entries:
            texture.append(list(entry.values()))
    images.append(["Geometry", "Image"])
    for row_number, (caption, picture) in enumerate(readings.texture.get("images", {}).items(), start=2):
        images.cell(row_number, 1, caption)
        images.add_image(Image(io.BytesIO(picture)), f"B{row_number}")
    with atomic.replacing(path) as partial:
        book.save(partial)

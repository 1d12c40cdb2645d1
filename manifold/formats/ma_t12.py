"""Workbooks (`.xlsx`) of multi-angle spectrophotometers such as the X-Rite MA-T12.

The sheets are `Color Data`, `Texture Data`, `Spectral Data` and `Texture Images`. `Spectral Data` has titles above a
header `Name`, `Date/Time`, `Geometry`, `400` ... `700`, then a row per geometry. Values are reflectance factors.
"""

from __future__ import annotations

import io
import warnings
import zipfile
import zlib
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import compress
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from manifold.core import disk
from manifold.core.errors import FileFormatError
from manifold.formats.column_heads import lab_head, name_columns, sample_names, viewing_in
from manifold.formats.foreign import name_archive
from manifold.formats.readings import DAYLIGHT, MA_T12_NAMES, Readings, Viewing
from manifold.formats.tables import (
    HEADERS,
    Cell,
    Columns,
    Table,
    find_columns,
    in_one_unit,
    name_cells,
    read_table,
    text_of,
)
from manifold.formats.text import ErrorContext, read_bytes
from manifold.formats.values import TAKEN_AS_FACTORS
from manifold.formats.workbook_pictures import SheetPicture, add_picture, pictures_in, read_part

T = TypeVar("T")

_REMEDY = "export the workbook again from the spectrophotometer's program"
_UNNAMED = "multi-angle spectrophotometer (workbook)"
_LARGEST_FILE = 200_000_000  # bytes; flake images make a real workbook a few megabytes
_LARGEST_SHEETS = 12_000_000  # bytes unpacked: 500 samples in one workbook
_MOST_PARTS = 5000
_HEAD = 64  # bytes by which a part is XML
_BEFORE_XML = b"\xef\xbb\xbf \t\r\n"
_MOST_ROWS = 50_000  # rows of a sheet
_MOST_CELLS = 2_000_000  # cells of all sheets: openpyxl makes all up to the last of a row


def sniff(head: bytes) -> bool:
    """Return whether a file is a ZIP archive, as workbooks are; `read` checks its parts."""
    return head.startswith(b"PK\x03\x04")


def read(path: Path) -> list[Readings]:
    """Read the readings and texture of every sample of a workbook."""
    context = ErrorContext(path, _REMEDY)
    data = read_bytes(path, _LARGEST_FILE)
    workbook = _xml_parts(data, context)
    sheets = _sheets(workbook, context)
    instrument = _instrument(sheets)
    found = _tables(sheets, context)
    seen_as = _viewing(sheets)
    readings = [
        (
            table.sheet,
            read_table(
                table,
                columns.seen_under(_titles(sheets)),
                context,
                str(table.sheet) if len(found) > 1 else path.stem,
                instrument,
            ),
        )
        for table, columns in found
    ]
    samples = [_in_its_unit(one, sheets, instrument) for one in in_one_unit(_named_apart(readings))]
    texture, notes = _texture(sheets, data, workbook, [sample.name for sample in samples])
    return [
        replace(
            sample,
            texture=texture[sample.name],
            viewing=sample.viewing if sample.bands.is_rgb else seen_as,
            notes=sample.notes + notes,
        )
        for sample in samples
    ]


def _in_its_unit(readings: Readings, sheets: Mapping[str, list[list[Cell]]], instrument: str) -> Readings:
    """Return readings without the note on factors as the assumed unit, if the layout is that of a known instrument."""
    if instrument == _UNNAMED and not any(_titled(sheets, "spectral data")):
        return readings
    return replace(readings, notes=tuple(note for note in readings.notes if note != TAKEN_AS_FACTORS))


def _tables(sheets: Mapping[str, list[list[Cell]]], context: ErrorContext) -> list[tuple[Table, Columns]]:
    """Return the sheets that hold readings: those called spectral, else all."""
    titles = [title for title in sheets if "spectral" in title.lower()] or list(sheets)
    tables = [Table(sheets[title], title) for title in titles]
    found = [one for table in tables if (one := find_columns(table, context)) is not None]
    if not found:
        raise context.error(
            f"found a workbook with sheets {', '.join(list(sheets)[:6])}, expected one called 'Spectral Data' with a "
            f"header such as {HEADERS}"
        )
    return found


def _named_apart(found: Sequence[tuple[str | None, list[Readings]]]) -> list[Readings]:
    """Return the samples of all sheets; if two have the same name, the title of the sheet precedes it."""
    names = Counter(one.name for _, own in found for one in own)
    return [
        one if names[one.name] == 1 else replace(one, name=f"{title}: {one.name}")
        for title, own in found
        for one in own
    ]


def _xml_parts(data: bytes, context: ErrorContext) -> io.BytesIO:
    """Repack a workbook without parts other than XML; refuse other files and those that unpack to too much.

    The first bytes of a part decide whether it is XML, not its name, because openpyxl opens pictures of chart
    sheets.
    """
    packed = io.BytesIO()
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive, zipfile.ZipFile(packed, "w") as made:
            parts = archive.infolist()
            if not any(part.filename.startswith("xl/") for part in parts):
                found = name_archive(part.filename for part in parts)
                raise context.error(
                    f"found {found}, expected an .xlsx workbook of a spectrophotometer",
                    remedy="name another file",
                )
            if len(parts) > _MOST_PARTS:
                raise context.error(
                    f"the archive has {len(parts)} parts, expected at most {_MOST_PARTS} in an instrument's workbook"
                )
            is_xml = [read_part(archive, part, _HEAD).lstrip(_BEFORE_XML).startswith(b"<") for part in parts]
            unpacked = sum(part.file_size for part in compress(parts, is_xml))
            if unpacked > _LARGEST_SHEETS:
                raise context.error(
                    f"its {sum(is_xml)} parts of XML unpack to {unpacked / 1e6:.0f} MB, expected a "
                    f"spectrophotometer's workbook of at most {_LARGEST_SHEETS / 1e6:.0f} MB"
                )
            for part, is_kept in zip(parts, is_xml, strict=True):
                made.writestr(part.filename, read_part(archive, part) if is_kept else b"")
    except FileFormatError:  # which is a ValueError
        raise
    except (zipfile.BadZipFile, zlib.error, ValueError, OSError, EOFError, RuntimeError) as error:
        raise context.error(f"not a readable workbook ({' '.join(str(error).split())[:80]})") from None
    return packed


def _sheets(workbook: io.BytesIO, context: ErrorContext) -> dict[str, list[list[Cell]]]:
    """Return the cells of every sheet by its title."""
    import openpyxl

    sheets: dict[str, list[list[Cell]]] = {}
    cells = 0
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            book = openpyxl.load_workbook(workbook, read_only=True, data_only=True)
            for sheet in book.worksheets:
                sheet.reset_dimensions()  # the size declared in the file is not trusted
                rows = sheets.setdefault(str(sheet.title), [])
                for row in sheet.iter_rows(values_only=True):
                    cells += len(row)
                    if cells > _MOST_CELLS or len(rows) >= _MOST_ROWS:
                        raise context.error(
                            f"sheet '{sheet.title}' has more than {_MOST_ROWS} rows, or {_MOST_CELLS} cells in total"
                        )
                    last = next((k for k in range(len(row), 0, -1) if row[k - 1] is not None), 0)
                    rows.append([c if isinstance(c, int | float | None) else str(c) for c in row[:last]])
            book.close()
    except (MemoryError, FileFormatError):
        raise
    except Exception as error:  # openpyxl raises whatever its parsers do
        reason = " ".join(str(error).split())[:80] or type(error).__name__
        raise context.error(f"not a readable workbook ({reason})") from None
    return sheets


def _titled(sheets: Mapping[str, list[list[Cell]]], words: str) -> Iterator[str]:
    """Yield the titles of the sheets whose titles hold these words, case aside."""
    return (title for title in sheets if words in title.lower())


def _instrument(sheets: Mapping[str, list[list[Cell]]]) -> str:
    """Return the instrument that the titles name."""
    for rows in sheets.values():
        for row in rows[:8]:
            for cell in row:
                text = str(cell or "")
                if any(word in text.lower() for word in ("ma-t12", "mat12", "ma-t6", "ma9", "byk", "x-rite")):
                    return text.strip()[:60]
    return _UNNAMED


def _titles(sheets: Mapping[str, list[list[Cell]]]) -> list[str]:
    """Return the texts at the top of all sheets: cells, then every row as one line."""
    rows = [[str(cell) for cell in row if cell is not None] for top in sheets.values() for row in top[:8]]
    return [cell for row in rows for cell in row] + [" ".join(row) for row in rows]


def _viewing(sheets: Mapping[str, list[list[Cell]]]) -> Viewing:
    """Return the light and observer of the workbook's own colours, which a title or its headings name."""
    for cell in _titles(sheets):
        lab = lab_head(cell)
        if found := viewing_in(cell) or (lab and lab.viewing):
            return found
    return DAYLIGHT


def _texture(
    sheets: Mapping[str, list[list[Cell]]], data: bytes, workbook: io.BytesIO, samples: Sequence[str]
) -> tuple[dict[str, dict[str, Any]], tuple[str, ...]]:
    """Return texture rows and pictures of every sample, and notes about those without a sample."""
    entries: dict[str, list[dict[str, Any]]] = {}
    images: dict[str, dict[str, bytes]] = {}
    unpacked: dict[str, bytes] = {}
    repeated: list[str] = []
    notes: list[str] = []
    for title in _titled(sheets, "texture data"):
        for name, entry in _texture_rows(sheets[title]):
            entries.setdefault(name, []).append(entry)
    for title in _titled(sheets, "texture image"):
        pictures: list[SheetPicture] = []
        try:
            pictures = pictures_in(data, workbook, title, unpacked)
        except Exception as error:  # openpyxl raises whatever its parsers do
            reason = " ".join(str(error).split())[:80] or type(error).__name__
            notes.append(f"the pictures of sheet '{title}' cannot be read ({reason}) and are left out")
        for picture in pictures:
            name, caption = _head_and_caption(sheets[title], picture)
            own = images.setdefault(name, {})
            if caption in own:
                repeated.append(f"{caption} of '{name}'")
            own.setdefault(caption, picture.content)
    values_of, unused_values = _by_sample(entries, samples)
    images_of, unused_images = _by_sample(images, samples)
    texture: dict[str, dict[str, Any]] = {name: {} for name in samples}
    for key, by_sample in (("values", values_of), ("images", images_of)):
        for name, content in by_sample.items():
            texture[name][key] = content
    notes += [
        f"{what} of {', '.join(repr(name) if name else 'no name' for name in unused)} left out: the workbook has no "
        "readings of that name"
        for what, unused in (("texture values", unused_values), ("pictures", unused_images))
        if unused
    ]
    if repeated:
        notes.append(f"several pictures {', '.join(dict.fromkeys(repeated))}: the first is used")
    return texture, tuple(notes)


def _by_sample(by_name: Mapping[str, T], samples: Sequence[str]) -> tuple[dict[str, T], list[str]]:
    """Return the data under the name of each sample, and the other names.

    A workbook of one specimen need not repeat its name: data under any single name belong to that specimen.
    """
    if len(samples) == 1 and len(by_name) == 1:
        return dict(zip(samples, by_name.values(), strict=True)), []
    return (
        {name: by_name[name] for name in samples if name in by_name},
        [name for name in by_name if name not in samples],
    )


def _texture_rows(rows: list[list[Cell]]) -> list[tuple[str, dict[str, Any]]]:
    """Sample and columns of every row below the header, which is the first row of at least three texts."""
    for index, row in enumerate(rows[:20]):
        heads = ["" if cell is None else str(cell).strip() for cell in row]
        if sum(bool(head) for head in heads) >= 3:
            names = name_columns(heads)
            cells = ("",) * len(names)
            found = []
            for k, below in enumerate(rows[index + 1 :], start=index + 1):
                entry = {h: c for h, c in zip(heads, below, strict=False) if h and c is not None}
                if entry:
                    cells = name_cells(Table(rows), k, names, cells)
                    found.append((cells, entry))
            by_cells = list(dict.fromkeys(own for own, _ in found))
            named = sample_names(dict(zip(names, own, strict=True)) for own in by_cells)
            of_cells = dict(zip(by_cells, named, strict=True))
            return [(of_cells[own], entry) for own, entry in found]
    return []


def _head_and_caption(rows: Sequence[Sequence[Cell]], picture: SheetPicture) -> tuple[str, str]:
    """Return the text above a picture in its column, which names the sample, and the first text of its row."""
    above = (cells[picture.column] for cells in rows[: picture.row][::-1] if picture.column < len(cells))
    head = next((text for cell in above if (text := text_of(cell))), "")
    caption = rows[picture.row][0] if picture.row < len(rows) and rows[picture.row] else None
    return head, text_of(caption) or f"row {picture.row + 1}"


def write(path: Path, readings: Readings) -> None:
    """Write a workbook in the layout of an MA-T12, with values as reflectance factors.

    Readings must be at the 12 geometries of `geometry_ma_t12`, in that order. Their texture has the form that
    `read` returns.
    """
    import openpyxl

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
    images.append([None, readings.name])
    for row_number, (caption, picture) in enumerate(readings.texture.get("images", {}).items(), start=2):
        images.cell(row_number, 1, caption)
        add_picture(images, f"B{row_number}", picture)
    with disk.replacing(path) as partial:
        book.save(partial)

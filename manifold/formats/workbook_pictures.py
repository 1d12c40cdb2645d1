"""Reads, decodes and writes pictures in the workbooks of instruments.

Parts are read as bytes, because openpyxl's own image loader passes any part of a workbook to Pillow, see
`manifold.core.picture_bytes`.
"""

from __future__ import annotations

import io
import re
import warnings
import zipfile
from typing import Any, NamedTuple

import numpy as np

from manifold.core import picture_bytes
from manifold.core.errors import FileFormatError
from manifold.core.records import Array
from manifold.formats.geometries import parse_geometry
from manifold.formats.readings import aspecular_pair

_MOST_BYTES = 200_000_000  # of the pictures of a workbook, unpacked
_MOST_PIXELS = 2_000_000  # of a picture; those of an MA-T12 have 172,800
_DIFFUSE = re.compile(r"r?_?(\d+)d", re.IGNORECASE)  # light from everywhere: `15d`


def read_part(archive: zipfile.ZipFile, part: zipfile.ZipInfo, most: int | None = None) -> bytes:
    """Read a part of a workbook, or its first bytes, and unpack no more than the archive's directory declares.

    Raises:
        zipfile.BadZipFile: the part has another size, or another compression than deflate.
    """
    if part.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):  # others unpack without a limit
        raise zipfile.BadZipFile(f"a part is packed by method {part.compress_type}, expected deflation")
    with archive.open(part) as stream:  # ZipFile.read unpacks everything before it looks at the size
        return stream.read(part.file_size if most is None else min(most, part.file_size))


class SheetPicture(NamedTuple):
    """A picture on a sheet: the cell of its upper left corner, counted from 0, and its bytes."""

    row: int
    column: int
    content: bytes


def pictures_in(
    data: bytes, workbook: io.BytesIO, sheet: str, unpacked: dict[str, bytes]
) -> list[SheetPicture]:
    """Return the pictures on a sheet of a workbook, as they are stored.

    Args:
        data: the workbook.
        workbook: the same workbook, with empty parts in place of parts that are not XML.
        sheet: title of the sheet.
        unpacked: pictures of the workbook by their parts; those of the sheet are added.

    Raises:
        Exception: openpyxl's exception for a damaged workbook.
    """
    import openpyxl
    from openpyxl.drawing.spreadsheet_drawing import SpreadsheetDrawing
    from openpyxl.packaging.relationship import get_dependents, get_rels_path
    from openpyxl.xml.functions import fromstring

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        relations = get_rels_path(openpyxl.load_workbook(workbook, read_only=True)[sheet]._worksheet_path)
    pictures = []
    with zipfile.ZipFile(workbook) as parts, zipfile.ZipFile(io.BytesIO(data)) as archive:
        if relations not in parts.namelist():
            return []
        drawings = [r.target for r in get_dependents(parts, relations) if r.Type.endswith("/drawing")]
        for drawing in drawings:
            targets = get_dependents(parts, get_rels_path(drawing))
            for blip in SpreadsheetDrawing.from_tree(fromstring(parts.read(drawing)))._blip_rels:
                part = archive.getinfo(targets.get(blip.embed).target)
                if part.filename not in unpacked:
                    if part.file_size + sum(map(len, unpacked.values())) > _MOST_BYTES:
                        raise FileFormatError(f"they unpack to more than {_MOST_BYTES / 1e6:g} MB")
                    unpacked[part.filename] = read_part(archive, part)
                corner = blip.anchor._from
                pictures.append(SheetPicture(corner.row, corner.col, unpacked[part.filename]))
    return pictures


def picture_values(content: bytes) -> Array:
    """Decode an instrument's picture, whose values are linear, to linear sRGB, shape (H, W, 3).

    Raises:
        FileFormatError: the picture is not a PNG or JPEG, too large, or damaged; the message does not name the file.
    """
    try:
        return picture_bytes.decode(content, most_pixels=_MOST_PIXELS) / 255.0
    except FileFormatError as error:
        raise FileFormatError(f"{error}; export the workbook again") from None


def add_picture(sheet: Any, cell: str, content: bytes) -> None:
    """Add a picture to a sheet of a workbook that openpyxl writes.

    Raises:
        FileFormatError: the content is not a PNG or JPEG.
    """
    from openpyxl.drawing.image import Image

    if picture_bytes.kind_of(content) is None:
        raise FileFormatError(f"the picture of cell {cell} is neither a PNG nor a JPEG; remove it")
    sheet.add_image(Image(io.BytesIO(content)), cell)


def picture_geometry(caption: str) -> tuple[float, float] | None:
    """Return the angles of camera and lamp in degrees that a caption names, or None.

    The lamp's angle is positive on the mirror side, and NaN for diffuse light.

    >>> picture_geometry("15as-45"), picture_geometry("15as80"), picture_geometry("15d")
    ((15.0, 60.0), (15.0, -65.0), (15.0, nan))
    """
    if (diffuse := _DIFFUSE.fullmatch(caption.strip())) is not None:
        return float(diffuse[1]), np.nan
    angles = parse_geometry(caption)
    return None if angles is None or angles[2] else (angles[0], angles[0] - angles[1])


def picture_directions(camera_deg: float, lamp_deg: float) -> tuple[Array, Array]:
    """Return wi (3,) and wo (3,) of a picture's geometry, as for the reading of the same name."""
    return aspecular_pair(camera_deg, camera_deg - lamp_deg)

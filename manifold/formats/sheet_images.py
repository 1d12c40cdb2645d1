"""Images in a sheet of a workbook, by the caption in the cell to their left."""

from __future__ import annotations

import io
import posixpath
import zipfile
from collections.abc import Sequence
from xml.etree import ElementTree

_LARGEST_IMAGE = 20_000_000  # bytes
_MOST_IMAGES = 200
_RELATION = "{http://schemas.openxmlformats.org/package/2006/relationships}Relationship"
_DRAWN = "{http://schemas.openxmlformats.org/drawingml/2006/spreadsheetDrawing}"
_EMBED = "{http://schemas.openxmlformats.org/officeDocument/2006/relationships}embed"
_ID = "{http://schemas.openxmlformats.org/officeDocument/2006/relationships}id"
_BLIP = "{http://schemas.openxmlformats.org/drawingml/2006/main}blip"


def sheet_images(data: bytes, title: str, rows: Sequence[Sequence[object]]) -> dict[str, bytes]:
    """Pictures of a sheet as they are stored (PNG, JPEG), by caption; none where anything is amiss.

    Args:
        data: the workbook.
        title: of the sheet.
        rows: its cells, for the captions.
    """
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            return _read(archive, title, rows)
    except (KeyError, ValueError, zipfile.BadZipFile, ElementTree.ParseError, OSError, NotImplementedError):
        return {}  # pictures are an extra: what is measured stands in other sheets


def _read(archive: zipfile.ZipFile, title: str, rows: Sequence[Sequence[object]]) -> dict[str, bytes]:
    book = _relations(archive, "xl/workbook.xml")
    sheets = ElementTree.fromstring(archive.read("xl/workbook.xml")).iter()
    ids = {element.get("name"): element.get(_ID) for element in sheets if element.tag.endswith("}sheet")}
    sheet = book[str(ids[title])]
    drawings = [target for target in _relations(archive, sheet).values() if "drawing" in target]
    found: dict[str, bytes] = {}
    for drawing in drawings[:1]:
        targets = _relations(archive, drawing)
        for anchor in ElementTree.fromstring(archive.read(drawing)):
            blip = next(anchor.iter(_BLIP), None)
            start = anchor.find(f"{_DRAWN}from")
            if blip is None or start is None or len(found) >= _MOST_IMAGES:
                continue
            row = int(start.findtext(f"{_DRAWN}row") or 0)
            target = targets[str(blip.get(_EMBED))]
            if archive.getinfo(target).file_size <= _LARGEST_IMAGE:
                caption = (
                    str(rows[row][0]) if row < len(rows) and rows[row] and rows[row][0] else f"row {row + 1}"
                )
                found[caption] = archive.read(target)
    return found


def _relations(archive: zipfile.ZipFile, part: str) -> dict[str, str]:
    """Targets of a part's relations by id, as names in the archive."""
    folder, name = posixpath.split(part)
    try:
        tree = ElementTree.fromstring(archive.read(f"{folder}/_rels/{name}.rels"))
    except KeyError:
        return {}
    targets = {}
    for relation in tree.iter(_RELATION):
        target = str(relation.get("Target"))
        absolute = target.startswith("/")
        targets[str(relation.get("Id"))] = (
            target.lstrip("/") if absolute else posixpath.normpath(posixpath.join(folder, target))
        )
    return targets

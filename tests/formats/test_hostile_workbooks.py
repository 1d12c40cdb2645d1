"""Hostile workbooks: no picture starts a program, and no part is unpacked beyond a limit."""

from __future__ import annotations

import io
import struct
import tracemalloc
import zipfile
from dataclasses import replace

import pytest
from helpers.instrument_files import smooth
from openpyxl import Workbook
from openpyxl.chart import BarChart, Reference
from PIL import EpsImagePlugin, Image

from manifold.analytic.virtual_instruments import MA_T12_BANDS, write_ma_t12
from manifold.core import picture_bytes
from manifold.core.errors import FileFormatError
from manifold.formats import ma_t12, registry
from manifold.formats.workbook_pictures import picture_values

EPS = b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 9 9\n%%EndComments\nshowpage\n"
MEDIA = "xl/media/image1.png"


@pytest.fixture
def workbook(tmp_path, rng):
    path = tmp_path / "sample.xlsx"
    write_ma_t12(path, smooth(MA_T12_BANDS), "smooth", rng)
    return path


def with_parts(path, parts, method=zipfile.ZIP_DEFLATED):
    """Replace parts of a workbook, or add them."""
    with zipfile.ZipFile(path) as archive:
        contents = {name: archive.read(name) for name in archive.namelist()} | parts
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as made:
        for name, content in contents.items():
            made.writestr(name, content, method if name in parts else None)


def declare(path, part, size):
    """Write another unpacked size of a part into the directory of an archive, and into the part's own header."""
    data = bytearray(path.read_bytes())
    for signature, size_at, name_at in ((b"PK\x01\x02", 24, 46), (b"PK\x03\x04", 22, 30)):
        at = data.find(signature)
        while data[at + name_at : at + name_at + len(part)] != part.encode():
            at = data.index(signature, at + 4)
        data[at + size_at : at + size_at + 4] = struct.pack("<I", size)
    path.write_bytes(data)


def encoded(image, kind="PNG"):
    stream = io.BytesIO()
    image.save(stream, kind)
    return stream.getvalue()


@pytest.fixture
def started(tmp_path, monkeypatch):
    """What has started a stand-in for Ghostscript: a file that it writes."""
    trace, program = tmp_path / "started", tmp_path / "bin" / "gs"
    program.parent.mkdir()
    program.write_text(f"#!/bin/sh\necho \"$@\" >> '{trace}'\n")
    program.chmod(0o755)
    monkeypatch.setenv("PATH", str(program.parent), prepend=":")
    monkeypatch.setattr(EpsImagePlugin, "gs_binary", None)  # which Pillow looks for once
    return trace


def test_the_stand_in_is_started_by_pillow_itself(started):
    with Image.open(io.BytesIO(EPS)) as image, pytest.raises(OSError):  # noqa: PT011 (there is no picture)
        image.load()
    assert started.exists()


def test_an_eps_named_png_is_refused_by_name_and_starts_no_program(workbook, started):
    with_parts(workbook, {MEDIA: EPS})
    readings = registry.read_readings(workbook)
    content = readings.texture["images"]["15as-45"]
    assert content == EPS
    with pytest.raises(FileFormatError, match=r"^is a PostScript picture, expected PNG or JPEG"):
        picture_values(content)
    with pytest.raises(FileFormatError, match="neither a PNG nor a JPEG"):
        ma_t12.write(workbook, readings)
    assert not started.exists()


def test_a_picture_in_a_chart_sheet_is_not_opened(tmp_path, monkeypatch):
    """Openpyxl reads the drawings of chart sheets even where it is to read cells alone."""
    path = tmp_path / "charts.xlsx"
    book = Workbook()
    sheet = book.active
    for row in (["Geometry", 400, 700], ["45as15", 0.1, 0.2]):
        sheet.append(row)
    chart = BarChart()
    chart.add_data(Reference(sheet, min_col=2, min_row=1, max_row=2))
    book.create_chartsheet().add_chart(chart)
    book.save(path)
    drawing = "xl/drawings/drawing1.xml"
    with zipfile.ZipFile(path) as archive:
        graphic = archive.read(drawing).replace(b"graphicFrame", b"pic")
        relations = archive.read("xl/drawings/_rels/drawing1.xml.rels")
    start, end = graphic.index(b"<pic"), graphic.index(b"</pic>") + 6
    picture = (
        b'<pic><nvPicPr><cNvPr id="1" name="a"/><cNvPicPr/></nvPicPr><blipFill><a:blip xmlns:a="http://schemas.'
        b'openxmlformats.org/drawingml/2006/main" xmlns:r="http://schemas.openxmlformats.org/officeDocument/2006/'
        b'relationships" r:embed="rId9"/></blipFill><spPr/></pic>'
    )
    relation = (
        b'<Relationship Id="rId9" Type="http://schemas.openxmlformats.org/officeDocument/2006/relationships/image" '
        b'Target="/xl/media/image1.xml"/></Relationships>'
    )
    with_parts(
        path,
        {
            drawing: graphic[:start] + picture + graphic[end:],
            "xl/drawings/_rels/drawing1.xml.rels": relations.replace(b"</Relationships>", relation),
            "xl/media/image1.xml": encoded(Image.new("RGB", (8, 8))),
        },
    )
    opened = []

    def open_picture(stream, *arguments, **options):
        opened.append(stream.getvalue())
        raise OSError

    monkeypatch.setattr(Image, "open", open_picture)
    (readings,) = registry.read_all(path)
    assert len(readings) == 1
    assert opened == [b""]


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (encoded(Image.new("P", (1500, 1500))), "has 1500 x 1500 pixels, expected at most 2 million"),
        (encoded(Image.new("RGB", (16, 16)))[:50], "cannot be decoded"),
        (encoded(Image.new("I;16", (16, 16))), "has pixels of mode I;16"),
        (encoded(Image.new("CMYK", (16, 16)), "JPEG"), "has pixels of mode CMYK"),
        (encoded(Image.new("P", (16, 16)), "GIF"), "is a GIF picture, expected PNG or JPEG"),
        (b"", "is no known picture"),
    ],
)  # fmt: skip
def test_pictures_of_other_kinds_and_sizes_are_refused(content, words):
    with pytest.raises(FileFormatError, match=f"^{words}.*; export the workbook again$"):
        picture_values(content)


@pytest.mark.parametrize("kind", ["PNG", "JPEG"])
@pytest.mark.parametrize("mode", ["L", "RGB"])
def test_png_and_jpeg_are_decoded_to_their_codes(kind, mode):
    image = Image.new(mode, (7, 5), 80 if mode == "L" else (80, 80, 80))
    codes = picture_bytes.decode(encoded(image, kind))
    assert codes.shape == (5, 7, 3)
    assert (codes == 80).all()


def test_pictures_that_cannot_be_found_are_noted(workbook):
    with_parts(workbook, {"xl/drawings/drawing1.xml": b"<broken"})
    readings = registry.read_readings(workbook)
    assert "images" not in readings.texture
    assert "the pictures of sheet 'Texture Images' cannot be read" in readings.notes[-1]


def test_a_sheet_of_pictures_without_any_has_no_note(workbook):
    ma_t12.write(workbook, replace(registry.read_readings(workbook), texture={}))
    assert not any("picture" in note for note in registry.read_readings(workbook).notes)


@pytest.fixture
def memory():
    """Bytes of Python's memory at most since the start of a test."""
    tracemalloc.start()
    yield lambda: tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()


@pytest.mark.parametrize("part", ["xl/worksheets/sheet9.xml", MEDIA])
def test_a_part_larger_than_the_directory_says_is_not_unpacked(workbook, memory, part):
    with_parts(workbook, {part: b"<" + bytes(100_000_000)})
    declare(workbook, part, 1000)
    tracemalloc.reset_peak()
    with pytest.raises(FileFormatError, match=r"not a readable workbook \(Bad CRC"):
        registry.read_all(workbook)
    assert memory() < 20e6  # a fifth of the part; the file has 0.1 MB


def test_parts_packed_by_bzip2_are_refused(workbook):
    """A kilobyte of it unpacks to a gigabyte at once."""
    with_parts(workbook, {"xl/worksheets/sheet9.xml": b"<sheet/>"}, zipfile.ZIP_BZIP2)
    with pytest.raises(FileFormatError, match="packed by method 12"):
        registry.read_all(workbook)

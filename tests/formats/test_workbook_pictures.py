"""Pictures and texture values of a workbook: each belongs to the sample whose name stands above or beside it."""

from __future__ import annotations

import io
import zipfile

import numpy as np
import openpyxl
import pytest
from openpyxl.drawing.image import Image as SheetImage
from PIL import Image

from manifold.convert import contents as info
from manifold.formats.ma_t12 import read
from manifold.formats.readings import MA_T12_NAMES
from manifold.formats.workbook_pictures import picture_values

CAPTIONS = ("15as-45", "15as15", "15d")


def _workbook(path, samples, sheets, values=()):
    """A workbook of readings of samples; each sheet of pictures has brightnesses of three pictures by its heads."""
    book = openpyxl.Workbook()
    spectral = book.active
    spectral.title = "Spectral Data"
    spectral.append(["MA-T12"])
    spectral.append(["Name", "Date/Time", "Geometry", *range(400, 701, 10)])
    for sample in samples:
        for geometry in MA_T12_NAMES:
            spectral.append([sample, "2026-01-01", geometry, *[0.4] * 31])
    texture = book.create_sheet("Texture Data")
    texture.append(["Name", "Geometry", "Graininess"])
    for row in values:
        texture.append(row)
    for number, columns in enumerate(sheets):
        sheet = book.create_sheet(f"Texture Images {number}" if number else "Texture Images")
        sheet.append([None, *(head for head, _ in columns)])
        for row, caption in enumerate(CAPTIONS, start=2):
            sheet.cell(row, 1, caption)
            for column, (_, brightness) in enumerate(columns, start=2):
                content = io.BytesIO()
                Image.fromarray(np.full((8, 8, 3), brightness, np.uint8)).save(content, "PNG")
                sheet.add_image(SheetImage(content), f"{'ABCD'[column - 1]}{row}")
    book.save(path)
    return path


def _brightness(sample):
    """Codes of a sample's pictures; none where it has none."""
    images = sample.texture.get("images", {})
    assert tuple(images) in ((), CAPTIONS)
    return sorted({round(255 * picture_values(content).mean()) for content in images.values()})


def test_each_sample_has_the_pictures_of_its_column_and_its_texture_values(tmp_path):
    values = [["one", "15d", 3.5], ["two", "15d", 7.0]]
    path = _workbook(tmp_path / "b.xlsx", ["one", "two"], [[("two", 90), ("one", 60)]], values)
    samples = {sample.name: sample for sample in read(path)}
    assert {name: _brightness(sample) for name, sample in samples.items()} == {"one": [60], "two": [90]}
    assert {name: s.texture["values"][0]["Graininess"] for name, s in samples.items()} == {
        "one": 3.5,
        "two": 7,
    }
    _, _, tables = info.inspect_instrument_file(path, "workbook")
    pictures = [row for heads, rows in tables if "picture" in heads for row in rows]
    assert [(row[0], row[1], row[4].split()[0]) for row in pictures] == [
        (name, caption, value) for name, value in (("one", "0.235"), ("two", "0.353")) for caption in CAPTIONS
    ]


def test_a_sample_without_pictures_and_values_does_not_get_those_of_another(tmp_path):
    path = _workbook(tmp_path / "b.xlsx", ["one", "two"], [[("two", 90)]], [["two", "15d", 7.0]])
    one, two = read(path)
    assert (one.texture, _brightness(two)) == ({}, [90])
    assert not any("left out" in note for note in two.notes)


@pytest.mark.parametrize(
    ("columns", "brightness"), [([("other", 60), ("one", 90)], [90]), ([("x", 60), ("y", 90)], [])]
)
def test_pictures_under_the_name_of_no_sample_are_left_out_with_a_note(columns, brightness, tmp_path):
    (one,) = read(_workbook(tmp_path / "b.xlsx", ["one"], [columns]))
    assert _brightness(one) == brightness
    assert any(f"pictures of '{columns[0][0]}'" in note and "left out" in note for note in one.notes)


def test_pictures_in_a_workbook_of_one_sample_belong_to_it_under_any_heading(tmp_path):
    (one,) = read(_workbook(tmp_path / "b.xlsx", ["one"], [[("Image", 60)]]))
    assert _brightness(one) == [60]


def test_pictures_on_several_sheets_and_drawings_are_read(tmp_path):
    path = _workbook(tmp_path / "b.xlsx", ["one", "two"], [[("one", 60)], [("two", 90)]])
    assert [_brightness(sample) for sample in read(path)] == [[60], [90]]
    relations = "xl/worksheets/_rels/sheet3.xml.rels"
    with zipfile.ZipFile(path) as archive:
        parts = {name: archive.read(name) for name in archive.namelist()}
    second = (
        b'<Relationship Type="http://schemas.openxmlformats.org/officeDocument/2006/relationships/drawing" '
    )
    second += b'Target="/xl/drawings/drawing2.xml" Id="rId9"/></Relationships>'
    parts[relations] = parts[relations].replace(b"</Relationships>", second)
    parts["xl/workbook.xml"] = parts["xl/workbook.xml"].replace(b"Texture Images 1", b"Other")
    with zipfile.ZipFile(path, "w") as archive:
        for name, content in parts.items():
            archive.writestr(name, content)
    one, two = read(path)
    assert (_brightness(one), two.texture) == ([60], {})  # both drawings hang on the column of `one`
    assert any("several pictures 15as-45 of 'one'" in note for note in one.notes)

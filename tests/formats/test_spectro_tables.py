"""Tables of spectrophotometers, in workbooks and CSV files: names of geometries, units, samples, what is refused."""

from __future__ import annotations

import re

import numpy as np
import openpyxl
import pytest
from helpers.instrument_files import smooth
from hypothesis import given
from hypothesis import strategies as st

from manifold.analytic.virtual_instruments import MA_T12_BANDS, ma_t12_readings, write_ma_t12
from manifold.colour.difference import lab_under_d65, lab_values
from manifold.colour.narrow_bands import with_spectra
from manifold.core.errors import FileFormatError
from manifold.formats import ma_t12, registry
from manifold.formats.geometries import parse_aspecular, parse_geometry
from manifold.formats.readings import DAYLIGHT, MA_T12_NAMES, Viewing

SPECTRO = ma_t12_readings(smooth(MA_T12_BANDS), "smooth")
FACTORS = np.pi * SPECTRO.values


def spectro_table(
    separator=",",
    point=".",
    cell="{}",
    head="{}",
    geometry=str,
    scale=1.0,
    order=1,
    before="",
    line_end="\n",
    columns="Name,Date",
) -> str:
    """The table of a spectrophotometer, spelt in many ways."""
    nm = [f"{w:g}" for w in MA_T12_BANDS.wavelengths_nm][::order]
    first = columns.split(",") if columns else []
    lines = [before] if before else []
    lines.append(separator.join([*first, "Geometry", *(head.format(w) for w in nm)]))
    for name, row in zip(MA_T12_NAMES, scale * FACTORS, strict=True):
        cells = [cell.format(f"{value:.7f}".replace(".", point)) for value in row[::order]]
        lines.append(separator.join([*(["smooth", "2026"][: len(first)]), geometry(name), *cells]))
    return line_end.join(lines) + line_end


TABLES = {
    "decimal commas": spectro_table(";", ","),
    "tabs, CR LF": spectro_table("\t", ",", line_end="\r\n"),
    "CR": spectro_table(line_end="\r"),
    "byte order mark": b"\xef\xbb\xbf" + spectro_table().encode(),
    "nm": spectro_table(head="{} nm"),
    "percent in the heads": spectro_table(head="R{} [%]", scale=100.0),
    "percent in the cells": spectro_table(";", ",", cell="{} %", scale=100.0),
    "percent, not said": spectro_table(scale=100.0),
    "percent in a title": spectro_table(before="Calibrated: 99 % reflectance standard"),
    "another geometry in a title": spectro_table(before="0/45 configuration, BRDF"),
    "the header again": spectro_table() + spectro_table().split("\n")[0],
    "SPECTRAL_NM_400": spectro_table(head="SPECTRAL_NM_{}"),
    "descending": spectro_table(order=-1),
    "r45as_15": spectro_table(geometry=lambda g: "r" + g.replace("-", "_")),
    "upper case": spectro_table(geometry=str.upper),
    "minus of typesetters": spectro_table(geometry=lambda g: g.replace("-", "\u2212")),
    "degrees, Latin-1": spectro_table(geometry=lambda g: g.replace("as", "\u00b0as") + "\u00b0").encode(
        "latin-1"
    ),
    "title and sep=": spectro_table(";", before="sep=;"),
    "no names": spectro_table(columns=""),
    "quotes": re.sub(r"([^,\n]+)", r'"\1"', spectro_table()),
    "other columns": spectro_table(columns="Name,L*"),
}


@pytest.mark.parametrize("name", TABLES)
def test_tables_of_a_spectrophotometer_are_read_however_they_are_spelt(name, tmp_path):
    content = TABLES[name]
    path = tmp_path / "table.csv"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    found = registry.read_readings(path)
    np.testing.assert_allclose(found.values, SPECTRO.values, rtol=1e-5)  # seven decimals of R
    np.testing.assert_allclose(found.wo, SPECTRO.wo, atol=1e-12)
    assert found.bands == MA_T12_BANDS


@pytest.mark.parametrize(
    "cell",
    [
        "NaN",
        "inf",
        "-inf",
        "#N/A",
        "n/a",
        "-",
        "---",
        "1e999",
        "O.3",
        "0.1.2",
        "0,1,2",
        "1_0",
        "1.234,5",
        "1 234,5",
        "1'234.5",
    ],
)
def test_a_cell_that_is_no_number_is_named(cell, tmp_path):
    path = tmp_path / "table.csv"
    path.write_text(spectro_table(";").replace(f"{FACTORS[1, 2]:.7f}", cell))
    with pytest.raises(FileFormatError, match="row 3, column 6"):
        registry.read_all(path)


def test_short_rows_are_named_and_empty_cells_are_not_measured(tmp_path):
    path = tmp_path / "table.csv"
    path.write_text(spectro_table()[:-40])
    with pytest.raises(FileFormatError, match="row 13, column 3"):
        registry.read_all(path)
    path.write_text(spectro_table().replace(f"{FACTORS[1, 2]:.7f}", ""))
    found = registry.read_readings(path)
    assert np.argwhere(~found.measured).tolist() == [[1, 2]]


def test_rows_of_workbooks_end_where_their_cells_do(tmp_path):
    """Not one value of the second geometry, nor the red end of the third, was measured."""
    book = openpyxl.Workbook()
    book.active.append(["Name", "Geometry", *(f"{w:g}" for w in MA_T12_BANDS.wavelengths_nm)])
    for k, (name, row) in enumerate(zip(MA_T12_NAMES, FACTORS.tolist(), strict=True)):
        book.active.append(["smooth", name, *row[: {1: 0, 2: 25}.get(k, 31)]])
    book.save(tmp_path / "gaps.xlsx")
    found = registry.read_readings(tmp_path / "gaps.xlsx")
    expected = np.ones((12, 31), bool)
    expected[1], expected[2, 25:] = False, False
    np.testing.assert_array_equal(found.measured, expected)
    np.testing.assert_allclose(found.values[expected], SPECTRO.values[expected], rtol=1e-9)


def test_a_sample_without_any_value_is_refused(tmp_path):
    path = tmp_path / "table.csv"
    path.write_text(re.sub(r"0\.\d{7}", "", spectro_table()))
    with pytest.raises(FileFormatError, match="'smooth' has no values"):
        registry.read_all(path)


def test_samples_of_one_table_are_told_apart_and_repeats_averaged(tmp_path):
    path = tmp_path / "table.csv"
    path.write_text(spectro_table() + spectro_table(scale=1.02).replace("smooth", "other").partition("\n")[2])
    assert [r.name for r in registry.read_all(path)] == ["smooth", "other"]
    path.write_text(spectro_table() + spectro_table(scale=1.02).partition("\n")[2])
    found = registry.read_readings(path)
    np.testing.assert_allclose(found.values, 1.01 * SPECTRO.values, rtol=1e-5)
    assert any("means" in note for note in found.notes)


@given(
    anchor=st.integers(0, 80), aspecular=st.integers(-90, 150), azimuth=st.sampled_from([0, 25, 90, 125]),
    spelling=st.sampled_from(["{a}as{s}", "r{a}as{u}", "R{a}AS{s}", "{a} as {s}", "{a}\u00b0 as {s}", "{a}:as{s}"]),
)  # fmt: skip
def test_geometries_are_read_in_every_spelling(anchor, aspecular, azimuth, spelling):
    text = spelling.format(a=anchor, s=aspecular, u=str(aspecular).replace("-", "_"))
    if azimuth:
        text += f"az{azimuth}"
    assert parse_geometry(text) == (anchor, aspecular, azimuth)


@pytest.mark.parametrize(
    ("text", "angles"),
    [
        ("r45as25az_90", (45, 25, -90)),
        ("45asMinus15", (45, -15, 0)),
        ("45as25azMinus90", (45, 25, -90)),
        ("15as46.9az-104.5", (15, 46.9, -104.5)),
        ("45/0", (45, 45, 0)),
        ("45\u00b0c:0\u00b0", (45, 45, 0)),
        ("0/45", (45, 45, 0)),
        ("45/0 Spectral", (45, 45, 0)),
        ("45/05", None),
        ("d/8", None),
        ("8/45", None),
    ],
)
def test_geometries_of_x_rites_programs_and_of_45_0_are_read(text, angles):
    assert parse_geometry(text) == angles


BARE = ("-15", "15", "25", "45", "75", "110")
ASPECULAR_TABLES = {
    "column": "\n".join(
        ["Name,Angle,400,500,600", *(f"s,{g},0.1,0.2,{k / 10}" for k, g in enumerate(BARE))]
    ),
    "degrees": "\n".join(
        ["Geometry;400;500;600", *(f"{g}\u00b0;0,1;0,2;{k / 10}" for k, g in enumerate(BARE))]
    ),
    "as15": "\n".join(["Geometry,400,500,600", *(f"as{g},0.1,0.2,{k / 10}" for k, g in enumerate(BARE))]),
}  # fmt: skip


@pytest.mark.parametrize("name", ASPECULAR_TABLES)
def test_aspecular_angles_alone_have_the_light_at_45_degrees(name, tmp_path):
    path = tmp_path / "byk.csv"
    path.write_text(ASPECULAR_TABLES[name])
    found = registry.read_readings(path)
    np.testing.assert_array_equal(found.wo, SPECTRO.wo[:6])  # those of an MA-T12 at 45 degrees
    np.testing.assert_allclose(np.pi * found.values, [[0.1, 0.2, k / 10] for k in range(6)])
    assert any("45 degrees" in note for note in found.notes)
    path.write_text(ASPECULAR_TABLES[name].replace("75", "77"))  # no multi-angle spectrophotometer's
    with pytest.raises(FileFormatError, match="such as 45as15"):
        registry.read_all(path)


@pytest.mark.parametrize("heads", ["Standard Name", "ID,Data Name", "Standard,Sample ID", "Batch"])
def test_samples_are_told_apart_whatever_their_column_is_called(heads, tmp_path):
    """Rows of two samples at one geometry were averaged where the head was not known."""
    rows = [
        ",".join(
            [
                *{"ID": [f"{k}{s}"], "Standard": ["white"]}.get(heads.split(",")[0], []),
                s,
                g,
                f"0.{k + 1},0.2,0.3",
            ]
        )
        for k, s in enumerate("ab")
        for g in ("45as15", "45as45")
    ]
    path = tmp_path / "samples.csv"
    path.write_text("\n".join([f"{heads},Geometry,400,500,600", *rows]))
    first, second = registry.read_all(path)
    assert (first.name, second.name) == ("a", "b")
    np.testing.assert_allclose(np.pi * second.values[:, 0], 0.2)


# Names of samples by the cells of their rows, by heads.
NAMED_TOGETHER = {
    "Standard Name,Trial Name": {
        "red,": "red",
        "red,red 1": "red 1",
        "blue,": "blue",
        "blue,blue 1": "blue 1",
    },
    "Trial Name,Standard Name": {",red": "red", "1,red": "red: 1", ",blue": "blue", "1,blue": "blue: 1"},
    "Name,Type": {"red,Standard": "red: Standard", "red,Batch": "red: Batch", "blue,Batch": "blue"},
    "Material,Color Name": {"felt,red": "felt: red", "felt,blue": "felt: blue", "wool,red": "wool"},
    "Sample ID,Name": {"1,red": "red: 1", "2,red": "red: 2", "3,blue": "blue: 3", "4,blue": "blue: 4"},
}


@pytest.mark.parametrize("is_merged", [False, True], ids=["each row named", "cells merged"])
@pytest.mark.parametrize("heads", NAMED_TOGETHER)
def test_columns_together_name_a_sample(heads, is_merged, tmp_path):
    """A row without a trial joined the sample above it, and rows of a standard and of its batch were averaged."""
    rows = [
        f"{',' if is_merged and geometry != '45as15' else cells},{geometry},0.{k + 1},0.2,0.3"
        for k, cells in enumerate(NAMED_TOGETHER[heads])
        for geometry in ("45as15", "45as45")
    ]
    path = tmp_path / "samples.csv"
    path.write_text("\n".join([f"{heads},Geometry,400,500,600", *rows]))
    found = registry.read_all(path)
    assert [one.name for one in found] == list(NAMED_TOGETHER[heads].values())
    for k, one in enumerate(found):
        np.testing.assert_allclose(np.pi * one.values[:, 0], 0.1 * (k + 1))
        assert len(one) == 2


def test_numbers_that_count_rows_name_no_sample(tmp_path):
    rows = [
        f"{3 * k + g},{name},45as{15 * g + 15},0.1,0.2,0.3" for k, name in enumerate("ab") for g in range(3)
    ]
    path = tmp_path / "samples.csv"
    path.write_text("\n".join(["ID,Name,Geometry,400,500,600", *rows]))
    assert [(one.name, len(one)) for one in registry.read_all(path)] == [("a", 3), ("b", 3)]


@pytest.mark.parametrize(
    ("heads", "rows", "wanted"),
    [
        ("Name,ID", ["a,1", "a,2", "b,1", "b,2"], ["a", "b"]),
        ("Name,Type", ["a,Batch", "a,", "b,Batch", "b,"], ["a", "b"]),
        ("Sample,Material", ["a,steel", ",steel", "b,steel", ",steel"], ["a", "b"]),
        ("Material,Sample", ["steel,a", "steel,", "brass,", "brass,"], ["a", "brass"]),
        ("Standard Name,Sample Name", ["red,", "red,", "red,1", "red,1"], ["red", "1"]),
    ],
)  # fmt: skip
def test_empty_and_counting_cells_name_no_sample_of_their_own(heads, rows, wanted, tmp_path):
    """Numbers of the geometries split samples, and rows below an empty cell joined those of another sample."""
    path = tmp_path / "samples.csv"
    lines = [f"{cells},45as{15 + 30 * (k % 2)},0.{k + 1},0.2,0.3" for k, cells in enumerate(rows)]
    path.write_text("\n".join([f"{heads},Geometry,400,500,600", *lines]))
    found = registry.read_all(path)
    assert [one.name for one in found] == wanted
    np.testing.assert_allclose(
        np.pi * np.array([one.values[:, 0] for one in found]), [[0.1, 0.2], [0.3, 0.4]]
    )


def test_types_of_directions_split_no_sample(tmp_path):
    path = tmp_path / "samples.csv"
    path.write_text(
        "Type,theta_i,theta_o,phi_o,633nm\nin plane,30,0,0,0.1\nin plane,30,10,0,0.1\nacross,30,10,90,0.1\n"
    )
    (found,) = registry.read_all(path)
    assert len(found) == 3
    path.write_text(
        "Name,Type,theta_i,theta_o,phi_o,Wavelength (nm),BRDF\n"
        "a,in plane,30,0,0,500,0.1\na,in plane,30,0,0,600,0.2\na,across,30,10,90,500,0.1\na,across,30,10,90,600,0.2\n"
    )
    (found,) = registry.read_all(path)
    assert found.values.shape == (2, 2)


def test_texture_values_are_found_by_columns_that_together_name_a_sample(tmp_path):
    heads = ["Standard Name", "Trial Name", "Geometry"]
    cells = [["red", None, "45as15"], ["red", "red 1", "45as15"]]
    spectra = [[*heads, 400, 500, 600], *([*own, 0.1, 0.2, 0.3] for own in cells)]
    texture = [[*heads, "Graininess"], *([*own, k] for k, own in enumerate(cells))]
    workbook(tmp_path / "a.xlsx", {"Spectral Data": spectra, "Texture Data": texture})
    red, trial = registry.read_all(tmp_path / "a.xlsx")
    assert (red.name, trial.name) == ("red", "red 1")
    assert [one.texture["values"][0]["Graininess"] for one in (red, trial)] == [0, 1]


TURNED = "\n".join(["nm,45as15,45as25,45as45", *(f"{w},1,2,3" for w in range(400, 701, 10))])


def test_spectra_may_stand_below_their_geometries(tmp_path):
    (tmp_path / "down.csv").write_text(TURNED)
    rows = [[f"{w:g}", *values] for w, values in zip(MA_T12_BANDS.wavelengths_nm, FACTORS.T, strict=True)]
    workbook(tmp_path / "down.xlsx", {"red": [["paint"], ["Wavelength [nm]", *MA_T12_NAMES], *rows]})
    np.testing.assert_allclose(
        100.0 * np.pi * registry.read_readings(tmp_path / "down.csv").values,
        np.tile([[1.0], [2.0], [3.0]], 31),
    )
    found = registry.read_readings(tmp_path / "down.xlsx")
    np.testing.assert_allclose(found.values, SPECTRO.values)
    np.testing.assert_allclose(found.wo, SPECTRO.wo, atol=1e-12)


def test_two_spectra_below_each_other_are_refused(tmp_path):
    (tmp_path / "down.csv").write_text("nm,45as15\n400,1\n500,2\n600,3\n405,1\n505,2\n605,3\n")
    with pytest.raises(
        FileFormatError, match="wavelengths go back from 600 to 405 nm, expected one spectrum"
    ):
        registry.read_all(tmp_path / "down.csv")


def test_a_row_per_geometry_and_wavelength_is_a_table_of_spectra(tmp_path):
    rows = [
        f"{sample},{geometry},{nm:g},{scale * value:.7f}"
        for sample, scale in (("red", 1.0), ("dark", 0.1))
        for geometry, spectrum in zip(MA_T12_NAMES, FACTORS, strict=True)
        for nm, value in zip(MA_T12_BANDS.wavelengths_nm, spectrum, strict=True)
    ]
    (tmp_path / "tidy.csv").write_text("\n".join(["Sample,Geometry,Wavelength,Reflectance", *rows]))
    red, dark = registry.read_all(tmp_path / "tidy.csv")
    assert (red.name, dark.name) == ("red", "dark")
    np.testing.assert_allclose(red.values, SPECTRO.values, rtol=1e-5)
    np.testing.assert_allclose(dark.values, 0.1 * SPECTRO.values, rtol=1e-4)


@pytest.mark.parametrize(
    ("table", "words"),
    [
        ("Name,Geometry,r,g,b\nx,45as15,120,100,90\n", "a header without values .Name, Geometry, r, g, b."),
        ("Geometry,400,500,600\nd/8 SPIN,1,2,3\n", "found geometry 'd/8 SPIN', expected one such as 45as15"),
        ("Name,400,500,600\nA,1,2,3\n", "no header .* such as 'Name, Geometry, 400, 410'"),
        (
            "Name,Angle,400,500,600\nA,25,1,2,3\nA,45,1,2,3\nA,75,1,2,3\n",
            "write 45as25 ... if they are aspecular angles, or 25/0",
        ),
        ("Geometry,400,500\n45/25,1,2\n45/75,1,2\n", "found geometry '45/25', expected one such as 45as15"),
        (TURNED.replace("500,", "5OO,"), "row 12, column 1: found '5OO', expected a wavelength in nm"),
        (TURNED.replace("500,1,2,", "500,1,two,"), "row 12, column 3: found 'two'"),
        (
            TURNED.replace("45as25", "45as15"),
            "row 1, column 3: geometry '45as15' is also in row 1, column 2",
        ),
        ("Name,45as15 400,45as15 500,45as25 400\nA,1,2,3\n", "has a header such as 'Name, Geometry, 400"),
        (
            "| Geometry | 400 | 500 |\n| 45as15 | 1 | 2 |\n",
            "give the table a header such as 'Name, Geometry, 400",
        ),
        ("Geometry,400,41O,420\n45as15,1,2,3\n", "row 1, column 3: found '41O' among wavelengths"),
        ("Geometry,400,410,9000\n45as15,1,2,3\n", "row 1, column 4: found '9000' among wavelengths"),
        ("Geometry,400,410,400 nm\n45as15,1,2,3\n", "two columns of the same wavelength"),
        ("45as25,1,2\nGeometry,400,410\n45as15,1,2\n", "row 1: readings above the header"),
        ("Geometry,400,410\n45as15,1,2\n45as15,1,3\n", "row 3: geometry '45as15' is also in row 2"),
        ("Name,Geometry,400,410\nA,45as15,1,2\nA,195as25,1,3\n", "row 3: found geometry '195as25'"),
        ('Name,Geometry,400,410\nA,45as15,"1,2\nA,45as25,1,3\n', "row 2: a quote that does not end"),
        (
            "Name,Mode,Geometry,400,410\nA,M1,45/0,0.9,0.9\nB,M2,45/0,0.8,0.8\nA,M2,45/0,0.8,0.8\n",
            "row 4, column 2: M2 beside M1 at '45/0', expected one measuring condition",
        ),
        ("Geometry,400,500\n45,1,2\n55as15,1,3\n", "geometries '45' and '55as15' in one column"),
        (
            "Angle,400,500,600\n45as15,1,2,3\n25\u00b0,1,3,4\n",
            "geometries '25\u00b0' and '45as15' in one column",
        ),
        ("Geometry,400,410\n45as15,1\n", "row 2, column 3: the row ends after 2"),
        ("Geometry,400,410\n45as15,0,1,0,2\n", "decimal commas need quotes"),
        ("Geometry,400,410\n", "a header but no rows"),
        ("Name,Geometry\nA,45as15\n", "a header without values .Name, Geometry., expected wavelengths or L"),
    ],
)
def test_tables_that_hold_no_reflectance_at_a_geometry_are_refused(table, words, tmp_path):
    path = tmp_path / "other.csv"
    path.write_text(table)
    with pytest.raises(FileFormatError, match=words) as error:
        registry.read_all(path)
    assert "\n" not in str(error.value)


def test_long_blanks_behind_a_geometry_do_not_hang(tmp_path):
    path = tmp_path / "blanks.csv"
    path.write_text(f"Geometry;400;410\n45as15{' ' * 3000}x;0.1;0.2\n45as25{' ' * 3000};0.1;0.2\n")
    with pytest.raises(FileFormatError, match="row 2: found geometry '45as15"):
        registry.read_all(path)


@pytest.mark.parametrize(
    ("text", "angle"),
    [("-15DP", -15), ("15 DP", 15), ("as15", 15), ("asMinus15", -15), ("15d", 15), ("-15\u00b0 (SP)", -15),
     ("aspecular 75", 75), ("M15", None), ("15x", None), ("400", None)],
)  # fmt: skip
def test_aspecular_angles_are_read_in_every_spelling(text, angle):
    assert parse_aspecular(text) == angle


def test_a_double_path_is_read_as_one_and_said(tmp_path):
    rows = "\n".join(f"{g}DP,0.1,0.2,0.3" for g in BARE)
    (tmp_path / "m6.csv").write_text(f"CM-M6\nAngle,400,500,600\n{rows}")
    found = registry.read_readings(tmp_path / "m6.csv")
    np.testing.assert_array_equal(found.wo, SPECTRO.wo[:6])
    assert any("two paths" in note for note in found.notes)


def workbook(path, sheets):
    book = openpyxl.Workbook()
    book.remove(book.active)
    for title, rows in sheets.items():
        sheet = book.create_sheet(title)
        for row in rows:
            sheet.append(row)
    book.save(path)


def test_all_sheets_are_read_and_name_their_samples(tmp_path):
    """The second sheet of a workbook was ignored."""
    table = [line.split(",") for line in spectro_table(columns="").split()]
    named = [["Name", *table[0]], *(["paint", *row] for row in table[1:])]
    workbook(tmp_path / "a.xlsx", {"red": table, "green": table, "notes": [["none"]]})
    assert [one.name for one in registry.read_all(tmp_path / "a.xlsx")] == ["red", "green"]
    workbook(tmp_path / "b.xlsx", {"Monday": named, "Friday": named})
    found = registry.read_all(tmp_path / "b.xlsx")
    assert [one.name for one in found] == ["Monday: paint", "Friday: paint"]
    np.testing.assert_allclose(found[1].values, SPECTRO.values, rtol=1e-5)
    broken = [*named[:3], ["paint", "45as25", "dark", *named[3][3:]]]
    workbook(tmp_path / "c.xlsx", {"Monday": named, "Friday": broken})
    with pytest.raises(FileFormatError, match=r"c\.xlsx, sheet 'Friday', row 4, column 3: found 'dark'"):
        registry.read_all(tmp_path / "c.xlsx")


def test_sheets_called_spectral_come_before_others_and_decimal_commas_are_numbers(tmp_path):
    table = [line.split(";") for line in spectro_table(";", ",").split()]
    workbook(tmp_path / "a.xlsx", {"Color Data": table[:5], "Spectral Data": [["MA-T12"], [], *table]})
    (found,) = registry.read_all(tmp_path / "a.xlsx")
    assert (found.name, found.instrument) == ("smooth", "MA-T12")
    np.testing.assert_allclose(found.values, SPECTRO.values, rtol=1e-5)


def test_rows_beyond_the_most_are_an_error(tmp_path, monkeypatch):
    monkeypatch.setattr(ma_t12, "_MOST_ROWS", 500)
    rows = [["Name", "Geometry", 400], *([f"paint {k}", "45as15", 0.1] for k in range(500))]
    workbook(tmp_path / "long.xlsx", {"Spectral Data": rows[:500]})
    assert len(registry.read_all(tmp_path / "long.xlsx")) == 499
    workbook(tmp_path / "long.xlsx", {"Spectral Data": rows})
    with pytest.raises(FileFormatError, match="more than 500 rows"):
        registry.read_all(tmp_path / "long.xlsx")


def test_texture_and_flake_images_stay_with_the_readings(tmp_path, rng):
    path = tmp_path / "sample.xlsx"
    write_ma_t12(path, smooth(MA_T12_BANDS), "flaky", rng, flakes=True)
    found = registry.read_readings(path)
    assert found.texture["values"][0]["Geometry"] == "15as-45"
    assert found.texture["values"][0]["Coarseness"] > 1.0
    assert list(found.texture["images"]) == list(MA_T12_NAMES[6:])
    assert all(image.startswith(b"\x89PNG") for image in found.texture["images"].values())


def lab_table(path, heads, rows):
    """A CSV file of CIELAB values per geometry."""
    lines = [",".join(["Name", "Geometry", *heads])]
    lines += [",".join(["red", name, *(f"{v:.6f}" for v in lab)]) for name, lab in rows]
    path.write_text("\n".join(lines) + "\n")
    return path


@pytest.mark.parametrize(
    ("heads", "viewing"),
    [
        (("L* (D65/10)", "a* (D65/10)", "b* (D65/10)"), Viewing("D65", 10)),
        (("L*(A/2°)", "a*(A/2°)", "b*(A/2°)"), Viewing("A", 2)),
        (("L*", "a*", "b*"), Viewing("D65", 10)),
        (("L", "a", "b"), Viewing("D65", 10)),
    ],
)
def test_cielab_values_at_geometries_are_colours_under_their_light(heads, viewing, tmp_path, rng):
    lab = rng.uniform([20.0, -40.0, -40.0], [90.0, 40.0, 40.0], (3, 3))
    path = lab_table(tmp_path / "lab.csv", heads, zip(("15as15", "45as45", "45as110"), lab, strict=True))
    (found,) = registry.read_all(path)
    assert found.viewing == viewing
    assert found.assumed_unit is None
    # Relative to the white of D65/2 they are the same numbers.
    np.testing.assert_allclose(lab_values(found.values, found.bands), lab, atol=1e-3)
    daylight = with_spectra(found)
    assert daylight.viewing == DAYLIGHT
    np.testing.assert_allclose(
        lab_values(daylight.values, found.bands), lab_under_d65(lab, viewing), atol=1e-3
    )
    assert 0.0 < daylight.colour_error < 5.0


def test_spectra_keep_the_light_and_observer_of_their_workbooks_colours(tmp_path, rng):
    path = tmp_path / "sample.xlsx"
    write_ma_t12(path, smooth(MA_T12_BANDS), "seen", rng)
    book = openpyxl.load_workbook(path)
    book["Color Data"].append(["ILLUMINANT/OBSERVER:", "A/2"])
    book.save(path)
    assert registry.read_readings(path).viewing == Viewing("A", 2)


def test_workbooks_of_the_instrument_need_no_unit_and_other_tables_name_the_assumed_one(tmp_path):
    path, other = tmp_path / "sample.xlsx", tmp_path / "sample.csv"
    write_ma_t12(path, smooth(MA_T12_BANDS), "smooth", np.random.default_rng(0))
    other.write_text("Geometry,400,500,600\n45as15,0.3,0.3,0.3\n45as45,0.2,0.2,0.2\n")
    assert registry.read_readings(path).unit_note is None
    assert "taken as reflectance factors" in (registry.read_readings(other).unit_note or "")

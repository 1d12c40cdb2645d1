"""Files as programs and people really write them: spelling, separators, marks and units do not matter; numbers do."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import openpyxl
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from instrument_files import dense, smooth, write_every_format

from manifold.brdf.synthetic.corpus import isotropic_materials
from manifold.brdf.synthetic.ggx import GGX
from manifold.brdf.synthetic.instruments import MA_T12_BANDS, MINI_DIFF_BANDS, ma_t12_readings, write_ma_t12
from manifold.brdf.synthetic.microfacet import Plastic
from manifold.errors import FileFormatError
from manifold.formats import astm, csv_table, lighttools, registry, utia
from manifold.formats.dense import DenseTable
from manifold.formats.geometry_names import parse_geometry
from manifold.formats.readings import MA_T12_NAMES, Readings
from manifold.records import Bands

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
    "UTF-16": spectro_table().encode("utf-16"),
    "UTF-16 without a mark": spectro_table().encode("utf-16-le"),
    "nm": spectro_table(head="{} nm"),
    "percent in the heads": spectro_table(head="R{} [%]", scale=100.0),
    "percent in the cells": spectro_table(";", ",", cell="{} %", scale=100.0),
    "percent, not said": spectro_table(scale=100.0),
    "percent in a title": spectro_table(";", ",", before="Reflectance [%]", scale=100.0),
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
    "Markdown": re.sub(r"(?m)^(.*)$", r"| \1 |", spectro_table(" | ").strip()),
    "turned": "\n".join(
        [",".join(["nm", *MA_T12_NAMES])]
        + [
            ",".join([f"{w:g}", *(f"{v:.7f}" for v in column)])
            for w, column in zip(MA_T12_BANDS.wavelengths_nm, FACTORS.T, strict=True)
        ]
    ),
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


@pytest.mark.parametrize("cell", ["NaN", "inf", "-inf", "#N/A", "1e999", "O.3", "0.1.2", "0,1,2", "1_0"])
def test_a_cell_that_is_no_number_is_named(cell, tmp_path):
    path = tmp_path / "table.csv"
    path.write_text(spectro_table(";").replace(f"{FACTORS[1, 2]:.7f}", cell))
    with pytest.raises(FileFormatError, match="row 3, column 6"):
        registry.read_all(path)


@pytest.mark.parametrize("cell", ["1.234,5", "1 234,5", "1\u00a0234,5", "1'234.5", "1.234.567", "12,345.6"])
def test_thousands_separators_are_named(cell, tmp_path):
    path = tmp_path / "table.csv"
    path.write_text(spectro_table(";").replace(f"{FACTORS[1, 2]:.7f}", cell), encoding="utf-8")
    with pytest.raises(FileFormatError, match=r"row 3, column 6: .* without thousands"):
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


def test_percent_in_a_title_is_believed_where_values_could_be_factors(tmp_path):
    path = tmp_path / "black.csv"
    path.write_text(
        "X-Rite MA-T12\nReflectance [%]\nGeometry,400,500,600\n45as45,1.2,1.3,1.4\n45as75,1.1,1.2,1.3\n"
    )
    found = registry.read_readings(path)
    np.testing.assert_allclose(np.pi * found.values[0], [0.012, 0.013, 0.014])


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
    "turned": "\n".join(
        [";".join(["Wavelength (nm)", *BARE]), "400" + 6 * ";0,1", "500" + 6 * ";0,2", "600;0;0,1;0,2;0,3;0,4;0,5"]
    ),
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


LINE_ENDS = {
    "CR": lambda text: text.replace("\n", "\r").encode(),
    "CRLF in UTF-16": lambda text: text.replace("\n", "\r\n").encode("utf-16"),
    "end mark of DOS": lambda text: text.encode() + b"\r\n\x1a",
    "empty lines around": lambda text: b"\n\n" + text.encode() + b"\n\n",
}


@pytest.mark.parametrize("name", ["zemax", "lighttools", "mini-diff", "astm", "pab-opto", "csv"])
@pytest.mark.parametrize("end", LINE_ENDS)
def test_text_files_are_read_however_their_lines_end(files, name, end, tmp_path):
    path = tmp_path / files[name].name
    path.write_bytes(LINE_ENDS[end](files[name].read_text()))
    np.testing.assert_array_equal(
        registry.read_readings(path).values, registry.read_readings(files[name]).values
    )


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


def test_units_behind_geometries_are_percent(tmp_path):
    path = tmp_path / "turned.csv"
    path.write_text("nm,45as15 (%),45as45 [%],45as75 %R\n400,1.5,1,1\n500,1,1,0.5\n600,1,1,1\n")
    found = registry.read_readings(path)
    np.testing.assert_allclose(100.0 * np.pi * found.values, [[1.5, 1, 1], [1, 1, 1], [1, 0.5, 1]])
    assert not found.notes


@pytest.mark.parametrize(
    ("table", "words"),
    [
        (
            "Name,Geometry,L*,a*,b*,r,g,b\nx,45as15,50,1,2,120,100,90\nx,45as25,40,1,2,11,9,8\n",
            "of a display",
        ),
        ("Geometry,400,500,600\nd/8 SPIN,1,2,3\n", "at geometry 'd/8 SPIN'"),
        ("Name,400,500,600\nA,1,2,3\n", "beside a column of geometries"),
        ("Name,Angle,400,500,600\nA,25,1,2,3\nA,45,1,2,3\nA,75,1,2,3\n", "45as25 ... or 25/0"),
        ("Geometry,400,500\n45/25,1,2\n45/75,1,2\n", "write 45as25 or 45as20"),
        ("Name,45as15 400,45as15 500,45as15 400 nm\nA,1,2,3\n", "row 1: two columns of 400 nm at 45as15"),
        ("Name,45as15 400,45as15 500,45as25 400\nA,1,2,3\nB,1,2,O.3\n", "row 3, column 4: found 'O.3'"),
        ("Name,45as15 400,45as15 500,45as25 400\nA,1,2\n", "row 2, column 4: the row ends after 3"),
        ("nm,45as15,45as25,45as45\n400,1,2,x\n500,1,2,3\n600,1,2,3\n", "row 2, column 4: found 'x'"),
    ],
)
def test_tables_that_hold_no_reflectance_at_a_geometry_are_refused(table, words, tmp_path):
    path = tmp_path / "other.csv"
    path.write_text(table)
    with pytest.raises(FileFormatError, match=words):
        registry.read_all(path)


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    return write_every_format(tmp_path_factory.mktemp("formats"))


def mini_diff(text: str, head: str, cells) -> str:
    """A Mini-Diff's text with another line VARS and other cells."""
    lines = text.split("\r\n")
    start = next(k for k, line in enumerate(lines) if line.startswith("VARS"))
    return "\n".join(
        [*lines[:start], f"VARS {head}", *(cells(line.split(",")) for line in lines[start + 1 :] if line)]
    )


MINI_DIFFS = {
    "decimal commas": lambda t: t.replace(",", ";").replace(".", ","),
    "blanks and decimal commas": lambda t: mini_diff(
        t, "theta_i,phi_i,theta_s,465nm,525nm,630nm", lambda c: " ".join(c).replace(".", ",")
    ),
    "units and case": lambda t: t.replace("theta_i,phi_i,theta_s,465nm", "Theta_I [rad],PHI_I,theta_s [rad],465 nm"),
    "BRDF_465": lambda t: re.sub(r"(\d{3})nm", r"BRDF_\1", t),
    "microns": lambda t: re.sub(r"(\d{3})nm", r"0.\1um", t),
    "phi_s named": lambda t: t.replace("theta_s,465nm", "theta_s,phi_s,465nm"),
    "keys with colons": lambda t: re.sub(r'(?m)^(\w+) "', r'\1: "', t),
    "other order": lambda t: mini_diff(
        t, "phi_s,theta_s,phi_i,theta_i,630nm,525nm,465nm",
        lambda c: ",".join([c[3], c[2], c[1], c[0], c[6], c[5], c[4]]),
    ),
    "degrees": lambda t: mini_diff(
        t, "theta_i,phi_i,theta_s,phi_s,465nm,525nm,630nm",
        lambda c: ",".join([*(f"{np.rad2deg(float(a)):.6f}" for a in c[:4]), *c[4:]]),
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", MINI_DIFFS)
def test_mini_diff_tables_are_read_however_they_are_spelt(files, name, tmp_path):
    path = tmp_path / "table.txt"
    path.write_text(MINI_DIFFS[name](files["mini-diff"].read_bytes().decode()))
    found, straight = registry.read_readings(path), registry.read_readings(files["mini-diff"])
    np.testing.assert_array_equal(found.values, straight.values)
    np.testing.assert_allclose(found.wo, straight.wo, atol=2e-6)  # angles of six decimals
    assert found.bands == MINI_DIFF_BANDS


@pytest.mark.parametrize(
    ("wavelength", "head", "nm"),
    [
        ("WAVELENGTH 0.6328", "VARS theta_i,phi_i,theta_s,phi_s,BRDF", 632.8),
        ("WAVELENGTH 633 nm", "VAR theta_i phi_i theta_s phi_s BRDF(1/sr)", 633.0),
        ("WAVELENGTH 10.6 um", "VARS theta_i,phi_i,theta_s,phi_s,BRDF_sr^-1", 10600.0),
        ("SAMPLE_ID 633", "VARS theta_i,phi_i,theta_s,phi_s,BRDF(1/sr)", 550.0),
        ("WAVELENGTH 0.6328", "VARS theta_i,phi_i,theta_s,phi_s,465nm", 465.0),
        ("WAVELENGTH 0.6328", "VARS theta_i,phi_i,theta_s,phi_s,BRDF_1", 632.8),
    ],
)
def test_the_wavelength_of_an_astm_table_of_one_band_may_stand_in_its_header(wavelength, head, nm, tmp_path):
    path = tmp_path / "black.astm"
    path.write_text(f"LAB_NAME x\n{wavelength}\n{head}\n0.5,3.14,0.4,0,0.02\n0.5,3.14,0.6,0,0.03\n")
    found = registry.read_readings(path).bands
    np.testing.assert_allclose(found.wavelengths_nm, [nm])
    assert str(found) == f"1 band, {nm:.1f} nm"


def test_numbers_of_bands_are_no_wavelengths(tmp_path):
    path = tmp_path / "three.astm"
    path.write_text("VARS theta_i,phi_i,theta_s,phi_s,BRDF_1,BRDF_2,BRDF_3\n0.5,3.14,0.4,0,0.1,0.2,0.3\n")
    with pytest.raises(FileFormatError, match="band 'BRDF_1'"):
        registry.read_all(path)


def test_readings_that_are_brightest_towards_the_light_say_so(files, tmp_path):
    """Where phi_i is counted from the mirror direction, a highlight becomes a retroreflection."""
    readings = registry.read_readings(files["mini-diff"])
    satin = Plastic(GGX.isotropic(0.2), np.array(1.5), np.array([0.05, 0.1, 0.2]), MINI_DIFF_BANDS)
    readings = replace(readings, values=satin.eval(readings.wi, readings.wo))
    path = tmp_path / "satin.astm"
    for turn, expected in ([1.0, 1.0, 1.0], False), ([-1.0, -1.0, 1.0], True):
        astm.write(path, replace(readings, wi=readings.wi * turn))
        notes = registry.read_readings(path).notes
        assert any("towards the light" in note for note in notes) == expected


def test_utia_files_that_are_not_energy_conserving_say_so(files, tmp_path):
    """The database names no unit: other programs take its values for sRGB, or scale them."""
    assert len(registry.read(files["utia"]).notes) == 1
    table = dense(Bands(None), "incident-outgoing", utia.axes())
    utia.write(tmp_path / "bright.bin", replace(table, values=3.0 * table.values))
    notes = registry.read(tmp_path / "bright.bin").notes
    assert any("directional albedo 2.17" in note for note in notes)


CXF_SPELLINGS = {
    "percent": (r"\d\.\d{6,}", lambda m: f"{100 * float(m[0]):.9f}"),
    "commas": (r"(?<=\d) (?=\d)", ", "),
    "wavelengths with a point": (r'StartWL="400"( Increment="10")?', 'StartWL="400.0" Increment="10.0"'),
    "words of a vendor": (
        r"</ns0:Model>",
        "</ns0:Model><ns0:DeviceIllumination>A</ns0:DeviceIllumination>",
    ),
    "increments of the spectra": (
        r'(<ns0:ReflectanceSpectrum [^>]*)>|(?<=WavelengthRange StartWL="400") Increment="10"',
        lambda m: f'{m[1]} NumPoints="31" EndWL="700" Increment="10">' if m[1] else ' Increment="20"',
    ),
}


@pytest.mark.parametrize("name", CXF_SPELLINGS)
def test_cxf_files_are_read_however_they_are_spelt(files, name, tmp_path):
    text, count = re.subn(*CXF_SPELLINGS[name], files["cxf"].read_text())
    assert count
    path = tmp_path / "spelt.cxf"
    path.write_text(text)
    found = registry.read_readings(path)
    np.testing.assert_allclose(found.values, SPECTRO.values, rtol=1e-6)
    assert found.bands == MA_T12_BANDS


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16-le", "utf-16-be", "cp1252"])
def test_cxf_files_are_read_in_every_encoding(files, encoding, tmp_path):
    text = files["cxf"].read_text().replace('Name="smooth"', 'Name="grün 45°"') + "\r\n"
    path = tmp_path / "encoded.cxf"
    path.write_text(("\ufeff" if "16" in encoding else "") + text, encoding=encoding)
    found = registry.read_readings(path)
    assert found.name == "grün 45°"
    np.testing.assert_allclose(found.values, SPECTRO.values, rtol=1e-6)


def test_cxf_spectra_may_be_named_by_their_geometries(files, tmp_path):
    """Where the specification is an integrating sphere's, as exports for want of multi-angle geometries write it."""
    sphere = (
        "<ns0:SphereGeometry><ns0:SphereGeometryConfiguration>Specular_Excluded"
        "</ns0:SphereGeometryConfiguration></ns0:SphereGeometry>"
    )
    text = re.sub(r"<ns0:MultiAngle>.*?</ns0:MultiAngle>", sphere, files["cxf"].read_text(), flags=re.S)
    path = tmp_path / "sphere.cxf"
    path.write_text(text)
    with pytest.raises(FileFormatError, match="no reflectance at directional geometries"):
        registry.read_readings(path)
    path.write_text(re.sub(r'ColorSpecification="M0_(\w+(-\d+)?)"', r'\g<0> Name="\1"', text))
    np.testing.assert_allclose(registry.read_readings(path).values, SPECTRO.values, rtol=1e-6)


def test_cxf_increments_that_contradict_the_last_wavelength_are_refused(files, tmp_path):
    path = tmp_path / "end.cxf"
    spectrum = "<ns0:ReflectanceSpectrum "
    path.write_text(files["cxf"].read_text().replace(spectrum, f'{spectrum}EndWL="1000" '))
    with pytest.raises(FileFormatError, match="EndWL='1000'"):
        registry.read_readings(path)


def lighttools_file(path, brdf) -> None:
    """A table of a BRDF in the bands of a Mini-Diff."""
    degrees = ([0.0, 20.0, 40.0, 60.0], [180.0], np.arange(0.0, 90.0, 5.0), np.arange(0.0, 360.0, 30.0))
    axes = tuple(np.deg2rad(a) for a in degrees)
    shape = (*(a.size for a in axes), 3)
    table = DenseTable("p", "t", "incident-outgoing", axes, np.array([465.0, 525.0, 630.0]), np.zeros(shape))
    lighttools.write(path, replace(table, values=brdf.eval(*table.directions()).reshape(shape)))


def test_lighttools_files_may_hold_zemaxs_words(files, tmp_path):
    text = files["lighttools"].read_text()
    path = tmp_path / "both.bsdf"
    path.write_text(
        text.replace("DataBegin", "SampleRotation 1\n0\nAngleOfIncidence 3\n0 30 60\n\nDataBegin")
    )
    np.testing.assert_array_equal(
        registry.read_readings(path).values, registry.read_readings(files["lighttools"]).values
    )


@pytest.mark.parametrize("rows_turned", [0, 3, 6, 9])
@pytest.mark.parametrize("alpha", [0.2, 0.4])
def test_the_azimuth_of_incidence_in_lighttools_files_is_found_from_the_highlight(
    alpha, rows_turned, tmp_path
):
    """Tables turned by 90, 180 and 270 degrees, as other programs have them, are the same material.

    The rougher one has no peak, but sends most light ahead at steep incidence.
    """
    satin = Plastic(GGX.isotropic(alpha), np.array(1.5), np.array([0.05, 0.1, 0.2]), MINI_DIFF_BANDS)
    lighttools_file(tmp_path / "straight.bsdf", satin)
    lines, out = (tmp_path / "straight.bsdf").read_text().splitlines(), []
    while lines:
        out.append(lines.pop(0))
        if out[-1].startswith("TIS"):
            table, lines = lines[:12], lines[13:]
            table = table[-rows_turned:] + table[:-rows_turned] if rows_turned else table
            out += [*table, table[0]]
    path = tmp_path / "turned.bsdf"
    path.write_text("\n".join(out))
    found = registry.read_readings(path)
    np.testing.assert_allclose(found.values, satin.eval(found.wi, found.wo), rtol=1e-5)


def test_paint_that_is_brightest_towards_the_light_is_not_turned_round(tmp_path):
    paint = next(m for m in isotropic_materials() if m.name == "syn_paint_sand").truth(MINI_DIFF_BANDS)
    lighttools_file(tmp_path / "paint.bsdf", paint)
    found = registry.read_readings(tmp_path / "paint.bsdf")
    np.testing.assert_allclose(found.values, paint.eval(found.wi, found.wo), rtol=1e-5)
    assert any("no highlight" in note for note in found.notes)


@pytest.mark.parametrize(
    "heading", ["#Data generated by Mini-Diff V2", "#Data generated by another goniometer"]
)
def test_the_ramp_of_a_mini_diff_is_dropped_from_lighttools_files_too(heading, tmp_path):
    theta = np.deg2rad(np.arange(0.0, 90.1, 5.0))
    axes = (np.deg2rad([0.0, 40.0]), np.array([np.pi]), theta, np.deg2rad(np.arange(0.0, 360.0, 30.0)))
    table = dense(MINI_DIFF_BANDS, "incident-outgoing", axes)
    values = table.values.copy()
    for k, ramp in ((16, 2 / 3), (17, 1 / 3), (18, 0.0)):
        values[:, :, k] = ramp * values[:, :, 15]
    path = tmp_path / "ramp.bsdf"
    lighttools.write(path, replace(table, values=values))
    path.write_text(path.read_text().replace("#LightTools BSDF", heading))
    found = registry.read_readings(path)
    steepest = np.rad2deg(np.arccos(found.wo[:, 2].min()))
    assert steepest == pytest.approx(75.0 if "Mini" in heading else 90.0, abs=1e-4)


@settings(max_examples=30, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    pairs=st.integers(1, 12),
    bands=st.integers(0, 6),
    seed=st.integers(0, 2**31),
    writer=st.sampled_from([astm, csv_table]),
)
def test_any_readings_survive_tables(pairs, bands, seed, writer, tmp_path):
    rng = np.random.default_rng(seed)
    w = rng.standard_normal((2, pairs, 3))
    w[..., 2] = np.abs(w[..., 2]) + 1e-3
    w /= np.linalg.norm(w, axis=-1, keepdims=True)
    nm = np.sort(rng.choice(np.arange(380, 780), bands, replace=False)).astype(float) if bands else None
    values = np.exp(rng.normal(0.0, 4.0, (pairs, bands or 3)))
    path = tmp_path / ("any.csv" if writer is csv_table else "any.astm")
    writer.write(path, Readings("any", "test", w[0], w[1], nm, values))
    found = registry.read_readings(path)
    np.testing.assert_allclose(found.values, values, rtol=1e-8)  # nine digits
    np.testing.assert_allclose(found.wo, w[1], atol=1e-7)
    assert (found.wavelengths_nm is None) == (nm is None)


def test_texture_and_flake_images_stay_with_the_readings(tmp_path, rng):
    path = tmp_path / "sample.xlsx"
    write_ma_t12(path, smooth(MA_T12_BANDS), "flaky", rng, flakes=True)
    found = registry.read_readings(path)
    assert found.texture["values"][0]["Geometry"] == "15as-45"
    assert found.texture["values"][0]["Coarseness"] > 1.0
    assert list(found.texture["images"]) == list(MA_T12_NAMES[6:])
    assert all(image.startswith(b"\x89PNG") for image in found.texture["images"].values())


def zemax_text(rows, azimuths=(0, 90, 180), radials=(0, 30, 50, 90), comment="# a scatterometer") -> str:
    """A Zemax file of one incidence of 30 degrees, as its users' scripts write them: tabs, half a plane."""
    lists = (
        ("SampleRotation", [0]),
        ("AngleOfIncidence", [30]),
        ("ScatterAzimuth", azimuths),
        ("ScatterRadial", radials),
    )
    lines = [
        comment,
        "Source\tMeasured",
        "Symmetry\tPlaneSymmetrical",
        "SpectralContent\tMonochrome",
        "ScatterType\tBRDF",
    ]
    for key, angles in lists:
        lines += [f"{key}\t{len(angles)}", "\t".join(map(str, angles)) + "\t"]
    rows = ["\t".join(f"{v:.3e}" for v in row) for row in rows]
    return "\n".join([*lines, "", "Monochrome", "DataBegin", "TIS\t0.1", *rows, "DataEnd", ""])


def test_zeros_that_fill_a_zemax_table_up_to_the_horizon_are_not_data(tmp_path):
    """Instruments end at 80 degrees or so; dark directions less steep than others with light are measured."""
    path = tmp_path / "black.bsdf"
    path.write_text(zemax_text([[0.2, 0.1, 0.0, 0.05], [0.2, 0.1, 0.0, 0.0], [0.2, 0.1, 0.0, 0.0]]))
    found = registry.read_readings(path)
    theta = np.rad2deg(np.arccos(found.wo[:, 2]))
    assert sorted(found.values[:, 0]) == [0.0, 0.0, 0.05, 0.1, 0.1, 0.1, 0.2]
    np.testing.assert_allclose(np.sort(theta[found.values[:, 0] == 0.0]), [20.0, 56.17], atol=0.01)
    assert any("1 zeros near the horizon" in note for note in found.notes)
    path.write_text(zemax_text(np.zeros((3, 4))))
    assert len(registry.read_readings(path)) == 8  # those above the horizon


@pytest.mark.parametrize(
    ("comment", "nm"),
    [
        ("# Light source: red laser (650 nm, 3.5mm spot diam.)", 650.0),
        ("# 632.8nm, again 632.8 nm", 632.8),
        ("# 450 nm and 650 nm", 550.0),
        ("# sample 650", 550.0),
    ],
)
def test_comments_of_zemax_files_may_name_the_wavelength(comment, nm, tmp_path):
    path = tmp_path / "laser.bsdf"
    path.write_text(zemax_text(np.ones((3, 4)), comment=comment))
    found = registry.read_readings(path)
    np.testing.assert_allclose(found.wavelengths_nm, [nm])
    assert any("comment" in note for note in found.notes) == (nm != 550.0)

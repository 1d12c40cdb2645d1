"""Damaged and hostile files: every one ends in one clear line, or in a record that is whole."""

from __future__ import annotations

import io
import random
import re
import zipfile

import pytest
from attack.cases import read_whole
from attack.mutations import of_archive, of_bytes
from helpers.instrument_files import SUFFIXES, write_every_format

from manifold.core.errors import ManifoldError
from manifold.formats import registry


@pytest.fixture(scope="module")
def contents(tmp_path_factory):
    paths = write_every_format(tmp_path_factory.mktemp("formats"), is_coarse=True)
    return {name: path.read_bytes() for name, path in paths.items()}


@pytest.mark.parametrize("name", SUFFIXES)
def test_damaged_files_end_in_one_line_or_a_whole_record(contents, name, tmp_path):
    """A fixed number of each format; `make attack` makes them without end."""
    rng, path = random.Random(name), tmp_path / f"mutated{SUFFIXES[name]}"
    for k in range({"merl": 8, "mini-diff": 20, "utia": 20, "mbsdf": 20}.get(name, 60)):
        change = of_archive if name == "ma-t12" and k % 2 else of_bytes
        path.write_bytes(change(contents[name], rng))
        try:
            read_whole(path)
        except ManifoldError as error:
            message = str(error)
            assert path.name in message
            assert "\n" not in message
            assert len(message) < 600


def test_a_zip_bomb_is_refused_before_it_is_unpacked(tmp_path):
    path = tmp_path / "bomb.xlsx"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("xl/workbook.xml", "<workbook/>")
        archive.writestr("xl/worksheets/sheet1.xml", b"<" + bytes(100_000_000))
    with pytest.raises(ManifoldError, match=r"^[^:]*: its 2 parts of XML unpack to 100 MB"):
        registry.read_all(path)


def repacked(data: bytes, path, change) -> None:
    """A workbook with its parts (name, bytes) changed."""
    with (
        zipfile.ZipFile(io.BytesIO(data)) as archive,
        zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as made,
    ):
        for name in archive.namelist():
            made.writestr(*change(name, archive.read(name)))


def test_cells_far_out_do_not_fill_the_memory(contents, tmp_path):
    """In every sheet a few, which a limit for each sheet would let through."""
    rows = b"".join(b'<row r="%d"><c r="XFD%d"><v>1</v></c></row>' % (k, k) for k in range(20, 60))
    path = tmp_path / "far.xlsx"
    repacked(
        contents["ma-t12"], path, lambda n, part: (n, part.replace(b"</sheetData>", rows + b"</sheetData>"))
    )
    with pytest.raises(ManifoldError, match="2000000 cells in total"):
        registry.read_all(path)


def test_shared_strings_that_call_themselves_an_image_are_not_unpacked(contents, tmp_path):
    kind = b"application/vnd.openxmlformats-officedocument.spreadsheetml.sharedStrings+xml"
    override = b'<Override PartName="/xl/media/image.xml" ContentType="%s"/></Types>' % kind

    def hidden(name, part):
        if name == "docProps/app.xml":
            return "xl/media/image.xml", b"<sst>" + b"<si/>" * 10_000_000 + b"</sst>"
        return name, part.replace(b"</Types>", override)

    path = tmp_path / "hidden.xlsx"
    repacked(contents["ma-t12"], path, hidden)
    with pytest.raises(ManifoldError, match="parts of XML unpack to 50 MB"):
        registry.read_all(path)


def test_cxf_spectra_of_thousands_of_wavelengths_are_refused(contents, tmp_path):
    text = contents["cxf"].decode()
    spectrum = re.search(r"<ns0:ReflectanceSpectrum.*?</ns0:ReflectanceSpectrum>", text, re.DOTALL)[0]
    many = "".join(spectrum.replace('StartWL="400"', f'StartWL="{400 + 0.01 * k:.2f}"') for k in range(2000))
    path = tmp_path / "shifted.cxf"
    path.write_text(text.replace(spectrum, many))
    with pytest.raises(ManifoldError, match=r"2011 spectra at .* expected the same wavelengths"):
        registry.read_all(path)


def test_entities_that_grow_are_refused(tmp_path):
    path = tmp_path / "laughs.cxf"
    path.write_text(
        '<?xml version="1.0"?><!DOCTYPE x [<!ENTITY a "aaaaaaaa"><!ENTITY b "&a;&a;&a;&a;">]>'
        '<CxF xmlns="http://colorexchangeformat.com/CxF3-core">&b;</CxF>'
    )
    with pytest.raises(ManifoldError, match="entities"):
        registry.read_all(path)


@pytest.mark.parametrize(
    ("name", "old", "new", "words"),
    [
        ("lighttools", rb"ScatterRadial \d+", b"ScatterRadial 99999999", "count"),
        ("zemax", rb"ScatterAzimuth \d+", b"ScatterAzimuth -3", "count"),
        ("mini-diff", rb"NUM_POINTS \d+", b"NUM_POINTS 99999", "truncated"),
        ("mini-diff", rb"NUM_POINTS \d+", b"NUM_POINTS 1e300", "count"),
        ("astm", rb"(VARS.*\n[^\n]*\n[^,\n]*),", rb"\1,nan,", "cells"),
        ("pab-opto", rb"#incident_angle.*\n#intheta.*\n", b"", "incidence"),
        ("csv", rb"\n45", b"\n195", "theta_i reaches 195"),
        ("astm", rb",\d\.\d+\n", b",1e250\n", "value of 1e"),
        ("cxf", rb"CxF3-core", b"CxF2-core", "older version"),
        ("lighttools", rb"Wavelength \d+", b"Colour red", "named by Wavelength"),
        (
            "zemax",
            rb"(?s)XYZ(.*)TristimulusX(.*)TristimulusY(.*)TristimulusZ",
            rb"RGB\1Red\2Green\3Blue",
            "SpectralContent RGB, expected",
        ),
    ],
)
def test_what_is_wrong_is_named(contents, name, old, new, words, tmp_path):
    data, count = re.subn(old, new, contents[name], count=0 if name == "cxf" else 1)
    assert count
    path = tmp_path / f"wrong{SUFFIXES[name]}"
    path.write_bytes(data)
    with pytest.raises(ManifoldError, match=words):
        registry.read_all(path)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "empty file"),
        (b"\x89HDF\r\n\x1a\n" + bytes(64), "HDF5"),
        (b"<!DOCTYPE html><html>cxf</html>", "HTML"),
        (b"tensor_file\0" + bytes(40), "RGL"),
        (b"SCATFUN" + bytes(40), "Fourier BSDF"),
        (b"<?xml version='1.0'?><WindowElement/>", "Radiance"),
        (b"PK\x03\x04word", "not a readable workbook"),
        (b"<?xml version='1.0'?><svg/>", "an XML document"),
        (b"<?xml version='1.0'?>\n<WindowElement>\n<ScatteringData>\n412.3, 380.1, 155.2,\n", "WINDOW BSDF"),
        (b"<WindowElement>\n<Note>\ntheta_i, theta_o, BRDF\n30, 20, 0.1\n</Note>", "WINDOW BSDF"),
        (b"NVIDIA ARC MBSDF V2\nMBSDF_DATA=\n", "MDL .* of an unknown version"),
        (b"Mini-Diff\nScatterType BRDF\nAOI 30\n0.1 0.2\n", "Mini-Diff"),
        (b"OPTIS - Coated surface file v1.0\nmirror\n2 2\n", "a surface file of Ansys Speos"),
        (b"TracePro Surface Property Data\nFile Name\tx\nTable_BSDF_Data\n", "TracePro"),
        (b"Surface\n\nTable_BSDF_Data\nTemperature\tWavelength\n", "TracePro"),
        (b"!! paint\nMODELS\n  BSDFDATA 'paint' ANGLES\n", "a scatter model of ASAP"),
        (b"#?RADIANCE\nFORMAT=BSDF_RBFmesh\n\n\0\1", "of Radiance"),
        (b"VERSION 0.2\n\nDATA_TYPE brdf\nPARAM0_LIST 0\nDATA ascii\n0.3\n", "SSDD"),
        (b";; x\nSource Measured\nTypeSym PSYM\nTypeColorModel BW\nsigma 2\n 0 30\n", "Integra"),
        (b"#ALTA HEADER BEGIN\n#DIM 2 3\n#PARAM_IN COS_TH_TD\n0.1 0.2 1 1 1\n", "ALTA"),
        (b"analytic\n::begin parameters\n::begin shader\n", "BRDF Explorer"),
        (b"#  \tLongDim\nSphereMesh:\t3\t2\t0\t0\t360\t90\n1\t2\t3\n", "LightTools"),
        (b"REFLET\nPhi measure step : 10\nTheta Lighting : 0\n-90\t0.01\n", "REFLET measurement"),
        (b"H|\\^&|||Host^1\nP|1\nO|1|123\n", "clinical analyser"),
        (b"just words\n" * 9, "text file"),
        (b"in the Software without restriction, including without limitation the rights\n", "a text file"),
        (b"Ask for the Zemax file; LightTools and REFLET, too.\nThe ScatterType is a BRDF.\n", "a text file"),
        (b"notes on <html> pages and <?xml files\n", "a text file"),
        (b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1" + bytes(600), "not a readable .xls workbook"),
        (("15\u00b0, 25\u00b0\n" * 9).encode(), "text file"),
    ],
)
def test_foreign_files_are_named_for_what_they_are(content, words, tmp_path):
    for suffix in (".bsdf", ".xlsx", ".binary", ".bin", ".csv", ".astm"):
        path = tmp_path / f"foreign{suffix}"
        path.write_bytes(content)
        with pytest.raises(ManifoldError, match=words):
            registry.read_all(path)

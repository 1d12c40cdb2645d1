"""Files of optical simulators and sensors' materials, FRED, Ansys Speos and OpenMATERIAL 3D, and of the RT-300S."""

from __future__ import annotations

import json
import re
from dataclasses import replace

import numpy as np
import pytest
from helpers.instrument_files import dense, lighttools_axes, smooth, write_every_format, write_rt300s
from helpers.paths import REPOSITORY

from manifold.analytic.ggx import GGX
from manifold.analytic.microfacet import Plastic
from manifold.analytic.virtual_instruments import MINI_DIFF_BANDS
from manifold.cli.main import run
from manifold.colour.conversion import luminance
from manifold.convert.conversion import convert
from manifold.convert.tabulated import ReadingsBRDF
from manifold.core.directions import from_spherical
from manifold.core.errors import FileFormatError, UsageError
from manifold.core.records import Bands
from manifold.formats import openmaterial, registry, speos
from manifold.formats.dense import DenseTable

REAL = REPOSITORY.parent / "shared" / "files"
needs_real_files = pytest.mark.skipif(not REAL.is_dir(), reason="the files of instruments are not here")
ONE = Bands((550.0,))


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    return write_every_format(tmp_path_factory.mktemp("formats"))


def changed(path, folder, *replacements, count=1):
    text = path.read_text()
    for old, new in replacements:
        assert old in text
        text = text.replace(old, new, count)
    other = folder / path.name
    other.write_text(text, newline="")
    return other


def refusal(path) -> str:
    with pytest.raises(FileFormatError) as error:
        registry.read_all(path)
    return str(error.value)


def mirror_of_the_brightest(readings):
    """The mirror direction of wi, and wo, of the brightest reading."""
    brightest = np.argmax(readings.values[:, 0])
    return readings.wi[brightest] * [-1.0, -1.0, 1.0], readings.wo[brightest]


# --- FRED ---


def test_fred_incidences_name_the_mirror_direction(tmp_path):
    path = tmp_path / "x.txt"
    rows = "30\t150\n0\t0\t0.1\n30\t150\t0.9\n30\t330\t0.2\n"
    path.write_text("type bsdf_data\nformat angles=deg bsdf=value scale=1\n" + rows)
    (found,) = registry.read_all(path)
    mirror, wo = mirror_of_the_brightest(found)
    np.testing.assert_allclose(mirror, wo, atol=1e-12)
    np.testing.assert_allclose(found.wi[0], from_spherical(np.deg2rad(30.0), np.deg2rad(330.0)), atol=1e-12)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("scale=1", "scale=2", "scale=2', expected 'format angles=deg bsdf=value scale=1"),
        ("bsdf=value", "bsdf=log", "bsdf=log"),
        ("30\t0\n", "30\t0\n60\t0\n", "2 numbers, expected theta phi value"),
        ("0\t0\n0\t0\t", "0\t0\t", "3 numbers, expected theta phi of an incidence"),
    ],
)
def test_a_fred_table_that_says_something_else_is_refused(files, old, new, words, tmp_path):
    assert words in refusal(changed(files["fred"], tmp_path, (old, new)))


@needs_real_files
def test_real_fred_and_zemax_files_of_one_coating_agree():
    folder = REAL / "bsdf-tools"
    fred, whole, zemax = (
        registry.read_readings(folder / f"AnoBlackEC1onAlum{end}") for end in (".txt", "_fullAz.txt", ".bsdf")
    )
    assert (len(fred), len(whole)) == (1144, 2175)
    steep = zemax.wo[:, 2] > 0.2
    ratio = ReadingsBRDF(whole).eval(zemax.wi[steep], zemax.wo[steep]) / zemax.values[steep]
    assert 0.9 < np.median(ratio) < 1.1
    np.testing.assert_allclose(ReadingsBRDF(fred).eval(whole.wi, whole.wo), whole.values, rtol=1e-4)


# --- Ansys Speos ---


PHI = "\t" + "\t".join(str(k) for k in range(0, 361, 30))


def speos_table(values) -> str:
    """A table every degree of elevation that is the same at all azimuths."""
    rows = [f"{k}\t" + "\t".join([f"{v:.9g}"] * 13) for k, v in enumerate(values)]
    return "\n".join(["91 13", PHI, *rows]) + "\n"


def speos_brdf(*, is_bsdf: bool, percent: float, break_: str = "\n", described: str = "") -> bytes:
    """A perfect diffuser, in units that Speos scales."""
    cosine = np.cos(np.deg2rad(np.arange(91.0)))
    tables = f"{percent}\n{speos_table(7.0 * (np.ones(91) if is_bsdf else cosine))}" * 2
    described = described.replace("\n", break_)
    head = f"OPTIS - brdf surface file v9.0\n0\ncomment\n{len(described)}\n"
    rest = f"\n1\t0\n{int(is_bsdf)}\n2\t1\n0 40\n550\n{tables}End of file\n"
    return (head.replace("\n", break_) + described + rest.replace("\n", break_)).encode()


@pytest.mark.parametrize("is_bsdf", [True, False])
@pytest.mark.parametrize("break_", ["\n", "\r\n", "\r"])
def test_speos_scales_values_and_intensities_to_the_percentage(is_bsdf, break_, tmp_path):
    path = tmp_path / "half.brdf"
    path.write_bytes(speos_brdf(is_bsdf=is_bsdf, percent=50.0, break_=break_, described="two\nlines 1 0\n"))
    (found,) = registry.read_all(path)
    np.testing.assert_allclose(found.values, 0.5 / np.pi, rtol=2e-4)  # trapezoids of a degree
    assert found.wi[-1, 0] < 0.0 < found.wo[:, 0].max()


def anisotropic_speos(wavelengths: str, angles="1\n0\n2\n0 40\n", has_transmission=False) -> bytes:
    values = np.ones(91)
    transmission = "1\n0\n2\n0 40\n" if has_transmission else ""
    spectra = f"40\t0\ntitle\n{wavelengths}" + (f"0\t0\n\n{wavelengths}" if has_transmission else "")
    count = 2 * (1 if angles.startswith("1") else 2)
    tables = speos_table(values) + speos_table(2.0 * values) + speos_table(3.0 * values) * (count - 2)
    head = f"OPTIS - Anisotropic BSDF surface file v11\n0\n\n0\n\n1\t0\t0\n1\t{int(has_transmission)}\n1\n"
    return (head + angles + transmission + spectra + tables).encode()


@pytest.mark.parametrize("has_transmission", [True, False])
def test_the_spectrum_of_an_anisotropic_file_scales_all_its_tables(has_transmission, tmp_path):
    path = tmp_path / "x.anisotropicbsdf"
    path.write_bytes(anisotropic_speos("2\n400\t20\n700\t60\n", has_transmission=has_transmission))
    (found,) = registry.read_all(path)
    assert found.bands.wavelengths_nm == (400.0, 700.0)
    is_first = np.isclose(found.wi[:, 2], 1.0)
    for rows, reflected in (
        (is_first, [0.1, 0.3]),
        (~is_first, [0.2, 0.6]),
    ):  # the spectrum is that at 40 degrees
        np.testing.assert_allclose(np.pi * found.values[rows].mean(axis=0), reflected, rtol=2e-4)
    assert any("transmission" in note for note in found.notes) == has_transmission


def test_a_flat_spectrum_is_one_band_and_a_turn_of_360_is_that_of_0(tmp_path):
    path = tmp_path / "x.anisotropicbsdf"
    path.write_bytes(anisotropic_speos("2\n400\t20\n700\t20\n", "2\n0 360\n2\n0 40\n2\n0 40\n"))
    (found,) = registry.read_all(path)
    assert (found.bands.count, len(found)) == (1, 2 * (1 + 12 * 89))


def test_an_anisotropic_sample_comes_back_from_speos(tmp_path):
    material = Plastic(GGX.anisotropic(0.2, 0.5), np.array(1.5), np.array([0.2]), ONE)
    degrees = ([20.0, 50.0], [0.0, 30.0, 210.0], np.arange(0.0, 90.0, 5.0), np.arange(0.0, 360.0, 15.0))
    axes = tuple(np.deg2rad(a) for a in degrees)
    table = DenseTable(
        "brushed", "x", "incident-outgoing", axes, np.array([550.0]), np.zeros((2, 3, 18, 24, 1))
    )
    values = material.eval(*table.directions()).reshape(table.values.shape)
    speos.write_anisotropic(tmp_path / "x.anisotropicbsdf", replace(table, values=values))
    found = registry.read_readings(tmp_path / "x.anisotropicbsdf")
    assert len(found) == 6 * (1 + 17 * 24)
    np.testing.assert_allclose(found.values, material.eval(found.wi, found.wo), rtol=1e-5)
    assert not ReadingsBRDF(found).is_isotropic


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("file v8.0", "file v1.0", "version 1, expected 7 or newer"),
        ("v8.0\n0\n", "v8.0\n1\n", "mode '1', expected 0"),
        ("1\t0\n1\n", "0\t1\n1\n", "transmission only"),
        ("\t360\n", "\t350\n", "azimuths of a full turn"),
        ("19 13\n", "20 13\n", "elevations that increase"),
    ],
)
def test_a_speos_file_that_cannot_be_read_says_why(files, old, new, words, tmp_path):
    assert words in refusal(changed(files["speos"], tmp_path, (old, new)))


@needs_real_files
def test_a_real_speos_file_of_the_oldest_version_is_refused_by_its_version():
    assert "version 1, expected 7 or newer" in refusal(REAL / "bsdf-tools" / "test_speos.rtd")


# --- OpenMATERIAL 3D ---


def test_openmaterial_has_its_mirror_direction_half_a_turn_from_the_light(tmp_path):
    path = tmp_path / "x.xompt"
    rows = [[5e-7, 0.5, 0.0, 0.0, 0.1], [5e-7, 0.5, 0.5, 0.0, 0.2], [5e-7, 0.5, 0.5, 3.141593, 0.9]]
    path.write_text(
        json.dumps({"$schema": "OpenMATERIAL", "brdf": {"wavelengths": [5e-7], "lookupTable": rows}})
    )
    (found,) = registry.read_all(path)
    np.testing.assert_allclose(*mirror_of_the_brightest(found), atol=1e-6)
    assert found.bands.wavelengths_nm == (500.0,)


def table_of(path) -> tuple[dict, list]:
    content = json.loads(path.read_text())
    return content, content["brdf"]["lookupTable"]


def test_values_that_are_null_or_absent_are_not_measured(files, tmp_path):
    content, rows = table_of(files["openmaterial"])
    rows[3][4] = None
    del rows[5]
    path = tmp_path / "gaps.xompt"
    path.write_text(json.dumps(content))
    found, whole = registry.read_readings(path), registry.read_readings(files["openmaterial"])
    assert np.isnan(found.values).sum() == 2
    np.testing.assert_array_equal(found.values[found.measured], whole.values[found.measured])


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda rows: rows.append(rows[0]), "two rows of the same wavelength and directions"),
        (lambda rows: rows[1].pop(), "row 2: found"),
        (lambda rows: rows[1].__setitem__(2, None), "row 2: theta_o is None, expected a number"),
        (lambda rows: rows[1].__setitem__(4, -0.1), "row 2: BRDF is -0.1"),
        (lambda rows: rows[1].__setitem__(0, "red"), "row 2: wavelength is red"),
        (lambda rows: rows[1].__setitem__(0, 450), "a wavelength of 450, expected metres"),
        (lambda rows: rows[1].__setitem__(3, 30), "probably degrees, expected radians"),
        (lambda rows: rows[1].__setitem__(1, 30), "probably degrees, expected radians"),
        (lambda rows: rows.clear(), "an empty brdf.lookupTable"),
    ],
)
def test_rows_that_are_not_what_their_columns_hold_are_named(files, change, words, tmp_path):
    content, rows = table_of(files["openmaterial"])
    change(rows)
    path = tmp_path / "wrong.xompt"
    path.write_text(json.dumps(content))
    assert words in refusal(path)


def test_wavelengths_in_other_units_are_refused_in_every_format(files, tmp_path):
    path = tmp_path / "micrometres.brdf"
    text, count = re.subn(
        r"\b465\b(.*)\b525\b(.*)\b630\b", r"0.465\1 0.525\2 0.630", files["speos"].read_text()
    )
    assert count
    path.write_text(text)
    assert "bands of 0.465 to 0.63 nm, expected 100" in refusal(path)


def test_the_same_table_is_written_as_the_same_file(files, tmp_path):
    openmaterial.write(
        tmp_path / "again.xompt", dense(MINI_DIFF_BANDS, "incident-outgoing", lighttools_axes())
    )
    assert (tmp_path / "again.xompt").read_text() == files["openmaterial"].read_text()


@needs_real_files
def test_what_is_written_is_valid_by_the_schema_of_openmaterial(tmp_path):
    import jsonschema

    schema = json.loads((REAL / "openmaterial" / "material_brdf_schema.json").read_text())
    axes = tuple(np.deg2rad(a) for a in ([0.0, 90.0], [180.0], [0.0, 45.0, 90.0], [0.0, 120.0, 240.0]))
    table = DenseTable(
        "x", "x", "incident-outgoing", axes, np.array([385.6523, 500.0]), np.ones((2, 1, 3, 3, 2))
    )
    openmaterial.write(tmp_path / "x.xompt", table)
    content, rows = table_of(tmp_path / "x.xompt")
    jsonschema.validate(content, schema)
    assert rows == sorted(rows)
    assert {row[0] for row in rows} == set(content["brdf"]["wavelengths"])


@needs_real_files
def test_a_real_table_of_asphalt_holds_its_spectra():
    (found,) = registry.read_all(REAL / "openmaterial" / "example_material_camera_brdf.xompt")
    assert (found.name, len(found), found.bands.count) == ("asphalt_brdf_for_camera", 59, 32)
    assert found.bands.wavelengths_nm[0] == 390.0
    assert found.values.min() == 1.4e-5
    assert found.values.max() == 2.6e-5


# --- RT-300S ---


def test_sheets_of_an_rt300s_are_one_sample_without_what_the_receiver_obscures(tmp_path):
    angles = [(-90.0, 30.0, r) for r in (-60.0, -35.0, -30.0, 0.0, 30.0)] + [
        (0.0, 30.0, 90.0),
        (0.0, 30.0, 20.0),
    ]
    write_rt300s(tmp_path / "x.xls", smooth(ONE), angles, titles=2)
    (found,) = registry.read_all(tmp_path / "x.xls")
    assert len(found) == 4
    assert any(note.startswith("2 readings within 10 degrees of the light") for note in found.notes)
    mirror = found.wi[0] * [-1.0, -1.0, 1.0]
    assert np.max(found.wo @ mirror) == pytest.approx(1.0)
    np.testing.assert_allclose(found.values, smooth(ONE).eval(found.wi, found.wo), rtol=1e-12)


def test_other_old_workbooks_are_refused(tmp_path):
    import xlwt

    book = xlwt.Workbook()
    book.add_sheet("Data").write(0, 0, "Azimuth")
    book.save(str(tmp_path / "x.xls"))
    assert "sheet 'Data': no row Incidence, expected an RT-300S" in refusal(tmp_path / "x.xls")


@needs_real_files
def test_counts_of_a_real_rt300s_that_was_not_calibrated_are_refused():
    assert "RT is -526 to -254: counts of the detector" in refusal(REAL / "bsdf-tools" / "test_excel.xls")


# --- Conversions ---


def error_of(path, expected) -> float:
    """Of the values in a file, relative to those of the material, away from the horizon."""
    back = registry.read_readings(path)
    inside = np.minimum(back.wi[:, 2], back.wo[:, 2]) > 0.3
    f = expected(back.wi[inside], back.wo[inside])
    return float(np.linalg.norm(back.values[inside] - f) / np.linalg.norm(f))


def test_formats_of_one_band_get_the_luminance(files, tmp_path):
    material = smooth(Bands(None))
    made = convert([files["utia"]], tmp_path / "fred.txt", to="fred")
    assert made.errors.linear < 0.005
    assert any("luminance (CIE Y under D65)" in note for note in made.notes)
    found = error_of(tmp_path / "fred.txt", lambda *w: luminance(material.eval(*w), Bands(None))[:, None])
    assert found < 0.005


def test_formats_of_wavelengths_refuse_linear_srgb(files, tmp_path):
    for name in ("x.brdf", "x.xompt"):
        with pytest.raises(UsageError, match="linear sRGB, but"):
            convert([files["merl"]], tmp_path / name)
        assert not (tmp_path / name).exists()


def test_spectra_survive_speos_openmaterial_and_back(files, tmp_path):
    first = convert([files["mini-diff"]], tmp_path / "x.brdf")
    second = convert([tmp_path / "x.brdf"], tmp_path / "x.xompt")
    third = convert([tmp_path / "x.xompt"], tmp_path / "x.csv")
    assert max(made.errors.linear for made in (first, second, third)) < 0.002
    assert error_of(tmp_path / "x.csv", smooth(MINI_DIFF_BANDS).eval) < 0.003


def test_info_shows_what_such_a_file_holds(files, capsys):
    with pytest.raises(SystemExit, match="0"):
        run(["info", str(files["openmaterial"])])
    shown = capsys.readouterr().out
    assert "theta_i in degrees" in shown
    assert "readings" in shown

"""Text files of goniometers and simulators, and CxF3, as programs really write them."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from helpers.instrument_files import dense, lighttools_axes, smooth, write_every_format
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from manifold.analytic.corpus import isotropic_materials
from manifold.analytic.ggx import GGX
from manifold.analytic.microfacet import Plastic
from manifold.analytic.virtual_instruments import MA_T12_BANDS, MINI_DIFF_BANDS, ma_t12_readings
from manifold.core.directions import from_spherical
from manifold.core.errors import FileFormatError, UsageError
from manifold.core.records import Bands
from manifold.formats import astm, csv_table, lighttools, registry, utia
from manifold.formats.dense import DenseTable
from manifold.formats.readings import Readings

SPECTRO = ma_t12_readings(smooth(MA_T12_BANDS), "smooth")
# theta_i, phi_i, theta_o, phi_o in degrees
SCAN = np.array([(20.0, 180.0, o, phi) for o in (10.0, 40.0, 80.0) for phi in (0.0, 75.0, 180.0)])


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    return write_every_format(tmp_path_factory.mktemp("formats"), is_coarse=True)


LINE_ENDS = {
    "CR": lambda text: text.replace("\n", "\r").encode(),
    "CR LF": lambda text: text.replace("\n", "\r\n").encode(),
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
    "custom spectra": (
        r"<ns0:ReflectanceSpectrum [^>]*(ColorSpecification=\S*\")[^>]*>([^<]*)</ns0:ReflectanceSpectrum>",
        lambda m: (
            f"<ns0:CustomSpectrum {m[1]}>"
            + "".join(
                f'<ns0:SpectralPoint WL="{400 + 10 * k}">{value}</ns0:SpectralPoint>'
                for k, value in reversed(list(enumerate(m[2].split())))
            )
            + "</ns0:CustomSpectrum>"
        ),
    ),
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


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16-le", "cp1252"])
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


def cxf_at_45_0(spectra: dict[str, float], device="") -> str:
    """One object at 45/0, a flat spectrum for each colour specification."""
    body = "".join(
        f'<ReflectanceSpectrum StartWL="400" ColorSpecification="{key}">{" ".join([str(value)] * 4)}'
        "</ReflectanceSpectrum>"
        for key, value in spectra.items()
    )
    specifications = "".join(
        f'<ColorSpecification Id="{key}"><MeasurementSpec><GeometryChoice><SingleAngle>'
        "<IlluminationAngle>45</IlluminationAngle><MeasurementAngle>0</MeasurementAngle></SingleAngle>"
        f"</GeometryChoice>{device.format(key)}</MeasurementSpec></ColorSpecification>"
        for key in spectra
    )
    return (
        '<CxF xmlns="http://colorexchangeformat.com/CxF3-core"><Resources><ObjectCollection><Object Name="paper">'
        f"<ColorValues>{body}</ColorValues></Object></ObjectCollection><ColorSpecificationCollection>{specifications}"
        "</ColorSpecificationCollection></Resources></CxF>"
    )


def test_cxf_reflectance_is_never_taken_as_percent(tmp_path):
    """CxF3 has 1.0 for the perfect diffuser; fluorescent colours reflect more."""
    path = tmp_path / "orange.cxf"
    path.write_text(cxf_at_45_0({"A": 2.1}))
    np.testing.assert_allclose(np.pi * registry.read_readings(path).values, 2.1)
    path.write_text(cxf_at_45_0({"A": 85.0}))
    with pytest.raises(
        FileFormatError, match=r"'paper': reflectance of up to 85, expected 1\.0 .* divide per cent"
    ):
        registry.read_all(path)


@pytest.mark.parametrize("device", ["", "<Device><DeviceIllumination>{}_lamp</DeviceIllumination></Device>"])
def test_cxf_measuring_conditions_are_samples_not_averaged(device, tmp_path):
    path = tmp_path / "paper.cxf"
    path.write_text(cxf_at_45_0({"M1": 1.1, "M2": 0.9}, device))
    first, second = registry.read_all(path)
    assert [one.name for one in (first, second)] == (
        ["paper (M1_lamp)", "paper (M2_lamp)"] if device else ["paper (M1)", "paper (M2)"]
    )
    np.testing.assert_allclose(np.pi * first.values, 1.1)
    np.testing.assert_allclose(np.pi * second.values, 0.9)
    with pytest.raises(UsageError, match="name one of them"):
        registry.read_readings(path)


def test_cxf_increments_that_contradict_the_last_wavelength_are_refused(files, tmp_path):
    path = tmp_path / "end.cxf"
    spectrum = "<ns0:ReflectanceSpectrum "
    path.write_text(files["cxf"].read_text().replace(spectrum, f'{spectrum}EndWL="1000" '))
    with pytest.raises(FileFormatError, match="EndWL='1000'"):
        registry.read_readings(path)


@pytest.mark.parametrize(
    ("count", "attributes", "last_nm", "words"),
    [
        (31, 'StartWL="400"', 700.0, "no Increment of wavelengths is stated: taken as 10 nm, up to 700 nm"),
        (39, 'StartWL="400"', 780.0, "no Increment of wavelengths is stated: taken as 10 nm, up to 780 nm"),
        (31, 'StartWL="400" EndWL="1000"', 1000.0, None),
        (61, 'StartWL="400" EndWL="700"', 700.0, None),
        (61, 'StartWL="400" Increment="5"', 700.0, None),
        (61, 'StartWL="400" Interval="10"', 1000.0, None),
    ],
)
def test_cxf_increments_are_stated_or_noted(count, attributes, last_nm, words, tmp_path):
    text = cxf_at_45_0({"A": 0.5}).replace('StartWL="400"', attributes)
    (tmp_path / "a.cxf").write_text(text.replace(" ".join(["0.5"] * 4), " ".join(["0.5"] * count)))
    found = registry.read_readings(tmp_path / "a.cxf")
    assert found.bands.wavelengths_nm[0] == 400.0
    assert found.bands.wavelengths_nm[-1] == pytest.approx(last_nm)
    assert (words in found.notes) if words else (found.notes == ())


def test_cxf_wavelengths_beyond_light_need_an_increment(tmp_path):
    """They were taken as 400 to 1000 nm, without a note."""
    text = cxf_at_45_0({"A": 0.5})
    (tmp_path / "a.cxf").write_text(text.replace(" ".join(["0.5"] * 4), " ".join(["0.5"] * 61)))
    with pytest.raises(
        FileFormatError, match=r"61 values from 400 nm without an Increment, .* end at 1000 nm"
    ):
        registry.read_readings(tmp_path / "a.cxf")


def cxf_objects(*objects: tuple[str, dict[str, str], str]) -> str:
    """Objects named red, of a type, with tags, at a geometry."""
    items = "".join(
        f'<Object ObjectType="{kind}" Name="red"><ColorValues><ReflectanceSpectrum Name="{geometry}" StartWL="400" '
        f'Increment="100">0.{k} 0.2 0.3 0.4</ReflectanceSpectrum></ColorValues><TagCollection Name="t">'
        + "".join(f'<Tag Name="{name}" Value="{value}"/>' for name, value in tags.items())
        + "</TagCollection></Object>"
        for k, (kind, tags, geometry) in enumerate(objects, start=1)
    )
    return (
        '<CxF xmlns="http://colorexchangeformat.com/CxF3-core"><Resources><ObjectCollection>'
        f"{items}</ObjectCollection></Resources></CxF>"
    )


def test_cxf_types_and_tints_tell_objects_apart(tmp_path):
    """Objects of one name at different geometries were joined; tints were listed as texture."""
    path = tmp_path / "a.cxf"
    path.write_text(cxf_objects(("Standard", {}, "45as15"), ("Trial", {}, "45as45"), ("Trial", {}, "45as15")))
    found = {one.name: len(one) for one in registry.read_all(path)}
    assert found == {"red: Standard": 1, "red: Trial": 2}
    tints = [{"Tint": tint, "Background": "Black", "Graininess": "3"} for tint in ("0", "100")]
    path.write_text(
        cxf_objects(
            *(("Target", tags, geometry) for tags, geometry in zip(tints, ("45as15", "45as45"), strict=True))
        )
    )
    solid, ink = registry.read_all(path)
    assert [one.name for one in (solid, ink)] == [
        "red: Tint 0, Background Black",
        "red: Tint 100, Background Black",
    ]
    assert (ink.texture["t"], ink.notes) == ({"Graininess": "3"}, ("Tint 100, Background Black",))


def lighttools_file(path, brdf) -> None:
    """Write a table of a BRDF in the bands of a Mini-Diff, without the package's comment on the light's azimuth."""
    degrees = ([0.0, 20.0, 40.0, 60.0], [180.0], np.arange(0.0, 90.0, 5.0), np.arange(0.0, 360.0, 30.0))
    axes = tuple(np.deg2rad(a) for a in degrees)
    shape = (*(a.size for a in axes), 3)
    table = DenseTable("p", "t", "incident-outgoing", axes, np.array([465.0, 525.0, 630.0]), np.zeros(shape))
    lighttools.write(path, replace(table, values=brdf.eval(*table.directions()).reshape(shape)))
    path.write_text(re.sub(r"#incidence at .*\n", "", path.read_text()))


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
def test_the_azimuth_of_incidence_in_lighttools_files_is_found_from_the_highlight(rows_turned, tmp_path):
    """Tables turned by 90, 180 and 270 degrees, as other programs have them, are the same material."""
    satin = Plastic(GGX.isotropic(0.2), np.array(1.5), np.array([0.05, 0.1, 0.2]), MINI_DIFF_BANDS)
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
def test_random_readings_are_the_same_after_writing_and_reading_a_table(pairs, bands, seed, writer, tmp_path):
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


def test_tables_that_this_program_wrote_are_brdf_however_bright(tmp_path):
    wi, wo = from_spherical(np.full(8, 0.7), np.pi), from_spherical(np.linspace(0.0, 1.0, 8), 1.5)
    csv_table.write(tmp_path / "bright.csv", Readings("bright", "test", wi, wo, None, np.full((8, 3), 20.0)))
    found = registry.read_readings(tmp_path / "bright.csv")
    np.testing.assert_allclose(found.values, 20.0)
    assert not any("no unit" in note for note in found.notes)


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
    path.write_text(zemax_text([[0.2, 0.1, 0.03, 0.05], [0.2, 0.1, 0.0, 0.0], [0.2, 0.1, 0.0, 0.0]]))
    found = registry.read_readings(path)
    theta = np.rad2deg(np.arccos(found.wo[:, 2]))
    assert sorted(found.values[:, 0]) == [0.0, 0.03, 0.05, 0.1, 0.1, 0.1, 0.2]
    np.testing.assert_allclose(theta[found.values[:, 0] == 0.0], [56.17], atol=0.01)
    assert any("1 zeros near the horizon" in note for note in found.notes)
    path.write_text(zemax_text(np.zeros((3, 4))))
    assert len(registry.read_readings(path)) == 8  # those above the horizon


@pytest.mark.parametrize(
    ("comment", "nm"),
    [
        ("# Light source: red laser (650 nm, 3.5mm spot diam.)", 650.0),
        ("# 632.8nm, again 632.8 nm", 632.8),
        ("# 450 nm and 650 nm", 550.0),
        ("#Wavelength (nm) = 850.0", 850.0),
        ("# wavelength 0.85 um, roughness 1.20 um", 850.0),
        ("# 0.85 um", 850.0),
        ("# CO2 laser, 10.6 um", 10600.0),
        ("# lambda [\u00b5m]: 0.6328, stray light below 400 nm", 632.8),
        ("# 350-850 nm", 550.0),
        ("# roughness 0.40 um", 550.0),
        ("# sample 650", 550.0),
    ],
)
def test_comments_of_zemax_files_may_name_the_wavelength(comment, nm, tmp_path):
    path = tmp_path / "laser.bsdf"
    path.write_text(zemax_text(np.ones((3, 4)), comment=comment))
    found = registry.read_readings(path)
    np.testing.assert_allclose(found.wavelengths_nm, [nm])
    assert any("comment" in note for note in found.notes) == (nm != 550.0)


ONE_BAND = {
    "lighttools": lambda path: lighttools.write(
        path, dense(Bands((700.0,)), "incident-outgoing", lighttools_axes())
    ),
    "pab-opto": lambda path: path.write_text(
        "#wavelength 700\n#incident_angle 30 180\n#format: theta phi BSDF\n0 0 0.1\n30 0 0.2\n"
    ),
    "astm": lambda path: path.write_text(
        "WAVELENGTH 700\nVARS theta_i,phi_i,theta_s,phi_s,BRDF\n0.5,3.1,0.4,0,0.1\n"
    ),
    "csv": lambda path: path.write_text(
        "# WAVELENGTH 700\ntheta_i,phi_i,theta_o,phi_o,BRDF\n30,180,20,0,0.1\n"
    ),
}


@pytest.mark.parametrize("name", ONE_BAND)
def test_a_comment_may_name_the_wavelength_in_every_text_format(name, tmp_path):
    path = tmp_path / "laser.txt"
    ONE_BAND[name](path)
    said = "# Wavelength (nm) = 850.0\n"
    path.write_text(said + re.sub(r"(?i)# ?wavelength 700\n|wavelength 700\n", "", path.read_text()))
    assert registry.read_readings(path).bands.wavelengths_nm == (850.0,)


@pytest.mark.parametrize(("tis", "is_said"), [("0.9", True), ("0.05", False)])
def test_a_tis_that_the_values_of_a_zemax_table_contradict_is_said(tis, is_said, tmp_path):
    """A constant of 0.015 is 0.047 (pi f); few nodes integrate to that within a tenth."""
    path = tmp_path / "tis.bsdf"
    rows = np.full((7, 19), 0.015)
    text = zemax_text(rows, azimuths=range(0, 181, 30), radials=range(0, 181, 10))
    path.write_text(text.replace("TIS\t0.1", f"TIS\t{tis}"))
    notes = [note for note in registry.read_readings(path).notes if "TIS" in note]
    assert len(notes) == is_said
    assert all(
        "1 of 1 tables" in note and "says 0.9" in note and "integrate to 0.04" in note for note in notes
    )


def test_a_tis_that_the_values_of_a_lighttools_table_contradict_is_said(files, tmp_path):
    assert not any("TIS" in note for note in registry.read_readings(files["lighttools"]).notes)
    path = tmp_path / "tis.bsdf"
    path.write_text(re.sub(r"TIS \S+", "TIS 2.5", files["lighttools"].read_text(), count=1))
    assert (
        sum(
            "1 of 9 tables contradict their TIS (one says 2.5" in n
            for n in registry.read_readings(path).notes
        )
        == 1
    )


def pab_opto(directions_deg, values, quantity: str = "BSDF") -> str:
    """A file of one incidence, that of the first row."""
    theta, phi = directions_deg[0, :2]
    head = f"#format: theta phi {quantity}\n" if quantity else ""
    rows = np.hstack([directions_deg[:, 2:], values[:, :1]])
    table = "\n".join("\t".join(f"{x:.9g}" for x in row) for row in rows)
    return f"#incident_angle {theta:g} {phi:g}\n#wavelength 465\n{head}{table}\n"


def test_a_pab_opto_sample_lit_from_behind_is_turned_over_not_mirrored(tmp_path):
    """A rotation about the x axis: azimuths change their sense with the side."""
    path = tmp_path / "back.txt"
    path.write_text(pab_opto(np.array([[140.0, 30.0, 120.0, 250.0]]), np.array([[0.2]])))
    found = registry.read_readings(path)
    turned = [from_spherical(np.deg2rad(t), np.deg2rad(p)) * [1, -1, -1] for t, p in ((140, 30), (120, 250))]
    np.testing.assert_allclose([found.wi[0], found.wo[0]], turned, atol=1e-12)


def test_pab_opto_quantities_are_said_or_refused(tmp_path):
    rows, values = SCAN, np.ones((9, 3))
    path = tmp_path / "one.txt"
    path.write_text(pab_opto(rows, values, ""))
    assert registry.read_readings(path).notes == ("no line #format: values are taken as BSDF in 1/sr",)
    path.write_text(pab_opto(rows, values, "BTDF"))
    with pytest.raises(FileFormatError, match="transmitted light"):
        registry.read_all(path)


@pytest.mark.parametrize("text", ["465", "465 nm", "0.465", "0.465 um", "465.0nm", "0,465"])
def test_wavelengths_of_pab_opto_files_are_nanometres_or_micrometres(text, tmp_path):
    path = tmp_path / "one.txt"
    path.write_text(pab_opto(SCAN, np.ones((9, 3))).replace("wavelength 465", f"wavelength: {text}"))
    assert registry.read_readings(path).bands == Bands((465.0,))

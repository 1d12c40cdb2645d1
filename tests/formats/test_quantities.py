"""Words and units of tables: what values, wavelengths, angles and uncertainties are, by heads, headers and comments."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from manifold.core.errors import FileFormatError, UsageError
from manifold.formats import registry
from manifold.formats.column_heads import (
    PHASE,
    RELATIVE,
    angle_names,
    lab_columns,
    uncertainty_head,
    value_head,
    wavelength_unit,
)
from manifold.formats.quantities import (
    BRDF,
    COSINE_BRDF,
    FACTORS,
    I_OVER_F,
    quantity_in_prose,
    quantity_of,
)
from manifold.formats.readings import Viewing
from manifold.formats.text import ErrorContext, number_with_unit, wavelength_nm
from manifold.formats.values import named_wavelength

CONTEXT = ErrorContext(Path("x.csv"), "correct it")


@pytest.mark.parametrize(
    ("text", "nm"),
    [
        ("1.55um", 1550), ("632.8nm", 632.8), ("632,8 nm", 632.8), ("10.6 \u00b5m", 10600), ("633 (nm)", 633),
        ("6328 [A]", 632.8), ("5,5e2nm", 550), ("6.328e-7 m", 632.8), ("20000 cm-1", 500), ("0.6328", 632.8),
        ("633", 633), ("2.33 eV", None), ("450, 550", None), ("red", None), ("-633 nm", None), ("0 nm", None),
    ],
)  # fmt: skip
def test_a_wavelength_is_a_number_with_its_unit(text, nm):
    found = wavelength_nm(text)
    assert found == (None if nm is None else pytest.approx(nm))


def test_numbers_keep_their_unit_whether_attached_or_in_brackets():
    assert number_with_unit("30\u00b0") == (30.0, "\u00b0")
    assert number_with_unit("12,5 (GU)") == (12.5, "gu")
    assert number_with_unit("1e3") == (1000.0, "")
    assert number_with_unit("GU 12") is None


@pytest.mark.parametrize(
    ("comment", "nm"),
    [
        ("# wavelength: 1.55um", 1550), ("# Wavelength: 632.8nm", 632.8), ("# wavelength = 10.6um", 10600),
        ("# wavelength: 632,8 nm", 632.8), ("# wavelength: 0.6328 [um]", 632.8), ("# wavelength [A]: 6328", 632.8),
        ("# \u03bb = 633nm", 633),
        ("# wavelength_nm: 633", 633), ("# Wellenl\u00e4nge: 632,8nm", 632.8),
        ("# wavelength: 633 nm (HeNe)", 633), ("Wavelength (nm), 633", 633),
        ("# wavelength 850 measured by x", 850), ("# wavelength: 400-700 nm", None), ("# wavelengths: 450, 550", None),
        ("# wavelength: 450, 550, 650 nm", None),
        ("# wavelengths: 450, 550, 650 nm", None), ("# wavelength 1 of 3", None), ("# wavelength: red", None),
    ],
)  # fmt: skip
def test_comments_name_one_wavelength_or_none(comment, nm):
    assert named_wavelength([comment], CONTEXT) == (None if nm is None else pytest.approx(nm))


@pytest.mark.parametrize(
    "comment", ["# wavelength: 1,550 nm", "# wavelength: 2.33 eV", "# wavelength: 474 THz"]
)
def test_a_comment_with_a_wavelength_that_is_none_is_refused(comment):
    with pytest.raises(FileFormatError, match=r"expected a wavelength such as 633 nm or 1\.55 um; correct"):
        named_wavelength([comment], CONTEXT)


@pytest.mark.parametrize(
    ("head", "nm", "quantity"),
    [
        ("BRDF (633 nm)", 633, BRDF), ("R(633)", 633, FACTORS), ("BRDF@633nm", 633, BRDF), ("633 nm BRDF", 633, BRDF),
        ("f_r (532 nm) [1/sr]", 532, BRDF),
        ("BRDF/633nm", 633, BRDF), ("BRDF 1.55 \u00b5m", 1550, BRDF), ("BRDF 6328 \u00c5", 632.8, BRDF),
        ("log10(BRDF) 633nm", 633, quantity_of("lg brdf")), ("ln BRDF", None, quantity_of("ln brdf")),
        ("I/F", None, I_OVER_F), ("RADF", None, I_OVER_F), ("REFF", None, FACTORS), ("BRDF [sr^-1]", None, BRDF),
        ("Radiance coefficient (1/sr)", None, BRDF), ("Reflectance factor (%)", None, FACTORS),
        ("Cosine-corrected BSDF", None, COSINE_BRDF), ("BRDF cos(theta_s)", None, COSINE_BRDF),
        ("angle-resolved scattering", None, COSINE_BRDF), ("465nm", 465, None), ("465nm [1/sr]", 465, BRDF),
        ("value (1/sr)", None, BRDF),
    ],
)  # fmt: skip
def test_heads_say_what_their_values_are(head, nm, quantity):
    said = value_head(head)
    assert said is not None
    assert said.nm == (None if nm is None else pytest.approx(nm))
    assert said.quantity == quantity


@pytest.mark.parametrize(
    "head",
    [
        "log_BRDF",
        "BRDF (a.u.)",
        "Intensity",
        "normalized BRDF",
        "BTDF",
        "BRDF (s-pol)",
        "Reflectance (sr)",
        "Reflectance (1/sr)",
        "Bidirectional reflectance",
        "dB",
        "BRDF 2",
        "1000*BRDF",
        "BRDF \u00d7 1000",
        "10^3 BRDF",
        "BRDF / 1000",
    ],
)
def test_heads_that_are_not_understood_are_no_values(head):
    assert value_head(head) is None


@pytest.mark.parametrize(
    ("text", "quantity"),
    [
        ("BRDF", BRDF), ("BRDF of plate 7", BRDF), ("BRDF, not cosine weighted", BRDF), ("degreased plate", None),
        ("Reflectance factor", FACTORS), ("Spectral reflectance factor of a plate", FACTORS),
        ("Cosine corrected BRDF", COSINE_BRDF), ("cosine-corrected scatter", COSINE_BRDF), ("ARS", COSINE_BRDF),
        ("log10(BRDF)", quantity_of("lg brdf")), ("BSDF [1/sr]", BRDF),
    ],
)  # fmt: skip
def test_prose_names_a_quantity_or_none(text, quantity):
    assert quantity_in_prose(text, "MEAS_NAME", CONTEXT) == quantity


@pytest.mark.parametrize(
    "text",
    [
        "Intensity",
        "BTDF",
        "Relative BRDF",
        "log BRDF",
        "BRDF normalized",
        "Absorbance",
        "Radiance",
        "BRDF and BTDF",
        "Bidirectional reflectance",
        "Hemispherical reflectance",
        "Reflectance factor [1/sr]",
    ],
)
def test_prose_on_another_quantity_is_refused(text):
    with pytest.raises(FileFormatError, match=r"MEAS_NAME is .* expected BRDF, cosine-corrected BRDF"):
        quantity_in_prose(text, "MEAS_NAME", CONTEXT)


def test_quantities_become_the_brdf():
    wi = np.array([[0.6, 0.0, 0.8]])
    wo = np.array([[0.0, 0.8, 0.6]])
    value = np.array([[0.3]])
    assert FACTORS.brdf(value, wi, wo)[0, 0] == pytest.approx(0.3 / np.pi)
    assert FACTORS.brdf(value, wi, wo, 100.0)[0, 0] == pytest.approx(0.003 / np.pi)
    assert COSINE_BRDF.brdf(value, wi, wo)[0, 0] == pytest.approx(0.3 / 0.6)
    assert I_OVER_F.brdf(value, wi, wo)[0, 0] == pytest.approx(0.3 / np.pi / 0.8)
    assert quantity_of("lg brdf").brdf(-value, wi, wo)[0, 0] == pytest.approx(10.0**-0.3)


@pytest.mark.parametrize(
    ("heads", "names"),
    [
        ("thetai,phi,thetar,phir", ["theta_i", "phi_i", "theta_o", "phi_o"]),
        ("theta,phi,theta_r,phi_r", ["theta_i", "phi_i", "theta_o", "phi_o"]),
        ("theta_i,theta,phi", ["theta_i", "theta_o", "phi_o"]),
        ("incidence (deg),emission (deg),azimuth (deg)", ["theta_i", "theta_o", RELATIVE]),
        ("inc,emi,phase", ["theta_i", "theta_o", PHASE]),
        ("i,e,g", ["theta_i", "theta_o", PHASE]),
        ("theta_i,theta_o,azimuth", ["theta_i", "theta_o", None]),
    ],
)
def test_heads_of_angles_are_understood_beside_each_other(heads, names):
    assert angle_names(heads.split(",")) == names


@pytest.mark.parametrize(
    ("head", "unit"),
    [
        ("Wavelength (nm)", "nm"), ("wavelength_nm", "nm"), ("lambda", ""), ("Wavelength [um]", "um"),
        ("cm^-1", "cm^-1"), ("Wavenumber", "cm-1"),
        ("Wavelength nm.", "nm"), ("Wellenl\u00e4nge / nm", "nm"), ("465nm", None), ("m", None),
        ("A", None), ("theta", None),
    ],
)  # fmt: skip
def test_heads_of_wavelengths_name_their_unit(head, unit):
    assert wavelength_unit(head) == unit


@pytest.mark.parametrize(
    ("head", "expected"),
    [
        ("Std. Dev.", (None, False, 1.0)), ("u(BRDF)", (None, False, 1.0)), ("sigma 633nm", (633.0, False, 1.0)),
        ("rel. uncertainty (%)", (None, True, 1.0)), ("U (k=2)", (None, False, 2.0)),
        ("Expanded uncertainty", (None, False, 0.0)), ("RADF_err", (None, False, 1.0)), ("+/-", (None, False, 1.0)),
        ("\u00b1", (None, False, 1.0)),
        ("BRDF", None), ("v", None), ("standard", None),
    ],
)  # fmt: skip
def test_heads_of_uncertainties_are_known(head, expected):
    assert uncertainty_head(head) == expected


def test_the_light_and_observer_of_colours_may_stand_in_either_order():
    heads = [
        "L* (10\u00b0/D65)",
        "a* (10\u00b0/D65)",
        "b* (10\u00b0/D65)",
        "L* (A/2)",
        "a* (A/2)",
        "b* (A/2)",
    ]
    assert lab_columns(heads) == ([0, 1, 2], Viewing("D65", 10))
    assert lab_columns(heads, Viewing("A", 2)) == ([3, 4, 5], Viewing("A", 2))


HEAD = "theta_i (deg),phi_i (deg),theta_o (deg),phi_o (deg)"
ROWS = np.array([(30.0, 180.0, 10.0, 0.0), (30.0, 180.0, 40.0, 0.0), (50.0, 180.0, 60.0, 90.0)])


def read(tmp_path, text: str):
    path = tmp_path / "table.csv"
    path.write_text(text, encoding="utf-8")
    return registry.read_readings(path)


def rows(*columns) -> str:
    return "".join(",".join(f"{v:.9g}" for v in row) + "\n" for row in np.column_stack([ROWS, *columns]))


F = np.array([0.1, 0.2, 0.05])


@pytest.mark.parametrize(
    ("head", "values"),
    [
        ("log10(BRDF)", np.log10(F)), ("ln(BRDF)", np.log(F)), ("I/F", np.pi * F * np.cos(np.deg2rad(ROWS[:, 0]))),
        ("REFF", np.pi * F), ("Reflectance factor (%)", 100.0 * np.pi * F),
        ("CCBRDF", F * np.cos(np.deg2rad(ROWS[:, 2]))),
        ("Radiance coefficient", F),
    ],
)  # fmt: skip
def test_columns_of_every_quantity_become_the_brdf(head, values, tmp_path):
    found = read(tmp_path, f"{HEAD},{head}\n" + rows(values))
    np.testing.assert_allclose(found.values[:, 0], F, rtol=1e-8)
    assert found.assumed_unit is None


@pytest.mark.parametrize(
    ("heads", "words"),
    [
        ("Intensity", "columns Intensity: expected values"),
        ("BRDF (%)", "percent of BRDF, expected reflectance factors"),
        ("BRDF 465,R 525", "columns of BRDF and of reflectance factors, expected one quantity"),
    ],
)
def test_columns_of_another_quantity_are_refused(heads, words, tmp_path):
    with pytest.raises(FileFormatError, match=words):
        read(tmp_path, f"{HEAD},{heads}\n" + rows(*[F] * (heads.count(",") + 1)))


def test_channels_may_name_their_quantity_and_r_is_red(tmp_path):
    found = read(tmp_path, f"{HEAD},BRDF R,BRDF G,BRDF B\n" + rows(F, F, F))
    assert found.assumed_unit is None
    found = read(tmp_path, f"{HEAD},R,G,B\n" + rows(F, F, F))
    assert found.assumed_unit == "brdf"
    np.testing.assert_allclose(found.values[:, 1], F)


def test_a_planetary_table_has_its_light_at_azimuth_0(tmp_path):
    """Source of the phase angle: Hapke 1993, cos g = cos i cos e + sin i sin e cos psi."""
    i, e, psi = np.deg2rad([[30.0, 30.0, 20.0], [0.0, 40.0, 60.0], [0.0, 180.0, 90.0]])
    phase = np.arccos(np.cos(i) * np.cos(e) + np.sin(i) * np.sin(e) * np.cos(psi))
    columns = np.rad2deg(np.column_stack([i, e, psi, phase]))
    by_azimuth = read(
        tmp_path, "incidence (deg),emission (deg),azimuth (deg),REFF\n"
        + "".join(f"{a},{b},{c},0.3\n" for a, b, c, _ in columns),
    )  # fmt: skip
    by_phase = read(
        tmp_path, "incidence (deg),emission (deg),phase (deg),I/F\n"
        + "".join(f"{a},{b},{g:.9f},0.3\n" for a, b, _, g in columns),
    )  # fmt: skip
    np.testing.assert_allclose(by_phase.wo[1:], by_azimuth.wo[1:], atol=1e-7)
    mirror = by_azimuth.wi * [-1.0, -1.0, 1.0]
    assert mirror[1] @ by_azimuth.wo[1] == pytest.approx(np.cos(np.deg2rad(10.0)))
    np.testing.assert_allclose(np.pi * by_phase.values[:, 0], 0.3 / np.cos(i))
    with pytest.raises(FileFormatError, match="phase angle 80 degrees at incidence 30 and emission 20"):
        read(tmp_path, "incidence (deg),emission (deg),phase (deg),I/F\n30,20,80,0.3\n")
    with pytest.raises(FileFormatError, match="expected those of the other angles"):
        read(tmp_path, "incidence (deg),emission (deg),azimuth (deg),phase (deg),I/F\n30,20,180,10,0.3\n")


def test_phi_beside_phi_r_is_that_of_the_light_and_negative_elevations_lie_opposite(tmp_path):
    found = read(
        tmp_path, "lambda,thetai,phi,thetar,phir,BRDF\n0.532,-30,0,10,0,0.3\n0.532,-30,0,70,90,0.3\n"
    )
    assert found.wavelengths_nm == [532.0]
    np.testing.assert_allclose(found.wi[0], [-0.5, 0.0, np.cos(np.pi / 6)], atol=1e-12)


@pytest.mark.parametrize(
    ("heads", "values", "uncertainties"),
    [
        ("BRDF,Std. Dev.", F, 0.03 * F), ("BRDF,rel. uncertainty (%)", F, np.full(3, 3.0)),
        ("BRDF,U (k=2)", F, 0.06 * F), ("BRF (%),u (%)", 100 * np.pi * F, 3 * np.pi * F),
        ("log10(BRDF),sigma", np.log10(F), np.full(3, 0.03 / np.log(10.0))),
        ("BRDF 633nm,u(BRDF) 633nm", F, 0.03 * F),
    ],
)  # fmt: skip
def test_uncertainties_weigh_the_readings(heads, values, uncertainties, tmp_path):
    found = read(tmp_path, f"{HEAD},{heads}\n" + rows(values, uncertainties))
    np.testing.assert_allclose(found.values[:, 0], F)
    np.testing.assert_allclose(3.0 * found.scatter, 0.03, rtol=1e-6)
    np.testing.assert_allclose(found.weights, 1.0 / (1.0 + 0.5**2), rtol=1e-6)
    assert found.repeatability == pytest.approx(0.03)
    assert any("uncertainties of 3 %" in note for note in found.notes)


def test_expanded_uncertainties_without_a_factor_are_left_out_and_said(tmp_path):
    found = read(tmp_path, f"{HEAD},BRDF,Expanded uncertainty\n" + rows(F, F))
    assert np.all(found.weights == 1.0)
    assert any("Expanded uncertainty: left out" in note for note in found.notes)


def test_uncertainties_may_stand_in_a_row_per_wavelength(tmp_path):
    found = read(
        tmp_path, "theta_i (deg),theta_o (deg),nm,BRDF,std\n10,30,450,0.1,0.003\n10,30,550,0.2,0.006\n"
    )
    np.testing.assert_allclose(found.values, [[0.1, 0.2]])
    np.testing.assert_allclose(3.0 * found.scatter, 0.03)


def test_wavelengths_of_rows_have_the_unit_of_their_column(tmp_path):
    found = read(
        tmp_path, "theta_i (deg),theta_o (deg),Wavenumber (cm-1),BRDF\n10,30,20000,0.1\n10,30,25000,0.2\n"
    )
    np.testing.assert_allclose(found.wavelengths_nm, [400.0, 500.0])
    np.testing.assert_allclose(found.values, [[0.2, 0.1]])


def test_angles_may_carry_their_unit_in_the_cells(tmp_path):
    found = read(tmp_path, "theta_i;theta_o;BRDF 633nm\n1\u00b0;0,5\u00b0;0,1\n1 deg;0.7\u00b0;0.2\n")
    np.testing.assert_allclose(np.rad2deg(np.arccos(found.wo[:, 2])), [0.5, 0.7])


def test_gloss_units_are_read_and_other_units_refused(tmp_path):
    table = "Geometry,400,500,Gloss 60\n45as15,0.1,0.2,{}\n"
    assert read(tmp_path, table.format("12.5 GU")).gloss == {60.0: 12.5}
    assert read(tmp_path, table.format("matt")).gloss == {}
    with pytest.raises(FileFormatError, match=r"found '12\.5 %', expected gloss units"):
        read(tmp_path, table.format("12.5 %"))


def test_a_line_above_the_header_may_name_the_wavelength(tmp_path):
    assert read(tmp_path, f"Instrument,x\nWavelength,632.8nm\n{HEAD},BRDF\n" + rows(F)).wavelengths_nm == [
        632.8
    ]


ASTM = "theta_i,phi_i,theta_s,phi_s"


def astm(tmp_path, head: str, measured: str = "", values=F, before: str = ""):
    path = tmp_path / "x.astm"
    said = f'MEAS_NAME "{measured}"\n' if measured else ""
    table = "".join(
        ",".join(f"{v:.9g}" for v in row) + "\n" for row in np.column_stack([np.deg2rad(ROWS), values])
    )
    path.write_text(f"SAMPLE_NAME x\n{before}{said}VARS {ASTM},{head}\n{table}")
    return registry.read_readings(path)


def test_the_name_of_an_astm_measurement_says_what_its_values_are(tmp_path):
    cosine = np.cos(np.deg2rad(ROWS[:, 2]))
    for measured, values in (
        ("Reflectance factor", np.pi * F), ("Cosine corrected BRDF", cosine * F), ("log10(BRDF)", np.log10(F)),
        ("Reflectance factor (%)", 100.0 * np.pi * F), ("BRDF", F), ("plate 3", F),
    ):  # fmt: skip
        np.testing.assert_allclose(astm(tmp_path, "550nm", measured, values).values[:, 0], F, rtol=1e-8)
    for measured in ("Intensity", "Relative BRDF", "Absorbance"):
        with pytest.raises(FileFormatError, match=f"MEAS_NAME is '{measured}': expected BRDF"):
            astm(tmp_path, "550nm", measured)
    with pytest.raises(FileFormatError, match="MEAS_NAME names reflectance factors, VARS BRDF"):
        astm(tmp_path, "BRDF", "Reflectance factor")


def test_astm_values_whose_unit_is_not_said_may_be_given_one(tmp_path):
    """`Reflectance` tells a goniometer's measurement from transmission, not its unit."""
    found = astm(tmp_path, "550nm", "Reflectance")
    np.testing.assert_allclose(found.values[:, 0], F)
    np.testing.assert_allclose(found.in_unit("factor").values[:, 0], F / np.pi)


def test_uncertainties_of_an_astm_table_weigh_its_readings(tmp_path):
    found = astm(tmp_path, "BRDF,uBRDF", values=np.column_stack([F, 0.03 * F]))
    np.testing.assert_allclose(found.values[:, 0], F)
    np.testing.assert_allclose(found.weights, 0.8, rtol=1e-6)
    assert found.repeatability == pytest.approx(0.03)


@pytest.mark.parametrize(
    ("before", "viewing"),
    [
        ("Illuminant: A/10", Viewing("A", 10)),
        ("# 10\u00b0/D50", Viewing("D50", 10)),
        ("# Illuminant: A, observer: 10", Viewing("A", 10)),
        ("# Illuminant F11\n# Observer: 2\u00b0", Viewing("F11", 2)),
        ("45/0, 2026", Viewing("D65", 10)),
    ],
)
def test_a_title_may_name_the_light_of_colours_whose_heads_name_none(before, viewing, tmp_path):
    found = read(tmp_path, f"{before}\nName,Geometry,L*,a*,b*\nred,45as45,40,45,25\nred,45as110,30,35,20\n")
    assert found.viewing == viewing
    assert found.is_viewing_assumed == (before == "45/0, 2026")
    if found.is_viewing_assumed:
        assert found.seen_under(Viewing("A", 2)).viewing == Viewing("A", 2)
    else:
        with pytest.raises(UsageError, match="leave --illuminant and --observer out"):
            found.seen_under(Viewing("A", 2))


def test_columns_may_hold_the_light_and_the_observer(tmp_path):
    head = "Name,Illuminant,Observer,Geometry,L*,a*,b*"
    rows = head + "\nred,A,10\u00b0,45as45,40,45,25\nred,{},10\u00b0,45as110,30,35,20\n"
    assert read(tmp_path, rows.format("A")).viewing == Viewing("A", 10)
    with pytest.raises(FileFormatError, match="column Illuminant holds A, D65, expected one value"):
        read(tmp_path, rows.format("D65"))


@pytest.mark.parametrize(("said", "nm"), [("WAVELENGTH 1.55um", 1550.0), ("WAVELENGTH 632,8nm", 632.8)])
def test_astm_wavelengths_keep_their_unit(said, nm, tmp_path):
    assert astm(tmp_path, "BRDF", before=said + "\n").wavelengths_nm == pytest.approx([nm])


def test_pab_opto_formats_name_the_quantity_and_units_may_be_attached(tmp_path):
    path = tmp_path / "x.txt"
    text = "#incident_angle 30\u00b0 180\u00b0\n#wavelength: 632.8nm\n#format: theta phi {}\n10 0 0.1\n40 0 0.2\n"
    cosine = np.cos(np.deg2rad([10.0, 40.0]))
    for word, scale in (
        ("BSDF", 1.0),
        ("DSF", 1.0 / cosine),
        ("cosine-corrected BSDF", 1.0 / cosine),
        ("BRF", 1.0 / np.pi),
    ):
        path.write_text(text.format(word), encoding="utf-8")
        found = registry.read_readings(path)
        np.testing.assert_allclose(found.values[:, 0], np.array([0.1, 0.2]) * scale)
        assert found.wavelengths_nm == [632.8]
        assert any("divided by" in note for note in found.notes) == (word != "BSDF")
    for word in ("Intensity", "BTDF", "luminance"):
        path.write_text(text.format(word), encoding="utf-8")
        with pytest.raises(FileFormatError, match=r"format is .*expected BRDF|format .*expected theta phi"):
            registry.read_all(path)

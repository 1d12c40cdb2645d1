"""Tables of directions as goniometers and people write them: units of angles, azimuths, what the values are."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from helpers.instrument_files import SUFFIXES, dense, lighttools_axes, smooth
from helpers.paths import REPOSITORY

from manifold.core.directions import from_spherical
from manifold.core.errors import FileFormatError, UsageError
from manifold.core.records import Array, Bands
from manifold.formats import fred, lighttools, openmaterial, registry, speos, utia
from manifold.formats.column_heads import RELATIVE, angle_name, value_head, wavelength
from manifold.formats.readings import UNITS, Assumption, assumptions_first

BLACK_LAB = REPOSITORY.parent / "shared" / "files" / "bsdf-tools" / "20250210_S7_sample_final.txt"
BANDS = Bands((465.0, 525.0, 630.0))
# theta_i, phi_i, theta_o, phi_o in degrees
DIRECTIONS = np.array(
    [
        (i, 180.0, o, phi)
        for i in (0.0, 20.0, 40.0, 60.0)
        for o in (10.0, 40.0, 80.0)
        for phi in (0.0, 75.0, 180.0)
    ]
)


def truth(directions_deg: Array) -> Array:
    """Values of `smooth` in 1/sr, (P, 3)."""
    theta_i, phi_i, theta_o, phi_o = np.deg2rad(directions_deg).T
    return smooth(BANDS).eval(from_spherical(theta_i, phi_i), from_spherical(theta_o, phi_o))


def lines(*columns: Array, separator: str = ",") -> str:
    """Rows of numbers."""
    return "".join(separator.join(f"{x:.9g}" for x in row) + "\n" for row in np.hstack(columns))


def assert_true(path, rtol=1e-6):
    """All readings of a file are those of `smooth`, in the sense of the package's directions."""
    found = registry.read_readings(path)
    order = [BANDS.wavelengths_nm.index(nm) for nm in found.bands.wavelengths_nm]
    expected = smooth(BANDS).eval(found.wi, found.wo)[:, order]
    np.testing.assert_allclose(found.values, expected, rtol=rtol)
    return found


COSINE = np.cos(np.deg2rad(DIRECTIONS[:, 2:3]))


@pytest.mark.parametrize("head", ["ARS", "CCBRDF", "BRDF*cos", "cos-corrected BRDF", "DSF"])
def test_astm_values_that_include_the_cosine_are_divided_by_it(head, tmp_path):
    path = tmp_path / "scan.astm"
    values = truth(DIRECTIONS)[:, :1] * COSINE
    path.write_text(
        f"WAVELENGTH 465\nVARS theta_i,phi_i,theta_s,phi_s,{head}\n" + lines(np.deg2rad(DIRECTIONS), values)
    )
    assert any("cosine" in note for note in assert_true(path).notes)


@pytest.mark.parametrize("measured", ["BRDF, not cosine weighted", "degreased plate", "BRDF"])
def test_what_an_astm_table_says_in_prose_changes_nothing(measured, tmp_path):
    path = tmp_path / "scan.astm"
    path.write_text(
        f'MEAS_NAME "{measured}"\nVARS theta_i,phi_i,theta_s,phi_s,465nm,525nm,630nm\n'
        + lines(np.deg2rad(DIRECTIONS), truth(DIRECTIONS))
    )
    assert assert_true(path).notes == ()


def test_transmission_in_radians_does_not_make_angles_degrees(tmp_path):
    path = tmp_path / "both.astm"
    behind = DIRECTIONS * [1, 1, -1, 1] + [0, 0, 180, 0]
    both = np.vstack([DIRECTIONS, behind])
    values = np.vstack([truth(DIRECTIONS), np.full((len(behind), 3), 0.01)])
    path.write_text("VARS theta_i,phi_i,theta_s,phi_s,465nm,525nm,630nm\n" + lines(np.deg2rad(both), values))
    found = assert_true(path)
    assert len(found) == len(DIRECTIONS)
    assert found.notes == (f"{len(behind)} rows of transmitted light (beyond 90 degrees) are left out",)


def test_azimuths_beyond_a_turn_make_small_angles_degrees(tmp_path):
    path = tmp_path / "near_the_normal.astm"
    near = DIRECTIONS * [0.02, 1, 0.02, 1]
    path.write_text("VARS theta_i,phi_i,theta_s,phi_s,465nm,525nm,630nm\n" + lines(near, truth(near)))
    np.testing.assert_allclose(assert_true(path).wi[-1, 0], -np.sin(np.deg2rad(1.2)))


@pytest.mark.parametrize("head", ["wavelength", "sigma", "log_BRDF"])
def test_an_astm_table_without_a_column_of_values_is_refused(head, tmp_path):
    path = tmp_path / "scan.astm"
    path.write_text(f"VARS theta_i,phi_i,theta_s,phi_s,{head}\n0.5,3.14,0.4,0,450\n")
    with pytest.raises(FileFormatError, match=f"line 1: column {head}, expected values"):
        registry.read_all(path)


def test_a_btdf_is_refused(tmp_path):
    path = tmp_path / "glass.astm"
    path.write_text(
        'MEAS_NAME "BTDF"\nVARS theta_i,phi_i,theta_s,phi_s,465nm,525nm,630nm\n'
        + lines(np.deg2rad(DIRECTIONS), truth(DIRECTIONS))
    )
    with pytest.raises(FileFormatError, match="MEAS_NAME is 'BTDF': transmitted light"):
        registry.read_all(path)


@pytest.mark.parametrize(
    ("head", "name"),
    [
        ("theta_i", "theta_i"), ("ThetaIn [rad]", "theta_i"), ("Incident angle (deg)", "theta_i"), ("AOI", "theta_i"),
        ("theta_i_deg", "theta_i"), ("\u03b8i [\u00b0]", "theta_i"), ("SZA", "theta_i"), ("Source zenith", "theta_i"),
        ("Zenith angle of light [deg]", "theta_i"), ("Azimuth of the observer", "phi_o"),
        ("phi_in", "phi_i"), ("incident azimuth", "phi_i"), ("scatter_theta", "theta_o"), ("thetaR", "theta_o"),
        ("Viewing zenith angle", "theta_o"), ("detector angle", "theta_o"), ("\u03c6_r", "phi_o"), ("phi", "phi_o"),
        ("Viewing azimuth angle", "phi_o"), ("dphi", RELATIVE), ("relative azimuth", RELATIVE), ("theta_h", None),
        ("theta_d", None), ("phi_d", None), ("Angle", None), ("465nm", None), ("R", None), ("time", None),
    ],
)  # fmt: skip
def test_angles_are_known_in_every_spelling(head, name):
    assert angle_name(head) == name


@pytest.mark.parametrize(
    ("head", "nm"),
    [("400", 400), ("465nm", 465), ("465 [nm]", 465), ("R400 [%]", 400), ("SPECTRAL_NM_400", 400), ("BRDF_465", 465),
     ("0.465 um", 465), ("0,6328 um", 632.8), ("BRF 465", 465), ("BRDF*cos 465", 465), ("BRDF_1", None), ("7000", None),
     ("Sample 450", None), ("L*", None), ("Date 2024", None), ("(" * 100_000, None)],
)  # fmt: skip
def test_heads_of_bands_are_whole_words(head, nm):
    assert wavelength(head) == pytest.approx(nm) if nm else wavelength(head) is None


def test_heads_of_other_columns_are_no_values():
    assert [value_head(head) for head in ("sigma", "BRDF, not cosine weighted", "time")] == [None] * 3


RADIANS = np.deg2rad(DIRECTIONS)
HEAD = "theta_i,phi_i,theta_o,phi_o,465,525,630"
VALUES = truth(DIRECTIONS)
TABLES = {
    "degrees, not said": f"{HEAD}\n" + lines(DIRECTIONS, VALUES),
    "radians in heads": re.sub(r"(theta|phi)_\w", r"\g<0> (rad)", HEAD) + "\n" + lines(RADIANS, VALUES),
    "radians in names": re.sub(r"(theta|phi)_\w", r"\g<0>_rad", HEAD) + "\n" + lines(RADIANS, VALUES),
    "degrees in names": re.sub(r"(theta|phi)_\w", r"\g<0>_deg", HEAD) + "\n" + lines(DIRECTIONS, VALUES),
    "other words": "Incident angle,Incident azimuth,Viewing angle,Viewing azimuth,465 nm,525 nm,630 nm\n"
    + lines(DIRECTIONS, VALUES),
    "zenith angles": "SZA;SAA;VZA;VAA;465;525;630\n"
    + lines(DIRECTIONS, VALUES, separator=";").replace(".", ","),
    "blanks": HEAD.replace(",", " ") + "\n" + lines(DIRECTIONS, VALUES, separator="  "),
    "a head in a comment": "# " + HEAD.replace(",", " ") + "\n" + lines(DIRECTIONS, VALUES, separator=" "),
    "micrometres": HEAD.replace("465,525,630", "0.465 um,0.525 um,0.630 um")
    + "\n"
    + lines(DIRECTIONS, VALUES),
    "percent": HEAD.replace("465", "465 (%)") + "\n" + lines(DIRECTIONS, 100.0 * np.pi * VALUES),
    "BRF": HEAD.replace(",465", ",BRF 465") + "\n" + lines(DIRECTIONS, np.pi * VALUES),
    "times the cosine": HEAD.replace(",465", ",BRDF*cos 465") + "\n" + lines(DIRECTIONS, COSINE * VALUES),
    "a row per wavelength": "theta_i,phi_i,wavelength,theta_o,phi_o,brdf\n"
    + lines(
        *np.split(np.repeat(DIRECTIONS, 3, axis=0), [2], axis=1)[:1],
        np.tile([[630.0], [465.0], [525.0]], (len(DIRECTIONS), 1)),
        *np.split(np.repeat(DIRECTIONS, 3, axis=0), [2], axis=1)[1:],
        VALUES[:, [2, 0, 1]].reshape(-1, 1),
    ),
    "a table per wavelength": "Wavelength (um);theta_i;phi_i;theta_o;phi_o;BRF\n"
    + "".join(
        lines(np.full((len(DIRECTIONS), 1), nm), DIRECTIONS, np.pi * VALUES[:, k : k + 1], separator=";")
        for k, nm in enumerate((0.465, 0.525, 0.63))
    ),
    "measured angles": HEAD.replace("theta_i", "Incident_angle").replace("theta_o", "Measure_angle")
    + "\n"
    + lines(DIRECTIONS, VALUES),
    "differences of azimuths": "theta_i,theta_o,dphi,465,525,630\n"
    + lines(DIRECTIONS[:, [0, 2]], DIRECTIONS[:, 3:] - 180.0, VALUES),
}


@pytest.mark.parametrize("name", TABLES)
def test_tables_of_directions_are_read_however_they_are_spelt(name, tmp_path):
    path = tmp_path / "table.csv"
    path.write_text(TABLES[name], encoding="utf-8")
    found = assert_true(path)
    assert found.bands == BANDS
    mirror = np.einsum("pi,pi->p", found.wi * [-1.0, -1.0, 1.0], found.wo)
    assert np.max(mirror) == pytest.approx(1.0)  # 40 degrees is among both elevations
    assert np.argmax(found.values[:, 0]) == np.argmax(smooth(BANDS).eval(found.wi, found.wo)[:, 0])


@pytest.mark.parametrize(
    "title",
    [
        "# BRDF, not cosine weighted",
        "BRDF of a degreased plate",
        "radial scan, Reflectance 99 %",
        "0/45 configuration",
    ],
)
def test_what_titles_say_changes_nothing(title, tmp_path):
    path = tmp_path / "table.csv"
    path.write_text(f"{title}\n" + TABLES["radians in heads"], encoding="utf-8")
    assert len(assert_true(path)) == len(DIRECTIONS)


def test_columns_of_the_black_lab_are_directions_of_reflectance_factors(tmp_path):
    path = tmp_path / "white.txt"
    titles = "BRF Values\nBRF values calculated using 0/45 configuration\n"
    head = "src_z\tsrc_a\tview_z\tview_a\t465nm\t525nm\t630nm\n"
    path.write_text(titles + head + lines(DIRECTIONS, np.pi * VALUES, separator="\t"))
    assert_true(path)


@pytest.mark.skipif(not BLACK_LAB.exists(), reason="the files of instruments are not here")
def test_a_real_file_of_the_black_lab_holds_its_directions():
    (found,) = registry.read_all(BLACK_LAB)
    theta = np.rad2deg(np.arccos(found.wi[:, 2]))
    assert (len(found), found.bands.count, len(np.unique(np.round(theta, 3)))) == (18, 11, 17)
    np.testing.assert_allclose(np.pi * found.values[1, :2], [1.052150, 1.054446])


@pytest.mark.parametrize(
    ("head", "expected"),
    [("BRDF", None), ("value", "taken as BRDF in 1/sr"), ("Reflectance", "divided by pi")],
)
def test_what_a_column_of_values_is_taken_for_is_said(head, expected, tmp_path):
    path = tmp_path / "one.csv"
    scale = np.pi if head == "Reflectance" else 1.0
    path.write_text(f"theta_i,phi_i,theta_r,phi_r,{head}\n" + lines(DIRECTIONS, scale * VALUES[:, 1:2]))
    found = registry.read_readings(path)
    np.testing.assert_allclose(found.values[:, 0], smooth(BANDS).eval(found.wi, found.wo)[:, 1], rtol=1e-6)
    said = [note for note in found.notes if "1/sr" in note or "pi" in note]
    assert said == [] if expected is None else expected in said[0]


@pytest.mark.parametrize(
    ("head", "factor", "unit"),
    [("value", 0.9, "factor"), ("value", 90.0, "percent"), ("value", 0.25, "brdf"), ("BRDF", 0.9, None)],
)
def test_values_that_only_one_unit_makes_plausible_decide_it(head, factor, unit, tmp_path):
    path = tmp_path / "diffuse.csv"
    rows = [f"45,0,{theta},{phi},{factor}" for theta in (0, 20, 40, 60) for phi in (30, 90)]
    path.write_text("\n".join([f"theta_i (deg),phi_i (deg),theta_o (deg),phi_o (deg),{head}", *rows]) + "\n")
    found = registry.read_readings(path)
    assert found.assumed_unit == unit
    np.testing.assert_allclose(found.values, factor * UNITS[unit or "brdf"])
    if unit in ("factor", "percent"):
        assert any("reflect more light than it receives" in note for note in found.notes)


RED = (0.046, 0.046, 0.13, 0.55, 0.61)
"""Reflectance factors of a red paint, whose mean over bands is possible for a BRDF in 1/sr."""


@pytest.mark.parametrize(("scale", "unit"), [(1.0, "factor"), (100.0, "percent"), (1.0 / np.pi, "brdf")])
def test_bands_that_reflect_too_much_decide_the_unit(scale, unit, tmp_path):
    path = tmp_path / "red.csv"
    pairs = [(45, 0, 0), (45, 20, 0), (30, 60, 180), (20, 50, 180)]
    rows = [";".join(map(str, (*pair, *(scale * v for v in RED)))) for pair in pairs]
    path.write_text("\n".join(["theta_i;theta_o;phi;400;480;560;640;700", *rows]) + "\n")
    found = registry.read_readings(path)
    assert found.assumed_unit == unit
    np.testing.assert_allclose(found.values, np.tile(RED, (4, 1)) / np.pi)


def test_a_saturated_band_is_noted_and_does_not_decide_the_unit(tmp_path):
    path = tmp_path / "saturated.csv"
    heads = [str(nm) for nm in range(400, 701, 20)]
    values = ["9.99" if head == "460" else "0.1" for head in heads]
    rows = [",".join([f"45,{theta},180", *values]) for theta in (0, 20, 40, 60)]
    path.write_text("\n".join(["theta_i,theta_o,phi_o," + ",".join(heads), *rows]) + "\n")
    found = registry.read_readings(path)
    assert found.assumed_unit == "brdf"
    assert any(note.startswith("band 460: brighter than a perfect diffuser") for note in found.notes)


def test_a_fluorescent_band_above_1_is_not_percent(tmp_path):
    """Fluorescent paints have reflectance factors up to about 1.8 in one band."""
    path = tmp_path / "pink.csv"
    rows = [f"45,{theta},180,0.2,0.2,1.6" for theta in (0, 20, 40, 60)]
    path.write_text("\n".join(["theta_i,theta_o,phi_o,450,550,610", *rows]) + "\n")
    assert registry.read_readings(path).assumed_unit == "factor"


@pytest.mark.parametrize(("factor", "is_said"), [(0.8, True), (0.25, False)])
def test_few_values_that_look_like_factors_stay_a_brdf_with_a_note(factor, is_said, tmp_path):
    """One of these directions is away from the mirror direction: too few to decide the unit."""
    path = tmp_path / "few.csv"
    pairs = [(45, 0), (45, 30), (45, 60), (15, 0)]
    path.write_text(
        "theta_i,theta_o,R,G,B\n" + "".join(f"{i},{o}" + f",{factor}" * 3 + "\n" for i, o in pairs)
    )
    found = registry.read_readings(path)
    assert found.assumed_unit == "brdf"
    np.testing.assert_allclose(found.values, factor)
    assert (
        any("looks like a reflectance factor" in note and "--unit factor" in note for note in found.notes)
        == is_said
    )
    told = registry.read_readings(path, unit="factor")
    np.testing.assert_allclose(told.values, factor / np.pi)
    assert not any("--unit factor" in note for note in told.notes)


@pytest.mark.parametrize(
    ("table", "words"),
    [
        ("theta_i,phi_i,theta_o,phi_o,u,v\n1,2,3,4,5,6\n", "expected values beside the directions"),
        ("theta_i,theta_i,theta_o,phi_o,465\n1,2,3,4,5\n", "theta_i appears twice"),
        ("theta_i,phi_i,theta_o,phi_o,465\n10,20,x,40,5\n", "row 2, theta_o: found 'x'"),
        ("theta_i,phi_i,theta_o,phi_o,465\n1,2,3,4,5\n,,,,6\n", "row 3: values without directions"),
        ("theta_i,phi_i,theta_o,phi_o,465,525\n1,2,3,4,0.5,O.3\n", "row 2, column 6: found 'O.3'"),
        ("theta_i,phi_i,theta_o,phi_o,465\n", "a header but no rows"),
        ("theta_i,phi_i,theta_o,phi_o,465,465\n10,20,30,40,5,6\n", "two columns of '465'"),
        (
            "theta_i,phi_i,theta_o,phi_o,465\n1,2,1.5,3,5\n",
            "degrees or radians, expected headings such as theta_i .deg",
        ),
        ("theta_i (deg),phi_i (rad),theta_o,phi_o,465\n1,2,1.5,3,5\n", "expected one unit"),
        ("theta_i,phi_i,theta_o,dphi,465\n10,20,30,40,5\n", "dphi beside phi_i"),
        ("theta_i,phi_i,theta_o,465\n10,20,30,5\n", "phi_i without phi_o"),
        ("wl,theta_i,phi_i,theta_o,phi_o,BRDF,BRF\n465,1,2,30,4,5,6\n", "columns wl: expected values"),
        ("wl,theta_i,phi_i,theta_o,phi_o,f,spin\n465,1,2,30,4,5,6\n", "columns wl, spin: expected values"),
        (
            "wl,theta_i,phi_i,theta_o,phi_o,f\n465,1,2,30,4,5\nred,1,2,30,4,5\n",
            "row 3, column 1: found 'red'",
        ),
        ("wl,theta_i,phi_i,theta_o,phi_o,f\n465,1,2,30,4,5\n525,1,2,30,4,x\n", "row 3, column 6: found 'x'"),
        ("theta_i,phi_i,theta_o,phi_o,wl,f\n1,2,30,4,465,5\n1,2,O,4,465,5\n", "row 3, theta_o: found 'O'"),
        ("theta_i,phi_i,theta_o,phi_o,wl,f\n1,2,30,4,465,5,6\n", "row 2: 7 cells below a header of 6"),
        ("theta_i,phi_i,theta_o,phi_o,lambda\n10,20,30,40,450\n", "columns lambda: expected values"),
        ("theta_i,phi_i,theta_o,phi_o,Wavelength (nm)\n1,2,30,4,450\n", "Wavelength .nm.: expected values"),
        ("theta_i,phi_i,theta_o,phi_o,465,spin\n10,20,30,40,5,6\n", "columns spin: expected values"),
        (
            "theta_i,phi_i,theta_o,phi_o,465,sigma\n10,20,30,40,5,-6\n",
            "a negative uncertainty in column 'sigma'",
        ),
        (
            "10,20,30,40,5\ntheta_i,phi_i,theta_o,phi_o,465\n10,20,30,40,5\n",
            "row 1: readings above the header",
        ),
        (
            'theta_i,phi_i,theta_o,phi_o,465\n10,20,30,40,"5\n20,20,30,40,5"\n',
            "row 2: a quote that does not end",
        ),
        ("theta_i,phi_i,theta_o,phi_o,465\n10,0,170,0,0.5\n", "no rows of reflected light"),
    ],
)
def test_tables_of_directions_that_cannot_be_read_say_why(table, words, tmp_path):
    path = tmp_path / "bad.csv"
    path.write_text(table)
    with pytest.raises(FileFormatError, match=words):
        registry.read_all(path)


def test_a_wavelength_that_a_pair_lacks_is_not_measured(tmp_path):
    path = tmp_path / "tidy.csv"
    path.write_text("theta_i,theta_o,nm,BRDF\n10,30,450,0.1\n10,30,550,0.2\n10,40,550,0.3\n10,40,450,\n")
    np.testing.assert_array_equal(registry.read_readings(path).values, [[0.1, 0.2], [np.nan, 0.3]])


def test_rows_of_which_each_has_a_wavelength_of_its_own_are_refused(tmp_path):
    path = tmp_path / "time.csv"
    rows = "".join(f"{k},30,{400 + 0.1 * k:.1f},0.1\n" for k in range(60))
    path.write_text("theta_i,theta_o,wavelength,BRDF\n" + rows)
    with pytest.raises(
        FileFormatError, match="60 wavelengths at 60 pairs of directions in 62 rows: few have a value"
    ):
        registry.read_all(path)


def scan(values_of, theta_i=(15.0, 45.0)) -> tuple[Array, str]:
    """theta_i and theta_o in degrees in the plane of incidence, the light's side negative, and a table of values."""
    angles = np.array([(i, o) for i in theta_i for o in np.arange(-75.0, 76.0, 5.0)])
    return angles, "theta_i (deg),theta_o (deg),465,525,630\n" + lines(
        angles, np.repeat(values_of(*angles.T)[:, None], 3, 1)
    )


def test_zeros_where_the_receiver_hides_the_light_are_no_readings(tmp_path):
    path = tmp_path / "scan.csv"
    angles, table = scan(lambda i, o: np.where(np.abs(i + o) <= 10.0, 0.0, 0.2))
    path.write_text(table)
    found = registry.read_readings(path)
    assert len(found) == len(angles) - 10
    assert np.all(found.values == 0.2)
    assert any("10 readings around the light are zero" in note for note in found.notes)
    assert not np.any(np.einsum("pi,pi->p", found.wi, found.wo) > np.cos(np.deg2rad(14.0)))


@pytest.mark.parametrize(
    "values_of",
    [
        lambda i, o: np.where(np.abs(i - o) <= 10.0, 5.0, 0.0),  # a mirror, whose sides are black
        lambda i, o: np.where((i + o <= 0.0) & (i + o > -20.0), 1e-3, 0.2),  # dark, but not zero
        lambda i, o: np.where(np.abs(np.abs(i + o) - 15.0) <= 0.1, 0.0, 0.2),  # zeros beside the light
    ],
)
def test_other_zeros_are_readings(values_of, tmp_path):
    path = tmp_path / "scan.csv"
    angles, table = scan(values_of)
    path.write_text(table)
    found = registry.read_readings(path)
    assert len(found) == len(angles)
    assert not any("hides" in note for note in found.notes)


@pytest.mark.parametrize("name", ["lighttools", "fred", "speos", "openmaterial", "utia"])
def test_hidden_nodes_of_tables_are_no_readings(name, tmp_path):
    bands, axes = {"utia": (Bands(None), utia.axes()), "fred": (Bands((550.0,)), lighttools_axes())}.get(
        name, (BANDS, lighttools_axes())
    )
    table = dense(bands, "incident-outgoing", axes)
    wi, wo = (w.reshape(*table.values.shape[:-1], 3) for w in table.directions())
    shadow = np.einsum("...i,...i->...", wi, wo) > np.cos(np.deg2rad(8.0))
    path = tmp_path / SUFFIXES[name]
    module = {
        "lighttools": lighttools,
        "fred": fred,
        "speos": speos,
        "openmaterial": openmaterial,
        "utia": utia,
    }
    module[name].write(path, replace(table, values=np.where(shadow[..., None], 0.0, table.values)))
    found = registry.read_readings(path)
    assert any("around the light are zero" in note for note in found.notes)
    assert np.min(found.values) > 0.0


HEAD = "theta_i,theta_o,phi,value\n"


def test_an_incidence_beyond_90_degrees_is_an_error_that_names_the_row(tmp_path):
    path = tmp_path / "table.csv"
    path.write_text(HEAD + "45,0,0,0.1\n95,20,0,0.1\n30,10,180,0.1\n")
    with pytest.raises(FileFormatError, match="row 3: incidence of 95 degrees, expected at most 90"):
        registry.read_readings(path)


def test_one_row_of_transmitted_light_is_noted_in_the_singular(tmp_path):
    path = tmp_path / "table.csv"
    path.write_text(HEAD + "45,0,0,0.1\n45,100,0,0.1\n30,10,180,0.1\n")
    notes = registry.read_readings(path).notes
    assert "1 row of transmitted light (beyond 90 degrees) is left out" in notes


def test_the_note_on_the_mirror_direction_has_the_heading_of_the_file(tmp_path):
    path = tmp_path / "table.csv"
    path.write_text(HEAD + "45,0,0,0.1\n30,10,180,0.1\n")
    found = registry.read_readings(path)
    said = [note for note in found.notes if "mirror direction is taken at phi = 0 degrees" in note]
    assert len(said) == 1
    assert isinstance(said[0], Assumption)


def test_rows_of_negative_values_are_named(tmp_path):
    path = tmp_path / "table.csv"
    path.write_text(HEAD + "45,0,0,0.1\n45,20,0,-0.2\n30,10,180,-0.1\n20,50,180,0.1\n")
    notes = registry.read_readings(path).notes
    assert "row 3, row 4: negative values, which count as 0" in notes


def test_a_row_far_brighter_than_a_diffuser_away_from_the_mirror_direction_is_named(tmp_path):
    """Flakes make L* above 100 near the mirror direction, as in the second row."""
    path = tmp_path / "lab.csv"
    lightness = {"45as-15": 60, "45as15": 140, "45as25": 64, "45as45": 52, "45as75": 138, "45as110": 48}
    path.write_text(
        "Geometry,L* (D65/10),a* (D65/10),b* (D65/10)\n"
        + "".join(f"{name},{L},1,1\n" for name, L in lightness.items())
    )
    said = [note for note in registry.read_readings(path).notes if "perfect diffuser" in note]
    assert len(said) == 1
    assert said[0].startswith("row 6: 2.34 times as bright")


def test_notes_on_assumptions_come_first_once():
    unit = Assumption("no unit given")
    assert assumptions_first(["a", unit, "b", "a"]) == (unit, "a", "b")


@pytest.mark.parametrize(("unit", "f"), [("brdf", 0.4), ("factor", 0.4 / np.pi), ("percent", 0.004 / np.pi)])
def test_a_unit_may_be_given_where_the_file_says_none(tmp_path, unit, f):
    path = tmp_path / "table.csv"
    path.write_text(
        "theta_i,phi_i,theta_o,phi_o,value\n" + "".join(f"{a},180,{a},0,0.4\n" for a in (10, 20, 30, 40))
    )
    assert registry.read_readings(path).values.max() == pytest.approx(0.4)
    found = registry.read_readings(path, unit=unit)
    np.testing.assert_allclose(found.values, f)
    assert not any("no unit" in note for note in found.notes)


def test_a_unit_is_refused_where_the_file_says_one_or_there_is_none_such(tmp_path):
    path = tmp_path / "table.csv"
    path.write_text(
        "theta_i,phi_i,theta_o,phi_o,BRDF\n" + "".join(f"{a},180,{a},0,0.4\n" for a in (10, 20, 30, 40))
    )
    with pytest.raises(UsageError, match="states its unit; leave --unit percent out"):
        registry.read_readings(path, unit="percent")
    path.write_text(path.read_text().replace("BRDF", "value"))
    with pytest.raises(UsageError, match="no unit is called 'nits', expected one of brdf, factor, percent"):
        registry.read_readings(path, unit="nits")

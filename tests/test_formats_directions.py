"""Tables of directions as goniometers and people write them: units of angles, azimuths, what the values are."""

from __future__ import annotations

import re

import numpy as np
import pytest
from instrument_files import smooth

from manifold.directions import from_spherical
from manifold.errors import FileFormatError
from manifold.formats import registry
from manifold.formats.angle_columns import RELATIVE, angle_name
from manifold.records import Array, Bands

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


def test_a_btdf_is_refused(tmp_path):
    path = tmp_path / "glass.astm"
    path.write_text(
        'MEAS_NAME "BTDF"\nVARS theta_i,phi_i,theta_s,phi_s,465nm,525nm,630nm\n'
        + lines(np.deg2rad(DIRECTIONS), truth(DIRECTIONS))
    )
    with pytest.raises(FileFormatError, match="MEAS_NAME is BTDF: transmitted light"):
        registry.read_all(path)


@pytest.mark.parametrize(
    ("head", "name"),
    [
        ("theta_i", "theta_i"), ("ThetaIn [rad]", "theta_i"), ("Incident angle (deg)", "theta_i"), ("AOI", "theta_i"),
        ("theta_i_deg", "theta_i"), ("\u03b8i [\u00b0]", "theta_i"), ("SZA", "theta_i"), ("Source zenith", "theta_i"),
        ("phi_in", "phi_i"), ("incident azimuth", "phi_i"), ("scatter_theta", "theta_o"), ("thetaR", "theta_o"),
        ("Viewing zenith angle", "theta_o"), ("detector angle", "theta_o"), ("\u03c6_r", "phi_o"), ("phi", "phi_o"),
        ("Viewing azimuth angle", "phi_o"), ("dphi", RELATIVE), ("relative azimuth", RELATIVE), ("theta_h", None),
        ("theta_d", None), ("phi_d", None), ("Angle", None), ("465nm", None), ("R", None), ("time", None),
    ],
)  # fmt: skip
def test_angles_are_known_in_every_spelling(head, name):
    assert angle_name(head) == name


RADIANS = np.deg2rad(DIRECTIONS)
HEAD = "theta_i,phi_i,theta_o,phi_o,465,525,630"
VALUES = truth(DIRECTIONS)
TABLES = {
    "degrees, not said": f"{HEAD}\n" + lines(DIRECTIONS, VALUES),
    "radians, not said": f"{HEAD}\n" + lines(RADIANS, VALUES),
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
    "percent, not said": f"{HEAD}\n" + lines(DIRECTIONS, 100.0 * np.pi * VALUES),
    "factors": f"# Bidirectional reflectance factor\n{HEAD}\n" + lines(DIRECTIONS, np.pi * VALUES),
    "BRF": HEAD.replace(",465", ",BRF 465") + "\n" + lines(DIRECTIONS, np.pi * VALUES),
    "times the cosine": HEAD.replace(",465", ",BRDF*cos 465") + "\n" + lines(DIRECTIONS, COSINE * VALUES),
    "differences of azimuths": "theta_i,theta_o,dphi,465,525,630\n"
    + lines(DIRECTIONS[:, [0, 2]], DIRECTIONS[:, 3:] - 180.0, VALUES),
    "a row per wavelength": "wavelength,theta_i,phi_i,theta_o,phi_o,BRDF\n"
    + "".join(
        lines(np.full((len(VALUES), 1), BANDS.wavelengths_nm[k]), DIRECTIONS, VALUES[:, k : k + 1])
        for k in (2, 0, 1)
    ),
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
    ("head", "expected"),
    [("BRDF", None), ("value", "no unit given: taken as BRDF in 1/sr"), ("Reflectance", "divided by pi")],
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
    ("table", "words"),
    [
        ("theta_i,phi_i,theta_o,phi_o,u,v\n1,2,3,4,5,6\n", "expected values beside the directions"),
        ("theta_i,theta_i,theta_o,phi_o,465\n1,2,3,4,5\n", "theta_i appears twice"),
        ("theta_i,phi_i,theta_o,phi_o,465\n1,2,x,4,5\n", "row 2, theta_o: found 'x'"),
        ("theta_i,phi_i,theta_o,phi_o,465\n1,2,3,4,5\n,,,,6\n", "row 3: values without directions"),
        ("theta_i,phi_i,theta_o,phi_o,465,525\n1,2,3,4,0.5,O.3\n", "row 2, column 6: found 'O.3'"),
        ("theta_i,phi_i,theta_o,phi_o,465\n", "a header but no rows"),
        ("theta_i,phi_i,theta_o,phi_o,465,465\n1,2,3,4,5,6\n", "two columns of '465'"),
        ("theta_i,phi_i,theta_o,phi_o,465\n10,0,170,0,0.5\n", "no rows of reflected light"),
    ],
)
def test_tables_of_directions_that_cannot_be_read_say_why(table, words, tmp_path):
    path = tmp_path / "bad.csv"
    path.write_text(table)
    with pytest.raises(FileFormatError, match=words):
        registry.read_all(path)


def pab_opto(directions_deg: Array, values: Array, quantity: str = "BSDF") -> str:
    """A file of one incidence, that of the first row."""
    theta, phi = directions_deg[0, :2]
    head = f"#format: theta phi {quantity}\n" if quantity else ""
    return f"#incident_angle {theta:g} {phi:g}\n#wavelength 465\n{head}" + lines(
        directions_deg[:, 2:], values[:, :1], separator="\t"
    )


def test_a_pab_opto_sample_lit_from_behind_is_turned_over_not_mirrored(tmp_path):
    """A rotation about the x axis: azimuths change their sense with the side."""
    path = tmp_path / "back.txt"
    path.write_text(pab_opto(np.array([[140.0, 30.0, 120.0, 250.0]]), np.array([[0.2]])))
    found = registry.read_readings(path)
    turned = [from_spherical(np.deg2rad(t), np.deg2rad(p)) * [1, -1, -1] for t, p in ((140, 30), (120, 250))]
    np.testing.assert_allclose([found.wi[0], found.wo[0]], turned, atol=1e-12)


def test_pab_opto_quantities_are_said_or_refused(tmp_path):
    rows, values = DIRECTIONS[9:18], VALUES[9:18]
    path = tmp_path / "one.txt"
    path.write_text(pab_opto(rows, values, ""))
    assert registry.read_readings(path).notes == ("no line #format: values are taken as BSDF in 1/sr",)
    path.write_text(pab_opto(rows, values, "BTDF"))
    with pytest.raises(FileFormatError, match="transmitted light"):
        registry.read_all(path)


@pytest.mark.parametrize("text", ["465", "465 nm", "0.465", "0.465 um", "465.0nm", "0,465"])
def test_wavelengths_of_pab_opto_files_are_nanometres_or_micrometres(text, tmp_path):
    path = tmp_path / "one.txt"
    path.write_text(pab_opto(DIRECTIONS[9:18], VALUES[9:18]).replace("wavelength 465", f"wavelength: {text}"))
    assert registry.read_readings(path).bands == Bands((465.0,))

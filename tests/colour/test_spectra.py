"""Indices, reflectances and colour."""

from __future__ import annotations

import os
import subprocess
import sys
import warnings

import numpy as np
import pytest

from manifold.colour.colour_science import OBSERVER, standard_tables
from manifold.colour.conversion import (
    SRGB_TO_XYZ,
    InvisibleBandsWarning,
    decode_srgb,
    encode_srgb,
    luminance,
    to_srgb,
    to_xyz,
    xyz_to_srgb,
)
from manifold.colour.difference import is_beyond_reflectances
from manifold.colour.illuminants import illuminant_names
from manifold.colour.reflectances import (
    beyond_reflectances,
    diffuse_reflectance,
    diffuse_reflectance_names,
    metal_ior,
    metal_names,
)
from manifold.core.errors import ShapeError, UsageError
from manifold.core.records import Bands
from manifold.io_rgl import rgl_wavelengths_nm

WAVELENGTHS = rgl_wavelengths_nm()
BANDS = Bands.from_array(WAVELENGTHS)


def test_colours_of_reflectances_lie_within_their_solid_and_stronger_ones_do_not():
    nm = np.arange(380.0, 781.0, 5.0)
    bands = Bands(tuple(nm.tolist()))
    for name in ("ohta/red", "ohta/yellow", "ohta/cyan"):
        assert beyond_reflectances(to_srgb(diffuse_reflectance(name, nm), bands)) < 0.0
    step = np.where(nm > 580.0, 1.0, 0.0)  # an optimal colour, on the surface of the solid
    assert abs(beyond_reflectances(to_srgb(step, bands))) < 0.01
    for lab, is_beyond in (
        ((40, 500, 3), True),
        ((75, 60, 90), False),
        ((50, 20, 10), False),
        ((0.3, 0.5, -0.4), False),
    ):
        assert is_beyond_reflectances(np.array(lab, float)) == is_beyond


def test_metal_index_at_a_node_of_the_table_is_the_table_value():
    # Johnson & Christy's gold, line "551.040771" of both files.
    eta, k = metal_ior("Au", np.array([551.040771]))
    assert (eta[0], k[0]) == (0.3455, 2.730625)


def test_every_shipped_metal_gives_finite_non_negative_indices_on_all_bands():
    for name in metal_names():
        eta, k = metal_ior(name, WAVELENGTHS)
        assert eta.shape == k.shape == (195,)
        assert np.all(np.isfinite(eta) & np.isfinite(k) & (eta > 0) & (k >= 0)), name


def test_unknown_metal_lists_the_known_ones():
    with pytest.raises(UsageError, match=r"'gold'.*Ag, Al.*Au"):
        metal_ior("gold", WAVELENGTHS)


def test_diffuse_reflectances_are_physical_on_all_bands():
    names = diffuse_reflectance_names()
    assert len(names) > 100
    for name in names:
        value = diffuse_reflectance(name, WAVELENGTHS)
        assert value.shape == (195,)
        assert np.all((value >= 0) & (value <= 1)), name


def test_perfect_diffuser_has_luminance_one_and_is_white_under_every_illuminant():
    names = illuminant_names()
    assert {"D65", "A", "E", "F2", "F11", "LED-B1"} <= set(names)
    for name in names:
        assert to_xyz(np.ones(195), BANDS, name)[1] == pytest.approx(1.0, abs=1e-12), name
        # rtol: rounding of a 3x3 inverse
        np.testing.assert_allclose(to_srgb(np.ones(195), BANDS, name), 1.0, rtol=1e-12)


def test_xyz_of_a_smooth_reflectance_agrees_with_colour_science():
    import warnings

    import colour

    patch = colour.SDS_COLOURCHECKERS["ColorChecker N Ohta"]["orange"]
    bands = Bands.from_array(patch.wavelengths)
    for name in ("D65", "A", "FL2"):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            expected = colour.sd_to_XYZ(patch, illuminant=colour.SDS_ILLUMINANTS[name]) / 100
        # 2e-3: colour interpolates by Sprague's polynomial or sums at 5 nm, we are linear at 1 nm
        np.testing.assert_allclose(to_xyz(patch.values, bands, name), expected, atol=2e-3)


def test_colour_does_not_depend_on_how_unevenly_the_bands_are_placed(rng):
    uneven = np.sort(np.concatenate([rng.uniform(361, 829, 300), [360.0, 830.0]]))
    even = np.linspace(360, 830, 95)

    def line(nm: np.ndarray) -> np.ndarray:
        return 0.2 + 0.6 * (nm - 360) / 470

    a = to_xyz(line(uneven), Bands.from_array(uneven))
    b = to_xyz(line(even), Bands.from_array(even))
    # a straight line is represented exactly by linear interpolation, whatever the nodes
    np.testing.assert_allclose(a, b, rtol=1e-12)


def test_rgb_values_keep_their_colour_and_give_the_luminance_of_rec_709():
    rgb = Bands(None)
    values = np.array([[0.2, 0.5, 0.7], [1.0, 1.0, 1.0]])
    assert np.array_equal(to_srgb(values, rgb, "D65"), values)
    y = luminance(values, rgb)
    np.testing.assert_allclose(y, values @ [0.2126, 0.7152, 0.0722], atol=1e-4)  # the standard's 4 digits
    np.testing.assert_allclose(to_xyz(values, rgb)[:, 1], y, rtol=1e-12)


def test_unknown_illuminant_suggests_near_names_even_for_rgb():
    for values, bands in ((np.ones(195), BANDS), (np.ones(3), Bands(None))):
        with pytest.raises(UsageError, match="did you mean D65"):
            to_srgb(values, bands, "D66")


def test_wrong_number_of_bands_is_refused():
    with pytest.raises(ShapeError, match="195"):
        to_xyz(np.ones(194), BANDS)


def test_standard_tables_are_those_of_colour_science(tmp_path, monkeypatch):
    import colour

    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    for made in ("computed", "kept"):  # the second from the file that the first left
        standard_tables.cache_clear()
        tables = standard_tables()
        assert list(tables.illuminants) == list(colour.SDS_ILLUMINANTS), made
        np.testing.assert_array_equal(tables.illuminants["D65"][1], colour.SDS_ILLUMINANTS["D65"].values)
        np.testing.assert_array_equal(tables.observer[1], colour.MSDS_CMFS[OBSERVER].values)
    standard_tables.cache_clear()
    srgb = colour.RGB_COLOURSPACES["sRGB"]
    matrix = colour.normalised_primary_matrix(srgb.primaries, srgb.whitepoint)
    np.testing.assert_allclose(SRGB_TO_XYZ, matrix, rtol=1e-14)
    assert [path.name for path in (tmp_path / "manifold").iterdir()] == ["colour-science.json"]


def test_white_is_adapted_as_by_colour_science():
    import colour

    a, d65 = (to_xyz(np.ones(195), BANDS, name) for name in ("A", "D65"))
    matrix = colour.adaptation.matrix_chromatic_adaptation_VonKries(a, d65, transform="Bradford")
    xyz = np.array([0.2, 0.3, 0.1])
    expected = xyz_to_srgb(matrix @ xyz, d65)
    np.testing.assert_allclose(xyz_to_srgb(xyz, a), expected, rtol=1e-12)


def test_display_values_are_those_of_colour_science():
    from colour.models import eotf_inverse_sRGB, eotf_sRGB

    x = np.linspace(0.0, 1.0, 1001)
    np.testing.assert_allclose(encode_srgb(x), eotf_inverse_sRGB(x), rtol=1e-15)
    np.testing.assert_allclose(decode_srgb(x), eotf_sRGB(x), rtol=1e-15)


def test_colour_is_imported_lazily_and_quietly(tmp_path):
    code = (
        "import sys; from manifold import colour; assert 'colour' not in sys.modules;"
        "colour.metal_ior('Au', [550.0]); assert 'colour' not in sys.modules;"
        "assert 'mitsuba' not in sys.modules; colour.illuminant_names()"
    )
    environment = os.environ | {"XDG_CACHE_HOME": str(tmp_path)}  # where nothing is kept yet
    for check in ("assert 'colour' in sys.modules", "assert 'colour' not in sys.modules"):
        done = subprocess.run(
            [sys.executable, "-c", f"{code}; {check}"],
            capture_output=True,
            text=True,
            check=True,
            env=environment,
        )
        assert done.stdout == ""
        assert done.stderr == ""


@pytest.mark.parametrize("nm", [(850.5, 940.5, 1050.5), (250.5, 300.5, 350.5), (350.5, 900.5), (905.5,)])
def test_bands_beyond_the_visible_are_said_to_have_no_colour(nm):
    with pytest.warns(InvisibleBandsWarning, match=f"{nm[0]:.1f}.*have no colour"):
        to_srgb(np.ones(len(nm)), Bands(nm))


@pytest.mark.parametrize("nm", [None, (340.0, 500.0, 900.0), (550.0,)])
def test_one_visible_band_is_a_colour(nm):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        colour = to_srgb(np.ones(Bands(nm).count), Bands(nm))
    assert colour.shape == (3,)
    assert np.all(np.isfinite(colour))
    assert colour.max() > 0.0
